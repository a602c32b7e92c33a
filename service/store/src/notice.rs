//! Short messages between servers on one database. They are told, not kept: whoever does not listen misses them.

use crate::error::StoreResult;
use async_trait::async_trait;

/// Listens on a connection of its own, straight to the server: a pooler in transaction mode would lose it.
#[async_trait]
pub trait Notices: Send + Sync + 'static {
    /// Connects and listens.
    async fn listen(&self) -> StoreResult<Box<dyn Listener>>;
}

/// A connection that listens. Dropping it, at any time, closes it.
#[async_trait]
pub trait Listener: Send + 'static {
    /// The next message, as it was sent. An error ends it: what is told until somebody listens again is missed.
    async fn next(&mut self) -> StoreResult<String>;
}
