//! One binary with every story; a module per subject.
#![expect(clippy::unwrap_used, reason = "a story that cannot go on fails where it stands")]

mod recordings;
