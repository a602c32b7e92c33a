//! The trait that both engines implement.

use crate::codec::Columns;
use crate::error::StoreResult;
use crate::feed_profile::{
    Drafted, FeedProfile, FeedProfileFilter, NewProfileVersion, ProfileMove, StoredProfileVersion,
};
use crate::notice::Notices;
use crate::point::{CyclePoint, LastPoints, PointColumns};
use crate::record::{
    ActiveProfiles, Actor, Alarm, AlarmFilter, AuditEntry, CheckPage, CheckedTo, Committed, CycleFilter,
    CycleKey, CycleOverrides, DatabaseUsage, Dropped, FleetRow, FoldKey, IssuedRecommendation, LevelPoint,
    Model, ModelKind, NewCycle, OpenSums, Page, Precondition, PutOutcome, QuarantineBounds, QuarantineEntry,
    Renewed, Repair, Round, RowNumber, SampleDrop, SampleRetention, SamplesGone, Sent, SessionRecord,
    StoreFault, StoredCalibration, StoredCycle, StoredToolEvent, StreamLease, Surroundings, TokenRecord,
    ToolLife, Versioned, WatchSettings, WearCheck,
};
use crate::row_sum::{SumPage, SummedTo};
use async_trait::async_trait;
use feedwright_core::cycle::{Cycle, ProfileVersion, Samples};
use feedwright_core::ids::{CycleId, MachineId, ModelId, OperationId, ProfileId, RecommendationId, ToolId};
use feedwright_core::machine::{Calibration, Machine};
use feedwright_core::operation::Operation;
use feedwright_core::recommend::{Knowledge, RecommendSettings};
use feedwright_core::tool::{Tool, ToolEvent};
use feedwright_core::units::Timestamp;
use feedwright_core::wear::Verdict;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Notify;

/// The store. Every method that changes something returns when it is durable and seen by who reads next, and writes its audit line
/// in the same transaction. Futures of mutating methods must not be dropped half-way: callers spawn them.
#[async_trait]
pub trait Store: Send + Sync + 'static {
    /// Commits a group of cycles as a whole, at once or by a journal of the engine, and answers each, in the order given: inserts the new ones,
    /// folds each tool they touch once, raises and clears alarms, stores the recommendations. When the group
    /// fails because of a row, it is retried row by row: a row that fails alone fails alone.
    async fn commit_cycles(
        &self,
        group: Vec<NewCycle>,
        now: Timestamp,
        settings: RecommendSettings,
    ) -> Vec<StoreResult<Committed>>;

    /// Asks the database for a word, for two seconds at the most: it waits for no lock, no disk and no connection that others
    /// have, so that only a database that is away does not answer. A file is never away.
    async fn answers(&self) -> StoreResult<()>;

    /// Proves that the database takes writes, by one.
    async fn probe_write(&self, now: Timestamp) -> StoreResult<()>;

    /// The fleet at a glance: machines by id, each with its newest `recent` cycles, the verdict on the tool it ran last
    /// and its open alarms, all of one moment.
    async fn fleet(&self, page: Page<MachineId>, recent: u32) -> StoreResult<Vec<FleetRow>>;

    /// One machine of the fleet; `None` where it is not registered.
    async fn fleet_machine(&self, machine: &MachineId, recent: u32) -> StoreResult<Option<FleetRow>>;

    /// One round of the watch: notes how long ago machines were `heard` of, raises and clears what only a look around can tell
    /// (silence, a quarantine that fills up), and says what was found. A database that several servers share goes by its own clock
    /// instead of `now`, and makes one round after the other, so that all of them tell the same.
    async fn watch(
        &self,
        heard: Vec<(MachineId, Duration)>,
        settings: &WatchSettings,
        now: Timestamp,
    ) -> StoreResult<Round>;

    /// What the database occupies and how many of its connections are in use.
    async fn usage(&self) -> StoreResult<DatabaseUsage>;

    /// Ends after everything handed in is committed; later calls fail.
    async fn close(&self);

    /// Tells the other servers on this database; no change, and lost where nobody listens. At most 7 999 bytes.
    async fn notify(&self, text: &str) -> StoreResult<()>;
    /// Where to listen to the other servers; `None` where the store is one server's alone.
    fn notices(&self) -> Option<Arc<dyn Notices>>;

    /// Registers or changes a machine.
    async fn put_machine(
        &self,
        machine: Machine,
        expects: Precondition,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<PutOutcome>;
    /// One machine.
    async fn machine(&self, id: &MachineId) -> StoreResult<Option<Versioned<Machine>>>;
    /// Machines by id.
    async fn machines(&self, page: Page<MachineId>) -> StoreResult<Vec<Versioned<Machine>>>;

    /// Registers or changes a tool. Registering counts the cycles that came before.
    async fn put_tool(
        &self,
        tool: Tool,
        expects: Precondition,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<PutOutcome>;
    /// One tool.
    async fn tool(&self, id: &ToolId) -> StoreResult<Option<Versioned<Tool>>>;
    /// Tools by id.
    async fn tools(&self, page: Page<ToolId>) -> StoreResult<Vec<Versioned<Tool>>>;
    /// Adds an event to a tool's history and refolds it; `None` where the tool is not registered.
    async fn add_tool_event(
        &self,
        tool: &ToolId,
        event: ToolEvent,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<Option<StoredToolEvent>>;
    /// Revokes an event: it stays, with who revoked it and when, and the tool is judged as if it had not been told. `None` where
    /// the tool has no such event; one that is revoked already stays as it is.
    async fn revoke_tool_event(
        &self,
        tool: &ToolId,
        event: RowNumber,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<Option<StoredToolEvent>>;
    /// A tool's events in the order of arrival.
    async fn tool_events(&self, tool: &ToolId, page: Page<RowNumber>) -> StoreResult<Vec<StoredToolEvent>>;

    /// Registers or changes an operation. Where what wear depends on changes, the tools it ran with are judged so from then on; their folds and
    /// alarms follow one by one, those that it does not come to at once with [`Store::renew_fold`] or their next cycle.
    async fn put_operation(
        &self,
        operation: Operation,
        expects: Precondition,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<PutOutcome>;
    /// One operation.
    async fn operation(&self, id: &OperationId) -> StoreResult<Option<Versioned<Operation>>>;
    /// Operations by id.
    async fn operations(&self, page: Page<OperationId>) -> StoreResult<Vec<Versioned<Operation>>>;

    /// Registers or changes an entry of the model library.
    async fn put_model(
        &self,
        model: Model,
        expects: Precondition,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<PutOutcome>;
    /// One entry of the model library.
    async fn model(&self, kind: ModelKind, id: &ModelId) -> StoreResult<Option<Versioned<Model>>>;
    /// Entries of one kind by id.
    async fn models(&self, kind: ModelKind, page: Page<ModelId>) -> StoreResult<Vec<Versioned<Model>>>;
    /// What the process of an operation needs to know, with this tool: library entry and what the edge has cut.
    async fn knowledge(&self, operation: &Operation, tool: &ToolId) -> StoreResult<Knowledge>;

    /// Drafts a version of a feed profile: the first of a new line, the next of a line for the same operation, tool
    /// type and wear band. The same content is kept once. `Conflict` where the line or its subject is another.
    async fn draft_profile(
        &self,
        id: &ProfileId,
        new: NewProfileVersion,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<Drafted>;
    /// Moves a feed profile along its way; `None` where the line or the version does not exist. The precondition is
    /// on the line's revision, so that of two moves at once one is refused.
    async fn move_profile(
        &self,
        id: &ProfileId,
        what: ProfileMove,
        expects: Precondition,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<Option<FeedProfile>>;
    /// One feed profile.
    async fn feed_profile(&self, id: &ProfileId) -> StoreResult<Option<FeedProfile>>;
    /// Feed profiles by id.
    async fn feed_profiles(
        &self,
        filter: &FeedProfileFilter,
        page: Page<ProfileId>,
    ) -> StoreResult<Vec<FeedProfile>>;
    /// One version of a feed profile.
    async fn profile_version(
        &self,
        id: &ProfileId,
        version: u32,
    ) -> StoreResult<Option<StoredProfileVersion>>;
    /// Versions of a feed profile, oldest first.
    async fn profile_versions(
        &self,
        id: &ProfileId,
        page: Page<u32>,
    ) -> StoreResult<Vec<StoredProfileVersion>>;
    /// Active versions for an operation and the type of a tool.
    async fn active_profiles(&self, operation: &OperationId, tool: &ToolId) -> StoreResult<ActiveProfiles>;
    /// The last `most` cycles that ran a version, oldest first.
    async fn cycles_of_profile(&self, ran: &ProfileVersion, most: u32) -> StoreResult<Vec<StoredCycle>>;
    /// The last `most` cycles of an operation with tools of a type, oldest first.
    async fn recent_cycles(
        &self,
        operation: &OperationId,
        tool_type: &str,
        most: u32,
    ) -> StoreResult<Vec<StoredCycle>>;

    /// Adds a version of a machine's fitted lines (its `version` is assigned here); `None` where the machine is not
    /// registered.
    async fn add_calibration(
        &self,
        machine: &MachineId,
        calibration: Calibration,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<Option<Calibration>>;
    /// A machine's fitted lines, oldest version first.
    async fn calibrations(&self, machine: &MachineId, page: Page<u32>)
    -> StoreResult<Vec<StoredCalibration>>;

    /// What is known around a cycle; `None` where the machine is not registered.
    async fn surroundings(
        &self,
        machine: &MachineId,
        operation: &OperationId,
        tool: &ToolId,
    ) -> StoreResult<Option<Surroundings>>;

    /// Holds the next page of what people registered against its sums.
    async fn hold_sums(&self, after: Option<&SummedTo>) -> StoreResult<SumPage>;
    /// Sums the rows of that page that have no sum of their version, as they are; how many.
    async fn sum_rows(&self, after: Option<&SummedTo>) -> StoreResult<u64>;

    /// As [`Store::surroundings`], from memory where it is there: as of a moment ago, with the generation of the
    /// registry that it belongs to, and with what the operation asked for at a time. For a [`NewCycle`] that began then, whose
    /// commit looks again.
    async fn recent_surroundings(
        &self,
        machine: &MachineId,
        operation: &OperationId,
        tool: &ToolId,
        at: Timestamp,
    ) -> StoreResult<Option<(Surroundings, i64)>>;

    /// One cycle without its samples.
    async fn cycle(&self, machine: &MachineId, id: &CycleId) -> StoreResult<Option<StoredCycle>>;
    /// Paths of the fields in which a cycle is another content than the one that is stored under its id; of samples that are
    /// gone nothing is said. Empty where none is stored.
    async fn differences(&self, sent: Cycle) -> StoreResult<Vec<String>>;
    /// One cycle's samples as the columns that are stored; `None` where there are none (any more).
    async fn cycle_columns(&self, machine: &MachineId, id: &CycleId) -> StoreResult<Option<Columns>>;
    /// One cycle's samples; `None` where there are none (any more).
    async fn cycle_samples(&self, machine: &MachineId, id: &CycleId) -> StoreResult<Option<Samples>> {
        // Who asks for many asks for one after the other, and each may be there at once: in between others have the thread.
        tokio::task::yield_now().await;
        self.cycle_columns(machine, id).await?.map(Columns::into_samples).transpose()
    }
    /// Cycles in the order of `(started_at, machine, cycle)`.
    async fn cycles(&self, filter: &CycleFilter, page: Page<CycleKey>) -> StoreResult<Vec<StoredCycle>>;

    /// The newest cycles, in the order of `(started_at, machine, cycle)`.
    async fn last_cycles(&self, filter: &CycleFilter, limit: u32) -> StoreResult<Vec<StoredCycle>>;
    /// What cycles amounted to, in the order of `(started_at, machine, cycle)`.
    async fn points(&self, filter: &CycleFilter, page: Page<CycleKey>) -> StoreResult<Vec<CyclePoint>>;
    /// The newest of them, oldest first. Cycles that began at the same time stand in the order of their tool.
    async fn last_points(
        &self,
        filter: &CycleFilter,
        told: PointColumns,
        limit: u32,
    ) -> StoreResult<LastPoints>;
    /// How worn a tool was after each cycle that began within `from` to `to` (exclusive), at most `limit`.
    async fn levels(
        &self,
        tool: &ToolId,
        from: Timestamp,
        to: Timestamp,
        limit: u32,
    ) -> StoreResult<Vec<LevelPoint>>;

    /// How long a machine's samples are kept, where that was said.
    async fn retention(&self, machine: &MachineId) -> StoreResult<Option<Versioned<SampleRetention>>>;
    /// Says how long a machine's samples are kept; `None` where it is not registered.
    async fn put_retention(
        &self,
        machine: &MachineId,
        retention: SampleRetention,
        expects: Precondition,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<Option<PutOutcome>>;
    /// What was decided to drop of a machine's samples, oldest decision first.
    async fn sample_drops(&self, machine: &MachineId) -> StoreResult<Vec<SampleDrop>>;
    /// When and why samples of these cycles of a machine were dropped, each told with its receipt. A cycle that is not in
    /// the answer was dropped by nobody.
    async fn samples_gone(
        &self,
        machine: &MachineId,
        cycles: &[(CycleId, Timestamp)],
    ) -> StoreResult<BTreeMap<CycleId, SamplesGone>>;
    /// Decides for every machine which samples are to go; `otherwise` holds where a machine has no say of its own. What several
    /// servers write to goes by the time that they agree on, and not by `now`: what is dropped by a clock that was ahead is gone.
    /// By age they go as far as [`Store::age_samples`] has let them age.
    async fn decide_drops(&self, otherwise: SampleRetention, now: Timestamp) -> StoreResult<Vec<SampleDrop>>;
    /// Lets samples age up to now, but no faster than eight times what has `gone_by` since it was called last, by a clock that nobody sets:
    /// one that leaps ahead would drop all that is kept by days. Says up to when they have aged.
    async fn age_samples(&self, now: Timestamp, gone_by: Duration) -> StoreResult<Timestamp>;
    /// Drops the oldest partition of which nothing is kept, where the engine has partitions; by the same time.
    ///
    /// # Errors
    ///
    /// `Unavailable` where whoever reads it is in the way for longer than posts can wait.
    async fn drop_partition(&self, now: Timestamp) -> StoreResult<Dropped>;
    /// Drops some of the samples that decisions name, `most` cycles in one short transaction.
    async fn drop_some(&self, most: u32) -> StoreResult<Dropped>;
    /// Makes room for what comes: the partitions of the months ahead.
    async fn make_room(&self, now: Timestamp) -> StoreResult<()>;

    /// Checks the cycles after that key with their samples and hashes. Reads only.
    async fn check_cycles(&self, after: Option<&CheckedTo>, limit: u32) -> StoreResult<CheckPage>;
    /// Checks the tables as a whole. Reads only, but all of them.
    async fn check_tables(&self) -> StoreResult<Vec<StoreFault>>;

    /// The verdict on a tool over all its machines; unknown where it has no cycles or is not registered.
    async fn verdict(&self, tool: &ToolId) -> StoreResult<Verdict>;
    /// The newest `most` cycles of a tool's current life with what became of each: the fold, walked from the last
    /// state on the way before them, or from the beginning where there is none.
    async fn life(&self, tool: &ToolId, most: u32) -> StoreResult<ToolLife>;
    /// The next registered tool after `after` with a fold that an earlier version of the rules made, that is behind a change of an operation, or
    /// of which nobody has noted what operations it ran.
    async fn next_outdated_fold(&self, after: Option<&ToolId>) -> StoreResult<Option<ToolId>>;
    /// Looks at some folds after that one, and writes to those that need not follow changes of operations which their cycles never ran that they
    /// are up to date; which was the last that was looked at. `None` behind the last.
    async fn note_unchanged_folds(&self, after: Option<&FoldKey>) -> StoreResult<Option<FoldKey>>;
    /// Makes such folds of a tool anew, and those that were postponed, durably and some thousand cycles at a time; its alarms follow when
    /// they are whole.
    async fn renew_fold(&self, tool: &ToolId, now: Timestamp) -> StoreResult<Renewed>;
    /// Told each time that a change left the cycles of a tool to be folded again: [`Store::next_outdated_fold`] names it until
    /// [`Store::renew_fold`] has folded them.
    fn folds_postponed(&self) -> Arc<Notify>;
    /// Refolds the tools from their cycles, compares with the cache, and repairs it where `repair` says so. A tool whose
    /// cycles cannot be read is named.
    async fn check_wear(&self, repair: Repair<'_>) -> StoreResult<WearCheck>;

    /// Keeps a recommendation that is handed out.
    async fn issue_recommendation(&self, issued: &IssuedRecommendation) -> StoreResult<()>;
    /// A recommendation that was handed out.
    async fn recommendation(&self, id: &RecommendationId) -> StoreResult<Option<IssuedRecommendation>>;

    /// Alarms in the order of their numbers, as they are now.
    async fn alarms(&self, filter: &AlarmFilter, page: Page<RowNumber>) -> StoreResult<Vec<Alarm>>;
    /// The same as far as none can be committed any more before them: whoever goes on behind a page is shown each, also one that was
    /// committed after others of higher numbers.
    async fn alarm_history(&self, filter: &AlarmFilter, page: Page<RowNumber>) -> StoreResult<Vec<Alarm>>;
    /// The overloads of a machine that are open and that nobody has acknowledged, in the order of their numbers: all of them, and no
    /// others are looked at, however many alarms are open.
    async fn open_overloads(&self, machine: &MachineId) -> StoreResult<Vec<RowNumber>>;
    /// The newest alarm's number, 0 where there is none, and what those that are open come to: whether anything has changed is told by
    /// one row.
    async fn open_alarm_sums(&self) -> StoreResult<(RowNumber, OpenSums)>;
    /// The numbers of open alarms, in their order, each with whether it was acknowledged.
    async fn open_alarm_numbers(&self, page: Page<RowNumber>) -> StoreResult<Vec<(RowNumber, bool)>>;
    /// Alarms by their numbers, as they are now, in the order of these; what there is none of is left out.
    async fn alarms_numbered(&self, numbers: &[RowNumber]) -> StoreResult<Vec<Alarm>>;
    /// How many groups of cycles have raised or cleared alarms through this store, or may have: another number than before, after a
    /// commit, says that there is something to look for.
    fn alarm_changes(&self) -> u64;
    /// Acknowledges an alarm; `None` where there is none of that number.
    async fn acknowledge_alarm(
        &self,
        id: RowNumber,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<Option<Alarm>>;

    /// Keeps what could not be accepted; `Full` where the bounds are reached. The same body from the same
    /// machine under the same cycle id is kept once: the id of the entry that stands is returned.
    async fn quarantine(
        &self,
        entry: QuarantineEntry,
        body: Vec<u8>,
        bounds: QuarantineBounds,
    ) -> StoreResult<String>;
    /// Quarantine entries after `page.after` (an id; ids ascend in time), unsettled ones only where `open`.
    async fn quarantined(
        &self,
        machine: Option<&MachineId>,
        open: bool,
        page: Page<String>,
    ) -> StoreResult<Vec<QuarantineEntry>>;
    /// One quarantine entry with its body as it came; without it where what is kept of it is not that any more.
    async fn quarantine_entry(&self, id: &str) -> StoreResult<Option<(QuarantineEntry, Option<Vec<u8>>)>>;
    /// Claims an entry that is to be settled for as long as `lease`; `false` where there is no unsettled one of that id, or another holder
    /// has claimed it. A database that several servers share goes by its own clock instead of `now`.
    async fn claim_quarantine(
        &self,
        id: &str,
        holder: &str,
        lease: Duration,
        now: Timestamp,
    ) -> StoreResult<bool>;
    /// Gives up a claim of this holder's.
    async fn release_quarantine(&self, id: &str, holder: &str) -> StoreResult<()>;
    /// Settles a quarantine entry that this holder has claimed; `false` where it has not, or the entry is settled.
    async fn settle_quarantine(
        &self,
        id: &str,
        holder: &str,
        how: &str,
        actor: &Actor,
        now: Timestamp,
    ) -> StoreResult<bool>;

    /// Audit lines in the order of their numbers.
    async fn audit(&self, page: Page<RowNumber>) -> StoreResult<Vec<AuditEntry>>;
    /// The audit from its newest line back; a page goes on before its `after`.
    async fn newest_audit(&self, page: Page<RowNumber>) -> StoreResult<Vec<AuditEntry>>;

    /// Keeps a token.
    async fn create_token(&self, token: TokenRecord, actor: &Actor) -> StoreResult<()>;
    /// Keeps the first token there is; `false`, with nothing kept, where there is one.
    async fn create_first_token(&self, token: TokenRecord, actor: &Actor) -> StoreResult<bool>;
    /// The token of that hash, revoked or not.
    async fn token_by_hash(&self, hash: &[u8; 32]) -> StoreResult<Option<TokenRecord>>;
    /// Tokens by id.
    async fn tokens(&self, page: Page<String>) -> StoreResult<Vec<TokenRecord>>;
    /// Revokes a token; `None` where there is none of that id.
    async fn revoke_token(&self, id: &str, actor: &Actor, now: Timestamp)
    -> StoreResult<Option<TokenRecord>>;

    /// Takes the lease on a machine's stream for as long as `lease`: where it is free, expired or the holder's own already, and
    /// where `takeover` even from another. One's own never ends sooner for it. A database that several servers share goes by
    /// its own clock instead of `now`: counted from before this was asked, no lease is over sooner than `lease`.
    async fn take_stream(
        &self,
        machine: &MachineId,
        holder: &str,
        takeover: bool,
        lease: Duration,
        now: Timestamp,
    ) -> StoreResult<StreamLease>;
    /// Prolongs a holder's unexpired leases on these machines, to end after `lease`; those it holds, with their generations. The
    /// clock is that of [`Store::take_stream`].
    async fn renew_streams(
        &self,
        holder: &str,
        machines: &[MachineId],
        lease: Duration,
        now: Timestamp,
    ) -> StoreResult<Vec<(MachineId, i64)>>;
    /// Those of these machines whose stream somebody holds. The clock is that of [`Store::take_stream`].
    async fn leased_streams(&self, machines: &[MachineId], now: Timestamp) -> StoreResult<Vec<MachineId>>;
    /// Gives a lease back, unless it is another's by now.
    async fn release_stream(&self, machine: &MachineId, holder: &str, generation: i64) -> StoreResult<()>;
    /// Keeps what a streamed cycle's samples were answered, unless it is stored by now; sent [again](Sent::Again), unless as many are
    /// there already.
    async fn put_overrides(&self, overrides: &CycleOverrides, sent: Sent) -> StoreResult<()>;
    /// What a streamed cycle's samples were answered.
    async fn overrides(&self, machine: &MachineId, id: &CycleId) -> StoreResult<Option<CycleOverrides>>;
    /// Raises an overload that a stream has seen, unless one is open for the machine and tool.
    async fn raise_overload(
        &self,
        machine: &MachineId,
        tool: &ToolId,
        message: &str,
        now: Timestamp,
    ) -> StoreResult<()>;
    /// Keeps a browser's session; of one token at most `most` are kept, the newest.
    async fn begin_session(&self, session: SessionRecord, most: u32, actor: &Actor) -> StoreResult<()>;
    /// The session of that hash with its token, over or not, revoked or not.
    async fn session_by_hash(&self, hash: &[u8; 32]) -> StoreResult<Option<(SessionRecord, TokenRecord)>>;
    /// Ends a session; `false` where there is none of that hash.
    async fn end_session(&self, hash: &[u8; 32], actor: &Actor, now: Timestamp) -> StoreResult<bool>;
}
