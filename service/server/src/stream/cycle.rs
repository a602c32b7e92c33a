//! A running cycle with what it will be stored as.

use super::binary::MOST_DECIMALS;
use super::message::{ProgramMessage, SamplesMessage, StartMessage};
use super::overload::Overload;
use super::standing::{BegunWith, KnownTool};
use crate::clock::Moment;
use crate::config::StreamConfig;
use crate::http::dto::{text, time};
use crate::ingest::body::CLOCK_AHEAD_MS;
use crate::state::AppState;
use feedwright_core::closed_loop::control::{self, LOOP_LAW_VERSION, Program, Standing};
use feedwright_core::closed_loop::plunge::{BoundedFeed, PlungeLimits, PlungeLoop};
use feedwright_core::closed_loop::profile;
use feedwright_core::closed_loop::record::Timing;
use feedwright_core::closed_loop::{Begun, LoopReason, LoopReasons, Mode, RunningCycle, SampleAdvice};
use feedwright_core::contact::{ContactInput, ContactSettings};
use feedwright_core::cycle::{Channel, ProfileVersion, check_seq};
use feedwright_core::friction::error::Invalid;
use feedwright_core::friction::law::OverloadHold;
use feedwright_core::friction::program::{Between, FeedProgram, Knot, MOST_KNOTS};
use feedwright_core::ids::{CycleId, MachineId, OperationId, ProfileId, RecommendationId, ToolId};
use feedwright_core::invalid::{Range, Violation};
use feedwright_core::machine::{IPO_RANGE, Machine, SPEED_RANGE};
use feedwright_core::operation::Operation;
use feedwright_core::plunge;
use feedwright_core::recommend::Knowledge;
use feedwright_core::units::{Process, Strategy, Timestamp};
use feedwright_store::StoreResult;
use serde_json::{Value, json};
use std::sync::Arc;

/// The override that a machine says is in force.
const IN_FORCE_RANGE: Range = Range::new(0.0, 1000.0, "%");

/// A cycle that runs over a stream.
#[derive(Debug)]
pub struct StreamedCycle {
    /// Its id.
    pub id: CycleId,
    /// Its tool.
    pub tool: ToolId,
    /// The message that began it.
    pub meta: StartMessage,
    /// The loop.
    pub running: RunningCycle,
    /// Decimals of the channels in binary messages.
    pub decimals: Vec<u8>,
    /// Version of the law.
    pub law_version: &'static str,
    /// Hash of the program that the machine told, or of the feed profile that it named.
    pub program_hash: Option<String>,
    /// The overload that holds it until somebody acknowledges it.
    pub overload: Option<Arc<Overload>>,
    /// When its samples were shown last.
    pub shown_at: Option<Moment>,
    /// When it began, by its machine's clock.
    started_at: Timestamp,
    /// When its start came, by the clock that is set now and then and by the one that never is.
    came: (Timestamp, Moment),
    /// What it was begun with.
    pub begun_with: Arc<BegunWith>,
}

/// A start that was checked, before anything was read of it in the database.
#[derive(Debug)]
pub struct Checked {
    id: CycleId,
    tool: ToolId,
    operation: OperationId,
    channels: Vec<Channel>,
    decimals: Vec<u8>,
    timing: Timing,
    begun: Begun,
    came_at: Moment,
    mode: Mode,
    program: Program,
    program_hash: Option<String>,
    profile: Option<ProfileVersion>,
    meta: StartMessage,
}

impl Checked {
    /// The cycle's id.
    pub const fn id(&self) -> &CycleId {
        &self.id
    }

    /// Whether it is sent again from its first sample.
    pub const fn resends(&self) -> bool {
        self.meta.resend
    }
}

fn keep<T>(result: Result<T, Violation>, wrong: &mut Vec<Violation>) -> Option<T> {
    result.map_err(|violation| wrong.push(violation)).ok()
}

/// Checks the message that begins a cycle; every violation, not only the first.
pub fn check(
    meta: StartMessage,
    (received_at, came_at): (Timestamp, Moment),
    config: &StreamConfig,
) -> Result<Checked, Vec<Violation>> {
    let mut wrong = Vec::new();
    let id = keep(CycleId::parse("cycle_id", &meta.cycle_id), &mut wrong);
    let tool = keep(ToolId::parse("tool", &meta.tool), &mut wrong);
    let operation = keep(OperationId::parse("operation", &meta.operation), &mut wrong);
    let started_at = keep(time::read("started_at", &meta.started_at), &mut wrong);
    let sent_at = keep(time::read("sent_at", &meta.sent_at), &mut wrong);
    if started_at.is_some_and(|at| at.millis_since(received_at) > CLOCK_AHEAD_MS) {
        let why = "is more than 10 minutes ahead of the server's clock";
        wrong.push(Violation::new("started_at", "started_in_future", why));
    }
    if let (Some(started), Some(sent)) = (started_at, sent_at)
        && sent < started
    {
        wrong.push(Violation::new("sent_at", "contradictory", "lies before started_at"));
    }
    let mut word = |path: &str, text: &Option<String>, known: &dyn Fn(&str) -> bool| {
        if text.as_deref().is_some_and(|text| !known(text)) {
            wrong.push(Violation::new(path, "unknown_word", format!("is no {path} that is known")));
        }
    };
    word("process", &meta.process, &|text| Process::parse(text).is_some());
    word("strategy", &meta.strategy, &|text| Strategy::parse(text).is_some());
    word("mode", &meta.mode, &|text| Mode::parse(text).is_some());
    check_seq(meta.seq, &mut wrong);
    text::law_version(meta.law_version.as_deref(), &mut wrong);
    if let Some(text) = &meta.recommendation_id {
        keep(RecommendationId::parse("recommendation_id", text), &mut wrong);
    }
    if meta.reference_cycle == Some(true)
        && (meta.law_version.is_some() || meta.strategy.as_deref().is_some_and(|word| word != "f_const"))
    {
        let why =
            "a reference cycle runs one constant feed without a law: its strategy is f_const, or is left out";
        wrong.push(Violation::new("reference_cycle", "contradictory", why));
    }
    let profile = meta.profile.as_ref().and_then(|named| {
        let profile = keep(ProfileId::parse("profile.id", &named.id), &mut wrong);
        if named.version == 0 {
            wrong.push(Violation::new("profile.version", "out_of_range", "must be at least 1"));
        }
        Some(ProfileVersion { profile: profile?, version: named.version })
    });
    for (path, range, value) in [
        ("spindle_speed_rpm", SPEED_RANGE, meta.spindle_speed_rpm),
        ("in_force_percent", IN_FORCE_RANGE, meta.in_force_percent),
    ] {
        if let Some(value) = value {
            range.collect(path, value, &mut wrong);
        }
    }
    if meta.in_force_percent.is_some() && !meta.resend {
        let why = "a new cycle starts at 100 %: only one that is sent again says what is in force";
        wrong.push(Violation::new("in_force_percent", "contradictory", why));
    }
    let timing = timing(&meta, &mut wrong);
    let channels = channels(&meta, &mut wrong);
    let decimals = decimals(&meta, &channels, &mut wrong);
    let (program, program_hash) = program(&meta, &mut wrong);
    // A server that may only watch never advises, whatever is asked for.
    let asked = meta.mode.as_deref().and_then(Mode::parse).unwrap_or(Mode::Advise);
    let mode = if config.advise { asked } else { Mode::Shadow };
    match (id, tool, operation, started_at, sent_at, timing) {
        (Some(id), Some(tool), Some(operation), Some(started_at), Some(sent_at), Some(timing))
            if wrong.is_empty() =>
        {
            let begun = Begun { started_at, sent_at, received_at };
            Ok(Checked {
                id,
                tool,
                operation,
                channels,
                decimals,
                timing,
                begun,
                came_at,
                mode,
                program,
                program_hash,
                profile,
                meta,
            })
        }
        _ => Err(wrong),
    }
}

fn timing(meta: &StartMessage, wrong: &mut Vec<Violation>) -> Option<Timing> {
    match (meta.period_ms, meta.usual_period_ms) {
        (Some(period_ms), None) => {
            IPO_RANGE.collect("period_ms", period_ms, wrong).map(|period_ms| Timing::Period { period_ms })
        }
        (None, Some(usual_ms)) => {
            IPO_RANGE.collect("usual_period_ms", usual_ms, wrong).map(|usual_ms| Timing::Stamps { usual_ms })
        }
        (None, None) => {
            let why = "period_ms or usual_period_ms is required";
            wrong.push(Violation::new("period_ms", "missing_field", why));
            None
        }
        (Some(_), Some(_)) => {
            let why = "period_ms and usual_period_ms are both given";
            wrong.push(Violation::new("usual_period_ms", "contradictory", why));
            None
        }
    }
}

fn channels(meta: &StartMessage, wrong: &mut Vec<Violation>) -> Vec<Channel> {
    let mut channels = Vec::new();
    if meta.channels.is_empty() {
        wrong.push(Violation::new("channels", "empty", "needs at least one channel"));
    }
    for (index, name) in meta.channels.iter().enumerate().take(Channel::ALL.len() + 1) {
        match Channel::parse(name) {
            Some(channel) if channels.contains(&channel) => {
                wrong.push(Violation::new(
                    format!("channels[{index}]"),
                    "duplicate_channel",
                    "is given twice",
                ));
            }
            Some(channel) => channels.push(channel),
            None => {
                let why = "is no channel that a cycle has";
                wrong.push(Violation::new(format!("channels[{index}]"), "unknown_channel", why));
            }
        }
    }
    channels
}

fn decimals(meta: &StartMessage, channels: &[Channel], wrong: &mut Vec<Violation>) -> Vec<u8> {
    match &meta.decimals {
        None => channels.iter().map(|channel| channel.usual_decimals()).collect(),
        Some(decimals) => {
            if decimals.len() != meta.channels.len() {
                wrong.push(Violation::new("decimals", "length_mismatch", "must be as many as channels"));
            }
            if let Some(index) = decimals.iter().position(|decimals| *decimals > MOST_DECIMALS) {
                let why = format!("must be within 0 to {MOST_DECIMALS}");
                wrong.push(Violation::new(format!("decimals[{index}]"), "out_of_range", why));
            }
            decimals.clone()
        }
    }
}

fn program(meta: &StartMessage, wrong: &mut Vec<Violation>) -> (Program, Option<String>) {
    let Some(told) = &meta.program else {
        return (Program::Unknown, None);
    };
    match feed_program(told) {
        Ok((program, range)) => (Program::Told { program, range }, Some(hash(told))),
        Err(violation) => {
            wrong.push(violation);
            (Program::Unknown, None)
        }
    }
}

fn feed_program(told: &ProgramMessage) -> Result<(FeedProgram, Option<(f64, f64)>), Violation> {
    let between = match told.between.as_str() {
        "held" => Between::Held,
        "linear" => Between::Linear,
        _ => return Err(Violation::new("program.between", "unknown_word", "must be held or linear")),
    };
    if told.knots.len() > MOST_KNOTS {
        return Err(Violation::new("program.knots", "too_many", format!("at most {MOST_KNOTS} knots")));
    }
    let knots =
        told.knots.iter().map(|k| Knot { depth_mm: k.depth_mm, feed_mm_min: k.feed_mm_min }).collect();
    let refused =
        |error: &Invalid| crate::http::dto::friction::refused(error, |path| format!("program.{path}"));
    let program = FeedProgram::new(between, knots).map_err(|error| refused(&error))?;
    let range = match (told.override_min_percent, told.override_max_percent) {
        (None, None) => None,
        (low, high) => {
            let (low, high) = (low.unwrap_or(100.0), high.unwrap_or(100.0));
            feedwright_core::friction::feed_override::OverrideRange::new(low, high).map_err(|error| {
                Violation::new(
                    format!("program.override_{}", error.field()),
                    "override_range",
                    "the override range must begin above 0 and contain 100 %",
                )
            })?;
            Some((low, high))
        }
    };
    Ok((program, range))
}

/// Hash over a program's exact numbers: whether two cycles ran the same one.
fn hash(told: &ProgramMessage) -> String {
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"feedwright stream program v1\n").update(told.between.as_bytes()).update(b"\n");
    for knot in &told.knots {
        hasher.update(&(knot.depth_mm + 0.0).to_bits().to_le_bytes());
        hasher.update(&(knot.feed_mm_min + 0.0).to_bits().to_le_bytes());
    }
    for limit in [told.override_min_percent, told.override_max_percent] {
        hasher.update(&limit.unwrap_or(0.0).to_bits().to_le_bytes());
    }
    hasher.finalize().to_hex().to_string()
}

/// Begins a cycle that was checked: reads what is known around it, and sets up its control.
pub async fn begin(
    state: &AppState,
    machine: &MachineId,
    checked: Checked,
) -> StoreResult<Option<StreamedCycle>> {
    let store = &state.store;
    let Some(around) = store.surroundings(machine, &checked.operation, &checked.tool).await? else {
        return Ok(None);
    };
    let config = &state.config.stream;
    let verdict = match around.tool {
        Some(_) => Some(store.verdict(&checked.tool).await?),
        None => None,
    };
    let known_tool = verdict.as_ref().map(KnownTool::from);
    let (mut program, mut program_hash) = (checked.program, checked.program_hash);
    // Without the operation or the tool the cycle stays neutral for that reason alone.
    if let (Some(version), Some(operation), Some(verdict)) = (&checked.profile, &around.operation, &verdict) {
        let active = store.active_profiles(&checked.operation, &checked.tool).await?;
        let stale_after_ms = state.config.recommendation.settings().stale_after_ms;
        let stale = verdict.age_ms(checked.begun.received_at).is_some_and(|age| age > stale_after_ms);
        let told = match &program {
            Program::Told { program, range } => Some((program, *range)),
            Program::Unknown | Program::Profile(_) | Program::Refused(_) => None,
        };
        let limits = &around.machine.limits;
        program = profile::named(version, &active.profiles, (operation, limits), (verdict, stale), told);
        if let Program::Profile(profile) = &program {
            program_hash = Some(profile.hash.to_string());
        }
    }
    // A cycle that is sent again is no next one.
    let holds = match config.law().overload {
        OverloadHold::UntilAcknowledged { .. } => true,
        OverloadHold::UntilNextCycle { .. } | OverloadHold::Off => checked.meta.resend,
    };
    let overload_open = holds && overload_open(state, machine).await?;
    let plunge = match around.operation.as_ref().filter(|operation| operation.process == Process::Plunge) {
        Some(operation) => {
            let knowledge = store.knowledge(operation, &checked.tool).await?;
            plunge_loop(
                &around.machine,
                operation,
                &knowledge,
                checked.timing.period_ms(),
                config.settling_samples,
            )
        }
        None => None,
    };
    let is_damaged = !around.damaged.is_empty();
    if is_damaged {
        tracing::error!(%machine, damaged = ?around.damaged, "what is stored around this cycle is damaged: it stays neutral");
    }
    let standing = Standing {
        machine: &around.machine,
        operation: around.operation.as_ref(),
        tool: verdict.map(|verdict| verdict.state),
        program: &program,
        overload_open,
        constant_feed: checked.mode == Mode::Advise && checked.meta.runs_constant_feed(),
        process: checked.meta.process.as_deref().and_then(Process::parse),
    };
    // Settings were checked at the start; what the law refuses all the same is no law.
    let control = control::control(&standing, &config.law(), checked.timing.period_ms(), plunge)
        .unwrap_or_else(|error| {
            tracing::warn!(%machine, %error, "no law for this cycle");
            neutral(LoopReasons::NONE)
        });
    let control = if is_damaged { neutral(control.1) } else { control };
    let runs_profile = matches!(program, Program::Profile(_));
    let begun_with = Arc::new(BegunWith {
        machine: around.machine.clone(),
        operation: (checked.operation.clone(), around.operation.clone()),
        tool: (checked.tool.clone(), known_tool),
        profile: checked.profile.clone().filter(|_| runs_profile),
    });
    let overload = overload_open
        .then(|| Arc::new(Overload::open_before(&checked.id, &checked.tool, checked.begun.received_at)));
    let mut running = RunningCycle::new(
        checked.begun,
        control,
        (checked.channels, checked.timing),
        (checked.mode, config.bounds()),
    );
    if checked.meta.resend {
        running = running.restarted(checked.meta.in_force_percent.unwrap_or(100.0));
    }
    Ok(Some(StreamedCycle {
        id: checked.id,
        tool: checked.tool,
        meta: checked.meta,
        running,
        decimals: checked.decimals,
        law_version: LOOP_LAW_VERSION,
        program_hash,
        overload,
        shown_at: None,
        started_at: checked.begun.started_at,
        came: (checked.begun.received_at, checked.came_at),
        begun_with,
    }))
}

/// No law, beside other reasons.
fn neutral(mut reasons: LoopReasons) -> (control::Control, LoopReasons, LoopReasons) {
    reasons.add(LoopReason::NoLaw);
    (control::Control::Neutral, reasons, LoopReasons::NONE)
}

/// Whether an overload of a machine is open that nobody has acknowledged.
pub async fn overload_open(state: &AppState, machine: &MachineId) -> StoreResult<bool> {
    Ok(!state.store.open_overloads(machine).await?.is_empty())
}

/// The plunge of an operation, where everything that a plunge feed needs is known.
fn plunge_loop(
    machine: &Machine,
    operation: &Operation,
    knowledge: &Knowledge,
    period_ms: f64,
    settling: u32,
) -> Option<PlungeLoop> {
    let (Knowledge::Plunge(Some(material)), Some(setup)) = (knowledge, &operation.plunge) else {
        return None;
    };
    // Without the loop's delay nobody knows how far the drill would bite.
    let latency = setup.latency?;
    let limits = &machine.limits;
    let range = plunge::Machine::new(plunge::MachineInput {
        least_feed_mm_min: limits.min_mm_min(),
        greatest_feed_mm_min: limits.max_mm_min(),
    })
    .ok()?;
    let advised = setup.feed(material, &range).ok()?.feed_mm_min?;
    let detector = ContactSettings::new(ContactInput {
        confirm_samples: latency.detector_samples,
        ..ContactInput::DEFAULT
    })
    .ok()?;
    // Below the machine's slowest feed it would be raised, which is not ours to do.
    let work = operation.programmed_feed_mm_min.filter(|work| *work >= limits.min_mm_min())?;
    let limits = PlungeLimits {
        plunge: BoundedFeed::within(limits, advised)?,
        work: BoundedFeed::within(limits, work)?,
        least: BoundedFeed::within(limits, limits.min_mm_min())?,
        retract: BoundedFeed::within(limits, limits.max_mm_min())?,
        allowed_bite_mm: latency.allowed_bite_mm,
        answer_age_ms: latency.answer_age_s * 1000.0,
        period_ms,
        longest_gap_ms: control::longest_gap_ms(period_ms),
    };
    PlungeLoop::new(limits, detector, settling)
}

/// Samples as the cycle's channels have them: column after column, in their order.
#[derive(Debug, Default)]
pub struct Ordered {
    /// Number of the first sample.
    pub first: u64,
    /// Samples.
    pub count: usize,
    /// Values.
    pub values: Vec<f64>,
    /// Times, ms.
    pub times_ms: Vec<f64>,
}

impl StreamedCycle {
    /// When it began, by its machine's clock.
    pub const fn started_at(&self) -> Timestamp {
        self.started_at
    }

    /// The time at that moment, as it went by since the start: where the clock is set meanwhile, no answer is valid for longer, and
    /// no sample older.
    pub fn time_at(&self, moment: Moment) -> Timestamp {
        let (at, came) = self.came;
        let micros = i64::try_from(moment.since(came).as_micros()).unwrap_or(i64::MAX);
        Timestamp::from_micros(at.micros().saturating_add(micros))
    }

    /// Orders the columns of a message; what does not fit the cycle is named.
    pub fn order(
        &self,
        message: &SamplesMessage,
        most: usize,
        ordered: &mut Ordered,
    ) -> Result<(), Violation> {
        let record = self.running.record();
        let channels = record.channels();
        let count = message.columns().next().map_or(message.time_ms.len(), |(_, column)| column.len());
        for (channel, column) in message.columns() {
            if !channels.contains(&channel) {
                let why = "was not among the channels of the start";
                return Err(Violation::new(channel.as_str(), "unknown_channel", why));
            }
            if column.len() != count {
                let why = format!("has {} samples where another column has {count}", column.len());
                return Err(Violation::new(channel.as_str(), "length_mismatch", why));
            }
        }
        self.fits(count, message.time_ms.len(), most)?;
        if let Some(missing) =
            channels.iter().find(|channel| message.columns().all(|(sent, _)| sent != **channel))
        {
            let why = "was named by the start: send null where it was not measured";
            return Err(Violation::new(missing.as_str(), "missing_field", why));
        }
        (ordered.first, ordered.count) = (message.first, count);
        ordered.values.clear();
        for channel in channels {
            if let Some((_, column)) = message.columns().find(|(sent, _)| sent == channel) {
                ordered.values.extend_from_slice(column);
            }
        }
        ordered.times_ms.clear();
        ordered.times_ms.extend_from_slice(&message.time_ms);
        Ok(())
    }

    /// Whether so many samples with so many times fit the cycle.
    pub fn fits(&self, count: usize, times: usize, most: usize) -> Result<(), Violation> {
        if count == 0 {
            return Err(Violation::new("samples", "empty", "a message has at least one sample"));
        }
        if count > most {
            return Err(Violation::new(
                "samples",
                "too_many_samples",
                format!("a message has at most {most} samples"),
            ));
        }
        match self.running.record().timing() {
            Timing::Period { .. } if times > 0 => Err(Violation::new(
                "time_ms",
                "contradictory",
                "the cycle has a period: samples have no times",
            )),
            Timing::Stamps { .. } if times != count => Err(Violation::new(
                "time_ms",
                "length_mismatch",
                format!("has {times} times for {count} samples"),
            )),
            _ => Ok(()),
        }
    }

    /// The body that a post of this cycle would have.
    pub fn body(&self, id: &str, outcome: Option<&str>, reported: Option<&Value>) -> Value {
        let meta = &self.meta;
        let mut body = json!({
            "cycle_id": id, "tool": meta.tool, "operation": meta.operation, "started_at": meta.started_at,
        });
        let mut put = |name: &str, value: Option<Value>| {
            if let Some(value) = value {
                body[name] = value;
            }
        };
        put("seq", meta.seq.map(Value::from));
        put("process", meta.process.as_deref().map(Value::from));
        put("strategy", meta.strategy.as_deref().map(Value::from));
        put("law_version", meta.law_version.as_deref().map(Value::from));
        put("profile", meta.profile.as_ref().map(|p| json!({"id": p.id, "version": p.version})));
        put("recommendation_id", meta.recommendation_id.as_deref().map(Value::from));
        put("reference_cycle", meta.reference_cycle.map(Value::from));
        put("spindle_speed_rpm", meta.spindle_speed_rpm.map(Value::from));
        put("outcome", outcome.map(Value::from));
        put("reported", reported.cloned());
        put("samples", self.samples());
        body
    }

    fn samples(&self) -> Option<Value> {
        let (time, columns) = self.running.record().columns()?;
        let mut samples = match time {
            feedwright_core::cycle::TimeBase::Period { period_ms } => json!({ "period_ms": period_ms }),
            feedwright_core::cycle::TimeBase::Stamps { time_ms } => json!({ "time_ms": time_ms }),
        };
        for (channel, column) in columns {
            samples[channel.as_str()] = column.into();
        }
        Some(samples)
    }

    /// The last sample of a batch as it is shown to those who watch.
    pub fn shown(&self, machine: &MachineId, ordered: &Ordered, advice: &SampleAdvice) -> Value {
        let last = ordered.count - 1;
        let number = ordered.first.saturating_add(last as u64);
        let record = self.running.record();
        let batch = feedwright_core::closed_loop::Batch {
            first: ordered.first,
            count: ordered.count,
            values: &ordered.values,
            times_ms: &ordered.times_ms,
        };
        let mut data = json!({
            "machine": machine.as_str(), "cycle_id": self.id.as_str(), "sample": number,
            "time_ms": record.time_ms(&batch, last), "mode": self.running.mode().as_str(),
            "override_percent": advice.ovr.percent(), "reasons": advice.reasons.codes().collect::<Vec<_>>(),
        });
        for (c, channel) in record.channels().iter().enumerate() {
            data[channel.as_str()] = ordered.values[c * ordered.count + last].into();
        }
        data
    }
}
