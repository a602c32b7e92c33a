//! The live view, read over real sockets as a page reads it.

mod elsewhere;
pub(crate) mod reader;
mod served;
mod session;
mod shown;
mod slow;

pub(crate) use served::Served;
