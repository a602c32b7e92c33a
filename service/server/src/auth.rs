//! Who calls, and what they may do.
//!
//! A token is looked up by its hash, and believed for two seconds: a revocation acts on the next request of this
//! process, and within that time where another process or replica did it. Which role may use which
//! route stands in one place, the table in `http/routes.rs`; nothing here knows a path.

mod caller;
mod failures;
mod known;
mod token;

pub(crate) use caller::Peer;
pub use caller::{Caller, authorise};
pub(crate) use failures::FailedAuthentications;
pub(crate) use known::KnownTokens;
pub use token::{Issued, Token};
