//! Who calls, and what they may do.
//!
//! A token, or the session that a browser began with one, is looked up by its hash at every request, so a revocation
//! acts on the next one. Which role may use which
//! route stands in one place, the table in `http/routes.rs`; nothing here knows a path.

mod caller;
mod failures;
mod session;
mod token;

pub use caller::{Caller, authorise};
pub(crate) use caller::{Peer, authenticate_token};
pub(crate) use failures::FailedAuthentications;
pub use session::{BegunSession, MOST_SESSIONS, PAGE_HEADER, Session, forgotten, from_own_page, over_tls};
pub use token::{Issued, Token};
