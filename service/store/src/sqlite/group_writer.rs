//! Whole groups, row by row, on the thread that calls.
//!
//! Every other connection has a thread of its own, to which each statement is a hop there and back. What is written for
//! every cycle of the shop goes without: a row's statement is made once and runs as often as there are rows, on the
//! thread of the groups ([`super::group_thread`]), which may wait for the disk.

#[cfg(test)]
mod tests;

use super::dialect::{CYCLES, PACK, PLACES, RECOMMENDATIONS, kept_cell};
use super::engine::Heads;
use super::group_blocks::Blocks;
use super::group_folds::Folds;
use super::journal::Journal;
use super::open::{SETTINGS, is_durable};
use super::recommendation_id;
use crate::error::{StoreError, StoreResult};
use crate::rows::{AlarmChange, BlockRow, CycleRow, IssuedRow, Rest, SavedWear, cycle_columns};
use crate::work::Written;
use feedwright_core::ids::{MachineId, ToolId};
use feedwright_core::units::Timestamp;
use rusqlite::{CachedStatement, Connection, OpenFlags};
use std::collections::BTreeSet;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// What the writer of groups keeps of the file, in KiB below zero. Others come from the system's cache; twice and four times
/// as much saved nothing that was seen, with 40 machines or 200 (docs/performance-history.md).
const CACHE: &str = "-1024";

/// Groups of so many cycles are written in one transaction at most: half as many take more of the processor, twice as many no
/// less (docs/performance-history.md).
const MOST_CYCLES: usize = 256;

/// A connection that writes groups. Whoever calls it waits for the disk.
#[derive(Debug)]
pub(super) struct GroupWriter {
    conn: Connection,
    /// The database, where groups may have a journal that is not made yet.
    planned: Option<PathBuf>,
    /// Without one each group is committed by itself.
    journal: Option<Journal>,
    /// Groups that were acknowledged by the journal, and the cycles of them; their transaction is open, where SQLite has
    /// not rolled it back by itself.
    groups: u32,
    cycles: usize,
    /// Whether there are such groups, for who does not hold the writer. Set before anybody hears of the first of them.
    ahead: Arc<AtomicBool>,
    /// When a group was written last, and how long after it another one still follows it.
    last: Option<Instant>,
    soon: Duration,
    /// The transaction may hold a part of a group that was not acknowledged.
    dirty: bool,
    /// The transaction could not be committed: no group is written before it is.
    stuck: bool,
    /// What those groups have counted: a fold that each of them changes is written once, before the commit.
    folds: Folds,
    /// The blocks that they brought, of which packs are made before the commit.
    blocks: Blocks,
}

/// What a group rests on that takes these heads for granted: they are held against the database in the transaction that
/// writes it.
#[derive(Clone, Copy)]
pub(super) struct Assumption<'h> {
    pub(super) heads: &'h Heads,
    /// All tools of the group; those without a version in the heads are taken to have no fold.
    pub(super) tools: &'h BTreeSet<&'h ToolId>,
}

impl<'h> Assumption<'h> {
    /// The versions of a tool's folds.
    pub(super) fn versions(self, tool: &ToolId) -> impl Iterator<Item = (&'h MachineId, i64)> + use<'h> {
        let versions = self.heads.versions.get(tool);
        versions.into_iter().flatten().map(|(machine, version)| (machine, *version))
    }
}

impl GroupWriter {
    /// Opens a file that is there, migrated and in WAL mode.
    pub(super) fn open(path: &Path, patience: Duration) -> StoreResult<Self> {
        // No lock around every call: it is one thread's at any time.
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let conn = Connection::open_with_flags(path, flags)?;
        conn.busy_timeout(patience)?;
        // Rows are held against the same ranges when they are made, which takes far less (docs/performance-history.md). Columns keep
        // their types, and what must be there.
        let own = [("synchronous", "FULL"), ("cache_size", CACHE), ("ignore_check_constraints", "ON")];
        for (name, value) in SETTINGS.into_iter().chain(own) {
            conn.pragma_update(None, name, value)?;
        }
        let text = |name| conn.pragma_query_value(None, name, |row| row.get::<_, String>(0));
        let number = |name| conn.pragma_query_value(None, name, |row| row.get::<_, i64>(0));
        is_durable(&text("journal_mode")?, number("synchronous")?)?;
        if number("foreign_keys")? != 1 {
            return Err(StoreError::NotWritable("foreign keys are not enforced".into()));
        }
        Ok(Self {
            conn,
            planned: None,
            journal: None,
            groups: 0,
            cycles: 0,
            ahead: Arc::default(),
            last: None,
            soon: Duration::ZERO,
            dirty: false,
            stuck: false,
            folds: Folds::default(),
            blocks: Blocks::default(),
        })
    }

    /// From here on transactions may stay open for several groups, which are acknowledged by a journal. It is made when
    /// the first group follows another one.
    ///
    /// A group that comes `soon` after another one is expected to be followed by others as soon. Where none follows, a
    /// journal is one write more than a commit alone.
    pub(super) fn plan_journal(&mut self, path: &Path, soon: Duration) {
        self.planned = Some(path.to_owned());
        self.soon = soon;
    }

    /// Makes the journal that was planned; where it cannot be made, none is planned any more. The database has to know it
    /// before it is written, so no transaction is open.
    fn make_journal(&mut self) {
        let Some(path) = self.planned.take() else { return };
        match Journal::open(&path, &self.conn) {
            Ok(journal) => self.journal = Some(journal),
            Err(error) => {
                let why = error.source().map_or_else(|| error.to_string(), ToString::to_string);
                tracing::warn!(why, "there is no journal of groups: each is committed by itself");
            }
        }
    }

    /// Writes a whole group; it is on the disk when this returns, in the database or in the journal. `None`, with nothing
    /// written, where what was assumed does not hold.
    ///
    /// # Errors
    ///
    /// As the database; [`StoreError::Refused`] where a cycle is stored already, and where a row is bad in itself. Nothing
    /// of the group is written then.
    pub(super) fn write(
        &mut self,
        assumption: Assumption<'_>,
        cycles: &[Arc<CycleRow>],
        rest: &Rest<'_>,
        now: Timestamp,
    ) -> StoreResult<Option<Written>> {
        if self.dirty || self.stuck {
            self.commit()?;
        }
        let begun = Instant::now();
        let follows = self.last.replace(begun).is_some_and(|last| begun - last <= self.soon);
        if self.conn.is_autocommit() {
            if follows {
                self.make_journal();
            }
            self.conn.execute_batch("BEGIN IMMEDIATE")?;
        }
        // Taken back by whoever comes next, if this one panics.
        self.dirty = true;
        let holds = self.run(assumption, cycles, rest, (now, follows));
        let written = holds.and_then(|holds| {
            if holds {
                self.keep(assumption, (cycles.len(), &rest.wear), (now, follows))?;
            } else if self.groups == 0 {
                self.conn.execute_batch("ROLLBACK")?;
            }
            Ok(holds)
        });
        match written {
            Ok(holds) => {
                self.dirty = false;
                Ok(holds.then(Written::whole))
            }
            Err(error) => {
                if let Err(error) = self.take_back() {
                    tracing::error!(%error, groups = self.groups, "acknowledged groups wait in their journal");
                }
                Err(error)
            }
        }
    }

    /// Runs a group's statements in the transaction that is open, and notes them for the journal where it follows another
    /// one; `false`, with none run, where what was assumed does not hold.
    fn run(
        &mut self,
        assumption: Assumption<'_>,
        cycles: &[Arc<CycleRow>],
        rest: &Rest<'_>,
        (now, follows): (Timestamp, bool),
    ) -> StoreResult<bool> {
        if !holds(&self.conn, assumption, &self.folds)? {
            return Ok(false);
        }
        let mut run = Run { conn: &self.conn, journal: self.journal.as_mut().filter(|_| follows) };
        if let Some(journal) = &mut run.journal {
            journal.begin(&self.conn)?;
        }
        insert_cycles(&mut run, cycles)?;
        note_blocks(&mut run, &rest.blocks)?;
        note_wear(&mut run, &rest.wear, now)?;
        change_alarms(&mut run, &rest.alarms, now)?;
        insert_advices(&mut run, rest.with_new_advice())?;
        insert_recommendations(&mut run, &rest.issued)?;
        self.blocks.add(&rest.blocks);
        Ok(true)
    }

    /// Keeps what was run last: by the journal where others will follow soon and it has room, by a commit otherwise.
    fn keep(
        &mut self,
        assumption: Assumption<'_>,
        (cycles, wear): (usize, &[Arc<SavedWear>]),
        (now, follows): (Timestamp, bool),
    ) -> StoreResult<()> {
        if let Some(journal) = self.journal.as_mut().filter(|journal| follows && journal.has_room()) {
            match journal.append() {
                Ok(()) => {
                    self.folds.keep(assumption, wear, now);
                    self.blocks.keep();
                    self.groups += 1;
                    self.cycles += cycles;
                    self.ahead.store(true, Ordering::Release);
                    return Ok(());
                }
                // The commit below has all of the transaction, whatever became of the record.
                Err(error) => {
                    let why = error.source().map_or_else(|| error.to_string(), ToString::to_string);
                    tracing::error!(
                        why,
                        "the groups' journal cannot be written: each is committed from here on"
                    );
                }
            }
        }
        if let Some(journal) = &mut self.journal {
            journal.forget();
        }
        self.end(Some((wear, now)))
    }

    /// Rolls back what a group that failed has run, and runs again what was acknowledged before it in its transaction.
    fn take_back(&mut self) -> StoreResult<()> {
        if let Some(journal) = &mut self.journal {
            journal.forget();
        }
        let rolled_back =
            if self.conn.is_autocommit() { Ok(()) } else { self.conn.execute_batch("ROLLBACK") };
        self.blocks.take_back();
        let outcome = rolled_back.map_err(StoreError::from).and_then(|()| self.resume());
        // Otherwise whoever comes next takes it back, or runs them again.
        self.dirty = !self.conn.is_autocommit() && outcome.is_err();
        self.stuck = outcome.is_err();
        outcome
    }

    /// Begins the transaction again, with all that it had acknowledged, where SQLite has rolled it back.
    fn resume(&mut self) -> StoreResult<()> {
        let touched = |journal: &&Journal| journal.is_touched() && self.conn.is_autocommit();
        let Some(journal) = self.journal.as_ref().filter(touched) else { return Ok(()) };
        self.conn.execute_batch("BEGIN IMMEDIATE")?;
        self.dirty = true;
        let outcome = journal.run_again(&self.conn);
        // Where SQLite has done so by itself there is nothing to roll back.
        if outcome.is_err() && !self.conn.is_autocommit() {
            self.conn.execute_batch("ROLLBACK")?;
        }
        self.dirty = false;
        outcome
    }

    /// Commits what is acknowledged by the journal alone.
    ///
    /// # Errors
    ///
    /// As the database. It stays acknowledged: the next call tries again.
    pub(super) fn commit(&mut self) -> StoreResult<()> {
        if self.dirty {
            self.take_back()?;
        }
        if !self.is_open() {
            return Ok(());
        }
        let outcome = self.resume().and_then(|()| self.end(None));
        self.stuck = outcome.is_err();
        // What it has written for its end is written again next time.
        self.dirty = self.stuck && !self.conn.is_autocommit();
        outcome
    }

    /// Commits the transaction that is open, with the folds that were counted in it, those of its last group included.
    fn end(&mut self, last: Option<(&[Arc<SavedWear>], Timestamp)>) -> StoreResult<()> {
        self.folds.save(&self.conn, last)?;
        self.blocks.save(&self.conn)?;
        // A record that may be on the disk is of an epoch that is over, also where it could not be relied on.
        let journal = self.journal.as_mut().filter(|journal| journal.is_touched());
        if let Some(journal) = &journal {
            journal.note_end(&self.conn)?;
        }
        self.conn.execute_batch("COMMIT")?;
        if let Some(journal) = journal {
            journal.turn();
        }
        (self.groups, self.cycles) = (0, 0);
        self.folds.forget();
        self.blocks.forget();
        self.ahead.store(false, Ordering::Release);
        // What a disk refused once is not tried again.
        self.journal.take_if(|journal| journal.has_failed());
        Ok(())
    }

    /// Whether something has to be committed or taken back before anybody else writes.
    pub(super) fn is_open(&self) -> bool {
        self.groups > 0 || self.dirty || self.journal.as_ref().is_some_and(Journal::is_touched)
    }

    /// Whether something is acknowledged by the journal alone, which nobody who reads the database sees.
    pub(super) const fn is_ahead(&self) -> bool {
        self.groups > 0
    }

    /// The same as long as it writes, for who does not hold it.
    pub(super) fn ahead(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.ahead)
    }

    /// Whether the transaction has as much as it should.
    pub(super) fn is_full(&self) -> bool {
        self.cycles >= MOST_CYCLES || self.journal.as_ref().is_some_and(Journal::is_nearly_full)
    }

    /// Commits, and closes the connection.
    pub(super) fn close(mut self) -> StoreResult<()> {
        let committed = self.commit();
        if let Some(journal) = self.journal.take().filter(|_| committed.is_ok())
            && let Err(error) = journal.remove()
        {
            tracing::debug!(%error, "the groups' journal stays where it is");
        }
        self.abandon().and(committed)
    }

    /// Closes the connection; what is not committed stays in the journal, for whoever opens the database next.
    pub(super) fn abandon(self) -> StoreResult<()> {
        self.conn.close().map_err(|(_, error)| error.into())
    }
}

/// Where a group's statements are run.
struct Run<'c> {
    conn: &'c Connection,
    journal: Option<&'c mut Journal>,
}

/// A statement that is noted for the journal with each row.
struct Noted<'c> {
    statement: CachedStatement<'c>,
    text: &'static str,
}

impl<'c> Run<'c> {
    fn prepare(&self, text: &'static str) -> rusqlite::Result<Noted<'c>> {
        Ok(Noted { statement: self.conn.prepare_cached(text)?, text })
    }
}

/// Whether the heads are those in force.
fn holds(conn: &Connection, assumption: Assumption<'_>, folds: &Folds) -> StoreResult<bool> {
    let heads = assumption.heads;
    let mut in_force = conn.prepare_cached(
        "SELECT (SELECT SUM(changes) FROM registry_generation) IS ?
            AND EXISTS (SELECT 1 FROM feed_profiles WHERE active_version IS NOT NULL) IS ?",
    )?;
    if !in_force.query_row((heads.generation, heads.any_profile), |row| row.get::<_, bool>(0))? {
        return Ok(false);
    }
    for tool in assumption.tools {
        // Nobody else writes the database as long as the transaction is open.
        let same = match folds.versions(tool) {
            Some(versions) => assumption.versions(tool).eq(versions),
            None => are_stored(conn, tool, assumption.versions(tool))?,
        };
        if !same {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Whether these are the versions of a tool's folds in the database.
fn are_stored<'h>(
    conn: &Connection,
    tool: &ToolId,
    mut assumed: impl Iterator<Item = (&'h MachineId, i64)>,
) -> StoreResult<bool> {
    let mut versions = conn
        .prepare_cached("SELECT machine_id, version FROM tool_wear WHERE tool_id = ? ORDER BY machine_id")?;
    // Ids are compared byte by byte there and here.
    let mut rows = versions.query([tool.as_str()])?;
    while let Some(row) = rows.next()? {
        let stored = (row.get_ref(0)?.as_str().map_err(rusqlite::Error::from)?, row.get(1)?);
        if assumed.next().map(|(machine, version)| (machine.as_str(), version)) != Some(stored) {
            return Ok(false);
        }
    }
    Ok(assumed.next().is_none())
}

/// Runs a statement with a row's values, in the order of its parameters.
macro_rules! run {
    ($run:ident, $noted:expr, $($value:expr),* $(,)?) => {{
        let noted = &mut *$noted;
        let mut place = 0;
        if let Some(journal) = &mut $run.journal {
            journal.run(noted.text)?;
        }
        $(
            place += 1;
            let value = $value;
            if let Some(journal) = &mut $run.journal {
                journal.value(&value)?;
            }
            noted.statement.raw_bind_parameter(place, value)?;
        )*
        noted.statement.raw_execute().inspect(|rows| {
            if let Some(journal) = &mut $run.journal {
                journal.ran(*rows);
            }
        })
    }};
}

fn insert_cycles(run: &mut Run<'_>, rows: &[Arc<CycleRow>]) -> rusqlite::Result<()> {
    let mut statement = run.prepare(CYCLES.one())?;
    for row in rows {
        macro_rules! insert_row {
            ($($column:ident: $type:ty = $placeholder:literal $(in $least:literal..=$most:literal)?,)*) => { run!(run, &mut statement, $(kept_cell!(row, $column),)*) };
        }
        cycle_columns!(insert_row)?;
    }
    Ok(())
}

/// Notes blocks for who takes the journal up, each as a pack of its own. They are written before the commit.
fn note_blocks(run: &mut Run<'_>, rows: &[BlockRow<'_>]) -> rusqlite::Result<()> {
    let Some(journal) = &mut run.journal else { return Ok(()) };
    for row in rows {
        journal.stands_for(PACK)?;
        journal.value(&*BlockRow::pack(std::slice::from_ref(row)))?;
        journal.stands_for(PLACES.one())?;
        journal.value(row.machine_id.as_str())?;
        journal.value(&row.received_at_us)?;
        journal.value(row.cycle_id.as_str())?;
        journal.value(&0)?;
        journal.value(&row.bytes())?;
    }
    Ok(())
}

/// Notes for who takes the journal up which folds are behind their cycles. They are written before the commit; nobody
/// believes those that were in force before the transaction, as they are of no version of the rules.
fn note_wear(run: &mut Run<'_>, rows: &[Arc<SavedWear>], now: Timestamp) -> rusqlite::Result<()> {
    let Some(journal) = &mut run.journal else { return Ok(()) };
    for row in rows {
        journal.stands_for(
            "INSERT INTO tool_wear (machine_id, tool_id, folded, fold_version, state, version, updated_at_us, ran)
             VALUES (?, ?, ?, 0, x'', 1, ?, ?)
             ON CONFLICT (machine_id, tool_id) DO UPDATE SET folded = excluded.folded, fold_version = 0,
                 version = tool_wear.version + 1, updated_at_us = excluded.updated_at_us, ran = excluded.ran",
        )?;
        journal.value(row.machine_id.as_str())?;
        journal.value(row.tool_id.as_str())?;
        journal.value(&row.folded)?;
        journal.value(&now.micros())?;
        // It is of these cycles; otherwise all of a tool's would be gone through again.
        journal.value(&row.ran)?;
    }
    Ok(())
}

fn change_alarms(run: &mut Run<'_>, changes: &[AlarmChange], now: Timestamp) -> rusqlite::Result<()> {
    for change in changes {
        match change {
            AlarmChange::ClearVerdicts { tool_id, but } => {
                let mut statement = run.prepare(AlarmChange::CLEAR_VERDICTS)?;
                run!(run, &mut statement, now.micros(), tool_id, but)?;
            }
            AlarmChange::Raise { kind, machine_id, tool_id, message } => {
                let mut statement = run.prepare(AlarmChange::RAISE)?;
                run!(run, &mut statement, kind, machine_id, tool_id, message, now.micros())?;
            }
        }
    }
    Ok(())
}

fn insert_advices<'r>(run: &mut Run<'_>, rows: impl Iterator<Item = &'r IssuedRow>) -> rusqlite::Result<()> {
    let mut statement = run.prepare(IssuedRow::INSERT_ADVICE)?;
    for row in rows {
        run!(run, &mut statement, row.advice.hash.as_slice(), &*row.advice.body)?;
    }
    Ok(())
}

fn insert_recommendations(run: &mut Run<'_>, rows: &[IssuedRow]) -> rusqlite::Result<()> {
    let mut statement = run.prepare(RECOMMENDATIONS.one())?;
    for row in rows {
        run!(
            run,
            &mut statement,
            recommendation_id::to_column(&row.recommendation_id),
            row.advice.hash.as_slice(),
            row.issued_at_us,
            row.valid_until_us,
            row.level_as_run,
            row.level_lowest,
            row.level_highest,
            row.level_n,
            row.level_window,
            row.remaining_cycles,
            row.remaining_low,
            row.remaining_high,
            row.data_age_ms,
            row.level_decides,
            row.level_value,
            row.level_sd,
            &row.machine_id,
            &row.operation_id,
            &row.tool_id,
        )?;
    }
    Ok(())
}
