//! The transaction of a group: begun and asked first, or assumed and held against the database when it is needed.
//!
//! Where memory holds what a group rests on and all its cycles are taken to be new, nothing has to be asked before the
//! group is written: what was assumed is checked in the statement that writes it. Where it does not hold, nothing was
//! written, and the group is counted again from what the database says.

use super::{Conn, dialect};
use crate::error::{StoreError, StoreResult};
use crate::rows::{CycleRow, Rest};
use crate::work::Written;
use feedwright_core::units::Timestamp;
use std::sync::Arc;

/// A group's connection and how far its transaction is.
pub(super) struct GroupTransaction<'c> {
    conn: &'c mut Conn,
    state: State,
}

enum State {
    /// Begun, with the cycles of the group inserted where that was assumed.
    Begun,
    /// Not begun: what it rests on, and the cycles that are taken to be new.
    Assumed(dialect::Assumption, Vec<Arc<CycleRow>>),
    /// What was assumed does not hold.
    Refuted,
}

impl<'c> GroupTransaction<'c> {
    /// One that has begun.
    pub(super) const fn begun(conn: &'c mut Conn) -> Self {
        Self { conn, state: State::Begun }
    }

    /// One that rests on the heads of the group's tools until it begins.
    pub(super) fn assumed(conn: &'c mut Conn, assumption: dialect::Assumption) -> Self {
        Self { conn, state: State::Assumed(assumption, Vec::new()) }
    }

    /// The connection, with the transaction begun.
    ///
    /// # Errors
    ///
    /// As the database; also where what was assumed does not hold, see [`GroupTransaction::is_refuted`].
    pub(super) async fn conn(&mut self) -> StoreResult<&mut Conn> {
        match std::mem::replace(&mut self.state, State::Begun) {
            State::Begun => Ok(self.conn),
            State::Assumed(assumption, cycles) => {
                if dialect::begin_assumed(self.conn, &assumption, &cycles).await? {
                    Ok(self.conn)
                } else {
                    self.refute()
                }
            }
            State::Refuted => self.refute(),
        }
    }

    /// Takes cycles of different keys to be new, in ascending order of their keys; they are inserted when the transaction
    /// begins. `false` where it has begun, and whoever asks has to insert them.
    pub(super) fn takes_as_new(&mut self, rows: &[Arc<CycleRow>]) -> bool {
        match &mut self.state {
            State::Assumed(_, cycles) => {
                cycles.extend(rows.iter().cloned());
                true
            }
            State::Begun | State::Refuted => false,
        }
    }

    /// Writes the rest of the group and, where this engine's groups end their own transaction, commits it.
    ///
    /// # Errors
    ///
    /// As [`GroupTransaction::conn`].
    pub(super) async fn write(&mut self, rest: &Rest<'_>, now: Timestamp) -> StoreResult<Written> {
        match std::mem::replace(&mut self.state, State::Begun) {
            State::Begun => dialect::write_rest(self.conn, rest, now).await,
            State::Assumed(assumption, cycles) => {
                match dialect::write_assumed(self.conn, &assumption, &cycles, rest, now).await? {
                    Some(written) => Ok(written),
                    None => self.refute(),
                }
            }
            State::Refuted => self.refute(),
        }
    }

    /// Whether it failed because what was assumed does not hold: then nothing of the group is stored.
    pub(super) const fn is_refuted(&self) -> bool {
        matches!(self.state, State::Refuted)
    }

    fn refute<T>(&mut self) -> StoreResult<T> {
        self.state = State::Refuted;
        Err(StoreError::Unavailable("what a group was taken to rest on does not hold".into()))
    }
}
