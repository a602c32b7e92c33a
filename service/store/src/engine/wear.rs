//! The cached fold of each machine's cycles of a tool: stepped, refolded from a checkpoint, composed.

pub(in super::super) mod outdated;

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
use crate::rows::{FactsRow, Place, PlacedEvent, SavedWear, count, id, number};
use feedwright_core::ids::{MachineId, ToolId};
use feedwright_core::operation::{Ask, asked_at};
use feedwright_core::units::Timestamp;
use feedwright_core::wear::{FOLD_VERSION, OrderKey, ToolFold, Verdict};
use outdated::{RAN_OF_TOOL_ON_MACHINE, first_changed, judged_otherwise_since, note_ran, ran_of};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Cycles read at once when refolding; bounds memory, not the work.
const FACTS_PAGE: i64 = 1000;

/// Before every cycle.
pub(super) const BEGINNING: Place = Place::at(Timestamp::from_micros(i64::MIN));

/// After every cycle.
const END: Place = Place::at(Timestamp::from_micros(i64::MAX));

/// Version of a fold that is behind its cycles, as no rules ever wrote it: a journal of groups was taken up.
pub(super) const BEHIND: i64 = 0;

/// The verdict on a tool that is not registered.
pub(super) fn not_registered() -> Verdict {
    Verdict::unknown("not_counted", "no cycle of the tool is counted: it is not registered")
}

#[derive(Debug)]
struct Cached {
    /// `None` where the stored state is of another version or damaged.
    fold: Option<ToolFold>,
    folded: u64,
    /// The operations that its cycles ran; `None` where that is not known, as who wrote the row noted none.
    ran: Option<Ran>,
    /// Version of the stored row; 0 where there is none.
    version: i64,
    /// Whether the row has to be written.
    changed: bool,
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
        .bind(FACTS_PAGE);
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
    pub(super) async fn load_locked(conn: &mut Conn, tool: &ToolId) -> StoreResult<Self> {
        let (mut wear, behind) = Self::load_by(conn, tool, dialect::WEAR_OF_TOOL_LOCKED).await?;
        wear.locked = true;
        for (machine, from) in &behind {
            wear.refold(conn, machine, from).await?;
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
            machines.insert(machine, Cached { fold, folded, ran, version: row.version, changed });
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
            if let Some(fold) = cached.fold.as_ref().filter(|_| cached.changed) {
                rows.push(Arc::new(SavedWear {
                    machine_id: machine.clone(),
                    tool_id: self.tool.clone(),
                    folded: count("folded", cached.folded)?,
                    state: fold.to_bytes(),
                    ran: cached.ran.as_ref().map(|ran| ran.to_bytes(cached.folded)),
                    version: cached.version,
                    judging_change: self.judging_change,
                }));
                cached.changed = false;
                cached.version += 1;
            }
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
        let cached = Cached { fold: Some(fold), folded, ran, version, changed: true };
        self.machines.insert(machine.clone(), cached);
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
    /// newest, refolds otherwise.
    pub(super) async fn count_new(
        &mut self,
        transaction: &mut GroupTransaction<'_>,
        machine: &MachineId,
        new: &[FactsRow],
    ) -> StoreResult<()> {
        let Some(first) = new.first() else {
            return Ok(());
        };
        let first = first.order()?;
        if !self.machines.contains_key(machine) {
            // The fold of one machine was that of the whole tool.
            self.whole = None;
        }
        if !self.machines.contains_key(machine)
            && has_more(transaction.conn().await?, &self.tool, machine, new.len()).await?
        {
            // Its cache is lost, and its cycles are not.
            let lost = Cached { fold: None, folded: 0, ran: None, version: 0, changed: true };
            self.machines.insert(machine.clone(), lost);
            return self.refold(transaction.conn().await?, machine, &BEGINNING).await;
        }
        let cached = self.machines.entry(machine.clone()).or_insert_with(|| Cached {
            fold: Some(beginning(&self.events)),
            folded: 0,
            ran: Some(Ran::nothing()),
            version: 0,
            changed: true,
        });
        let newest = |fold: &ToolFold| fold.last().is_none_or(|last| *last < first);
        let Some(fold) = cached.fold.take_if(|fold| newest(fold)) else {
            return self.refold(transaction.conn().await?, machine, &Place::of(&first)).await;
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

    /// Folds one machine's cycles again from `from` on: from the last checkpoint before it.
    pub(super) async fn refold(
        &mut self,
        conn: &mut Conn,
        machine: &MachineId,
        from: &Place,
    ) -> StoreResult<()> {
        self.whole = None;
        let known = self.machines.get(machine).and_then(|cached| cached.fold.as_ref());
        if known.is_some() {
            // What comes before is what it was, for the tool as for the machine.
            forget_checkpoints(conn, &self.tool, from).await?;
        }
        if known.and_then(ToolFold::last).is_some_and(|last| Place::of(last) < *from) {
            return Ok(());
        }
        let resumed = checkpoint_before(conn, &self.tool, Of::Machine(machine), from).await?;
        if known.is_none() {
            // Of what another version has counted meanwhile, or what is lost, nobody knows from where on.
            let good = resumed.as_ref().and_then(|(fold, _)| fold.last()).map_or(BEGINNING, Place::of);
            forget_checkpoints(conn, &self.tool, &good).await?;
        }
        let (fold, folded) = resumed.unwrap_or_else(|| (beginning(&self.events), 0));
        // What was noted holds for all cycles that were counted, and those that were not are gone through from here on.
        let noted = self.machines.get(machine).and_then(|cached| cached.ran.clone());
        let mut ran = if folded == 0 { Some(Ran::nothing()) } else { noted };
        sqlx::query::<Db>(
            "DELETE FROM tool_wear_checkpoints WHERE machine_id = $1 AND tool_id = $2 AND folded > $3",
        )
        .bind(machine.as_str())
        .bind(self.tool.as_str())
        .bind(count("folded", folded)?)
        .execute(&mut *conn)
        .await?;
        let mut walk = Walk::resume(fold, folded, &self.events);
        loop {
            let page = facts_after(conn, &self.tool, Some(machine), walk.fold().last()).await?;
            if page.is_empty() {
                break;
            }
            for row in &page {
                walk.step(row)?;
                note_ran(&mut ran, row);
                if walk.at_checkpoint() {
                    save_checkpoint(conn, &self.tool, Of::Machine(machine), &walk).await?;
                }
            }
        }
        let (folded, fold) = (walk.folded(), walk.into_fold());
        self.keep(machine, fold, folded, ran);
        Ok(())
    }

    /// Folds anew what another version of the fold wrote, or what is damaged, of machines that ran none of the new cycles: the
    /// tool would otherwise be folded over all of its cycles with every group, until each of them runs it again.
    pub(super) async fn refold_unreadable(&mut self, conn: &mut Conn) -> StoreResult<()> {
        for machine in self.machines() {
            if self.machines.get(&machine).is_some_and(|cached| cached.fold.is_none()) {
                self.refold(conn, &machine, &BEGINNING).await?;
            }
        }
        Ok(())
    }

    /// Whether the state of a machine cannot be read.
    fn is_unreadable_on(&self, machine: &MachineId) -> bool {
        self.machines.get(machine).is_some_and(|cached| cached.fold.is_none())
    }

    /// Whether a state of some machine cannot be read.
    pub(super) fn is_unreadable(&self) -> bool {
        self.machines.values().any(|cached| cached.fold.is_none())
    }

    /// Whether states on the way may be gone on from. Who wrote a state of a machine that cannot be read here may not have known of
    /// those over all machines, and then has not taken them back.
    pub(super) fn may_resume(&self, of: Of<'_>) -> bool {
        !self.outdated && (matches!(of, Of::Machine(_)) || !self.is_unreadable())
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
    /// on the way, which is exact by construction.
    pub(super) async fn verdict(&mut self, conn: &mut Conn) -> StoreResult<Verdict> {
        if let Some(verdict) = self.known_verdict() {
            return Ok(verdict);
        }
        let state = self.state_before(conn, &END).await?;
        self.verdict_from(conn, state).await
    }

    /// The same, folded from a state on the way with as many cycles, or from the first cycle on.
    async fn verdict_from(
        &mut self,
        conn: &mut Conn,
        state: Option<(ToolFold, u64)>,
    ) -> StoreResult<Verdict> {
        let mut walk = match state {
            Some((fold, folded)) => Walk::resume(fold, folded, &self.events),
            None => Walk::new(&self.events),
        };
        if !self.machines.is_empty() {
            loop {
                let page = facts_after(conn, &self.tool, None, walk.fold().last()).await?;
                if page.is_empty() {
                    break;
                }
                for row in &page {
                    walk.step(row)?;
                    if self.locked && self.machines.len() > 1 && walk.at_checkpoint() {
                        save_checkpoint(conn, &self.tool, Of::All, &walk).await?;
                    }
                }
            }
        }
        let folded = walk.folded();
        let (fold, _) = self.whole.insert((walk.into_fold(), folded));
        Ok(verdict_after(fold, &self.events))
    }
}

/// Whose cycles a checkpoint has counted.
#[derive(Debug, Clone, Copy)]
pub(super) enum Of<'a> {
    /// Those of a tool on one machine.
    Machine(&'a MachineId),
    /// All of a tool that more than one machine has run.
    All,
}

/// Up to so many cycles of a tool on one machine are counted.
pub(in super::super) const FIRST_OF_TOOL_ON_MACHINE: &str = concat!(
    "SELECT CAST(COUNT(*) AS BIGINT) FROM (
         SELECT 1 FROM cycles WHERE tool_id = $1 AND ",
    dialect::checked!("machine_id"),
    " = $2 LIMIT $3) AS first"
);

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

async fn save_checkpoint(conn: &mut Conn, tool: &ToolId, of: Of<'_>, walk: &Walk<'_>) -> StoreResult<()> {
    let Some(last) = walk.fold().last() else {
        return Ok(());
    };
    // Of one machine the last cycle is its own.
    let (sql, machine) = match of {
        Of::Machine(machine) => (
            "INSERT INTO tool_wear_checkpoints (machine_id, tool_id, folded, fold_version, last_started_at_us,
                 last_seq, last_cycle_id, state)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8)
             ON CONFLICT (machine_id, tool_id, folded) DO UPDATE SET fold_version = excluded.fold_version,
                 last_started_at_us = excluded.last_started_at_us, last_seq = excluded.last_seq,
                 last_cycle_id = excluded.last_cycle_id, state = excluded.state",
            machine,
        ),
        Of::All => (
            concat!(
                "INSERT INTO tool_checkpoints (last_machine_id, tool_id, folded, fold_version, last_started_at_us,
                 last_seq, last_cycle_id, state)
             SELECT $1, $2, $3, $4, $5, $6, $7, $8 WHERE ",
                dialect::at_one_moment!(),
                " ON CONFLICT (tool_id, folded) DO UPDATE SET fold_version = excluded.fold_version,
                 last_started_at_us = excluded.last_started_at_us, last_machine_id = excluded.last_machine_id,
                 last_seq = excluded.last_seq, last_cycle_id = excluded.last_cycle_id, state = excluded.state"
            ),
            &last.machine,
        ),
    };
    sqlx::query::<Db>(sql)
        .bind(machine.as_str())
        .bind(tool.as_str())
        .bind(count("folded", walk.folded())?)
        .bind(i64::from(FOLD_VERSION))
        .bind(last.started_at.micros())
        .bind(last.seq.map(|seq| count("last_seq", seq)).transpose()?)
        .bind(last.cycle.as_str())
        .bind(state_of(walk.fold()))
        .execute(&mut *conn)
        .await?;
    Ok(())
}

/// A place as the key of the last cycle stands beside a state.
fn key_of(place: &Place) -> StoreResult<(i64, &str, i64, &str)> {
    let at = place.at.micros();
    Ok(match &place.cycle {
        None => (at, "", i64::MIN, ""),
        Some((machine, seq, cycle)) => {
            (at, machine.as_str(), seq.map_or(Ok(-1), |seq| count("seq", seq))?, cycle.as_str())
        }
    })
}

/// Takes back the states over all machines of a tool that have counted what comes at a place or after it. The tool's name is locked
/// by then.
async fn forget_checkpoints(conn: &mut Conn, tool: &ToolId, from: &Place) -> StoreResult<()> {
    let (at, machine, seq, cycle) = key_of(from)?;
    sqlx::query::<Db>(
        "DELETE FROM tool_checkpoints WHERE tool_id = $1
         AND (last_started_at_us, last_machine_id, COALESCE(last_seq, -1), last_cycle_id) >= ($2, $3, $4, $5)",
    )
    .bind(tool.as_str())
    .bind(at)
    .bind(machine)
    .bind(seq)
    .bind(cycle)
    .execute(&mut *conn)
    .await?;
    Ok(())
}

#[derive(sqlx::FromRow)]
struct CheckpointRow {
    folded: i64,
    fold_version: i64,
    last_machine_id: String,
    last_started_at_us: i64,
    last_seq: Option<i64>,
    last_cycle_id: String,
    state: Vec<u8>,
}

impl CheckpointRow {
    /// The fold, where it ends with the cycle that the row says, which late cycles are held against: a key that says otherwise
    /// would leave some out.
    fn fold(&self) -> StoreResult<Option<(ToolFold, u64)>> {
        let Some(fold) = readable(self.fold_version, &self.state) else { return Ok(None) };
        let told = (
            self.last_started_at_us,
            &*self.last_machine_id,
            self.last_seq.unwrap_or(-1),
            &*self.last_cycle_id,
        );
        let last = fold.last().map(Place::of);
        let ends_so = last.as_ref().map(key_of).transpose()?.is_some_and(|key| key == told);
        Ok(ends_so.then_some((fold, number("folded", self.folded)?)))
    }
}

/// The last checkpoint whose cycles all come before `from`.
pub(super) async fn checkpoint_before(
    conn: &mut Conn,
    tool: &ToolId,
    of: Of<'_>,
    from: &Place,
) -> StoreResult<Option<(ToolFold, u64)>> {
    let (at, machine, seq, cycle) = key_of(from)?;
    let sql = match of {
        Of::Machine(_) => {
            "SELECT folded, fold_version, machine_id AS last_machine_id, last_started_at_us, last_seq, last_cycle_id, state
             FROM tool_wear_checkpoints
             WHERE tool_id = $1
               AND (last_started_at_us, machine_id, COALESCE(last_seq, -1), last_cycle_id) < ($2, $3, $4, $5)
               AND machine_id = $6
             ORDER BY folded DESC LIMIT 1"
        }
        Of::All => concat!(
            "SELECT folded, fold_version, last_machine_id, last_started_at_us, last_seq, last_cycle_id, state
             FROM tool_checkpoints
             WHERE ",
            dialect::at_one_moment!(),
            " AND tool_id = $1
               AND (last_started_at_us, last_machine_id, COALESCE(last_seq, -1), last_cycle_id) < ($2, $3, $4, $5)
             ORDER BY folded DESC LIMIT 1"
        ),
    };
    let mut query = sqlx::query_as::<Db, CheckpointRow>(sql)
        .bind(tool.as_str())
        .bind(at)
        .bind(machine)
        .bind(seq)
        .bind(cycle);
    if let Of::Machine(machine) = of {
        query = query.bind(machine.as_str());
    }
    match query.fetch_optional(&mut *conn).await? {
        Some(row) => row.fold(),
        None => Ok(None),
    }
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
pub(super) async fn count_all(conn: &mut Conn, tool: &ToolId, now: Timestamp) -> StoreResult<Verdict> {
    let mut wear = ToolWear::load_locked(conn, tool).await?;
    for machine in machines_of(conn, tool).await? {
        wear.refold(conn, &machine, &BEGINNING).await?;
    }
    wear.save(conn, now).await?;
    wear.verdict(conn).await
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
    let wear = ToolWear::load_locked(conn, tool).await?;
    let from = place_of(event, &wear.events);
    count_from(conn, wear, from, now).await
}

/// Refolds a tool from where an event that was just revoked took effect; `before` are the events with it.
pub(super) async fn count_without_event(
    conn: &mut Conn,
    tool: &ToolId,
    (event, before): (i64, &[PlacedEvent]),
    now: Timestamp,
) -> StoreResult<Verdict> {
    let wear = ToolWear::load_locked(conn, tool).await?;
    count_from(conn, wear, place_of(event, before), now).await
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
    from: Place,
    now: Timestamp,
) -> StoreResult<Verdict> {
    for machine in wear.machines() {
        wear.refold(conn, &machine, &from).await?;
    }
    wear.save(conn, now).await?;
    wear.verdict(conn).await
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
        Some(verdict) => verdict,
        None => {
            let state = wear.state_before(conn, &END).await?;
            let known = state.as_ref().map_or(0, |(_, folded)| *folded);
            if wear.folded().saturating_sub(known) > bound {
                return Ok(None);
            }
            wear.verdict_from(conn, state).await?
        }
    };
    let last = wear.events.iter().rfind(|event| event.kind.begins_life());
    Ok(Some((verdict, last.map_or(BEGINNING, |event| event.place.clone()))))
}
