//! Short messages between servers on one database. They are told, not kept: whoever does not listen misses them.

use crate::error::StoreResult;
use async_trait::async_trait;

/// What a listener hears.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Notice {
    /// A message, as it was sent.
    Text(String),
    /// The connection broke and stands again: messages in between are lost.
    Missed,
}

/// Listens on a connection of its own, straight to the server: a pooler in transaction mode would lose it.
#[async_trait]
pub trait Notices: Send + Sync + 'static {
    /// Connects and listens.
    async fn listen(&self) -> StoreResult<Box<dyn Listener>>;
}

/// A connection that listens. Dropping it, at any time, closes it.
#[async_trait]
pub trait Listener: Send + 'static {
    /// The next message. An error ends it.
    async fn next(&mut self) -> StoreResult<Notice>;
}
