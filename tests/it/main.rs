//! One binary with every story; a module per subject.

#![expect(clippy::float_cmp, reason = "what was stored comes back to the bit")]
#![expect(clippy::unwrap_used, reason = "helpers of stories are part of the stories")]

mod friction;
mod http;
mod shop;
mod store;
