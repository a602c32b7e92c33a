//! The cached fold of each machine's cycles of a tool: stepped, refolded from a checkpoint, composed.
//!
//! What comes late is folded on from the last state before it. Where that is far back, others would wait: the fold is postponed then, its
//! states on the way are those that still hold, and the background goes on from them, some cycles at a time (`outdated.rs`). Until it is
//! whole nothing is told of the tool but that.

mod budget;
mod checkpoints;
pub(in super::super) mod outdated;

pub(in super::super) use budget::Budget;
pub(super) use checkpoints::Of;
pub(super) use outdated::{
    After, Looked, Looks, Unchanged, next_outdated, next_unchanged, note_unchanged, renew,
};

use super::transaction::GroupTransaction;
use super::{Conn, Db, alarms, dialect, operations, tools};
use crate::codec::ran::Ran;
use crate::codec::state;
use crate::error::StoreResult;
use crate::history::{CHECKPOINT_CYCLES, Walk, beginning, verdict_after};
use crate::registry::Registry;
use crate::rows::{FactsRow, Place, PlacedEvent, SavedState, SavedWear, count, id, number};
use checkpoints::{
    are_kept_over_all, checkpoint_before, forget_after, forget_checkpoints, save_checkpoint, take_over,
};
use feedwright_core::ids::{MachineId, ToolId};
use feedwright_core::operation::{Ask, asked_at};
use feedwright_core::summary::EARLIEST_CLOCK;
use feedwright_core::units::Timestamp;
use feedwright_core::wear::{FOLD_VERSION, OrderKey, ToolFold, Verdict};
use outdated::{RAN_OF_TOOL_ON_MACHINE, first_changed, judged_otherwise_since, note_ran, ran_of};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Cycles read at once when refolding; bounds memory, not the work. So many that a page which begins behind a state on the way ends with one.
const FACTS_PAGE: usize = 1024;
const _: () = assert!((FACTS_PAGE as u64).is_multiple_of(CHECKPOINT_CYCLES));

/// Before every cycle.
pub(super) const BEGINNING: Place = Place::at(Timestamp::from_micros(i64::MIN));

/// After every cycle.
const END: Place = Place::at(Timestamp::from_micros(i64::MAX));

/// Version of a fold that is behind its cycles.
pub(super) const BEHIND: i64 = SavedState::BEHIND;

/// The verdict on a tool that is not registered.
pub(super) fn not_registered() -> Verdict {
    Verdict::unknown("not_counted", "no cycle of the tool is counted: it is not registered")
}

#[derive(Debug)]
struct Cached {
    /// `None` where the stored state is of another version or damaged, or the fold is postponed.
    fold: Option<ToolFold>,
    /// Whether the background folds its cycles again: states on the way hold, for the machine and over all.
    postponed: bool,
    /// Whether its row said that it is behind its cycles: its states on the way are as good as they were.
    behind: bool,
    /// Whether it was folded again in this transaction, and may have counted some of what the group has stored.
    refolded: bool,
    /// Cycles that it has counted, or is to count where it is postponed.
    folded: u64,
    /// The operations that its cycles ran; `None` where that is not known, as who wrote the row noted none.
    ran: Option<Ran>,
    /// Version of the stored row; 0 where there is none.
    version: i64,
    /// Whether the row has to be written.
    changed: bool,
}

impl Cached {
    /// A fold that is to be written over that version of its row.
    const fn of(fold: ToolFold, folded: u64, ran: Option<Ran>, version: i64) -> Self {
        let (postponed, behind, refolded) = (false, false, false);
        Self { fold: Some(fold), postponed, behind, refolded, folded, ran, version, changed: true }
    }
}

/// One tool's events and the cached folds of its machines.
#[derive(Debug)]
pub(super) struct ToolWear {
    tool: ToolId,
    pub(super) events: Vec<PlacedEvent>,
    /// Whether an event names a cycle that is not stored: that cycle will move it.
    unplaced: bool,
    machines: BTreeMap<MachineId, Cached>,
    /// The fold over all machines, where there are several and it is known.
    whole: Option<(ToolFold, u64)>,
    /// Number of the last change of an operation that the folds go along with.
    judging_change: i64,
    /// Whether a fold is behind such a change, as it was loaded for reading: no state on the way may be gone on from.
    outdated: bool,
    /// Whether the tool's name is locked: only then are states on the way kept, and those taken back that do not hold any more.
    locked: bool,
    /// The open alarms that follow the verdict, where they are known. They hold as long as the folds of these versions do:
    /// who changes such an alarm writes a fold or begins another generation of the registry.
    pub(super) alarms: Option<Vec<alarms::Open>>,
}

#[derive(sqlx::FromRow)]
struct WearRow {
    machine_id: String,
    folded: i64,
    fold_version: i64,
    state: Vec<u8>,
    version: i64,
    judging_change: i64,
    ran: Option<Vec<u8>>,
}

/// Versions of the stored folds of one tool, by machine: what a fold in memory is held against.
pub(in super::super) type Versions = BTreeMap<MachineId, i64>;

/// What a group asks first, in one statement.
pub(in super::super) struct Heads {
    /// The generation of the registry.
    pub(in super::super) generation: i64,
    /// Whether the database is one of several nodes.
    pub(in super::super) is_distributed: bool,
    /// Whether any feed profile is active.
    pub(in super::super) any_profile: bool,
    /// Versions of the folds of the group's tools.
    pub(in super::super) versions: BTreeMap<ToolId, Versions>,
}

/// Asks for the heads of some tools.
pub(super) async fn heads(
    conn: &mut Conn,
    registry: &Registry,
    tools: &BTreeSet<&ToolId>,
) -> StoreResult<Heads> {
    let rows: Vec<(String, String, i64)> = sqlx::query_as::<Db, _>(dialect::HEADS)
        .bind(dialect::list(tools.iter().map(|tool| tool.as_str())))
        .fetch_all(&mut *conn)
        .await?;
    let mut heads =
        Heads { generation: 0, is_distributed: false, any_profile: false, versions: BTreeMap::new() };
    let (mut server, mut changes) = (0, 0);
    for (tool, machine, version) in &rows {
        if !tool.is_empty() {
            let versions = heads.versions.entry(id("tool_id", tool)?).or_default();
            versions.insert(id("machine_id", machine)?, *version);
        } else {
            match machine.as_str() {
                "" => changes = *version,
                "server" => server = *version,
                "distributed" => heads.is_distributed = *version > 0,
                _ => heads.any_profile = *version > 0,
            }
        }
    }
    heads.generation = registry.generation(server, changes);
    Ok(heads)
}

/// Longest state that is read, bytes: a fold has bounds far below it.
const MOST_STATE: usize = 16 << 20;

/// A fold's state as it is stored.
pub(super) fn state_of(fold: &ToolFold) -> Vec<u8> {
    state::pack(&fold.to_bytes())
}

/// A stored state as the fold gave it; `None` where it is damaged.
pub(super) fn plain_state(stored: &[u8]) -> Option<Cow<'_, [u8]>> {
    state::unpack(stored, MOST_STATE)
}

/// The fold of a stored state, where this version of the fold wrote it.
fn readable(version: i64, stored: &[u8]) -> Option<ToolFold> {
    (version == i64::from(FOLD_VERSION)).then(|| ToolFold::from_bytes(&plain_state(stored)?)).flatten()
}

/// The columns of a [`FactsRow`], of `cycles c LEFT JOIN operations o`.
macro_rules! facts_columns {
    () => {
        "c.machine_id, c.cycle_id, c.operation_id, c.started_at_us, c.received_at_us, c.seq, c.strategy, c.law_version, c.profile_id,
         c.profile_version, c.spindle_speed_rpm, c.median_spindle_speed_rpm, c.dynamometer_joules,
         c.calibrated_joules, c.measured_power_joules, c.measured_power_idle_watts, c.rated_power_joules,
         c.reported_energy_joules, c.duration_ms, c.max_depth_mm, c.energy_scale, c.spindle_load_fall_depth_mm,
         c.operator_override_percent, c.coverage, c.flags, c.depth_digest, c.recommendation_id,
         o.baseline_cycles, o.window_cycles, o.reference_every_cycles, o.reference_feed_mm_min, o.process AS operation_process,
         o.programmed_feed_mm_min AS operation_feed_mm_min, o.depth_mm AS operation_depth_mm,
         o.spindle_speed_rpm AS operation_speed_rpm"
    };
}
pub(super) use facts_columns;

macro_rules! select_facts {
    ($($tail:tt)*) => {
        concat!(
            "SELECT ",
            facts_columns!(),
            " FROM cycles c LEFT JOIN operations o ON o.operation_id = c.operation_id
             WHERE c.tool_id = $1 AND c.started_at_us >= $2
               AND (c.started_at_us, c.machine_id, COALESCE(c.seq, -1), c.cycle_id) > ($2, $3, $4, $5) ",
            $($tail)*,
            " ORDER BY c.started_at_us, c.machine_id, COALESCE(c.seq, -1), c.cycle_id LIMIT $6"
        )
    };
}

/// The next cycles of a tool, of all machines.
const FACTS_OF_TOOL: &str = select_facts!("");

/// The next cycles of a tool on one machine: those of the tool are gone through, and never those of the machine, which may be more by any
/// factor.
pub(in super::super) const FACTS_OF_TOOL_ON_MACHINE: &str =
    select_facts!("AND ", dialect::checked!("c.machine_id"), " = $7");

/// The place after which to read on, as columns.
fn after(order: Option<&OrderKey>) -> StoreResult<(i64, String, i64, String)> {
    Ok(match order {
        None => (i64::MIN, String::new(), i64::MIN, String::new()),
        Some(order) => (
            order.started_at.micros(),
            order.machine.as_str().to_owned(),
            order.seq.map_or(Ok(-1), |seq| count("seq", seq))?,
            order.cycle.as_str().to_owned(),
        ),
    })
}

/// The next cycles of a tool, of one machine or of all, in the order of the fold.
pub(super) async fn facts_after(
    conn: &mut Conn,
    tool: &ToolId,
    machine: Option<&MachineId>,
    last: Option<&OrderKey>,
) -> StoreResult<Vec<FactsRow>> {
    let (at, after_machine, seq, cycle) = after(last)?;
    let sql = if machine.is_some() { FACTS_OF_TOOL_ON_MACHINE } else { FACTS_OF_TOOL };
    let query = sqlx::query_as::<Db, FactsRow>(sql)
        .bind(tool.as_str())
        .bind(at)
        .bind(after_machine)
        .bind(seq)
        .bind(cycle)
        .bind(count("page", FACTS_PAGE as u64)?);
    let query = match machine {
        Some(machine) => query.bind(machine.as_str()),
        None => query,
    };
    let mut rows = query.fetch_all(&mut *conn).await?;
    ask_operations(conn, rows.iter_mut(), &mut BTreeMap::new()).await?;
    Ok(rows)
}

/// Fills in what the operations of cycles asked for when these began; `known` are those that were asked before.
pub(super) async fn ask_operations(
    conn: &mut Conn,
    rows: impl Iterator<Item = &mut FactsRow>,
    known: &mut BTreeMap<String, Vec<Ask>>,
) -> StoreResult<()> {
    for row in rows {
        if !known.contains_key(&row.operation_id) {
            let dated = operations::asks_until_now(conn, &row.operation_id).await?;
            known.insert(row.operation_id.clone(), dated);
        }
        if let Some(asks) = known.get(&row.operation_id) {
            row.asked = asked_at(asks, Timestamp::from_micros(row.started_at_us));
        }
    }
    Ok(())
}

impl ToolWear {
    /// Loads a tool's events and caches, whose name is locked; those that are behind a change of an operation are folded again.
    pub(super) async fn load_locked(
        conn: &mut Conn,
        tool: &ToolId,
        budget: &mut Budget,
    ) -> StoreResult<Self> {
        let (mut wear, behind) = Self::load_by(conn, tool, dialect::WEAR_OF_TOOL_LOCKED).await?;
        wear.locked = true;
        for (machine, from) in &behind {
            wear.refold(conn, machine, (from, 0), budget).await?;
        }
        Ok(wear)
    }

    /// Loads a tool's events and caches for reading.
    pub(super) async fn load(conn: &mut Conn, tool: &ToolId) -> StoreResult<Self> {
        let (mut wear, behind) = Self::load_by(
            conn,
            tool,
            "SELECT machine_id, folded, fold_version, state, version, judging_change, ran FROM tool_wear
             WHERE tool_id = $1 ORDER BY machine_id",
        )
        .await?;
        for machine in behind.keys() {
            wear.forget(machine);
        }
        wear.outdated = !behind.is_empty();
        Ok(wear)
    }

    /// With the machines whose folds are behind a change of an operation, and from where on.
    async fn load_by(
        conn: &mut Conn,
        tool: &ToolId,
        sql: &'static str,
    ) -> StoreResult<(Self, BTreeMap<MachineId, Place>)> {
        // Asked before anything is judged: with what changes after that, whoever loads the folds next goes along.
        let judging_change = operations::last_judging_change(conn).await?;
        let rows: Vec<WearRow> =
            sqlx::query_as::<Db, _>(sql).bind(tool.as_str()).fetch_all(&mut *conn).await?;
        let since = rows.iter().map(|row| row.judging_change).min().unwrap_or(judging_change);
        let changes = operations::changed_since(conn, since, judging_change).await?;
        let (mut machines, mut behind, mut untold) = (BTreeMap::new(), BTreeMap::new(), Vec::new());
        for row in rows {
            let machine: MachineId = id("machine_id", &row.machine_id)?;
            let fold = readable(row.fold_version, &row.state);
            let postponed = SavedState::is_postponed(row.fold_version, &row.state);
            let folded = number("folded", row.folded)?;
            let ran = ran_of(row.ran.as_deref(), folded);
            let changed = row.judging_change < judging_change;
            match (&ran, changed) {
                (Some(Ran::These(ran)), true) => {
                    if let Some(first) = first_changed(ran, &changes, row.judging_change) {
                        behind.insert(machine.clone(), Place::at(Timestamp::from_micros(first)));
                    }
                }
                (_, true) => untold.push(machine.clone()),
                (_, false) => {}
            }
            let behind = row.fold_version == BEHIND;
            let version = row.version;
            let cached = Cached { fold, postponed, behind, refolded: false, folded, ran, version, changed };
            machines.insert(machine, cached);
        }
        if !untold.is_empty() {
            let mut told = judged_otherwise_since(conn, tool, since).await?;
            behind.extend(untold.into_iter().filter_map(|machine| told.remove_entry(&machine)));
        }
        let (events, unplaced) = tools::placed_events(conn, tool).await?;
        let wear = Self {
            tool: tool.clone(),
            events,
            unplaced,
            machines,
            whole: None,
            judging_change,
            outdated: false,
            locked: false,
            alarms: None,
        };
        Ok((wear, behind))
    }

    /// Whether some of its folds are behind a change of an operation, as they are stored.
    pub(super) const fn is_outdated(&self) -> bool {
        self.outdated
    }

    /// Whether what is here is what is stored, so that it need not be loaded again.
    pub(super) fn is_of(&self, versions: Option<&Versions>) -> bool {
        let known = self.machines.iter().map(|(machine, cached)| (machine, cached.version));
        match versions {
            None => self.machines.is_empty(),
            Some(versions) => known.eq(versions.iter().map(|(machine, version)| (machine, *version))),
        }
    }

    /// The versions of its rows; `None` where there is none.
    pub(super) fn versions(&self) -> Option<Versions> {
        let versions = self.machines.iter().map(|(machine, cached)| (machine.clone(), cached.version));
        (!self.machines.is_empty()).then(|| versions.collect())
    }

    /// Whether it may be kept in memory until the next group.
    pub(super) fn may_be_kept(&self) -> bool {
        !self.unplaced && self.machines.values().all(|cached| cached.fold.is_some())
    }

    /// Takes the rows that have to be written, in the order of their machines.
    pub(super) fn take_changed(&mut self) -> StoreResult<Vec<Arc<SavedWear>>> {
        let mut rows = Vec::new();
        for (machine, cached) in &mut self.machines {
            let state = match &cached.fold {
                Some(fold) => Some(SavedState::Fold(fold.to_bytes())),
                None => cached.postponed.then_some(SavedState::Postponed),
            };
            if let Some(state) = state.filter(|_| cached.changed) {
                rows.push(Arc::new(SavedWear {
                    machine_id: machine.clone(),
                    tool_id: self.tool.clone(),
                    folded: count("folded", cached.folded)?,
                    state,
                    ran: cached.ran.as_ref().map(|ran| ran.to_bytes(cached.folded)),
                    version: cached.version,
                    judging_change: self.judging_change,
                }));
                cached.changed = false;
                cached.version += 1;
            }
            cached.refolded = false;
        }
        Ok(rows)
    }

    /// Writes what changed.
    async fn save(&mut self, conn: &mut Conn, now: Timestamp) -> StoreResult<()> {
        dialect::save_wear(conn, &self.take_changed()?, now).await
    }

    /// Keeps the fold that one machine's walk came to; it is written with [`ToolWear::take_changed`].
    fn keep(&mut self, machine: &MachineId, fold: ToolFold, folded: u64, ran: Option<Ran>) {
        let version = self.machines.get(machine).map_or(0, |cached| cached.version);
        self.machines.insert(machine.clone(), Cached::of(fold, folded, ran, version));
    }

    /// Leaves the fold of one machine's cycles, which are so many, to the background.
    fn postpone(&mut self, machine: &MachineId, folded: u64, ran: Option<Ran>) {
        self.whole = None;
        let before = self.machines.get(machine);
        let as_before = before.is_some_and(|it| it.postponed && it.folded == folded && it.ran == ran);
        let changed = before.is_none_or(|it| it.changed) || !as_before;
        let version = before.map_or(0, |it| it.version);
        let (postponed, behind, refolded) = (true, true, false);
        let cached = Cached { fold: None, postponed, behind, refolded, folded, ran, version, changed };
        self.machines.insert(machine.clone(), cached);
    }

    /// Whether the background folds the cycles of one machine again.
    pub(super) fn is_postponed_on(&self, machine: &MachineId) -> bool {
        self.machines.get(machine).is_some_and(|cached| cached.postponed)
    }

    /// Whether the background folds its cycles again: until then nobody knows how worn it is.
    pub(super) fn is_postponed(&self) -> bool {
        self.machines.values().any(|cached| cached.postponed)
    }

    /// The operations that one machine's cycles ran, where that is known.
    pub(super) fn ran(&self, machine: &MachineId) -> Option<&Ran> {
        self.machines.get(machine)?.ran.as_ref()
    }

    /// Finds out which operations were run, where nobody noted it: once for each fold, through all of its tool's cycles.
    async fn find_ran(&mut self, conn: &mut Conn) -> StoreResult<()> {
        for (machine, cached) in &mut self.machines {
            if cached.ran.is_none() && cached.fold.is_some() {
                let found: Vec<(String, i64)> = sqlx::query_as::<Db, _>(RAN_OF_TOOL_ON_MACHINE)
                    .bind(self.tool.as_str())
                    .bind(machine.as_str())
                    .fetch_all(&mut *conn)
                    .await?;
                let mut ran = Ran::nothing();
                found.iter().for_each(|(operation, first)| ran.note(operation, *first));
                (cached.ran, cached.changed) = (Some(ran), true);
            }
        }
        Ok(())
    }

    /// Machines that have a cache.
    pub(super) fn machines(&self) -> Vec<MachineId> {
        self.machines.keys().cloned().collect()
    }

    /// Counts cycles of one machine that were just stored, in the order of the fold: steps on where they are the
    /// newest, otherwise refolds or, where the budget does not reach, postpones.
    pub(super) async fn count_new(
        &mut self,
        transaction: &mut GroupTransaction<'_>,
        machine: &MachineId,
        new: &[FactsRow],
        budget: &mut Budget,
    ) -> StoreResult<()> {
        let Some(first) = new.first() else {
            return Ok(());
        };
        let first = first.order()?;
        let newest = |fold: &ToolFold| fold.last().is_none_or(|last| *last < first);
        if !self.machines.contains_key(machine) {
            // The fold of one machine was that of the whole tool.
            self.whole = None;
        }
        if !self.machines.contains_key(machine)
            && has_more(transaction.conn().await?, &self.tool, machine, new.len()).await?
        {
            // Its cache is lost, and its cycles are not.
            return self.refold(transaction.conn().await?, machine, (&BEGINNING, 0), budget).await;
        }
        if !self.machines.contains_key(machine)
            && self.machines.len() == 1
            && let Some((only, cached)) = self.machines.first_key_value()
        {
            // Until now its fold was that of the whole tool, as were its states on the way; unless another one's cache is lost.
            let is_whole = cached.fold.is_some() || cached.postponed;
            if is_whole
                && take_over(transaction.conn().await?, (only, &self.tool), &Place::of(&first)).await?
            {
                self.whole = cached.fold.clone().filter(newest).map(|fold| (fold, cached.folded));
            }
        }
        let cached = self
            .machines
            .entry(machine.clone())
            .or_insert_with(|| Cached::of(beginning(&self.events), 0, Some(Ran::nothing()), 0));
        let Some(fold) = cached.fold.take_if(|fold| newest(fold)) else {
            let from = (&Place::of(&first), new.len() as u64);
            return self.refold(transaction.conn().await?, machine, from, budget).await;
        };
        let (folded, mut ran) = (cached.folded, cached.ran.take());
        // The machine's newest need not be the tool's.
        if self.machines.len() > 1 && !self.whole.as_ref().is_some_and(|(whole, _)| newest(whole)) {
            self.whole = None;
            forget_checkpoints(transaction.conn().await?, &self.tool, &Place::of(&first)).await?;
        }
        let mut walk = Walk::resume(fold, folded, &self.events);
        for row in new {
            walk.step(row)?;
            note_ran(&mut ran, row);
            if walk.at_checkpoint() {
                save_checkpoint(transaction.conn().await?, &self.tool, Of::Machine(machine), &walk).await?;
            }
        }
        let (folded, fold) = (walk.folded(), walk.into_fold());
        self.keep(machine, fold, folded, ran);
        self.count_whole(transaction, new).await
    }

    /// Counts cycles in the fold over all machines, where that is known: they are the newest of all then.
    async fn count_whole(
        &mut self,
        transaction: &mut GroupTransaction<'_>,
        new: &[FactsRow],
    ) -> StoreResult<()> {
        let Some((fold, folded)) = self.whole.take() else {
            return Ok(());
        };
        let mut walk = Walk::resume(fold, folded, &self.events);
        for row in new {
            walk.step(row)?;
            if walk.at_checkpoint() {
                save_checkpoint(transaction.conn().await?, &self.tool, Of::All, &walk).await?;
            }
        }
        let folded = walk.folded();
        self.whole = Some((walk.into_fold(), folded));
        Ok(())
    }

    /// Forgets one machine's cached fold, so that it is folded again whatever comes next.
    pub(super) fn forget(&mut self, machine: &MachineId) {
        self.whole = None;
        if let Some(cached) = self.machines.get_mut(machine) {
            cached.fold = None;
        }
    }

    /// Folds one machine's cycles again from a place on, from the last state before it; `new` of them were stored since it was folded last.
    /// Postpones it where the budget does not reach.
    pub(super) async fn refold(
        &mut self,
        conn: &mut Conn,
        machine: &MachineId,
        (from, new): (&Place, u64),
        budget: &mut Budget,
    ) -> StoreResult<()> {
        self.whole = None;
        let cached = self.machines.get(machine);
        let known = cached.and_then(|cached| cached.fold.as_ref());
        let holds = cached.is_some_and(|cached| cached.fold.is_some() || cached.postponed);
        if holds {
            // What comes before is what it was, for the tool as for the machine.
            forget_checkpoints(conn, &self.tool, from).await?;
        }
        if known.and_then(ToolFold::last).is_some_and(|last| Place::of(last) < *from) {
            return Ok(());
        }
        let resumed = checkpoint_before(conn, &self.tool, Of::Machine(machine), from).await?;
        if !holds {
            // Of what another version has counted meanwhile, or what is lost, nobody knows from where on.
            let good = resumed.as_ref().and_then(|(fold, _)| fold.last()).map_or(BEGINNING, Place::of);
            forget_checkpoints(conn, &self.tool, &good).await?;
        }
        let (fold, folded) = resumed.unwrap_or_else(|| (beginning(&self.events), 0));
        forget_after(conn, (machine, &self.tool), folded).await?;
        let cycles = match cached {
            Some(cached) if !cached.refolded => cached.folded + new,
            _ => cycles_of(conn, &self.tool, machine).await?,
        };
        // What was noted holds for all cycles that were counted, and those that were not are gone through from here on. As long as a fold is
        // postponed it says what ran in states over all machines, too, which hold.
        let noted = cached.and_then(|cached| cached.ran.clone());
        let left = if holds || folded > 0 { noted.clone() } else { Some(Ran::nothing()) };
        let mut ran = if folded == 0 { Some(Ran::nothing()) } else { noted };
        if !budget.begins(cycles.saturating_sub(folded)) {
            self.postpone(machine, cycles, left);
            return Ok(());
        }
        let mut walk = Walk::resume(fold, folded, &self.events);
        loop {
            let page = facts_after(conn, &self.tool, Some(machine), walk.fold().last()).await?;
            for row in &page {
                walk.step(row)?;
                note_ran(&mut ran, row);
                if walk.at_checkpoint() {
                    save_checkpoint(conn, &self.tool, Of::Machine(machine), &walk).await?;
                }
            }
            budget.spend(page.len() as u64);
            if page.len() < FACTS_PAGE {
                break;
            }
            if budget.is_spent() {
                // What was folded is in the states on the way.
                let ran = left.zip(ran).map(|(left, ran)| left.and(&ran));
                self.postpone(machine, cycles, ran);
                return Ok(());
            }
        }
        let (folded, fold) = (walk.folded(), walk.into_fold());
        self.keep(machine, fold, folded, ran);
        if let Some(cached) = self.machines.get_mut(machine) {
            cached.refolded = true;
        }
        Ok(())
    }

    /// Folds anew what another version of the fold wrote, or what is damaged, of machines that ran none of the new cycles: the
    /// tool would otherwise be folded over all of its cycles with every group, until each of them runs it again. And what is postponed,
    /// where little of it is left.
    pub(super) async fn refold_unreadable(
        &mut self,
        conn: &mut Conn,
        budget: &mut Budget,
    ) -> StoreResult<()> {
        for machine in self.machines() {
            let Some(cached) = self.machines.get(&machine).filter(|cached| cached.fold.is_none()) else {
                continue;
            };
            let from = if cached.behind { END } else { BEGINNING };
            self.refold(conn, &machine, (&from, 0), budget).await?;
        }
        Ok(())
    }

    /// Whether a machine's fold is not known, as its state cannot be read or it is postponed.
    fn lacks_fold_of(&self, machine: &MachineId) -> bool {
        self.machines.get(machine).is_some_and(|cached| cached.fold.is_none())
    }

    /// Whether a state of some machine cannot be read, or is postponed.
    pub(super) fn is_unreadable(&self) -> bool {
        self.machines.values().any(|cached| cached.fold.is_none())
    }

    /// Whether states on the way may be gone on from. Who wrote a state of a machine that cannot be read here may not have known of
    /// those over all machines, and then has not taken them back.
    pub(super) fn may_resume(&self, of: Of<'_>) -> bool {
        let is_known = |cached: &Cached| cached.fold.is_some() || cached.postponed;
        !self.outdated && (matches!(of, Of::Machine(_)) || self.machines.values().all(is_known))
    }

    /// The last state on the way, over all machines, that has counted nothing from a place on: what comes there is folded on from it. Of
    /// one machine the checkpoints are those of the whole tool.
    pub(super) async fn state_before(
        &self,
        conn: &mut Conn,
        from: &Place,
    ) -> StoreResult<Option<(ToolFold, u64)>> {
        let mut machines = self.machines.keys();
        let of = match (machines.next(), machines.next()) {
            (None, _) => return Ok(None),
            (Some(only), None) => Of::Machine(only),
            _ => Of::All,
        };
        if !self.may_resume(of) {
            return Ok(None);
        }
        checkpoint_before(conn, &self.tool, of, from).await
    }

    /// How many cycles are counted, on all machines.
    pub(super) fn folded(&self) -> u64 {
        self.machines.values().map(|cached| cached.folded).sum()
    }

    /// The verdict over all machines, where no cycle has to be read for it: of one machine it is that one's fold.
    pub(super) fn known_verdict(&self) -> Option<Verdict> {
        let mut caches = self.machines.values();
        if let (Some(Cached { fold: Some(fold), .. }), None) = (caches.next(), caches.next()) {
            return Some(verdict_after(fold, &self.events));
        }
        self.whole.as_ref().map(|(fold, _)| verdict_after(fold, &self.events))
    }

    /// The verdict over all machines. The cycles of a tool that moved between machines are folded in their order, from the last state
    /// on the way, which is exact by construction. Postpones it where the budget does not reach.
    pub(super) async fn verdict(&mut self, conn: &mut Conn, budget: &mut Budget) -> StoreResult<Verdict> {
        if self.is_postponed() {
            return being_counted(conn, &self.tool).await;
        }
        if let Some(verdict) = self.known_verdict() {
            return Ok(verdict);
        }
        let state = self.state_before(conn, &END).await?;
        let known = state.as_ref().map_or(0, |(_, folded)| *folded);
        // Where no states over all machines are kept, or a newer server has folded one of them, there is nothing that could be gone on from.
        let mut whole = Budget::whole();
        let may_go_on = self.may_resume(Of::All) && are_kept_over_all(conn).await?;
        let budget = if may_go_on { budget } else { &mut whole };
        if budget.begins(self.folded().saturating_sub(known))
            && let Some(verdict) = self.verdict_from(conn, state, budget).await?
        {
            return Ok(verdict);
        }
        self.postpone_whole();
        being_counted(conn, &self.tool).await
    }

    /// Leaves the fold over all machines to the background, which finds it by the fold of one of them: of the one that ran last, which is
    /// soon folded again from its last state on the way.
    fn postpone_whole(&mut self) {
        let last = |cached: &Cached| cached.fold.as_ref().and_then(ToolFold::last).cloned();
        let latest = self.machines.iter().max_by_key(|(_, cached)| last(cached));
        if let Some((machine, cached)) = latest {
            let (machine, folded, ran) = (machine.clone(), cached.folded, cached.ran.clone());
            self.postpone(&machine, folded, ran);
        }
    }

    /// The same, folded from a state on the way with as many cycles, or from the first cycle on. `None` where the budget did not reach: what
    /// was folded is in the states on the way.
    async fn verdict_from(
        &mut self,
        conn: &mut Conn,
        state: Option<(ToolFold, u64)>,
        budget: &mut Budget,
    ) -> StoreResult<Option<Verdict>> {
        let mut walk = match state {
            Some((fold, folded)) => Walk::resume(fold, folded, &self.events),
            None => Walk::new(&self.events),
        };
        if !self.machines.is_empty() {
            loop {
                let page = facts_after(conn, &self.tool, None, walk.fold().last()).await?;
                for row in &page {
                    walk.step(row)?;
                    if self.locked && self.machines.len() > 1 && walk.at_checkpoint() {
                        save_checkpoint(conn, &self.tool, Of::All, &walk).await?;
                    }
                }
                budget.spend(page.len() as u64);
                if page.len() < FACTS_PAGE {
                    break;
                }
                if budget.is_spent() {
                    return Ok(None);
                }
            }
        }
        let folded = walk.folded();
        let (fold, _) = self.whole.insert((walk.into_fold(), folded));
        Ok(Some(verdict_after(fold, &self.events)))
    }
}

/// Up to so many cycles of a tool on one machine are counted.
pub(in super::super) const FIRST_OF_TOOL_ON_MACHINE: &str = concat!(
    "SELECT CAST(COUNT(*) AS BIGINT) FROM (
         SELECT 1 FROM cycles WHERE tool_id = $1 AND ",
    dialect::checked!("machine_id"),
    " = $2 LIMIT $3) AS first"
);

/// How many cycles of a tool a machine has stored.
async fn cycles_of(conn: &mut Conn, tool: &ToolId, machine: &MachineId) -> StoreResult<u64> {
    let found: i64 = sqlx::query_scalar::<Db, _>(concat!(
        "SELECT COUNT(*) FROM cycles WHERE tool_id = $1 AND ",
        dialect::checked!("machine_id"),
        " = $2"
    ))
    .bind(tool.as_str())
    .bind(machine.as_str())
    .fetch_one(&mut *conn)
    .await?;
    number("cycles", found)
}

/// Whether a tool has more cycles of a machine than these, which are stored by now.
async fn has_more(conn: &mut Conn, tool: &ToolId, machine: &MachineId, these: usize) -> StoreResult<bool> {
    let found: i64 = sqlx::query_scalar::<Db, _>(FIRST_OF_TOOL_ON_MACHINE)
        .bind(tool.as_str())
        .bind(machine.as_str())
        .bind(count("these", these as u64 + 1)?)
        .fetch_one(&mut *conn)
        .await?;
    Ok(found > count("these", these as u64)?)
}

/// Whether a tool is registered.
pub(super) async fn is_registered(conn: &mut Conn, tool: &ToolId) -> StoreResult<bool> {
    let found: Option<i64> = sqlx::query_scalar::<Db, _>("SELECT version FROM tools WHERE tool_id = $1")
        .bind(tool.as_str())
        .fetch_optional(&mut *conn)
        .await?;
    Ok(found.is_some())
}

/// Folds everything that is stored of a tool that was just registered.
pub(super) async fn count_all(
    conn: &mut Conn,
    tool: &ToolId,
    now: Timestamp,
    mut budget: Budget,
) -> StoreResult<Verdict> {
    let mut wear = ToolWear::load_locked(conn, tool, &mut budget).await?;
    for machine in machines_of(conn, tool).await? {
        wear.refold(conn, &machine, (&BEGINNING, 0), &mut budget).await?;
    }
    let verdict = wear.verdict(conn, &mut budget).await?;
    wear.save(conn, now).await?;
    Ok(verdict)
}

/// Machines that stored a cycle of a tool.
pub(super) async fn machines_of(conn: &mut Conn, tool: &ToolId) -> StoreResult<Vec<MachineId>> {
    let found: Vec<String> = sqlx::query_scalar::<Db, _>(
        "SELECT DISTINCT machine_id FROM cycles WHERE tool_id = $1 ORDER BY machine_id",
    )
    .bind(tool.as_str())
    .fetch_all(&mut *conn)
    .await?;
    found.iter().map(|machine| id("machine_id", machine)).collect()
}

/// Refolds a tool from where an event that was just added takes effect.
pub(super) async fn count_event(
    conn: &mut Conn,
    tool: &ToolId,
    event: i64,
    now: Timestamp,
) -> StoreResult<Verdict> {
    let mut budget = Budget::at_once();
    let wear = ToolWear::load_locked(conn, tool, &mut budget).await?;
    let from = place_of(event, &wear.events);
    count_from(conn, wear, (from, now), budget).await
}

/// Refolds a tool from where an event that was just revoked took effect; `before` are the events with it.
pub(super) async fn count_without_event(
    conn: &mut Conn,
    tool: &ToolId,
    (event, before): (i64, &[PlacedEvent]),
    now: Timestamp,
) -> StoreResult<Verdict> {
    let mut budget = Budget::at_once();
    let wear = ToolWear::load_locked(conn, tool, &mut budget).await?;
    count_from(conn, wear, (place_of(event, before), now), budget).await
}

/// From where on the fold is another one with an event than without it; `events` are those with it.
fn place_of(event: i64, events: &[PlacedEvent]) -> Place {
    let mut without = events.to_vec();
    let Some(at) = without.iter().position(|placed| placed.id == event) else { return BEGINNING };
    let place = without.remove(at).place;
    if beginning(&without) == beginning(events) { place } else { BEGINNING }
}

/// Refolds all machines of a tool from a place on.
async fn count_from(
    conn: &mut Conn,
    mut wear: ToolWear,
    (from, now): (Place, Timestamp),
    mut budget: Budget,
) -> StoreResult<Verdict> {
    for machine in wear.machines() {
        wear.refold(conn, &machine, (&from, 0), &mut budget).await?;
    }
    let verdict = wear.verdict(conn, &mut budget).await?;
    wear.save(conn, now).await?;
    Ok(verdict)
}

/// The verdict on a tool whose cycles are being folded again, which says where cycles without a clock may be why: each of them
/// stands before all others, so that it begins anew.
async fn being_counted(conn: &mut Conn, tool: &ToolId) -> StoreResult<Verdict> {
    let verdict = Verdict::being_counted();
    let first: Option<i64> =
        sqlx::query_scalar::<Db, _>("SELECT MIN(started_at_us) FROM cycles WHERE tool_id = $1")
            .bind(tool.as_str())
            .fetch_one(&mut *conn)
            .await?;
    let has_suspects = first.is_some_and(|first| first < EARLIEST_CLOCK.micros());
    Ok(if has_suspects { verdict.beside_suspects() } else { verdict })
}

/// The verdict on a tool, read only.
pub(super) async fn verdict(conn: &mut Conn, tool: &ToolId) -> StoreResult<Verdict> {
    let found = verdict_of_life(conn, tool, u64::MAX).await?;
    Ok(found.map_or_else(not_registered, |(verdict, _)| verdict))
}

/// Cycles that are folded for an answer which others wait behind: those since the last state on the way, and a page of late ones.
pub(super) const AT_ONCE: u64 = 4 * CHECKPOINT_CYCLES;

/// The verdict on a tool, read only, where no more than some cycles have to be folded for it.
pub(super) async fn verdict_at_once(conn: &mut Conn, tool: &ToolId) -> StoreResult<Option<Verdict>> {
    Ok(verdict_of_life(conn, tool, AT_ONCE).await?.map(|(verdict, _)| verdict))
}

/// The verdict on a tool, read only, with the place from which on cycles are of its current life. `None` where more cycles than `bound`
/// had to be folded for it.
pub(super) async fn verdict_of_life(
    conn: &mut Conn,
    tool: &ToolId,
    bound: u64,
) -> StoreResult<Option<(Verdict, Place)>> {
    if !is_registered(conn, tool).await? {
        return Ok(Some((not_registered(), BEGINNING)));
    }
    let mut wear = ToolWear::load(conn, tool).await?;
    let verdict = match wear.known_verdict() {
        // Who runs it is told the same. What it comes to is soon known, and nobody need read all of it for that.
        None if wear.is_postponed() => being_counted(conn, tool).await?,
        Some(verdict) => verdict,
        None => {
            let state = wear.state_before(conn, &END).await?;
            let known = state.as_ref().map_or(0, |(_, folded)| *folded);
            if wear.folded().saturating_sub(known) > bound {
                return Ok(None);
            }
            let mut budget = Budget::whole();
            match wear.verdict_from(conn, state, &mut budget).await? {
                Some(verdict) => verdict,
                None => being_counted(conn, tool).await?,
            }
        }
    };
    let last = wear.events.iter().rfind(|event| event.kind.begins_life());
    Ok(Some((verdict, last.map_or(BEGINNING, |event| event.place.clone()))))
}
