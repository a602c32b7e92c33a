//! What a machine is answered, as JSON text.

use super::cycle::StreamedCycle;
use crate::http::dto::time;
use crate::http::problem::{FieldError, Problem};
use feedwright_core::closed_loop::monitor::BlockAdvice;
use feedwright_core::closed_loop::{Answer, LoopReasons, Mode, SampleAdvice};
use feedwright_core::invalid::Violation;
use serde::Serialize;
use utoipa::ToSchema;

/// The answer to samples, and to a heartbeat in a cycle.
#[derive(Debug, Serialize, ToSchema)]
pub struct OverrideMessage<'a> {
    /// `override`, or `heartbeat`.
    #[serde(rename = "type")]
    #[schema(example = "override")]
    pub kind: &'static str,
    /// Number of this message.
    pub n: u32,
    /// Number of the message that it answers.
    pub re: Option<u32>,
    /// What is in force.
    #[serde(flatten)]
    pub standing: StandingPart<'a>,
    /// What each sample was answered, in their order.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub each: Option<Vec<EachPart>>,
}

/// What is in force, and how long and why.
#[derive(Debug, Serialize, ToSchema)]
pub struct StandingPart<'a> {
    /// The cycle.
    pub cycle_id: &'a str,
    /// `advise` or `shadow`.
    pub mode: &'static str,
    /// The override to apply, percent of the programmed feed; absent in shadow.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub override_percent: Option<f64>,
    /// Why: stable codes.
    #[schema(value_type = Vec<String>)]
    pub reasons: Codes,
    /// Not to be acted on after this, by the server's clock.
    pub valid_until: String,
    /// The same in ms: count it from the moment the message that is answered was sent.
    pub valid_for_ms: i64,
    /// `good`, `limited`, `stale` or `missing`.
    pub quality: &'static str,
    /// Age of the newest sample when it was judged, ms.
    pub age_ms: Option<f64>,
    /// Number of the sample that comes next.
    pub next: u64,
    /// Whether an overload holds the override: never go up by yourself then, whatever expires.
    pub overload: bool,
    /// Version of the law.
    pub law_version: &'static str,
    /// The feed profile that the cycle runs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub profile: Option<&'a super::message::ProfileMessage>,
    /// Hash of the program that the machine told, or of the feed profile that it named.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub program_hash: Option<&'a str>,
    /// What a plunge is to do.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plunge: Option<PlungePart>,
}

/// What a plunge is to do now.
#[derive(Debug, Serialize, ToSchema)]
pub struct PlungePart {
    /// `approach`, `work` or `retract`.
    pub phase: &'static str,
    /// The feed to run, mm/min; absent in shadow.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feed_mm_min: Option<f64>,
    /// How far the drill would bite at this feed before the axis reacts, mm.
    pub bite_mm: f64,
    /// Where contact was found, relative to the programmed surface, mm.
    pub contact_offset_mm: Option<f64>,
    /// Where the load fell back, below the programmed surface, mm.
    pub breakthrough_depth_mm: Option<f64>,
}

/// What one sample was answered.
#[derive(Debug, Serialize, ToSchema)]
pub struct EachPart {
    /// The override after it, percent; absent in shadow.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub override_percent: Option<f64>,
    /// Why.
    #[schema(value_type = Vec<String>)]
    pub reasons: Codes,
}

/// A cycle has begun.
#[derive(Debug, Serialize, ToSchema)]
pub struct StartedMessage<'a> {
    /// `started`.
    #[serde(rename = "type")]
    #[schema(example = "started")]
    pub kind: &'static str,
    /// Number of this message.
    pub n: u32,
    /// Number of the message that it answers.
    pub re: u32,
    /// What is in force: 100 %, or the lower of that and what a cycle sent again says.
    #[serde(flatten)]
    pub standing: StandingPart<'a>,
    /// The channels in the order of binary messages.
    pub channels: Vec<&'static str>,
    /// Their decimals there.
    pub decimals: Vec<u8>,
    /// Least and greatest override that will be answered, percent; absent where it is always neutral.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub override_range_percent: Option<(f64, f64)>,
}

/// Where a cycle goes on after the connection broke.
#[derive(Debug, Serialize, ToSchema)]
pub struct ResumedMessage<'a> {
    /// `resumed`.
    #[serde(rename = "type")]
    #[schema(example = "resumed")]
    pub kind: &'static str,
    /// Number of this message.
    pub n: u32,
    /// Number of the message that it answers.
    pub re: u32,
    /// The cycle.
    pub cycle_id: &'a str,
    /// Send samples from this number on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub resume_from: Option<u64>,
    /// 0: nothing of it is held. Start it again with `resend`, and send every sample.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub restart_from: Option<u64>,
    /// What is in force, where the cycle is held.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub standing: Option<StandingPart<'a>>,
}

/// A cycle is durably stored: what a post would have been answered.
#[derive(Debug, Serialize, ToSchema)]
pub struct StoredMessage {
    /// `stored`.
    #[serde(rename = "type")]
    #[schema(example = "stored")]
    pub kind: &'static str,
    /// Number of this message.
    pub n: u32,
    /// Number of the message that it answers.
    pub re: u32,
    /// 201 (new) or 200 (known).
    pub status: u16,
    /// The answer of a post.
    #[schema(value_type = crate::http::dto::cycle::CycleAnswerBody)]
    pub answer: serde_json::Value,
}

/// A message was refused, or could not be read.
#[derive(Debug, Serialize, ToSchema)]
pub struct ErrorMessage<'a> {
    /// `error`.
    #[serde(rename = "type")]
    #[schema(example = "error")]
    pub kind: &'static str,
    /// Number of this message.
    pub n: u32,
    /// Number of the message that it answers; null where that could not be read.
    pub re: Option<u32>,
    /// Stable code.
    pub code: &'a str,
    /// A sentence for a person.
    pub detail: &'a str,
    /// What is wrong with which field.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub errors: Vec<FieldError<'a>>,
    /// The status that a post would have been answered, where the cycle was to be stored.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub status: Option<u16>,
    /// Where the cycle is kept in quarantine: its machine may forget it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quarantine_id: Option<&'a str>,
    /// Wait so long before the same is sent again, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub retry_after_s: Option<u64>,
    /// What is in force in the cycle that runs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub standing: Option<StandingPart<'a>>,
}

/// The answer to a heartbeat without a cycle, and to `monitor`.
#[derive(Debug, Serialize, ToSchema)]
pub struct PlainMessage {
    /// `heartbeat` or `monitoring`.
    #[serde(rename = "type")]
    #[schema(example = "heartbeat")]
    pub kind: &'static str,
    /// Number of this message.
    pub n: u32,
    /// Number of the message that it answers.
    pub re: u32,
    /// The server's clock.
    pub at: String,
}

/// The answer to a block of vibration.
#[derive(Debug, Serialize, ToSchema)]
pub struct GainMessage {
    /// `gain`.
    #[serde(rename = "type")]
    #[schema(example = "gain")]
    pub kind: &'static str,
    /// Number of this message.
    pub n: u32,
    /// Number of the message that it answers.
    pub re: u32,
    /// Gain b after the block, −1 to 1.
    pub gain: f64,
    /// Least gain within it.
    pub gain_min: f64,
    /// Greatest gain within it.
    pub gain_max: f64,
    /// Peak-to-peak displacement after it, mm.
    pub amplitude_mm: f64,
    /// Vibration frequency after it, Hz.
    pub frequency_hz: f64,
    /// Samples that could not be used.
    pub unusable: usize,
    /// Number of the sample that comes next.
    pub next: u64,
    /// Why.
    #[schema(value_type = Vec<String>)]
    pub reasons: Codes,
}

/// Reasons as their codes.
#[derive(Debug, Clone, Copy)]
pub struct Codes(pub LoopReasons);

impl Serialize for Codes {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.codes())
    }
}

/// What is in force in a cycle.
pub fn standing<'a>(cycle: &'a StreamedCycle, answer: &Answer) -> StandingPart<'a> {
    let advise = cycle.running.mode() == Mode::Advise;
    StandingPart {
        cycle_id: cycle.id.as_str(),
        mode: cycle.running.mode().as_str(),
        override_percent: advise.then(|| answer.ovr.percent()),
        reasons: Codes(answer.reasons),
        valid_until: time::show(answer.valid_until),
        valid_for_ms: answer.valid_for_ms,
        quality: answer.quality.as_str(),
        age_ms: answer.age_ms,
        next: answer.next,
        overload: answer.overloaded,
        law_version: cycle.law_version,
        profile: cycle.meta.profile.as_ref(),
        program_hash: cycle.program_hash.as_deref(),
        plunge: answer.plunge.map(|step| PlungePart {
            phase: step.phase.as_str(),
            feed_mm_min: advise.then(|| step.feed.mm_min()),
            bite_mm: step.bite_mm,
            contact_offset_mm: step.contact_offset_mm,
            breakthrough_depth_mm: step.breakthrough_depth_mm,
        }),
    }
}

/// What each sample was answered.
pub fn each(mode: Mode, advice: &[SampleAdvice]) -> Vec<EachPart> {
    let advise = mode == Mode::Advise;
    let part = |advice: &SampleAdvice| EachPart {
        override_percent: advise.then(|| advice.ovr.percent()),
        reasons: Codes(advice.reasons),
    };
    advice.iter().map(part).collect()
}

/// The answer to a block of vibration.
pub const fn gain(n: u32, re: u32, advice: &BlockAdvice) -> GainMessage {
    GainMessage {
        kind: "gain",
        n,
        re,
        gain: advice.gain,
        gain_min: advice.gain_range.0,
        gain_max: advice.gain_range.1,
        amplitude_mm: advice.amplitude_mm,
        frequency_hz: advice.frequency_hz,
        unusable: advice.unusable,
        next: advice.next,
        reasons: Codes(advice.reasons),
    }
}

/// An error of one field.
pub fn error<'a>(
    n: u32,
    re: Option<u32>,
    violation: &'a Violation,
    standing: Option<StandingPart<'a>>,
) -> ErrorMessage<'a> {
    ErrorMessage {
        kind: "error",
        n,
        re,
        code: violation.code,
        detail: &violation.message,
        errors: vec![FieldError { path: &violation.path, code: violation.code, message: &violation.message }],
        status: None,
        quarantine_id: None,
        retry_after_s: None,
        standing,
    }
}

/// A problem, as a post would have been answered with.
pub fn problem<'a>(
    n: u32,
    re: Option<u32>,
    problem: &'a Problem,
    standing: Option<StandingPart<'a>>,
) -> ErrorMessage<'a> {
    let field = |e: &'a Violation| FieldError { path: &e.path, code: e.code, message: &e.message };
    let retry = problem.headers.iter().find(|(name, _)| *name == http::header::RETRY_AFTER);
    ErrorMessage {
        kind: "error",
        n,
        re,
        code: problem.code,
        detail: &problem.detail,
        errors: problem.errors.iter().map(field).collect(),
        status: Some(problem.status.as_u16()),
        quarantine_id: problem.members.get("quarantine_id").and_then(serde_json::Value::as_str),
        retry_after_s: retry.and_then(|(_, value)| value.to_str().ok()?.parse().ok()),
        standing,
    }
}

/// A message as text. Maps with string keys and finite floats cannot fail to serialise.
pub fn text(message: &impl Serialize) -> String {
    // An answer to a sample is about 500 bytes: no growing on the way there.
    let mut bytes = Vec::with_capacity(640);
    match serde_json::to_writer(&mut bytes, message) {
        Ok(()) => String::from_utf8(bytes).unwrap_or_default(),
        Err(_) => String::new(),
    }
}
