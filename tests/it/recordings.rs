//! Recordings of real machines: what is said of their tools, and that replaying them loses and doubles nothing.
#![expect(clippy::unwrap_used, reason = "a story that cannot go on fails where it stands")]

mod judged;
