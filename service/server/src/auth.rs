//! Who calls, and what they may do.
//!
//! A token, or the session that a browser began with one, is looked up by its hash. A token is believed for two
//! seconds: a revocation acts on the next request of this process, and within that time where another process or
//! replica did it. While the database cannot be asked, `/metrics` alone believes what it knew within the last hour. A session
//! is looked up every time. Which role may use which
//! route stands in one place, the table in `http/routes.rs`; nothing here knows a path.

mod caller;
mod failures;
mod known;
mod session;
mod token;

pub use caller::Caller;
pub(crate) use caller::{Peer, Trust, authenticate_token, authorise};
pub(crate) use failures::FailedAuthentications;
pub(crate) use known::KnownTokens;
pub use session::{BegunSession, MOST_SESSIONS, PAGE_HEADER, Session, forgotten, from_own_page, over_tls};
pub use token::{Issued, Token};
