//! A connection that reads.

use super::{Conn, Db};
use sqlx::Transaction;
use sqlx::pool::PoolConnection;
use std::ops::{Deref, DerefMut};

/// Reads outside of a transaction; behind a pooler, inside one that is rolled back when it is dropped.
pub(super) enum Reader {
    Own(PoolConnection<Db>),
    Pooled(Transaction<'static, Db>),
}

impl Reader {
    /// Gives it back: this engine's pool asks its server all the same, which may be gone.
    pub(super) fn settle(self) {
        drop(self);
    }
}

impl Deref for Reader {
    type Target = Conn;
    fn deref(&self) -> &Conn {
        match self {
            Self::Own(conn) => conn,
            Self::Pooled(transaction) => transaction,
        }
    }
}

impl DerefMut for Reader {
    fn deref_mut(&mut self) -> &mut Conn {
        match self {
            Self::Own(conn) => conn,
            Self::Pooled(transaction) => transaction,
        }
    }
}
