//! The live view, read over real sockets as a page reads it.

pub(crate) mod reader;
mod served;
mod session;
mod shown;
mod slow;

pub(crate) use served::Served;
