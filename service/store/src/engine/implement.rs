//! The trait, on top of the statements beside it: which of them run in one transaction.

use super::commit::Counted;
use super::operations::OperationPut;
use super::tools::Judged;
use super::wear::{After, Budget, Looks};
use super::{
    CLOCK_AHEAD_US, Db, Engine, ONE_CLOCK_US, alarms, audit, check, commit, cycles, dialect, feed_profiles,
    fleet, life, machines, models, operations, quarantine, recommendations, registry, retention, series,
    sessions, streams, sums, tokens, tools, verify, watch, wear,
};
use crate::codec::{self, Columns};
use crate::error::{StoreError, StoreResult};
use crate::feed_profile::{
    Drafted, FeedProfile, FeedProfileFilter, NewProfileVersion, ProfileMove, StoredProfileVersion,
};
use crate::lanes::Lane;
use crate::locks::Locks;
use crate::notice::Notices;
use crate::past;
use crate::point::{CyclePoint, LastPoints, PointColumns};
use crate::recent::Group;
use crate::record::{
    ActiveProfiles, Actor, Alarm, AlarmFilter, AuditEntry, CheckPage, CheckedTo, Committed, CycleFilter,
    CycleKey, CycleOverrides, DatabaseUsage, Dropped, FleetRow, FoldKey, IssuedRecommendation, LevelPoint,
    Model, ModelKind, NewCycle, OpenSums, Page, Precondition, PutOutcome, QuarantineBounds, QuarantineEntry,
    Renewed, Repair, Round, RowNumber, SampleDrop, SampleRetention, SamplesGone, Sent, SessionRecord,
    StoreFault, StoredCalibration, StoredCycle, StoredToolEvent, StreamLease, Surroundings, TokenRecord,
    ToolLife, Versioned, WatchSettings, WearCheck,
};
use crate::row_sum::{SumPage, SummedTo};
use crate::store::Store;
use async_trait::async_trait;
use feedwright_core::cycle::{Cycle, MOST_SAMPLES, ProfileVersion};
use feedwright_core::ids::{CycleId, MachineId, ModelId, OperationId, ProfileId, RecommendationId, ToolId};
use feedwright_core::machine::{Calibration, Machine};
use feedwright_core::operation::Operation;
use feedwright_core::recommend::{Knowledge, RecommendSettings};
use feedwright_core::tool::{Tool, ToolEvent};
use feedwright_core::units::Timestamp;
use feedwright_core::wear::Verdict;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
use tokio::sync::Notify;

/// How often it is tried to take a decision back by which more and more goes meanwhile; the next run tries again.
const TAKE_BACK_ATTEMPTS: u32 = 3;
/// Machines that are looked at in one snapshot for samples that are to go.
const MOST_LOOKED_AT: i64 = 512;
/// Machines that are read at a time.
const MACHINES_PAGE: u32 = 100;
/// Bytes of a block that is read on the thread of whoever asks: a millisecond or so. A larger one would hold up streams.
const READ_AT_ONCE: usize = 32 << 10;
/// So long a changed operation waits for folds that follow it: those of a shop's tools do, those of years of a plant's later.
const FOLLOWED_AT_ONCE: Duration = Duration::from_millis(500);
/// Between two pages of cycles whose drops are named.
const NAMES_PAUSE: Duration = Duration::from_millis(20);

/// One change in one transaction, in a task that nobody can cancel.
macro_rules! write {
    ($engine:ident, |$conn:ident| $body:expr) => {
        $engine.write(move |$conn| Box::pin(async move { $body })).await
    };
}

/// As `write!`, of what is registered: begins the next generation, and this server forgets the one before. Where nothing
/// was changed nobody has to forget anything.
macro_rules! register {
    ($engine:ident, |$conn:ident| $body:expr) => {{
        let outcome = write!($engine, |$conn| {
            let outcome = $body?;
            if outcome.is_change() {
                registry::changed($conn).await?;
            }
            Ok(outcome)
        });
        // What it came to may not be known.
        if !outcome.as_ref().is_ok_and(|outcome| !outcome.is_change()) {
            $engine.registry().forget();
        }
        outcome
    }};
}

/// What a change of what is registered came to.
trait Registered {
    /// Whether it changed anything.
    fn is_change(&self) -> bool;
}

impl Registered for OperationPut {
    fn is_change(&self) -> bool {
        self.outcome.is_change()
    }
}

impl Registered for PutOutcome {
    fn is_change(&self) -> bool {
        !matches!(self, Self::Unchanged(_))
    }
}

impl<T: Registered> Registered for Judged<T> {
    fn is_change(&self) -> bool {
        self.outcome.is_change()
    }
}

impl<T> Registered for Option<T> {
    fn is_change(&self) -> bool {
        self.is_some()
    }
}

/// One statement that reads. Cancelled half-way it leaves a connection that may still be at work: only one that ended
/// well is lent again without a question.
macro_rules! read {
    ($engine:ident, |$conn:ident| $body:expr) => {
        read!($engine.reader(Lane::Usual), |$conn| $body)
    };
    ($engine:ident.$reader:ident($lane:expr), |$conn:ident| $body:expr) => {{
        let mut lent = $engine.$reader($lane).await?;
        let $conn = &mut *lent;
        let outcome = $engine.in_time(async { $body }).await;
        if outcome.is_ok() {
            lent.settle();
        }
        outcome
    }};
}

/// Reads that belong together, in one snapshot.
macro_rules! snapshot {
    ($engine:ident, |$conn:ident| $body:expr) => {
        snapshot!($engine, Lane::Usual, |$conn| $body)
    };
    ($engine:ident, $lane:expr, |$conn:ident| $body:expr) => {
        $engine.snapshot($lane, move |$conn| Box::pin(async move { $body })).await
    };
}

impl Engine {
    /// The next machine of which samples are to go: that of the step before, or the first one behind it, or the first of all.
    /// Looked for beside the writer: a step that finds them gone by then deletes nothing.
    async fn next_to_drop(&self) -> StoreResult<Option<String>> {
        let before = self.dropping().take();
        let was_at_first = before.is_empty();
        let mut found = self.to_drop_from(before).await?;
        if found.is_none() && !was_at_first {
            found = self.to_drop_from(String::new()).await?;
        }
        self.dropping().put(found.clone().unwrap_or_default());
        Ok(found)
    }

    /// The first machine from one on of which samples are to go.
    async fn to_drop_from(&self, mut from: String) -> StoreResult<Option<String>> {
        // Most steps go on where the last one was.
        let mut most = 1;
        loop {
            let (found, last) = snapshot!(self, |conn| dialect::next_to_drop(conn, &from, most).await)?;
            match (found, last) {
                (Some(found), _) => return Ok(Some(found)),
                (None, None) => return Ok(None),
                // The least text behind it.
                (None, Some(last)) => from = last + "\u{1}",
            }
            most = (most * 8).min(MOST_LOOKED_AT);
        }
    }

    /// Takes back what a clock that was ahead has decided on a machine's samples. What is gone by it stays told: its
    /// cycles are named first, some at a time, which the writer can bear; where more goes meanwhile, again.
    async fn take_back(&self, machine: &MachineId, now: Timestamp) -> StoreResult<()> {
        if !past::may_be_right(now) {
            return Ok(());
        }
        let clock = (now, if self.is_alone() { ONE_CLOCK_US } else { CLOCK_AHEAD_US });
        for _ in 0..TAKE_BACK_ATTEMPTS {
            let id = machine.clone();
            let Some(ahead) = snapshot!(self, |conn| retention::gone::ahead(conn, &id, clock).await)? else {
                return Ok(());
            };
            let mut after = ahead.has_dropped().then(String::new);
            while let Some(from) = after {
                let (id, ahead) = (machine.clone(), ahead.clone());
                after = write!(self, |conn| retention::gone::name_page(conn, &id, &ahead, &from, now).await)?;
                // Live posts have the writer between two pages.
                tokio::time::sleep(NAMES_PAUSE).await;
            }
            let id = machine.clone();
            if write!(self, |conn| retention::gone::take_back(conn, &id, &ahead, clock).await)? {
                return Ok(());
            }
        }
        tracing::warn!(%machine, "samples go by the decision of a clock that was ahead while it is taken back");
        Ok(())
    }

    /// Makes the folds anew that are behind a change of an operation, one tool after the other, as far as that is done soon, so that alarms
    /// follow as well. The change is stored by then, and holds whether this succeeds or not.
    async fn follow_change(&self, now: Timestamp) {
        let (until, mut after) = (Instant::now() + FOLLOWED_AT_ONCE, After::Nothing);
        while Instant::now() < until {
            let tool = match self.look_for_outdated(&after, Looks::AtOnce).await {
                Ok(wear::Looked::Found(tool)) => tool,
                Ok(wear::Looked::NoneUpTo(fold)) => {
                    after = After::Fold(fold);
                    continue;
                }
                Ok(wear::Looked::End) => return,
                Err(error) => {
                    return tracing::warn!(%error, "folds do not follow a changed operation at once");
                }
            };
            if let Err(error) = self.renew(&tool, now, Budget::at_once()).await {
                tracing::warn!(%error, %tool, "the tool's fold does not follow a changed operation at once");
            }
            after = After::Tool(tool);
        }
    }

    /// Makes a tool's folds anew that are not up to date, as far as the budget reaches; its alarms follow when they are whole.
    async fn renew(&self, tool: &ToolId, now: Timestamp, mut budget: Budget) -> StoreResult<Renewed> {
        let tool = tool.clone();
        write!(self, |conn| {
            dialect::lock(conn, &Locks::tool(&tool)).await?;
            let Some((renewed, verdict)) = wear::renew(conn, &tool, now, &mut budget).await? else {
                return Ok(Renewed::Nothing);
            };
            if renewed == Renewed::Whole {
                alarms::follow_verdict(conn, &tool, &verdict, now).await?;
            }
            Ok(renewed)
        })
    }

    /// What a change that tools are judged anew by came to; wakes who folds in the background what it left.
    fn judged<T>(&self, change: StoreResult<Judged<T>>) -> StoreResult<T> {
        let may_be_postponed = match &change {
            Ok(judged) => judged.is_postponed,
            Err(error) => matches!(error, StoreError::OutcomeUnknown(_)),
        };
        if may_be_postponed {
            self.postponed().notify_one();
        }
        change.map(|judged| judged.outcome)
    }

    async fn look_for_outdated(&self, after: &After, looks: Looks) -> StoreResult<wear::Looked> {
        read!(self, |conn| wear::next_outdated(conn, after, looks).await)
    }

    /// Commits a group, again where the server was lost or chose it as a deadlock's victim: what was committed after
    /// all is found by its key and answered as known. Not again where the server could not be reached in all of a
    /// connection's patience, or took as long as a group may: machines wait, and send again what is not acknowledged.
    async fn commit_group(
        &self,
        group: &Arc<[NewCycle]>,
        now: Timestamp,
        settings: RecommendSettings,
    ) -> StoreResult<Vec<Committed>> {
        let (mut attempt, mut unknown) = (1, false);
        loop {
            let begun = Instant::now();
            let cycles = Arc::clone(group);
            let registry = Arc::clone(self.registry());
            let mut memory = self.memory().take();
            let touched = self.recent().map(|recent| Group::of(Arc::clone(group), Arc::clone(recent)));
            let locked = Arc::clone(group);
            let group = self.write_group(
                move || commit::locks(&locked),
                move |writer| {
                    Box::pin(async move {
                        let _until_committed = touched;
                        let known = (&*registry, &mut memory);
                        let (counted, written) = commit::group(writer, &cycles, now, settings, known).await?;
                        Ok(((counted, memory), written))
                    })
                },
            );
            let outcome = group.await;
            match outcome {
                Ok((Counted { answers, changes_alarms }, memory)) => {
                    self.memory().put(memory);
                    // One before this may have been committed, with the alarms that this one found there.
                    if changes_alarms || unknown {
                        self.changes_of_alarms().fetch_add(1, Ordering::Release);
                    }
                    if answers.iter().any(Committed::is_being_counted) {
                        self.postponed().notify_one();
                    }
                    self.heed_group(Ok(()));
                    return Ok(answers);
                }
                Err(error @ (StoreError::Unavailable(_) | StoreError::OutcomeUnknown(_)))
                    if attempt < dialect::COMMIT_ATTEMPTS
                        && !self.is_away(&error).await
                        && !self.is_too_slow(begun.elapsed()) =>
                {
                    attempt += 1;
                    unknown |= matches!(error, StoreError::OutcomeUnknown(_));
                }
                // What an attempt before this one may have committed is not undone by this one.
                Err(StoreError::Unavailable(error)) if unknown => {
                    return Err(StoreError::OutcomeUnknown(error));
                }
                Err(error) => {
                    self.heed_group(Err(&error));
                    return Err(error);
                }
            }
        }
    }
}

#[async_trait]
impl Store for Engine {
    async fn commit_cycles(
        &self,
        group: Vec<NewCycle>,
        now: Timestamp,
        settings: RecommendSettings,
    ) -> Vec<StoreResult<Committed>> {
        let group: Arc<[NewCycle]> = group.into();
        let error = match self.commit_group(&group, now, settings).await {
            Ok(outcomes) => return outcomes.into_iter().map(Ok).collect(),
            Err(error) => error,
        };
        let of_a_row = matches!(
            error,
            StoreError::Refused { .. } | StoreError::Damaged { .. } | StoreError::Database(_)
        );
        if !of_a_row || group.len() < 2 {
            return group.iter().map(|_| Err(error.again())).collect();
        }
        let mut outcomes = Vec::with_capacity(group.len());
        for cycle in group.iter() {
            let one: Arc<[NewCycle]> = [cycle.clone()].into();
            outcomes.push(self.commit_group(&one, now, settings).await.and_then(|mut outcomes| {
                outcomes.pop().ok_or_else(|| StoreError::Damaged { what: "no answer".to_owned() })
            }));
        }
        outcomes
    }

    async fn answers(&self) -> StoreResult<()> {
        self.word().await
    }

    async fn probe_write(&self, now: Timestamp) -> StoreResult<()> {
        write!(self, |conn| {
            sqlx::query::<Db>(
                "INSERT INTO write_probe (probe_id, probed_at_us) VALUES (1, $1)
                 ON CONFLICT (probe_id) DO UPDATE SET probed_at_us = excluded.probed_at_us",
            )
            .bind(now.micros())
            .execute(&mut *conn)
            .await?;
            dialect::may_write(conn).await
        })?;
        self.has_room()
    }

    async fn fleet(&self, page: Page<MachineId>, recent: u32) -> StoreResult<Vec<FleetRow>> {
        let asked = page.clone();
        // As with the verdict on one tool: histories are not walked where lists wait.
        let rows = snapshot!(self, |conn| fleet::list(conn, &asked, recent, wear::AT_ONCE).await)?;
        let rows = match rows {
            None => snapshot!(self, Lane::Long, |conn| fleet::list(conn, &page, recent, u64::MAX).await)?,
            rows => rows,
        };
        Ok(rows.unwrap_or_default())
    }

    async fn fleet_machine(&self, machine: &MachineId, recent: u32) -> StoreResult<Option<FleetRow>> {
        let (machine, asked) = (machine.clone(), machine.clone());
        let rows = snapshot!(self, |conn| fleet::one(conn, &asked, recent, wear::AT_ONCE).await)?;
        let rows = match rows {
            None => snapshot!(self, Lane::Long, |conn| fleet::one(conn, &machine, recent, u64::MAX).await)?,
            rows => rows,
        };
        Ok(rows.and_then(|mut rows| rows.pop()))
    }

    async fn watch(
        &self,
        heard: Vec<(MachineId, Duration)>,
        settings: &WatchSettings,
        now: Timestamp,
    ) -> StoreResult<Round> {
        let (engine, settings) = (self.clone(), settings.clone());
        write!(self, |conn| {
            // The clock is read by one round after the other: one that waited with an earlier time would clear what the other raised.
            dialect::lock(conn, &Locks::subject("watch", "")).await?;
            let now = engine.common_time(conn, now).await?;
            watch::round(conn, &heard, &settings, now).await
        })
    }

    async fn usage(&self) -> StoreResult<DatabaseUsage> {
        self.measure().await
    }

    async fn close(&self) {
        self.shut().await;
    }

    async fn notify(&self, text: &str) -> StoreResult<()> {
        self.tell(text).await
    }

    fn notices(&self) -> Option<Arc<dyn Notices>> {
        self.ears()
    }

    async fn put_machine(
        &self,
        machine: Machine,
        expects: Precondition,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<PutOutcome> {
        let actor = actor.clone();
        register!(self, |conn| machines::put(conn, &machine, expects, &actor, now).await)
    }

    async fn machine(&self, id: &MachineId) -> StoreResult<Option<Versioned<Machine>>> {
        read!(self.reader(Lane::Short), |conn| machines::get(conn, id).await)
    }

    async fn machines(&self, page: Page<MachineId>) -> StoreResult<Vec<Versioned<Machine>>> {
        read!(self, |conn| machines::list(conn, &page).await)
    }

    async fn put_tool(
        &self,
        tool: Tool,
        expects: Precondition,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<PutOutcome> {
        let actor = actor.clone();
        self.judged(register!(self, |conn| tools::put(conn, &tool, expects, &actor, now).await))
    }

    async fn tool(&self, id: &ToolId) -> StoreResult<Option<Versioned<Tool>>> {
        read!(self.reader(Lane::Short), |conn| tools::get(conn, id).await)
    }

    async fn tools(&self, page: Page<ToolId>) -> StoreResult<Vec<Versioned<Tool>>> {
        read!(self, |conn| tools::list(conn, &page).await)
    }

    async fn add_tool_event(
        &self,
        tool: &ToolId,
        event: ToolEvent,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<Option<StoredToolEvent>> {
        let (tool, actor) = (tool.clone(), actor.clone());
        self.judged(register!(self, |conn| tools::add_event(conn, &tool, event, &actor, now).await))
    }

    async fn revoke_tool_event(
        &self,
        tool: &ToolId,
        event: RowNumber,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<Option<StoredToolEvent>> {
        let (tool, actor) = (tool.clone(), actor.clone());
        self.judged(register!(self, |conn| tools::revoke_event(conn, &tool, event, &actor, now).await))
    }

    async fn tool_events(&self, tool: &ToolId, page: Page<RowNumber>) -> StoreResult<Vec<StoredToolEvent>> {
        read!(self, |conn| tools::events(conn, tool, &page).await)
    }

    async fn put_operation(
        &self,
        operation: Operation,
        expects: Precondition,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<PutOutcome> {
        let actor = actor.clone();
        let put = register!(self, |conn| operations::put(conn, &operation, expects, &actor, now).await)?;
        if put.judged_otherwise {
            self.follow_change(now).await;
        }
        Ok(put.outcome)
    }

    async fn operation(&self, id: &OperationId) -> StoreResult<Option<Versioned<Operation>>> {
        read!(self.reader(Lane::Short), |conn| operations::get(conn, id).await)
    }

    async fn operations(&self, page: Page<OperationId>) -> StoreResult<Vec<Versioned<Operation>>> {
        read!(self, |conn| operations::list(conn, &page).await)
    }

    async fn put_model(
        &self,
        model: Model,
        expects: Precondition,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<PutOutcome> {
        let actor = actor.clone();
        register!(self, |conn| models::put(conn, &model, expects, &actor, now).await)
    }

    async fn model(&self, kind: ModelKind, id: &ModelId) -> StoreResult<Option<Versioned<Model>>> {
        read!(self.reader(Lane::Short), |conn| models::get(conn, kind, id).await)
    }

    async fn models(&self, kind: ModelKind, page: Page<ModelId>) -> StoreResult<Vec<Versioned<Model>>> {
        read!(self, |conn| models::list(conn, kind, &page).await)
    }

    async fn knowledge(&self, operation: &Operation, tool: &ToolId) -> StoreResult<Knowledge> {
        if !models::are_needed(operation) {
            return Ok(Knowledge::None);
        }
        // Of an edge all that it has cut is read; of a plunge one entry, which a stream that begins waits for.
        let lane = if operation.turning.is_some() { Lane::Usual } else { Lane::Short };
        let (operation, tool) = (operation.clone(), tool.clone());
        snapshot!(self, lane, |conn| models::knowledge(conn, Some(&operation), &tool).await)
    }

    async fn draft_profile(
        &self,
        id: &ProfileId,
        new: NewProfileVersion,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<Drafted> {
        let (id, actor) = (id.clone(), actor.clone());
        write!(self, |conn| feed_profiles::draft(conn, &id, &new, &actor, now).await)
    }

    async fn move_profile(
        &self,
        id: &ProfileId,
        what: ProfileMove,
        expects: Precondition,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<Option<FeedProfile>> {
        let (id, actor) = (id.clone(), actor.clone());
        // What is active is remembered with the registry, see `Memory::profiles`.
        register!(self, |conn| feed_profiles::advance(conn, &id, what, expects, &actor, now).await)
    }

    async fn feed_profile(&self, id: &ProfileId) -> StoreResult<Option<FeedProfile>> {
        read!(self, |conn| feed_profiles::get(conn, id).await)
    }

    async fn feed_profiles(
        &self,
        filter: &FeedProfileFilter,
        page: Page<ProfileId>,
    ) -> StoreResult<Vec<FeedProfile>> {
        read!(self, |conn| feed_profiles::list(conn, filter, &page).await)
    }

    async fn profile_version(
        &self,
        id: &ProfileId,
        version: u32,
    ) -> StoreResult<Option<StoredProfileVersion>> {
        read!(self.reader(Lane::Short), |conn| feed_profiles::version(conn, id, version).await)
    }

    async fn profile_versions(
        &self,
        id: &ProfileId,
        page: Page<u32>,
    ) -> StoreResult<Vec<StoredProfileVersion>> {
        read!(self, |conn| feed_profiles::versions(conn, id, &page).await)
    }

    async fn active_profiles(&self, operation: &OperationId, tool: &ToolId) -> StoreResult<ActiveProfiles> {
        read!(self.reader(Lane::Short), |conn| feed_profiles::active(conn, operation, tool).await)
    }

    async fn cycles_of_profile(&self, ran: &ProfileVersion, most: u32) -> StoreResult<Vec<StoredCycle>> {
        read!(self, |conn| feed_profiles::cycles(conn, ran, most).await)
    }

    async fn recent_cycles(
        &self,
        operation: &OperationId,
        tool_type: &str,
        most: u32,
    ) -> StoreResult<Vec<StoredCycle>> {
        let (operation, tool_type) = (operation.clone(), tool_type.to_owned());
        snapshot!(self, |conn| feed_profiles::recent(conn, &operation, &tool_type, most).await)
    }

    async fn add_calibration(
        &self,
        machine: &MachineId,
        calibration: Calibration,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<Option<Calibration>> {
        let (machine, actor) = (machine.clone(), actor.clone());
        register!(self, |conn| machines::calibrate(conn, &machine, calibration, &actor, now).await)
    }

    async fn calibrations(
        &self,
        machine: &MachineId,
        page: Page<u32>,
    ) -> StoreResult<Vec<StoredCalibration>> {
        read!(self, |conn| machines::calibrations(conn, machine, &page).await)
    }

    async fn surroundings(
        &self,
        machine: &MachineId,
        operation: &OperationId,
        tool: &ToolId,
    ) -> StoreResult<Option<Surroundings>> {
        let (machine, operation, tool) = (machine.clone(), operation.clone(), tool.clone());
        snapshot!(self, Lane::Short, |conn| machines::surroundings(conn, &machine, &operation, &tool).await)
    }

    async fn hold_sums(&self, after: Option<&SummedTo>) -> StoreResult<SumPage> {
        let after = after.cloned();
        snapshot!(self, |conn| Ok(sums::page(conn, after.as_ref()).await?.0))
    }

    async fn sum_rows(&self, after: Option<&SummedTo>) -> StoreResult<u64> {
        let after = after.cloned();
        write!(self, |conn| sums::sum(conn, after.as_ref()).await)
    }

    async fn recent_surroundings(
        &self,
        machine: &MachineId,
        operation: &OperationId,
        tool: &ToolId,
        at: Timestamp,
    ) -> StoreResult<Option<(Surroundings, i64)>> {
        if let Some(known) = self.registry().around(machine, operation, tool, at) {
            return Ok(Some(known));
        }
        let names = (machine.clone(), operation.clone(), tool.clone());
        let registry = Arc::clone(self.registry());
        snapshot!(self, Lane::Short, |conn| registry::around(
            conn,
            &registry,
            (&names.0, &names.1, &names.2),
            at
        )
        .await)
    }

    async fn cycle(&self, machine: &MachineId, id: &CycleId) -> StoreResult<Option<StoredCycle>> {
        read!(self.reader(Lane::Short), |conn| cycles::get(conn, machine, id).await)
    }

    async fn differences(&self, sent: Cycle) -> StoreResult<Vec<String>> {
        let content = {
            let (machine, id) = (sent.machine.clone(), sent.id.clone());
            snapshot!(self, Lane::Short, |conn| cycles::content(conn, &machine, &id).await)?
        };
        let Some(content) = content else {
            return Ok(Vec::new());
        };
        // Large ones take long, and conflicts are rare.
        tokio::task::spawn_blocking(move || content.differences(&sent))
            .await
            .map_err(|error| StoreError::Unavailable(error.into()))?
    }

    async fn cycle_columns(&self, machine: &MachineId, id: &CycleId) -> StoreResult<Option<Columns>> {
        let block = match self.block_at_once(machine, id) {
            Some(block) => block?,
            None => read!(self, |conn| dialect::block(conn, machine, id).await)?,
        };
        match block {
            Some(block) if block.len() > READ_AT_ONCE => {
                tokio::task::spawn_blocking(move || codec::decode_columns(&block, MOST_SAMPLES))
                    .await
                    .map_err(|error| StoreError::Unavailable(error.into()))?
                    .map(Some)
            }
            block => block.map(|block| codec::decode_columns(&block, MOST_SAMPLES)).transpose(),
        }
    }

    async fn cycles(&self, filter: &CycleFilter, page: Page<CycleKey>) -> StoreResult<Vec<StoredCycle>> {
        read!(self.reader_in_order(Lane::Usual), |conn| cycles::list(conn, filter, &page).await)
    }

    async fn last_cycles(&self, filter: &CycleFilter, limit: u32) -> StoreResult<Vec<StoredCycle>> {
        read!(self.reader_in_order(Lane::Usual), |conn| cycles::last(conn, filter, limit).await)
    }

    async fn points(&self, filter: &CycleFilter, page: Page<CycleKey>) -> StoreResult<Vec<CyclePoint>> {
        read!(self.reader_in_order(Lane::Long), |conn| series::points(conn, filter, &page).await)
    }

    async fn last_points(
        &self,
        filter: &CycleFilter,
        told: PointColumns,
        limit: u32,
    ) -> StoreResult<LastPoints> {
        match (self.recent(), filter) {
            (
                Some(recent),
                CycleFilter { tool: Some(tool), machine: None, operation: None, from: None, to: None },
            ) if told == PointColumns::Energy => self.last_energies(recent, tool, limit).await,
            _ => {
                let read = read!(self.reader_in_order(Lane::Usual), |conn| {
                    series::last_points(conn, filter, told, limit).await
                });
                Ok(read?.into())
            }
        }
    }

    async fn levels(
        &self,
        tool: &ToolId,
        from: Timestamp,
        to: Timestamp,
        limit: u32,
    ) -> StoreResult<Vec<LevelPoint>> {
        let tool = tool.clone();
        snapshot!(self, Lane::Long, |conn| series::levels(conn, &tool, from, to, limit).await)
    }

    async fn retention(&self, machine: &MachineId) -> StoreResult<Option<Versioned<SampleRetention>>> {
        read!(self, |conn| retention::get(conn, machine).await)
    }

    async fn put_retention(
        &self,
        machine: &MachineId,
        retention: SampleRetention,
        expects: Precondition,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<Option<PutOutcome>> {
        let (machine, actor) = (machine.clone(), actor.clone());
        write!(self, |conn| retention::put(conn, &machine, retention, expects, &actor, now).await)
    }

    async fn sample_drops(&self, machine: &MachineId) -> StoreResult<Vec<SampleDrop>> {
        read!(self, |conn| retention::drops(conn, machine).await)
    }

    async fn samples_gone(
        &self,
        machine: &MachineId,
        cycles: &[(CycleId, Timestamp)],
    ) -> StoreResult<BTreeMap<CycleId, SamplesGone>> {
        let (machine, cycles) = (machine.clone(), cycles.to_vec());
        snapshot!(self, |conn| retention::gone::of(conn, &machine, &cycles).await)
    }

    async fn age_samples(&self, now: Timestamp, gone_by: Duration) -> StoreResult<Timestamp> {
        let engine = self.clone();
        write!(self, |conn| {
            let now = engine.common_time(conn, now).await?;
            retention::age(conn, now, gone_by).await
        })
    }

    async fn decide_drops(&self, otherwise: SampleRetention, now: Timestamp) -> StoreResult<Vec<SampleDrop>> {
        let (mut decided, mut after) = (Vec::new(), None);
        let engine = self.clone();
        let (now, aged_to) = snapshot!(self, |conn| {
            let now = engine.common_time(conn, now).await?;
            Ok((now, retention::aged_to(conn, now).await?.min(now)))
        })?;
        loop {
            let page = self.machines(Page { after: after.take(), limit: MACHINES_PAGE }).await?;
            for machine in &page {
                let id = machine.value.id.clone();
                self.take_back(&id, now).await?;
                let horizon = snapshot!(self, |conn| {
                    let said = retention::get(conn, &id).await?;
                    let kept = said.as_ref().map_or(otherwise, |said| said.value);
                    let horizon = retention::horizon(conn, &id, kept, (now, aged_to)).await?;
                    Ok(horizon.map(|horizon| (horizon, said.map(|said| said.version))))
                })?;
                let id = machine.value.id.clone();
                if let Some((horizon, said)) = horizon {
                    let made = write!(self, |conn| retention::decide(conn, &id, horizon, said, now).await)?;
                    // What is dropped goes machine by machine, from the first of them on.
                    self.dropping().put(String::new());
                    decided.extend(made);
                }
            }
            match page.last() {
                Some(last) if page.len() == MACHINES_PAGE as usize => after = Some(last.value.id.clone()),
                _ => return Ok(decided),
            }
        }
    }

    async fn drop_partition(&self, now: Timestamp) -> StoreResult<Dropped> {
        let engine = self.clone();
        write!(self, |conn| {
            let now = engine.common_time(conn, now).await?;
            retention::drop_partition(conn, now).await
        })
    }

    async fn drop_some(&self, most: u32) -> StoreResult<Dropped> {
        let dropped = match self.next_to_drop().await? {
            Some(machine) => write!(self, |conn| retention::delete_some(conn, &machine, most).await)?,
            None => write!(self, |conn| retention::tidy(conn).await)?,
        };
        let freed = self.give_back().await?;
        Ok(Dropped { more: dropped.more || freed, ..dropped })
    }

    async fn make_room(&self, now: Timestamp) -> StoreResult<()> {
        write!(self, |conn| dialect::make_room(conn, now).await)
    }

    async fn check_cycles(&self, after: Option<&CheckedTo>, limit: u32) -> StoreResult<CheckPage> {
        let after = after.cloned();
        snapshot!(self, Lane::Long, |conn| verify::page(conn, after.as_ref(), limit).await)
    }

    async fn check_tables(&self) -> StoreResult<Vec<StoreFault>> {
        self.held_to_constraints(|conn| Box::pin(async move { verify::tables(conn).await })).await
    }

    async fn verdict(&self, tool: &ToolId) -> StoreResult<Verdict> {
        let tool = tool.clone();
        let asked = tool.clone();
        if let Some(verdict) = snapshot!(self, Lane::Short, |conn| wear::verdict_at_once(conn, &asked).await)?
        {
            return Ok(verdict);
        }
        snapshot!(self, Lane::Long, |conn| wear::verdict(conn, &tool).await)
    }

    async fn life(&self, tool: &ToolId, most: u32) -> StoreResult<ToolLife> {
        let tool = tool.clone();
        let asked = tool.clone();
        if let Some(life) = snapshot!(self, Lane::Usual, |conn| life::at_once(conn, &asked, most).await)? {
            return Ok(life);
        }
        snapshot!(self, Lane::Long, |conn| life::of(conn, &tool, most).await)
    }

    async fn next_outdated_fold(&self, after: Option<&ToolId>) -> StoreResult<Option<ToolId>> {
        let mut after = after.cloned().map_or(After::Nothing, After::Tool);
        loop {
            match self.look_for_outdated(&after, Looks::InBackground).await? {
                wear::Looked::Found(tool) => return Ok(Some(tool)),
                wear::Looked::NoneUpTo(fold) => after = After::Fold(fold),
                wear::Looked::End => return Ok(None),
            }
        }
    }

    async fn renew_fold(&self, tool: &ToolId, now: Timestamp) -> StoreResult<Renewed> {
        self.renew(tool, now, Budget::slice()).await
    }

    fn folds_postponed(&self) -> Arc<Notify> {
        Arc::clone(self.postponed())
    }

    async fn note_unchanged_folds(&self, after: Option<&FoldKey>) -> StoreResult<Option<FoldKey>> {
        let after = after.cloned().map_or(After::Nothing, After::Fold);
        let Some(wear::Unchanged { last, folds, judging_change }) =
            snapshot!(self, |conn| wear::next_unchanged(conn, &after).await)?
        else {
            return Ok(None);
        };
        if !folds.is_empty() {
            write!(self, |conn| wear::note_unchanged(conn, judging_change, &folds).await)?;
        }
        Ok(Some(last))
    }

    async fn check_wear(&self, repair: Repair<'_>) -> StoreResult<WearCheck> {
        let mut checked = WearCheck::default();
        let doubt = repair.doubt().cloned().map(Arc::new);
        for next in snapshot!(self, Lane::Long, |conn| check::tools(conn).await)? {
            let Some(tool) = next.as_str().and_then(|tool| ToolId::try_from(tool).ok()) else {
                checked.unreadable.push((next.to_string(), "its id is no identifier".to_owned()));
                continue;
            };
            let found: StoreResult<_> = match doubt.clone() {
                Some(doubt) => write!(self, |conn| check::tool(conn, &tool, Some(&doubt)).await),
                None => snapshot!(self, Lane::Long, |conn| check::tool(conn, &tool, None).await),
            };
            match found {
                Ok((rows, different)) => {
                    checked.rows += rows;
                    checked.different.extend(different);
                }
                Err(StoreError::Damaged { what }) => checked.unreadable.push((next.to_string(), what)),
                Err(error) => return Err(error),
            }
        }
        Ok(checked)
    }

    async fn issue_recommendation(&self, issued: &IssuedRecommendation) -> StoreResult<()> {
        let issued = issued.clone();
        write!(self, |conn| recommendations::issue(conn, &issued).await)
    }

    async fn recommendation(&self, id: &RecommendationId) -> StoreResult<Option<IssuedRecommendation>> {
        read!(self, |conn| recommendations::get(conn, id).await)
    }

    async fn alarms(&self, filter: &AlarmFilter, page: Page<RowNumber>) -> StoreResult<Vec<Alarm>> {
        read!(self, |conn| alarms::list(conn, filter, &page, RowNumber::MAX).await)
    }

    async fn alarm_history(&self, filter: &AlarmFilter, page: Page<RowNumber>) -> StoreResult<Vec<Alarm>> {
        // As with the audit.
        let last = read!(self, |conn| dialect::last_alarm(conn).await)?;
        read!(self, |conn| alarms::list(conn, filter, &page, last).await)
    }

    async fn open_overloads(&self, machine: &MachineId) -> StoreResult<Vec<RowNumber>> {
        // A stream that begins waits for the answer.
        read!(self.reader(Lane::Short), |conn| alarms::open_overloads(conn, machine).await)
    }

    async fn open_alarm_sums(&self) -> StoreResult<(RowNumber, OpenSums)> {
        read!(self, |conn| alarms::open_sums(conn).await)
    }

    async fn open_alarm_numbers(&self, page: Page<RowNumber>) -> StoreResult<Vec<(RowNumber, bool)>> {
        read!(self, |conn| alarms::open_numbers(conn, &page).await)
    }

    async fn alarms_numbered(&self, numbers: &[RowNumber]) -> StoreResult<Vec<Alarm>> {
        read!(self, |conn| alarms::numbered(conn, numbers).await)
    }

    fn alarm_changes(&self) -> u64 {
        self.changes_of_alarms().load(Ordering::Acquire)
    }

    async fn acknowledge_alarm(
        &self,
        id: RowNumber,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<Option<Alarm>> {
        let actor = actor.clone();
        write!(self, |conn| alarms::acknowledge(conn, id, &actor, now).await)
    }

    async fn quarantine(
        &self,
        entry: QuarantineEntry,
        body: Vec<u8>,
        bounds: QuarantineBounds,
    ) -> StoreResult<String> {
        let packed = quarantine::Packed::of(&body)?;
        write!(self, |conn| quarantine::add(conn, &entry, &packed, bounds).await)
    }

    async fn quarantined(
        &self,
        machine: Option<&MachineId>,
        open: bool,
        page: Page<String>,
    ) -> StoreResult<Vec<QuarantineEntry>> {
        read!(self, |conn| quarantine::list(conn, machine, open, &page).await)
    }

    async fn quarantine_entry(&self, id: &str) -> StoreResult<Option<(QuarantineEntry, Option<Vec<u8>>)>> {
        read!(self, |conn| quarantine::get(conn, id).await)
    }

    async fn claim_quarantine(
        &self,
        id: &str,
        holder: &str,
        lease: Duration,
        now: Timestamp,
    ) -> StoreResult<bool> {
        let (engine, id, holder) = (self.clone(), id.to_owned(), holder.to_owned());
        write!(self, |conn| {
            let now = engine.common_time(conn, now).await?;
            quarantine::claim(conn, &id, &holder, (now, lease)).await
        })
    }

    async fn release_quarantine(&self, id: &str, holder: &str) -> StoreResult<()> {
        let (id, holder) = (id.to_owned(), holder.to_owned());
        write!(self, |conn| quarantine::release(conn, &id, &holder).await.map(drop))
    }

    async fn settle_quarantine(
        &self,
        id: &str,
        holder: &str,
        how: &str,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<bool> {
        let (id, holder, how, actor) = (id.to_owned(), holder.to_owned(), how.to_owned(), actor.clone());
        write!(self, |conn| quarantine::settle(conn, (&id, &holder), &how, &actor, now).await)
    }

    async fn audit(&self, page: Page<RowNumber>) -> StoreResult<Vec<AuditEntry>> {
        // By itself, before what is listed is looked up: what was open then is left for the next page.
        let last = read!(self, |conn| dialect::last_audit_line(conn).await)?;
        read!(self, |conn| audit::list(conn, &page, last).await)
    }

    async fn newest_audit(&self, page: Page<RowNumber>) -> StoreResult<Vec<AuditEntry>> {
        read!(self, |conn| audit::newest(conn, &page).await)
    }

    async fn create_token(&self, token: TokenRecord, actor: &Actor) -> StoreResult<()> {
        let actor = actor.clone();
        write!(self, |conn| tokens::create(conn, &token, &actor).await)
    }

    async fn create_first_token(&self, token: TokenRecord, actor: &Actor) -> StoreResult<bool> {
        let actor = actor.clone();
        write!(self, |conn| tokens::create_first(conn, &token, &actor).await)
    }

    async fn token_by_hash(&self, hash: &[u8; 32]) -> StoreResult<Option<TokenRecord>> {
        read!(self.reader_of_others(Lane::Short), |conn| tokens::by_hash(conn, hash).await)
    }

    async fn tokens(&self, page: Page<String>) -> StoreResult<Vec<TokenRecord>> {
        read!(self, |conn| tokens::list(conn, &page).await)
    }

    async fn revoke_token(
        &self,
        id: &str,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<Option<TokenRecord>> {
        let (id, actor) = (id.to_owned(), actor.clone());
        write!(self, |conn| tokens::revoke(conn, &id, &actor, now).await)
    }

    async fn take_stream(
        &self,
        machine: &MachineId,
        holder: &str,
        takeover: bool,
        lease: Duration,
        now: Timestamp,
    ) -> StoreResult<StreamLease> {
        let (engine, machine, holder) = (self.clone(), machine.clone(), holder.to_owned());
        write!(self, |conn| {
            let now = engine.common_time(conn, now).await?;
            streams::take(conn, &machine, &holder, takeover, (now, lease)).await
        })
    }

    async fn renew_streams(
        &self,
        holder: &str,
        machines: &[MachineId],
        lease: Duration,
        now: Timestamp,
    ) -> StoreResult<Vec<(MachineId, i64)>> {
        let (engine, holder, machines) = (self.clone(), holder.to_owned(), machines.to_vec());
        write!(self, |conn| {
            let now = engine.common_time(conn, now).await?;
            streams::renew(conn, &holder, &machines, (now, lease)).await
        })
    }

    async fn leased_streams(&self, machines: &[MachineId], now: Timestamp) -> StoreResult<Vec<MachineId>> {
        read!(self.reader(Lane::Short), |conn| {
            let now = self.common_time(conn, now).await?;
            streams::leased(conn, machines, now).await
        })
    }

    async fn release_stream(&self, machine: &MachineId, holder: &str, generation: i64) -> StoreResult<()> {
        let (machine, holder) = (machine.clone(), holder.to_owned());
        write!(self, |conn| streams::release(conn, &machine, &holder, generation).await)
    }

    async fn put_overrides(&self, overrides: &CycleOverrides, sent: Sent) -> StoreResult<()> {
        let overrides = overrides.clone();
        write!(self, |conn| streams::put_overrides(conn, &overrides, sent).await)
    }

    async fn overrides(&self, machine: &MachineId, id: &CycleId) -> StoreResult<Option<CycleOverrides>> {
        read!(self.reader(Lane::Short), |conn| streams::overrides(conn, machine, id).await)
    }

    async fn raise_overload(
        &self,
        machine: &MachineId,
        tool: &ToolId,
        message: &str,
        now: Timestamp,
    ) -> StoreResult<()> {
        let (machine, tool, message) = (machine.clone(), tool.clone(), message.to_owned());
        write!(self, |conn| streams::raise_overload(conn, &machine, &tool, &message, now).await)
    }

    async fn begin_session(&self, session: SessionRecord, most: u32, actor: &Actor) -> StoreResult<()> {
        let actor = actor.clone();
        write!(self, |conn| sessions::begin(conn, &session, most, &actor).await)
    }

    async fn session_by_hash(&self, hash: &[u8; 32]) -> StoreResult<Option<(SessionRecord, TokenRecord)>> {
        read!(self.reader_of_others(Lane::Short), |conn| sessions::by_hash(conn, hash).await)
    }

    async fn end_session(&self, hash: &[u8; 32], actor: &Actor, now: Timestamp) -> StoreResult<bool> {
        let (hash, actor) = (*hash, actor.clone());
        write!(self, |conn| sessions::end(conn, &hash, &actor, now).await)
    }
}
