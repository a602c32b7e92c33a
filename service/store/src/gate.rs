//! Counts the changes under way, so that closing can wait for them and refuse later ones.

use crate::error::{StoreError, StoreResult};
use std::sync::Arc;
use tokio::sync::{OwnedRwLockReadGuard, RwLock};

/// The gate that every change passes.
#[derive(Debug, Clone, Default)]
pub(crate) struct Gate {
    shut: Arc<RwLock<bool>>,
}

/// Held by a change until its outcome is known.
#[derive(Debug)]
pub(crate) struct Pass {
    _held: OwnedRwLockReadGuard<bool>,
}

impl Gate {
    /// Lets a change in, unless the gate is shut.
    pub(crate) async fn enter(&self) -> StoreResult<Pass> {
        let held = Arc::clone(&self.shut).read_owned().await;
        if *held {
            return Err(StoreError::Unavailable("the store is closed".into()));
        }
        Ok(Pass { _held: held })
    }

    /// Ends after every change that was let in has ended; lets no further one in.
    pub(crate) async fn shut(&self) {
        *self.shut.write().await = true;
    }
}

/// A change that panicked: its transaction is rolled back before anybody else writes.
pub(crate) fn panicked(error: tokio::task::JoinError) -> StoreError {
    StoreError::Database(Box::new(error))
}
