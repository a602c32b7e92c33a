//! What runs in a transaction.

use crate::error::StoreResult;
use std::future::Future;
use std::pin::Pin;

/// Work on a borrowed connection. A box, because the borrow has to be named.
pub(crate) type Work<'c, T> = Pin<Box<dyn Future<Output = StoreResult<T>> + Send + 'c>>;

/// A group is written. On an engine whose group begins and ends its own transaction, it is on the disk, committed or in a
/// journal: only what writes the last of a group makes one, so that no group is answered that could be lost.
#[derive(Debug)]
pub(crate) struct Written(());

impl Written {
    /// Said by what writes the last of a group.
    pub(crate) const fn whole() -> Self {
        Self(())
    }
}
