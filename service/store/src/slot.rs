//! One value that is taken out to be worked on and put back when the work has succeeded.

use std::sync::{Mutex, PoisonError};

/// Holds a value, or its default while somebody has it.
#[derive(Debug, Default)]
pub(crate) struct Slot<T> {
    value: Mutex<T>,
}

impl<T: Default> Slot<T> {
    /// Takes the value out.
    pub(crate) fn take(&self) -> T {
        std::mem::take(&mut *self.value.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Puts a value back; what somebody else has put here since is dropped.
    pub(crate) fn put(&self, value: T) {
        *self.value.lock().unwrap_or_else(PoisonError::into_inner) = value;
    }
}
