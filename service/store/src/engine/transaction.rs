//! The transaction of a group: begun and asked first, or assumed and held against the database when it is needed.
//!
//! Where memory holds what a group rests on and all its cycles are taken to be new, nothing has to be asked before the
//! group is written: what was assumed is checked in the transaction that writes it. Where it does not hold, nothing was
//! written, and the group is counted again from what the database says.

use super::{Conn, Writer, alarms, dialect, recommendations};
use crate::error::{StoreError, StoreResult};
use crate::rows::{CycleRow, Rest};
use crate::work::Written;
use feedwright_core::units::Timestamp;
use std::sync::Arc;

/// How far the transaction of a group is, with what writes it.
pub(super) struct GroupTransaction<'c> {
    state: State<'c>,
}

enum State<'c> {
    /// Begun, with the cycles of the group inserted where that was assumed; and whether the database is distributed.
    Begun(&'c mut Conn, bool),
    /// Not begun: what it rests on, and the cycles that are taken to be new.
    Assumed(&'c mut Writer, dialect::Assumption<'c>, Vec<Arc<CycleRow>>),
    /// What was assumed does not hold.
    Refuted,
}

impl<'c> GroupTransaction<'c> {
    /// One that has begun, in a database that is distributed or not.
    pub(super) const fn begun(conn: &'c mut Conn, is_distributed: bool) -> Self {
        Self { state: State::Begun(conn, is_distributed) }
    }

    /// One that rests on the heads of the group's tools until it begins.
    pub(super) const fn assumed(writer: &'c mut Writer, assumption: dialect::Assumption<'c>) -> Self {
        Self { state: State::Assumed(writer, assumption, Vec::new()) }
    }

    /// The connection, with the transaction begun.
    ///
    /// # Errors
    ///
    /// As the database; also where what was assumed does not hold, see [`GroupTransaction::is_refuted`].
    pub(super) async fn conn(&mut self) -> StoreResult<&mut Conn> {
        if let State::Assumed(writer, assumption, cycles) = &mut self.state {
            let holds = dialect::begin_assumed(dialect::asked(writer)?, *assumption, cycles).await?;
            self.state = match std::mem::replace(&mut self.state, State::Refuted) {
                // Where that is assumed the database is a file.
                State::Assumed(writer, ..) if holds => State::Begun(dialect::asked(writer)?, false),
                _ => State::Refuted,
            };
        }
        match &mut self.state {
            State::Begun(conn, _) => Ok(conn),
            State::Assumed(..) | State::Refuted => Err(refuted()),
        }
    }

    /// Takes cycles of different keys to be new, in ascending order of their keys; they are inserted when the transaction
    /// begins. `false` where it has begun, and whoever asks has to insert them.
    pub(super) fn takes_as_new(&mut self, rows: &[Arc<CycleRow>]) -> bool {
        match &mut self.state {
            State::Assumed(_, _, cycles) => {
                cycles.extend(rows.iter().cloned());
                true
            }
            State::Begun(..) | State::Refuted => false,
        }
    }

    /// Writes the rest of the group and, where this engine's groups end their own transaction, commits it.
    ///
    /// # Errors
    ///
    /// As [`GroupTransaction::conn`].
    pub(super) async fn write(&mut self, rest: &Rest<'_>, now: Timestamp) -> StoreResult<Written> {
        match &mut self.state {
            State::Begun(conn, is_distributed) => {
                for row in rest.with_new_advice() {
                    recommendations::keep_advice(conn, row).await?;
                }
                alarms::apply(conn, &rest.alarms, now).await?;
                dialect::write_rest(conn, rest, now, *is_distributed).await
            }
            State::Assumed(writer, assumption, cycles) => {
                match dialect::write_assumed(writer, *assumption, cycles, rest, now)? {
                    Some(written) => Ok(written),
                    None => {
                        self.state = State::Refuted;
                        Err(refuted())
                    }
                }
            }
            State::Refuted => Err(refuted()),
        }
    }

    /// Whether it failed because what was assumed does not hold: then nothing of the group is stored.
    pub(super) const fn is_refuted(&self) -> bool {
        matches!(self.state, State::Refuted)
    }
}

fn refuted() -> StoreError {
    StoreError::Unavailable("what a group was taken to rest on does not hold".into())
}
