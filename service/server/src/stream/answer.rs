//! What a machine is answered, as JSON text.

use super::cycle::StreamedCycle;
use crate::http::dto::time;
use crate::http::problem::{FieldError, Problem};
use bytes::{BufMut, BytesMut};
use feedwright_core::closed_loop::monitor::BlockAdvice;
use feedwright_core::closed_loop::{Answer, LoopReasons, Mode, SampleAdvice};
use feedwright_core::invalid::Violation;
use feedwright_core::units::Timestamp;
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
    #[schema(value_type = String)]
    pub valid_until: At,
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
    #[schema(value_type = crate::http::dto::cycle::CycleAnswerBody<'static>)]
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

/// A time, shown as every other.
#[derive(Debug, Clone, Copy)]
pub struct At(pub Timestamp);

impl Serialize for At {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&time::show(self.0))
    }
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
        valid_until: At(answer.valid_until),
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

/// Writes the answer to samples, byte for byte what [`OverrideMessage`] serialises to. It is told for every sample of
/// every machine: names and words that need no escaping are written as they are.
pub fn overrides(
    out: &mut BytesMut,
    (n, re): (u32, u32),
    standing: &StandingPart<'_>,
    (mode, each): (Mode, &[SampleAdvice]),
) {
    out.put_slice(b"{\"type\":\"override\",\"n\":");
    put(out, &n);
    member(out, "re", &re);
    member(out, "cycle_id", standing.cycle_id);
    word(out, "mode", standing.mode);
    if let Some(percent) = standing.override_percent {
        member(out, "override_percent", &percent);
    }
    name(out, "reasons");
    list(out, standing.reasons.0);
    name(out, "valid_until");
    out.put_u8(b'"');
    time::write(out, standing.valid_until.0);
    out.put_u8(b'"');
    member(out, "valid_for_ms", &standing.valid_for_ms);
    word(out, "quality", standing.quality);
    member(out, "age_ms", &standing.age_ms);
    member(out, "next", &standing.next);
    member(out, "overload", &standing.overload);
    word(out, "law_version", standing.law_version);
    if let Some(profile) = standing.profile {
        member(out, "profile", profile);
    }
    if let Some(hash) = standing.program_hash {
        word(out, "program_hash", hash);
    }
    if let Some(plunge) = &standing.plunge {
        member(out, "plunge", plunge);
    }
    name(out, "each");
    let advise = mode == Mode::Advise;
    for (i, advice) in each.iter().enumerate() {
        out.put_slice(if i == 0 { b"[{" } else { b",{" });
        if advise {
            out.put_slice(b"\"override_percent\":");
            put(out, &advice.ovr.percent());
            out.put_u8(b',');
        }
        out.put_slice(b"\"reasons\":");
        list(out, advice.reasons);
        out.put_u8(b'}');
    }
    out.put_slice(if each.is_empty() { b"[]}" } else { b"]}" });
}

fn name(out: &mut BytesMut, name: &str) {
    out.put_slice(b",\"");
    out.put_slice(name.as_bytes());
    out.put_slice(b"\":");
}

/// Numbers and text as JSON has them. Into memory, and with finite floats or null, this cannot fail.
fn put<T: Serialize + ?Sized>(out: &mut BytesMut, value: &T) {
    let _ = serde_json::to_writer(out.writer(), value);
}

fn member<T: Serialize + ?Sized>(out: &mut BytesMut, named: &str, value: &T) {
    name(out, named);
    put(out, value);
}

/// A word of ours, in which nothing has to be escaped.
fn word(out: &mut BytesMut, named: &str, word: &str) {
    name(out, named);
    out.put_u8(b'"');
    out.put_slice(word.as_bytes());
    out.put_u8(b'"');
}

fn list(out: &mut BytesMut, reasons: LoopReasons) {
    out.put_u8(b'[');
    for (i, code) in reasons.codes().enumerate() {
        out.put_slice(if i == 0 { b"\"" } else { b",\"" });
        out.put_slice(code.as_bytes());
        out.put_u8(b'"');
    }
    out.put_u8(b']');
}

/// A message as text. Maps with string keys and finite floats cannot fail to serialise.
pub fn text(message: &impl Serialize) -> String {
    serde_json::to_string(message).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::message::ProfileMessage;
    use feedwright_core::closed_loop::control::LOOP_LAW_VERSION;
    use feedwright_core::friction::feed_override::{OverrideBounds, OverrideRange};
    use proptest::prelude::*;

    fn each_part(mode: Mode, advice: &[SampleAdvice]) -> Vec<EachPart> {
        let advise = mode == Mode::Advise;
        let part = |advice: &SampleAdvice| EachPart {
            override_percent: advise.then(|| advice.ovr.percent()),
            reasons: Codes(advice.reasons),
        };
        advice.iter().map(part).collect()
    }

    proptest! {
        #[test]
        fn an_answer_to_samples_is_what_its_description_serialises_to(
            (n, re, next) in any::<(u32, u32, u64)>(),
            (bits, micros, valid_for_ms) in (any::<u64>(), any::<i64>(), any::<i64>()),
            cycle_id in ".{0,12}",
            (advise, overload) in any::<(bool, bool)>(),
            age_ms in proptest::option::of(any::<f64>()),
            percents in proptest::collection::vec((0.0..300.0_f64, any::<u64>()), 0..4),
            (version, hash) in (proptest::option::of(any::<u32>()), proptest::option::of("[0-9a-f]{8}")),
            plunge in proptest::option::of((any::<f64>(), proptest::option::of(-9.0..9.0_f64))),
        ) {
            let mode = if advise { Mode::Advise } else { Mode::Shadow };
            let profile = version.map(|version| ProfileMessage { id: cycle_id.clone(), version });
            let standing = || StandingPart {
                cycle_id: &cycle_id,
                mode: mode.as_str(),
                override_percent: advise.then_some(87.5),
                reasons: Codes(LoopReasons::from_bits(bits)),
                valid_until: At(Timestamp::from_micros(micros)),
                valid_for_ms,
                quality: LoopReasons::from_bits(bits).quality().as_str(),
                age_ms,
                next,
                overload,
                law_version: LOOP_LAW_VERSION,
                profile: profile.as_ref(),
                program_hash: hash.as_deref(),
                plunge: plunge.map(|(bite_mm, contact_offset_mm)| PlungePart {
                    phase: "work",
                    feed_mm_min: advise.then_some(50.0),
                    bite_mm,
                    contact_offset_mm,
                    breakthrough_depth_mm: None,
                }),
            };
            let range = OverrideRange::new(1.0, 255.0).unwrap();
            let limits = OverrideBounds::new(range, range);
            let each: Vec<SampleAdvice> = percents
                .iter()
                .map(|(percent, bits)| SampleAdvice {
                    ovr: limits.clamp(*percent).0,
                    reasons: LoopReasons::from_bits(*bits),
                })
                .collect();
            let mut written = BytesMut::new();
            overrides(&mut written, (n, re), &standing(), (mode, &each));
            let described = OverrideMessage {
                kind: "override",
                n,
                re: Some(re),
                standing: standing(),
                each: Some(each_part(mode, &each)),
            };
            prop_assert_eq!(String::from_utf8(written.to_vec()).unwrap(), text(&described));
        }
    }
}
