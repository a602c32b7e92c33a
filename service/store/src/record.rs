//! What the store keeps, as values.

use crate::error::{StoreError, StoreResult};
use crate::stored_text::StoredText;
use feedwright_core::cycle::{Cycle, Outcome};
use feedwright_core::feed::choose::ActiveProfile;
use feedwright_core::ids::{CycleId, MachineId, ModelId, OperationId, RecommendationId, ToolId};
use feedwright_core::machine::{Calibration, Machine};
use feedwright_core::operation::Operation;
use feedwright_core::plunge::Material;
use feedwright_core::recommend::{Damaged, Recommendation};
use feedwright_core::summary::CycleSummary;
use feedwright_core::tool::{Tool, ToolEvent};
use feedwright_core::turning::TurningModel;
use feedwright_core::units::{Process, Timestamp};
use feedwright_core::wear::{CycleFacts, Exclusion, FoldSettings, Level, Verdict};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

/// A value with the version that its ETag names, counted from 1.
#[derive(Debug, Clone, PartialEq)]
pub struct Versioned<T> {
    /// The value.
    pub value: T,
    /// Its version.
    pub version: u64,
    /// When this version came into force.
    pub updated_at: Timestamp,
    /// Whether it is not what was written, as its sum says: to be shown as that, and for nothing that decides.
    pub is_damaged: bool,
}

impl<T> Versioned<T> {
    /// To decide by.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] where it is not what was written.
    pub fn sound(self) -> StoreResult<Self> {
        if self.is_damaged {
            return Err(StoreError::Damaged {
                what: "a row of the registry is not what was written".to_owned(),
            });
        }
        Ok(self)
    }
}

/// Fitted lines of a machine as they are kept.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredCalibration {
    /// The lines.
    pub calibration: Calibration,
    /// When they were fitted.
    pub fitted_at: Timestamp,
    /// Whether they are not what was written, as their sum says.
    pub is_damaged: bool,
}

/// What a change expects to find.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Precondition {
    /// Nothing was said: creating and repeating the same content pass, changing needs a version.
    Unstated,
    /// It must not exist yet (`If-None-Match: *`).
    Absent,
    /// This version must be in force (`If-Match`).
    Version(u64),
}

/// What a put did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PutOutcome {
    /// It is new, at version 1.
    Created,
    /// It was changed to this version.
    Changed(u64),
    /// It already was exactly so, at this version.
    Unchanged(u64),
}

impl PutOutcome {
    /// The version now in force.
    pub const fn version(self) -> u64 {
        match self {
            Self::Created => 1,
            Self::Changed(version) | Self::Unchanged(version) => version,
        }
    }
}

/// Who changes something, for the audit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Actor {
    /// Id of the token that was used, or `cli`.
    pub token: String,
    /// The role it acts in.
    pub role: Role,
}

/// Roles, deny by default.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// Writes its own machine's cycles, reads its own recommendation.
    Machine,
    /// Reads everything but secrets: MES, Prometheus, Grafana.
    Viewer,
    /// Registers machines, tools and operations, drafts profiles, resets with a reason.
    Engineer,
    /// Approves, never their own draft.
    Approver,
    /// Manages identities, and everything an engineer does.
    Admin,
}

impl Role {
    /// Every role, in the order of the enum.
    pub const ALL: [Self; 5] = [Self::Machine, Self::Viewer, Self::Engineer, Self::Approver, Self::Admin];

    /// The word used in the API and in storage.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Machine => "machine",
            Self::Viewer => "viewer",
            Self::Engineer => "engineer",
            Self::Approver => "approver",
            Self::Admin => "admin",
        }
    }

    /// The role of that word.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|role| role.as_str() == text)
    }
}

/// Kinds of entries in the model library.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ModelKind {
    /// Coefficients of a tool–work–machine set for turning.
    Turning,
    /// Constants of a work material for plunging.
    Plunge,
}

impl ModelKind {
    /// Every kind, in the order of the enum.
    pub const ALL: [Self; 2] = [Self::Turning, Self::Plunge];

    /// The word used in storage.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Turning => "turning",
            Self::Plunge => "plunge",
        }
    }

    /// The kind of that word.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.as_str() == text)
    }
}

/// Content of an entry of the model library.
#[derive(Debug, Clone, PartialEq)]
pub enum ModelContent {
    /// Turning.
    Turning(TurningModel),
    /// Plunge.
    Plunge(Material),
}

impl ModelContent {
    /// Its kind.
    pub const fn kind(&self) -> ModelKind {
        match self {
            Self::Turning(_) => ModelKind::Turning,
            Self::Plunge(_) => ModelKind::Plunge,
        }
    }
}

/// An entry of the model library: data that a process's laws are computed with. Ids are unique within a kind.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Its name in every path.
    pub id: ModelId,
    /// What it holds.
    pub content: ModelContent,
}

/// A token as it is kept: never the secret, only its hash.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TokenRecord {
    /// Its public id.
    pub id: String,
    /// What people call it.
    pub name: String,
    /// Hash of the secret.
    pub hash: [u8; 32],
    /// What it may do.
    pub role: Role,
    /// The one machine that it is bound to, where the role is `machine`.
    pub machine: Option<MachineId>,
    /// When it was made.
    pub created_at: Timestamp,
    /// When it was revoked.
    pub revoked_at: Option<Timestamp>,
}

/// A browser's session as it is kept: never its secret, only the hash.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SessionRecord {
    /// Hash of the secret in the cookie.
    pub hash: [u8; 32],
    /// Id of the token it was begun with; it ends when that is revoked.
    pub token: String,
    /// When it began.
    pub created_at: Timestamp,
    /// When it ends.
    pub expires_at: Timestamp,
}

/// A machine at a glance.
#[derive(Debug, Clone, PartialEq)]
pub struct FleetRow {
    /// The machine.
    pub machine: Versioned<Machine>,
    /// Its newest cycles, newest first.
    pub recent: Vec<FleetCycle>,
    /// What people call the tool and the operation of the newest cycle, where they are registered.
    pub names: (Option<String>, Option<String>),
    /// The verdict on the tool of the newest cycle.
    pub verdict: Option<Verdict>,
    /// Energies of those of the newest cycles that this tool ran in its current life, each over the new tool's that it is compared
    /// with, oldest first.
    pub energy_ratios: Vec<f64>,
    /// Its open alarms, oldest first.
    pub alarms: Vec<Alarm>,
}

/// What a glance needs of a cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct FleetCycle {
    /// What wear needs of it.
    pub facts: CycleFacts,
    /// How its operation has it judged, where that is registered.
    pub settings: Option<FoldSettings>,
    /// Its tool.
    pub tool: ToolId,
    /// When the server received it.
    pub received_at: Timestamp,
    /// How it ended.
    pub outcome: Outcome,
}

/// The cycles of a tool's current life, each with what became of it.
#[derive(Debug, Clone, PartialEq)]
pub struct ToolLife {
    /// The verdict after all of them.
    pub verdict: Verdict,
    /// Cycles of this life that came before the first one here.
    pub before: u64,
    /// The newest cycles, in the order of the fold.
    pub cycles: Vec<LifeCycle>,
}

/// A cycle as the fold saw it.
#[derive(Debug, Clone, PartialEq)]
pub struct LifeCycle {
    /// What the fold needed of it.
    pub facts: CycleFacts,
    /// How its operation has it judged, where that is registered.
    pub settings: Option<FoldSettings>,
    /// Why it was not counted; `None` for a counted cycle and for one that later cycles have yet to settle.
    pub excluded: Option<Exclusion>,
    /// The level that was judged after it: what decided then, and the value.
    pub level: Option<Level>,
}

/// Hash over the canonical decoded content of a cycle .
pub type ContentHash = [u8; 32];

/// A cycle that is ready to be committed.
#[derive(Debug, Clone)]
pub struct NewCycle {
    /// The cycle. Its samples are in `encoded`; nobody asks for them here.
    pub cycle: Arc<Cycle>,
    /// When the server received it.
    pub received_at: Timestamp,
    /// Its content hash and its compressed sample blocks, made before queueing, outside the writer.
    pub encoded: EncodedCycle,
    /// Its summary.
    pub summary: CycleSummary,
    /// Generation of the registry that the summary rests on: where another one is in force at the commit, the summary
    /// is made again. `None` where it stands as it is.
    pub generation: Option<i64>,
    /// Whether only a part of it was kept, or its end never came in: it is flagged `incomplete` and `cut_short`, whatever its
    /// summary says, and does not count for wear.
    pub cut_short: bool,
}

/// What the codec makes of a cycle.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EncodedCycle {
    /// Content hash.
    pub hash: ContentHash,
    /// One compressed block per channel, framed as one byte string; `None` without samples.
    pub samples: Option<Vec<u8>>,
}

/// What became of a cycle that was to be committed.
#[derive(Debug, Clone)]
pub enum Committed {
    /// It is new and durably stored.
    Stored(Box<CycleAnswer>),
    /// The same content was stored before.
    Known(Box<CycleAnswer>),
    /// Another content is stored under the same id.
    Conflict {
        /// Hash of what is stored.
        stored_hash: ContentHash,
    },
    /// The machine is not registered.
    UnknownMachine,
}

impl Committed {
    /// Whether the cycles of its tool are left to be folded again in the background.
    pub(crate) fn is_being_counted(&self) -> bool {
        match self {
            Self::Stored(answer) | Self::Known(answer) => answer.verdict.is_being_counted(),
            Self::Conflict { .. } | Self::UnknownMachine => false,
        }
    }
}

/// What a machine is told once its cycle is stored.
#[derive(Debug, Clone)]
pub struct CycleAnswer {
    /// The cycle's summary as it is stored.
    pub summary: CycleSummary,
    /// When it was received first.
    pub received_at: Timestamp,
    /// Whether its tool and its operation are registered.
    pub registered: bool,
    /// The verdict on the tool, after this cycle.
    pub verdict: Arc<Verdict>,
    /// What to run next.
    pub recommendation: IssuedRecommendation,
}

/// A recommendation that was handed out and is stored.
#[derive(Debug, Clone, PartialEq)]
pub struct IssuedRecommendation {
    /// Its id.
    pub id: RecommendationId,
    /// What it says.
    pub recommendation: Recommendation,
}

/// A stored cycle without its samples.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredCycle {
    /// The cycle; its `samples` are `None` here and read apart.
    pub cycle: CycleMeta,
    /// Its summary.
    pub summary: CycleSummary,
    /// When the server received it.
    pub received_at: Timestamp,
    /// Its content hash.
    pub hash: ContentHash,
    /// Whether samples are kept for it.
    pub has_samples: bool,
}

impl StoredCycle {
    /// Whether it came with samples that are not kept any more.
    pub const fn samples_are_gone(&self) -> bool {
        !self.has_samples && self.summary.sample_count > 0
    }
}

/// How worn a tool was after a cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct LevelPoint {
    /// When the cycle began, on which machine, its id.
    pub key: CycleKey,
    /// Its operation.
    pub operation: OperationId,
    /// The level that is judged: 1 is the new tool; `None` before there is one, and for a tool that was never known to be new.
    pub level: Option<f64>,
}

/// What identifies and describes a stored cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleMeta {
    /// The machine that ran it.
    pub machine: MachineId,
    /// Its id within the machine.
    pub id: CycleId,
    /// The tool.
    pub tool: ToolId,
    /// The operation.
    pub operation: OperationId,
    /// When it began.
    pub started_at: Timestamp,
    /// The machine's own count.
    pub seq: Option<u64>,
    /// The process it was tagged with.
    pub process: Option<Process>,
    /// How the feed was chosen.
    pub strategy: Option<feedwright_core::units::Strategy>,
    /// Which version of the law ran.
    pub law_version: Option<String>,
    /// Which profile ran.
    pub profile: Option<feedwright_core::cycle::ProfileVersion>,
    /// The recommendation that it followed.
    pub recommendation: Option<RecommendationId>,
    /// Whether the machine says that it is a reference cycle; `None` where it says nothing.
    pub reference: Option<bool>,
    /// Commanded spindle speed, rpm.
    pub spindle_speed_rpm: Option<f64>,
    /// How it ended.
    pub outcome: feedwright_core::cycle::Outcome,
    /// How long it took as the control reports, ms; `None` where it does not. The summary's length is that of the samples, where
    /// there are any.
    pub reported_duration_ms: Option<f64>,
}

/// Which cycles a list asks for; all given conditions hold.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CycleFilter {
    /// Of this machine.
    pub machine: Option<MachineId>,
    /// Of this tool.
    pub tool: Option<ToolId>,
    /// Of this operation.
    pub operation: Option<OperationId>,
    /// Begun at or after.
    pub from: Option<Timestamp>,
    /// Begun before.
    pub to: Option<Timestamp>,
}

/// A page of a list in ascending order: rows after `after`, at most `limit`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Page<K> {
    /// Key of the last row of the page before.
    pub after: Option<K>,
    /// Most rows wanted; bounded by the caller.
    pub limit: u32,
}

/// Where a page of cycles goes on: `(started_at, machine, cycle)`, unique and in the order of the list.
pub type CycleKey = (Timestamp, MachineId, CycleId);

/// The fold of a tool's cycles on one machine.
pub type FoldKey = (ToolId, MachineId);

/// An event of a tool as it is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredToolEvent {
    /// Its number, ascending in the order of arrival.
    pub id: i64,
    /// The event.
    pub event: ToolEvent,
    /// Who told it.
    pub actor: String,
    /// When it was told.
    pub recorded_at: Timestamp,
    /// By whom and when it was revoked: it holds no more.
    pub revoked: Option<(String, Timestamp)>,
}

/// Kinds of alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum AlarmKind {
    /// A tool is worn.
    Worn,
    /// A tool may be broken.
    BrokenSuspected,
    /// Conditions changed, to be confirmed.
    ConditionsChanged,
    /// A load exceeded what is sane.
    Overload,
    /// A machine has been silent for too long.
    MachineSilent,
    /// Something is in quarantine.
    Quarantine,
}

impl AlarmKind {
    /// Every kind, in the order of the enum.
    pub const ALL: [Self; 6] = [
        Self::Worn,
        Self::BrokenSuspected,
        Self::ConditionsChanged,
        Self::Overload,
        Self::MachineSilent,
        Self::Quarantine,
    ];

    /// The word used in the API and in storage.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Worn => "worn",
            Self::BrokenSuspected => "broken_suspected",
            Self::ConditionsChanged => "conditions_changed",
            Self::Overload => "overload",
            Self::MachineSilent => "machine_silent",
            Self::Quarantine => "quarantine",
        }
    }

    /// The kind of that word.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.as_str() == text)
    }
}

/// An alarm: at most one of a kind is open for one subject.
#[derive(Debug, Clone, PartialEq)]
pub struct Alarm {
    /// Its number, ascending.
    pub id: i64,
    /// What it says.
    pub kind: AlarmKind,
    /// The machine it concerns.
    pub machine: Option<MachineId>,
    /// The tool it concerns.
    pub tool: Option<ToolId>,
    /// A sentence for a person.
    pub message: String,
    /// When it was raised.
    pub raised_at: Timestamp,
    /// When it was cleared.
    pub cleared_at: Option<Timestamp>,
    /// By whom and when it was acknowledged.
    pub acknowledged: Option<(String, Timestamp)>,
}

/// What the watch goes by.
#[derive(Debug, Clone, PartialEq)]
pub struct WatchSettings {
    /// A machine that posts no cycle for so long is silent, ms; `None`: never.
    pub silent_after_ms: Option<i64>,
    /// Machines with a limit of their own.
    pub silent_after_ms_by_machine: BTreeMap<MachineId, Option<i64>>,
    /// Bounds of the quarantine.
    pub quarantine: QuarantineBounds,
    /// The quarantine alarms when it is filled to this share, 0 to 1.
    pub quarantine_warning_ratio: f64,
}

impl WatchSettings {
    /// The limit of one machine, ms.
    pub fn silent_after_ms(&self, machine: &MachineId) -> Option<i64> {
        self.silent_after_ms_by_machine.get(machine).copied().unwrap_or(self.silent_after_ms)
    }
}

/// What one round of the watch found.
#[derive(Debug, Clone, PartialEq)]
pub struct Round {
    /// Every registered machine, by id.
    pub machines: Vec<MachineContact>,
    /// The quarantine.
    pub quarantine: QuarantineFill,
    /// Open alarms, counted; kinds without any are left out.
    pub alarms: Vec<OpenAlarms>,
    /// The state of when is backed up; `None` where no backup was ever noted.
    pub last_backup_at: Option<Timestamp>,
}

/// When a machine was last heard of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MachineContact {
    /// The machine.
    pub machine: MachineId,
    /// When a cycle of it last arrived, whatever became of it; `None` where none ever did.
    pub last_cycle_at: Option<Timestamp>,
    /// Its limit, ms; `None`: it is never silent.
    pub silent_after_ms: Option<i64>,
    /// Whether it is beyond its limit.
    pub is_silent: bool,
}

/// How full the quarantine is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct QuarantineFill {
    /// Unsettled entries.
    pub entries: u64,
    /// Bytes of their bodies as they are kept.
    pub bytes: u64,
    /// The most of both.
    pub bounds: QuarantineBounds,
}

impl QuarantineFill {
    /// How full it is by the bound that is nearer, 0 to 1.
    #[expect(clippy::cast_precision_loss, reason = "a share for a person and a threshold")]
    pub fn ratio(&self) -> f64 {
        let share = |of: u64, most: u64| of as f64 / most.max(1) as f64;
        share(self.entries, self.bounds.entries).max(share(self.bytes, self.bounds.bytes))
    }
}

/// Open alarms of one kind and machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OpenAlarms {
    /// Their kind.
    pub kind: AlarmKind,
    /// The machine they concern.
    pub machine: Option<MachineId>,
    /// How many there are.
    pub open: u64,
}

/// What the database occupies and how busy it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DatabaseUsage {
    /// Size of the database, bytes; SQLite's without its write-ahead log.
    pub bytes: u64,
    /// SQLite's write-ahead log, bytes; `None` for a server, whose own watch it is.
    pub wal_bytes: Option<u64>,
    /// Connections of this process that are in use.
    pub connections_in_use: u32,
    /// Connections of this process that are open and idle.
    pub connections_idle: u32,
    /// Most connections of this process.
    pub connections_max: u32,
}

/// What all open alarms come to, in a few numbers: where two of these are alike, the same alarms are open, and as many of them
/// acknowledged. Two sums, so that of alarms that go and others that come late neither hides the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct OpenSums {
    /// How many are open.
    pub open: i64,
    /// The sum of their numbers.
    pub numbers: i64,
    /// The sum of the squares of their numbers' remainders by [`OpenSums::MODULUS`].
    pub squares: i64,
    /// How many of them are acknowledged.
    pub acknowledged: i64,
}

impl OpenSums {
    /// A prime, whose squares leave room for millions of them in a sum.
    pub const MODULUS: i64 = 1_000_003;

    /// Of open alarms, each with whether it is acknowledged.
    pub fn of(open: impl Iterator<Item = (RowNumber, bool)>) -> Self {
        open.fold(Self::default(), |sums, (number, acknowledged)| Self {
            open: sums.open + 1,
            numbers: sums.numbers.wrapping_add(number),
            squares: sums.squares.wrapping_add((number % Self::MODULUS).pow(2)),
            acknowledged: sums.acknowledged + i64::from(acknowledged),
        })
    }
}

/// Which alarms a list asks for.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct AlarmFilter {
    /// Only those that are open, or only those that are cleared.
    pub open: Option<bool>,
    /// Of this machine.
    pub machine: Option<MachineId>,
    /// Of this tool.
    pub tool: Option<ToolId>,
}

/// What could not be accepted, kept as it came.
#[derive(Debug, Clone, PartialEq)]
pub struct QuarantineEntry {
    /// Its id.
    pub id: String,
    /// The machine that sent it.
    pub machine: MachineId,
    /// Its cycle id, where that could be read.
    pub cycle: Option<String>,
    /// When it came.
    pub received_at: Timestamp,
    /// Stable code of the first problem.
    pub code: String,
    /// The problem document that was answered, JSON.
    pub problem: String,
    /// The content type it came with.
    pub content_type: String,
    /// When and how it was settled: the cycle was re-ingested, or it was discarded with a reason.
    pub settled: Option<(Timestamp, String)>,
    /// Size of the body, bytes.
    pub size: u64,
}

/// Bounds of the quarantine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct QuarantineBounds {
    /// Most unsettled entries.
    pub entries: u64,
    /// Most bytes of unsettled bodies as they are kept.
    pub bytes: u64,
}

/// One line of the audit, append-only.
#[derive(Debug, Clone, PartialEq)]
pub struct AuditEntry {
    /// Its number, ascending.
    pub id: i64,
    /// When.
    pub at: Timestamp,
    /// Who: a token's id.
    pub actor: String,
    /// In which role.
    pub role: Role,
    /// What, as in `machine.put`.
    pub action: String,
    /// Of what, as in `machine/M1`.
    pub subject: String,
    /// What changed, JSON.
    pub detail: String,
}

/// Everything a summary or a recommendation needs about one cycle's surroundings.
#[derive(Debug, Clone, PartialEq)]
pub struct Surroundings {
    /// The machine.
    pub machine: Machine,
    /// Its newest fitted lines.
    pub calibration: Option<Calibration>,
    /// The operation, where it is registered.
    pub operation: Option<Operation>,
    /// The tool, where it is registered.
    pub tool: Option<Tool>,
    /// What of these was found damaged: instead of the machine stands [`Machine::unknown`], instead of the others nothing.
    pub damaged: Vec<Damaged>,
}

impl Surroundings {
    /// Whether the tool is registered.
    pub fn has_tool(&self) -> bool {
        self.tool.is_some() || self.damaged.contains(&Damaged::Tool)
    }
}

/// The active feed profiles for an operation and a tool.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ActiveProfiles {
    /// By their wear bands; none where any of them is damaged.
    pub profiles: Vec<ActiveProfile>,
    /// Whether one is not what was activated.
    pub are_damaged: bool,
}

/// What became of a tool's folds that were not up to date.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Renewed {
    /// There were none.
    Nothing,
    /// Some cycles were folded, and there are more.
    Part,
    /// They are up to date.
    Whole,
}

/// What wear is not folded over again, as it would be wrong as if it were right.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Doubt {
    /// Tools of cycles that say something else than was taken in.
    pub tools: BTreeSet<ToolId>,
    /// Of some of whose cycles nothing says any more whether they are what was taken in: their samples were dropped or are damaged,
    /// or what they were summarised by was changed since.
    pub unproven: BTreeSet<(MachineId, ToolId)>,
    /// Whether nothing but their flag says which cycles were cut short: where a cache has left out more or fewer of them than are
    /// flagged, nothing says which is right.
    pub cut_short: bool,
}

/// Which caches of wear are folded again where they differ from their fold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Repair<'a> {
    /// None.
    No,
    /// Those of tools without a doubt, whose cycles are all there.
    AllBut(&'a Doubt),
}

impl<'a> Repair<'a> {
    /// What is in doubt, where anything is to be folded again.
    pub(crate) const fn doubt(self) -> Option<&'a Doubt> {
        match self {
            Self::No => None,
            Self::AllBut(doubt) => Some(doubt),
        }
    }
}

/// Why a cache that differs from its fold is left as it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Left {
    /// Nobody asked for it to be folded again.
    Unasked,
    /// Cycles of its tool say something else than was taken in.
    Doubtful,
    /// Cycles that it has counted are not there.
    Missing,
    /// Of some of its cycles nothing says whether they are what was taken in.
    Unproven,
    /// That of another machine of the tool is left.
    Another,
}

/// A cache that differs from its fold.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DifferingWear {
    /// Whose.
    pub machine: MachineId,
    /// Of which tool.
    pub tool: ToolId,
    /// Cycles that it has counted, more than there are.
    pub missing: u64,
    /// Why it is left; `None` where it was folded again.
    pub left: Option<Left>,
}

/// What the check of tools' caches against their folds found.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct WearCheck {
    /// Rows of the cache that were compared.
    pub rows: u64,
    /// Those that differed from the fold.
    pub different: Vec<DifferingWear>,
    /// Ids of tools whose cycles could not be folded, with what could not be read.
    pub unreadable: Vec<(String, String)>,
}

/// How long a machine's samples are kept; without either limit for ever.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SampleRetention {
    /// Days since they were received.
    pub days: Option<u32>,
    /// Bytes as they are stored, the newest first.
    pub bytes: Option<u64>,
}

/// Why samples were dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DropReason {
    /// They were older than the machine's samples are kept.
    Age,
    /// The machine's samples were larger than it may keep.
    Size,
}

impl DropReason {
    /// Every reason, in the order of the enum.
    pub const ALL: [Self; 2] = [Self::Age, Self::Size];

    /// The word used in the API and in storage.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Age => "age",
            Self::Size => "size",
        }
    }

    /// The reason of that word.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|reason| reason.as_str() == text)
    }
}

/// A decision to drop a machine's samples.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SampleDrop {
    /// The machine.
    pub machine: MachineId,
    /// Samples that were received before this.
    pub before: Timestamp,
    /// When it was decided.
    pub dropped_at: Timestamp,
    /// Why.
    pub reason: DropReason,
    /// Cycles whose samples have gone so far.
    pub cycles: u64,
    /// Bytes that have gone so far.
    pub bytes: u64,
}

/// That a cycle's samples were dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SamplesGone {
    /// When; of the decisions of one day (UTC) for one reason the last.
    pub dropped_at: Timestamp,
    /// Why.
    pub reason: DropReason,
}

/// What one step of dropping did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Dropped {
    /// Cycles whose samples have gone.
    pub cycles: u64,
    /// Bytes of blocks that have gone.
    pub bytes: u64,
    /// Whether there may be more to do.
    pub more: bool,
}

/// Tables of which a tool's wear is folded.
const FOLDED: [&str; 5] = ["cycles", "operations", "operation_asks", "tools", "tool_events"];
/// Their columns of which none is: they are shown, or something else rests on them. A cycle of which one of these is damaged is at fault
/// by itself, too, and what is folded of it is in doubt.
const NOT_FOLDED: [(&str, &[&str]); 4] = [
    ("cycles", &["outcome", "process"]),
    ("operations", &["feature", "name", "program", "setup", "work_material"]),
    ("tool_events", &["actor", "reason", "revoked_by"]),
    ("tools", &["name", "serial", "tool_type"]),
];

/// What is wrong with something stored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoreFault {
    /// What it is about: `cycle`, `samples`, `hash`, `summary`, of a cycle; `table`, `file`, `samples`, `cut`, `quarantine`,
    /// `recommendation`, `advice`, `overrides`, `feed profile`, `row`, of the tables.
    pub kind: &'static str,
    /// Which one, as in `M1/c0001`; of a row with its table before it, as in `audit 17`.
    pub key: String,
    /// What is wrong.
    pub detail: String,
    /// Of a row the column that it is in.
    pub column: Option<String>,
}

impl StoreFault {
    /// Whether a fault of the tables, not of a page of cycles, may have wear folded of something else than was taken in: it may leave cycles out of what
    /// is read, or show them elsewhere, as an index does that is wrong, or it is in what a fold rests on besides, or what is left of
    /// a cycle says that there was one.
    pub fn may_mislead_wear(&self) -> bool {
        match self.kind {
            "file" | "schema" | "samples" | "cut" => true,
            "table" | "row" => self.key.split(' ').next().is_some_and(|table| self.is_folded(table)),
            _ => false,
        }
    }

    /// Whether it is in what wear is folded of; where it does not tell its column it may be.
    fn is_folded(&self, table: &str) -> bool {
        let is_not =
            |column: &str| NOT_FOLDED.iter().any(|(of, columns)| *of == table && columns.contains(&column));
        FOLDED.contains(&table) && !self.column.as_deref().is_some_and(is_not)
    }
}

/// What the check of a page of cycles found.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct CheckPage {
    /// Cycles that were looked at.
    pub checked: u64,
    /// Those among them whose samples were dropped, so that their content hash cannot be computed again.
    pub dropped: u64,
    /// Those whose energies could not be computed again: machine, operation, fitted lines or the summary's rules were
    /// others, or may have been, when they were received. What rests on the samples alone was compared.
    pub unverified: u64,
    /// What is wrong.
    pub faults: Vec<StoreFault>,
    /// What wear is not folded over.
    pub doubt: Doubt,
    /// Where to go on; `None` at the end.
    pub next: Option<CheckedTo>,
}

/// How far rows are gone through by a key with texts, of which some may be damaged: PostgreSQL takes such a text from nobody, and an index
/// may have it where it was before. So behind the last row whose key is sound, and so many rows more.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct Through<K> {
    pub(crate) key: K,
    past: u32,
}

impl<K> Through<K> {
    /// Passes the next row.
    pub(crate) fn pass(&mut self, key: K, is_sound: bool) {
        if is_sound {
            (self.key, self.past) = (key, 0);
        } else {
            self.past += 1;
        }
    }

    /// How many rows behind that of the key are gone through.
    pub(crate) fn past(&self) -> i64 {
        self.past.into()
    }
}

/// Machine and id of a cycle to which a page has come, as they are stored.
pub type CheckedTo = Through<(StoredText, StoredText)>;

/// Names a row of the quarantine, of alarms or of audit in a list.
pub type RowNumber = i64;

/// Which tool's history a CSV or a verdict is about.
pub type ToolKey = ToolId;

/// No lease on a stream lasts longer, ms: what stands for later was written by another clock, or before the clock was put back.
pub const LONGEST_LEASE_MS: u64 = 600_000;

/// What became of the wish to hold a machine's stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StreamLease {
    /// It is the asker's.
    Taken {
        /// Counts the times it was taken: a later number ends an earlier one.
        generation: i64,
    },
    /// It is another one's.
    Held {
        /// It is free after this long, unless it is prolonged.
        wait: Duration,
    },
}

/// How the samples of a streamed cycle came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sent {
    /// While it ran: the machine cut by what they were answered.
    AsItRan,
    /// Again from the first one, as who holds them has not said so.
    Again,
}

/// What the samples of a streamed cycle were answered, told or only computed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CycleOverrides {
    /// The cycle's machine.
    pub machine: MachineId,
    /// Its id.
    pub cycle: CycleId,
    /// `advise` or `shadow`.
    pub mode: String,
    /// Version of the law.
    pub law_version: String,
    /// Hash of the program that the machine told, 64 hexadecimal digits.
    pub program_hash: Option<String>,
    /// When it was stored.
    pub stored_at: Timestamp,
    /// [`crate::codec::encode_overrides`] of them.
    pub block: Vec<u8>,
}
