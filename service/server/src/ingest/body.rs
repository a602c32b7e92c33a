//! The JSON body of a cycle, to a checked [`Cycle`], with the path of whatever is wrong.
//!
//! The usual body is read in one pass by [`reader`]; anything else by [`json`], with the same outcome and with the path
//! of what is wrong.

mod frame;
mod reader;
mod short;

use super::number::{Number, Numbers};
use super::scan;
use crate::http::dto::{text, time};
use crate::json::{self, Wrong};
use feedwright_core::cycle::{
    Channel, Cycle, CycleDraft, Outcome, ProfileVersion, Reported, ReportedCut, Samples, TimeBase,
};
use feedwright_core::ids::{CycleId, MachineId, OperationId, ProfileId, RecommendationId, ToolId};
use feedwright_core::invalid::Violation;
use feedwright_core::units::{Process, Strategy, Timestamp};
use feedwright_store::codec::Places;
use feedwright_store::wire;
use serde::de::{Error as _, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use std::fmt;

/// How far a machine's clock may be ahead of the server's: beyond, a cycle goes to quarantine.
pub const CLOCK_AHEAD_MS: i64 = 10 * 60 * 1000;

/// Why a body is not a cycle.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum BodyError {
    /// It is no JSON: answered 400, nothing is kept.
    Malformed(String),
    /// It is no frame of the binary form: answered 400, nothing is kept.
    MalformedFrame(&'static str),
    /// It is read, but no cycle that could have been run: answered 422 and kept in quarantine.
    Invalid(Vec<Violation>),
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Body {
    cycle_id: String,
    tool: String,
    operation: String,
    started_at: Started,
    seq: Option<u64>,
    process: Option<String>,
    strategy: Option<String>,
    law_version: Option<String>,
    profile: Option<ProfileBody>,
    recommendation_id: Option<String>,
    reference_cycle: Option<bool>,
    spindle_speed_rpm: Option<Number>,
    outcome: Option<String>,
    samples: Option<SamplesBody>,
    reported: Option<ReportedBody>,
}

/// When a cycle began: JSON has a text, the binary form the time itself.
#[derive(Debug)]
enum Started {
    Text(String),
    At(Timestamp),
}

impl<'de> Deserialize<'de> for Started {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer).map(Self::Text)
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ProfileBody {
    id: String,
    version: u32,
}

#[derive(Debug, Deserialize, Default)]
#[serde(deny_unknown_fields)]
struct ReportedBody {
    energy_joules: Option<Number>,
    duration_ms: Option<Number>,
    max_depth_mm: Option<Number>,
    max_spindle_load_percent: Option<Number>,
    max_feed_drive_load_percent: Option<Number>,
    mean_spindle_load_percent: Option<Number>,
    mean_feed_drive_load_percent: Option<Number>,
    operator_override_percent: Option<Number>,
    cutting_speed_m_min: Option<Number>,
    feed_mm_rev: Option<Number>,
    spindle_power_watts: Option<Number>,
    thrust_newtons: Option<Number>,
    edge_wear_mm: Option<Number>,
}

#[derive(Debug, Default)]
struct SamplesBody {
    period_ms: Option<f64>,
    time_ms: Option<Vec<f64>>,
    columns: Vec<(Channel, Vec<f64>)>,
    /// As far as whoever has read it knows them.
    places: Places,
}

/// Name of a field in `samples`, refused where there is no such field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum SamplesField {
    PeriodMs,
    TimeMs,
    Column(Channel),
}

impl SamplesField {
    const fn as_str(self) -> &'static str {
        match self {
            Self::PeriodMs => "period_ms",
            Self::TimeMs => "time_ms",
            Self::Column(channel) => channel.as_str(),
        }
    }
}

impl<'de> Deserialize<'de> for SamplesField {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Name;
        impl Visitor<'_> for Name {
            type Value = SamplesField;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("the name of a channel")
            }
            fn visit_str<E: serde::de::Error>(self, name: &str) -> Result<SamplesField, E> {
                match name {
                    "period_ms" => Ok(SamplesField::PeriodMs),
                    "time_ms" => Ok(SamplesField::TimeMs),
                    _ => Channel::parse(name)
                        .map(SamplesField::Column)
                        .ok_or_else(|| E::custom(no_channel(name))),
                }
            }
        }
        deserializer.deserialize_identifier(Name)
    }
}

/// Says that samples have no such field, and which channels there are.
pub(crate) fn no_channel(name: &str) -> String {
    let channels: Vec<_> = Channel::ALL.iter().map(|channel| format!("`{}`", channel.as_str())).collect();
    format!("unknown field `{name}`, expected a channel: one of {}", channels.join(", "))
}

impl<'de> Deserialize<'de> for SamplesBody {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Columns;
        impl<'de> Visitor<'de> for Columns {
            type Value = SamplesBody;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object of columns")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<SamplesBody, A::Error> {
                let mut body = SamplesBody::default();
                while let Some(field) = map.next_key::<SamplesField>()? {
                    let is_there = match field {
                        SamplesField::PeriodMs => body.period_ms.is_some(),
                        SamplesField::TimeMs => body.time_ms.is_some(),
                        SamplesField::Column(channel) => {
                            body.columns.iter().any(|(known, _)| *known == channel)
                        }
                    };
                    if is_there {
                        return Err(A::Error::duplicate_field(field.as_str()));
                    }
                    match field {
                        SamplesField::PeriodMs => body.period_ms = Some(map.next_value::<Number>()?.0),
                        SamplesField::TimeMs => body.time_ms = Some(map.next_value::<Numbers>()?.0),
                        SamplesField::Column(channel) => {
                            body.columns.push((channel, map.next_value::<Numbers>()?.0));
                        }
                    }
                }
                Ok(body)
            }
        }
        deserializer.deserialize_map(Columns)
    }
}

/// Decodes one cycle's body: the binary form where it begins as that does, else JSON, which never does.
///
/// `now` is the server's clock; a cycle that begins more than [`CLOCK_AHEAD_MS`] after it is refused.
pub fn decode(
    machine: &MachineId,
    body: &[u8],
    max_samples: usize,
    now: Timestamp,
) -> Result<Cycle, BodyError> {
    decode_with_places(machine, body, max_samples, now).map(|(cycle, _)| cycle)
}

/// As [`decode`], with how its samples were written, as far as that is known.
pub fn decode_with_places(
    machine: &MachineId,
    body: &[u8],
    max_samples: usize,
    now: Timestamp,
) -> Result<(Cycle, Places), BodyError> {
    let body = if is_frame(body) { frame::read(body, max_samples)? } else { parse(body, max_samples)? };
    let places = body.samples.as_ref().map(|samples| samples.places).unwrap_or_default();
    Ok((checked(machine, body, max_samples, now)?, places))
}

/// Whether a body is of the binary form.
pub fn is_frame(body: &[u8]) -> bool {
    body.starts_with(&wire::MAGIC[..3])
}

/// As [`decode`], by serde alone: what the fast reader is held against.
pub fn decode_by_serde(
    machine: &MachineId,
    json: &[u8],
    max_samples: usize,
    now: Timestamp,
) -> Result<Cycle, BodyError> {
    refuse_too_many_values(json, max_samples)?;
    checked(machine, parse_by_serde(json)?, max_samples, now)
}

fn checked(machine: &MachineId, body: Body, max_samples: usize, now: Timestamp) -> Result<Cycle, BodyError> {
    let mut wrong = Vec::new();
    let draft = draft(machine, body, max_samples, now, &mut wrong);
    match draft {
        Some(draft) if wrong.is_empty() => Cycle::new(draft).map_err(BodyError::Invalid),
        _ => Err(BodyError::Invalid(wrong)),
    }
}

/// Most characters that are told of a cycle id which may be none.
const MOST_OF_ID: usize = 128;

/// The cycle id of a body that is otherwise refused, for the quarantine's list, of bounded length. Control characters, which
/// not every database takes, are replaced, so that it is not taken for another id.
pub fn cycle_id_of(body: &[u8]) -> Option<String> {
    let id = any_cycle_id_of(body)?;
    let shown =
        |character: char| if character.is_control() { char::REPLACEMENT_CHARACTER } else { character };
    Some(id.chars().take(MOST_OF_ID).map(shown).collect())
}

fn any_cycle_id_of(body: &[u8]) -> Option<String> {
    if is_frame(body) {
        return wire::cycle_id_of(body);
    }
    #[derive(Deserialize)]
    struct OnlyId {
        cycle_id: String,
    }
    match serde_json::from_slice::<OnlyId>(body) {
        Ok(body) => Some(body.cycle_id),
        // What is no JSON for a number such as NaN is kept too.
        Err(error) if error.is_syntax() => scan::text_of(body, "cycle_id"),
        Err(_) => None,
    }
}

fn parse(json: &[u8], max_samples: usize) -> Result<Body, BodyError> {
    refuse_too_many_values(json, max_samples)?;
    reader::read(json).map_or_else(|| parse_by_serde(json), Ok)
}

fn parse_by_serde(json: &[u8]) -> Result<Body, BodyError> {
    json::read(json).map_err(|wrong| refusal(json, wrong))
}

fn refusal(json: &[u8], wrong: Wrong) -> BodyError {
    match wrong {
        Wrong::Malformed(why) => BodyError::Malformed(why),
        Wrong::Field(violation) => BodyError::Invalid(vec![told(json, violation)]),
    }
}

/// Refuses samples with more values than all columns of a cycle together, before any of them is kept: a compressed body of
/// some hundred kilobytes may hold tens of millions, which take eight bytes each. Values elsewhere are not kept: whoever
/// reads the body stops where they begin.
fn refuse_too_many_values(json: &[u8], max_samples: usize) -> Result<(), BodyError> {
    // Times are a column too. One value more than a column may have is told by the column.
    let most = (max_samples.saturating_add(1)).saturating_mul(Channel::ALL.len() + 1);
    // A value takes a digit and a comma at the least, so that a usual body is not looked through.
    if json.len() / 2 <= most || json.iter().filter(|byte| **byte == b',').count() <= most {
        return Ok(());
    }
    // Commas part other things too: reported values, fields, words of a text.
    let counted: Counted = json::read(json).map_err(|wrong| refusal(json, wrong))?;
    if counted.samples.is_none_or(|Values(values)| values <= most) {
        return Ok(());
    }
    json::well_formed(json).map_err(|wrong| refusal(json, wrong))?;
    let message =
        format!("may hold at most {max_samples} samples, has more values than so many of all channels");
    Err(BodyError::Invalid(vec![Violation::new("samples", "too_many_samples", message)]))
}

/// A body of which nothing is kept.
#[derive(Deserialize)]
struct Counted {
    samples: Option<Values>,
}

/// How many values the columns of samples hold together.
struct Values(usize);

impl<'de> Deserialize<'de> for Values {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Columns;
        impl<'de> Visitor<'de> for Columns {
            type Value = Values;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object of columns")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Values, A::Error> {
                let (mut all, mut counted) = (0_usize, Vec::new());
                while let Some(field) = map.next_key::<SamplesField>()? {
                    if counted.contains(&field) {
                        return Err(A::Error::duplicate_field(field.as_str()));
                    }
                    if field == SamplesField::PeriodMs {
                        let IgnoredAny = map.next_value()?;
                    } else {
                        all = all.saturating_add(map.next_value::<Length>()?.0);
                    }
                    counted.push(field);
                }
                Ok(Values(all))
            }
        }
        deserializer.deserialize_map(Columns)
    }
}

/// How many values a column holds.
struct Length(usize);

impl<'de> Deserialize<'de> for Length {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Column;
        impl<'de> Visitor<'de> for Column {
            type Value = Length;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an array of numbers")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut values: A) -> Result<Length, A::Error> {
                let mut length = 0;
                while let Some(IgnoredAny) = values.next_element()? {
                    length += 1;
                }
                Ok(Length(length))
            }
        }
        deserializer.deserialize_any(Column)
    }
}

/// What a cycle's body tells in words of its own: null, and a number beyond every other, which is told like NaN.
fn told(json: &[u8], violation: Violation) -> Violation {
    match violation.code {
        "number_out_of_range" => match scan::first_non_finite(json) {
            Some((path, literal)) => {
                Violation::new(path, "not_finite", format!("must be a finite number, is {literal}"))
            }
            None => violation,
        },
        "wrong_type" if violation.message.starts_with("invalid type: null") => {
            let message = if violation.path.starts_with("samples") {
                "must be a number, is null: leave out what was not sampled"
            } else {
                "must not be null"
            };
            Violation::new(violation.path, "null_value", message)
        }
        "invalid_value" => Violation { code: "wrong_type", ..violation },
        _ => violation,
    }
}

fn draft(
    machine: &MachineId,
    body: Body,
    max_samples: usize,
    now: Timestamp,
    wrong: &mut Vec<Violation>,
) -> Option<CycleDraft> {
    let id = keep(CycleId::parse("cycle_id", &body.cycle_id), wrong);
    let tool = keep(ToolId::parse("tool", &body.tool), wrong);
    let operation = keep(OperationId::parse("operation", &body.operation), wrong);
    let started_at = keep(started_at(body.started_at, now), wrong);
    let process = word("process", body.process.as_deref(), Process::parse, wrong);
    let strategy = word("strategy", body.strategy.as_deref(), Strategy::parse, wrong);
    let outcome = word("outcome", body.outcome.as_deref(), Outcome::parse, wrong);
    let recommendation = body
        .recommendation_id
        .and_then(|text| keep(RecommendationId::parse("recommendation_id", &text), wrong));
    let profile = body.profile.and_then(|profile| {
        let id = keep(ProfileId::parse("profile.id", &profile.id), wrong)?;
        Some(ProfileVersion { profile: id, version: profile.version })
    });
    // Here and not where a cycle is made: those that are stored with other text have to be read.
    let law_version = text::law_version(body.law_version.as_deref(), wrong);
    let samples = body.samples.and_then(|samples| columns(samples, max_samples, wrong));
    let reported = body.reported.unwrap_or_default();
    let value = |number: Option<Number>| number.map(|number| number.0);
    Some(CycleDraft {
        machine: machine.clone(),
        id: id?,
        tool: tool?,
        operation: operation?,
        started_at: started_at?,
        seq: body.seq,
        process,
        strategy,
        law_version,
        profile,
        recommendation,
        reference: body.reference_cycle,
        spindle_speed_rpm: value(body.spindle_speed_rpm),
        outcome: outcome.unwrap_or_default(),
        samples,
        reported: Reported {
            energy_joules: value(reported.energy_joules),
            duration_ms: value(reported.duration_ms),
            max_depth_mm: value(reported.max_depth_mm),
            max_spindle_load_percent: value(reported.max_spindle_load_percent),
            max_feed_drive_load_percent: value(reported.max_feed_drive_load_percent),
            mean_spindle_load_percent: value(reported.mean_spindle_load_percent),
            mean_feed_drive_load_percent: value(reported.mean_feed_drive_load_percent),
            operator_override_percent: value(reported.operator_override_percent),
            cut: ReportedCut {
                cutting_speed_m_min: value(reported.cutting_speed_m_min),
                feed_mm_rev: value(reported.feed_mm_rev),
                spindle_power_watts: value(reported.spindle_power_watts),
                thrust_newtons: value(reported.thrust_newtons),
                edge_wear_mm: value(reported.edge_wear_mm),
            },
        },
    })
}

fn keep<T>(result: Result<T, Violation>, wrong: &mut Vec<Violation>) -> Option<T> {
    result.map_err(|violation| wrong.push(violation)).ok()
}

fn word<T>(
    path: &'static str,
    text: Option<&str>,
    parse: fn(&str) -> Option<T>,
    wrong: &mut Vec<Violation>,
) -> Option<T> {
    let text = text?;
    let parsed = parse(text);
    if parsed.is_none() {
        let shown: String = text.chars().take(40).collect();
        wrong.push(Violation::new(path, "unknown_word", format!("{shown:?} is no {path} that is known")));
    }
    parsed
}

fn started_at(started: Started, now: Timestamp) -> Result<Timestamp, Violation> {
    let at = match started {
        Started::Text(text) => time::read("started_at", &text)?,
        // Within what a text could have said.
        Started::At(at) => {
            time::read("started_at", &time::show(at)).ok().filter(|shown| *shown == at).ok_or_else(|| {
                Violation::new("started_at", "invalid_timestamp", "must be within the years 1 to 9999")
            })?
        }
    };
    if at.millis_since(now) > CLOCK_AHEAD_MS {
        return Err(Violation::new(
            "started_at",
            "started_in_future",
            "is more than 10 minutes ahead of the server's clock",
        ));
    }
    Ok(at)
}

fn columns(body: SamplesBody, max_samples: usize, wrong: &mut Vec<Violation>) -> Option<Samples> {
    let time = match (body.period_ms, body.time_ms) {
        (Some(period_ms), None) => TimeBase::Period { period_ms },
        // As every other value: −0 is 0. Not where stored blocks are read, as some of before have it in their hash.
        (None, Some(mut time_ms)) => {
            time_ms.iter_mut().for_each(|stamp| *stamp += 0.0);
            TimeBase::Stamps { time_ms }
        }
        (None, None) => {
            wrong.push(Violation::new(
                "samples.period_ms",
                "missing_field",
                "period_ms or time_ms is required",
            ));
            return None;
        }
        (Some(_), Some(_)) => {
            wrong.push(Violation::new(
                "samples.time_ms",
                "contradictory",
                "period_ms and time_ms are both given: which of them holds is not known",
            ));
            return None;
        }
    };
    Samples::new(time, body.columns, max_samples).map_err(|violations| wrong.extend(violations)).ok()
}

#[cfg(test)]
mod tests;
