//! Who calls, and what they may do.
//!
//! A token is looked up by its hash at every request, so a revocation acts on the next one. Which role may use which
//! route stands in one place, the table in `http/routes.rs`; nothing here knows a path.

mod caller;
mod failures;
mod token;

pub(crate) use caller::Peer;
pub use caller::{Caller, authorise};
pub(crate) use failures::FailedAuthentications;
pub use token::{Issued, Token};
