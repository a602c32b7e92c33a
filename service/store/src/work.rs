//! What runs in a transaction.

use crate::error::StoreResult;
use std::future::Future;
use std::pin::Pin;

/// Work on a borrowed connection. A box, because the borrow has to be named.
pub(crate) type Work<'c, T> = Pin<Box<dyn Future<Output = StoreResult<T>> + Send + 'c>>;
