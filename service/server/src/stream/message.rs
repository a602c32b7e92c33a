//! What a machine sends as JSON text, read apart from any socket.
//!
//! A message names its type and its number; samples come as columns by the channels' names. What cannot be read is an
//! error with the path of the field, never a guess.

use crate::http::dto::peak_to_peak::ControllerBody;
use crate::ingest::body::no_channel;
use crate::json::{self, Wrong};
use feedwright_core::cycle::Channel;
use feedwright_core::invalid::Violation;
use feedwright_core::units::Strategy;
use serde::de::{DeserializeSeed, Error as _, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::borrow::Cow;
use std::fmt;
use utoipa::ToSchema;

/// Begins a cycle, or one whose memory was lost (`resend`).
#[derive(Debug, Clone, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct StartMessage {
    /// `start`.
    #[serde(rename = "type")]
    #[schema(value_type = String, example = "start")]
    pub kind: String,
    /// Number of the message; the answer names it.
    pub n: u32,
    /// The cycle's id, unique within the machine for ever: a UUIDv7 or boot id + counter.
    pub cycle_id: String,
    /// The tool in the spindle.
    pub tool: String,
    /// What is machined.
    pub operation: String,
    /// When the cycle began, RFC 3339, by the machine's clock.
    pub started_at: String,
    /// What that clock said when this message was sent: ages are reckoned from the difference to the server's.
    pub sent_at: String,
    /// Distance of two samples, ms; the first is taken at the end of the first period.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub period_ms: Option<f64>,
    /// Instead of `period_ms`: every message of samples has `time_ms`, and this is the usual distance, ms.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub usual_period_ms: Option<f64>,
    /// The channels that samples have, by their names.
    pub channels: Vec<String>,
    /// Decimals of each channel in binary messages; those that controls usually have where it is left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decimals: Option<Vec<u8>>,
    /// `advise` (where it is left out) or `shadow`: computed and stored, not told.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mode: Option<String>,
    /// The programmed feed over depth that the machine runs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub program: Option<ProgramMessage>,
    /// The feed profile that the machine runs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub profile: Option<ProfileMessage>,
    /// The cycle began before this message and is sent again from its first sample: answers to what is old are neutral.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub resend: bool,
    /// With `resend`: the override that is in force at the machine, percent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub in_force_percent: Option<f64>,
    /// The machine's own count of cycles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seq: Option<u64>,
    /// The process, as in a posted cycle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub process: Option<String>,
    /// `f_const`, `f_sec`, `f_lin` or `f_ac`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub strategy: Option<String>,
    /// Version of the control law that the machine applies.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub law_version: Option<String>,
    /// The recommendation that the cycle follows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recommendation_id: Option<String>,
    /// Whether it is a reference cycle, as in a posted cycle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference_cycle: Option<bool>,
    /// Commanded spindle speed, rpm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spindle_speed_rpm: Option<f64>,
}

impl StartMessage {
    /// Whether the machine says that it runs one constant feed, without an override.
    pub fn runs_constant_feed(&self) -> bool {
        self.reference_cycle == Some(true)
            || self.strategy.as_deref().and_then(Strategy::parse) == Some(Strategy::FConst)
    }
}

/// Programmed feed over depth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ProgramMessage {
    /// `held` (F_Const, F_Sec) or `linear` (F_Lin).
    pub between: String,
    /// At most 256 knots with rising depths.
    pub knots: Vec<KnotMessage>,
    /// Least override that the program permits, percent; the configuration's where it is left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub override_min_percent: Option<f64>,
    /// Greatest override that the program permits, percent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub override_max_percent: Option<f64>,
}

/// A knot of a program.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct KnotMessage {
    /// Depth below first contact, mm.
    pub depth_mm: f64,
    /// Programmed feed, mm/min.
    pub feed_mm_min: f64,
}

/// A version of a feed profile.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ProfileMessage {
    /// Its id.
    pub id: String,
    /// Its version.
    pub version: u32,
}

/// Ends a cycle: it is stored, and the answer is a post's.
#[derive(Debug, Clone, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct EndMessage {
    /// `end`.
    #[serde(rename = "type")]
    #[schema(value_type = String, example = "end")]
    pub kind: String,
    /// Number of the message.
    pub n: u32,
    /// The cycle's id: asks again for the answer to a cycle that has ended.
    pub cycle_id: Option<String>,
    /// Samples that the machine has sent; where some are missing the answer names the first of them.
    pub samples: Option<u64>,
    /// `completed` (where it is left out) or `aborted`.
    pub outcome: Option<String>,
    /// What the control itself reports, as in a posted cycle.
    #[schema(value_type = Option<Object>)]
    pub reported: Option<serde_json::Value>,
}

/// Goes on with a cycle after the connection broke.
#[derive(Debug, Clone, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ResumeMessage {
    /// `resume`.
    #[serde(rename = "type")]
    #[schema(value_type = String, example = "resume")]
    pub kind: String,
    /// Number of the message.
    pub n: u32,
    /// The cycle's id.
    pub cycle_id: String,
}

/// Says that the machine lives; answered with what is in force.
#[derive(Debug, Clone, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct HeartbeatMessage {
    /// `heartbeat`.
    #[serde(rename = "type")]
    #[schema(value_type = String, example = "heartbeat")]
    pub kind: String,
    /// Number of the message.
    pub n: u32,
}

/// Begins to watch a vibration, beside any cycle.
#[derive(Debug, Clone, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MonitorMessage {
    /// `monitor`.
    #[serde(rename = "type")]
    #[schema(value_type = String, example = "monitor")]
    pub kind: String,
    /// Number of the message.
    pub n: u32,
    /// Settings of the controller; the paper's where they are left out.
    pub settings: Option<ControllerBody>,
}

/// A block of vibration.
#[derive(Debug, Clone, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct VibrationMessage {
    /// `vibration`.
    #[serde(rename = "type")]
    #[schema(value_type = String, example = "vibration")]
    pub kind: String,
    /// Number of the message.
    pub n: u32,
    /// Number of the block's first sample, counted from 0 since `monitor`.
    pub first: u64,
    /// Velocity, mm/s.
    pub velocity_mm_s: Vec<f64>,
    /// Acceleration, mm/s², as many.
    pub acceleration_mm_s2: Vec<f64>,
}

/// Some samples in a row. A value that was not measured is null; a single value needs no array.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SamplesMessage {
    /// Number of the message.
    pub n: u32,
    /// Number of the first sample within the cycle, counted from 0.
    pub first: u64,
    /// Times since the start of the cycle, ms.
    pub time_ms: Vec<f64>,
    /// Each column's channel, and where it ends among the values.
    ends: Vec<(Channel, usize)>,
    /// The values of every column, column after column.
    values: Vec<f64>,
}

impl SamplesMessage {
    /// The columns, in the order in which they came.
    pub fn columns(&self) -> impl Iterator<Item = (Channel, &[f64])> {
        let mut from = 0;
        self.ends.iter().map(move |(channel, to)| {
            let column = self.values.get(from..*to).unwrap_or_default();
            from = *to;
            (*channel, column)
        })
    }
}

/// The schema of [`SamplesMessage`], which is read by hand: a column for each channel that the start has named.
#[derive(ToSchema)]
#[schema(as = SamplesMessage)]
#[expect(dead_code, reason = "the schema of what is read by hand")]
pub struct SamplesSchema {
    /// `samples`.
    #[schema(rename = "type", example = "samples")]
    kind: String,
    /// Number of the message.
    n: u32,
    /// Number of the first sample within the cycle, counted from 0.
    first: u64,
    /// Times since the start of the cycle, ms; only where the start has `usual_period_ms`.
    #[schema(required = false)]
    time_ms: OneOrMore,
    /// Tool tip depth, mm; null where it was not measured. So every other channel of a posted cycle, by its name.
    #[schema(required = false)]
    depth_mm: OneOrMore,
    /// Feed-drive load, percent.
    #[schema(required = false)]
    feed_drive_load_percent: OneOrMore,
    /// Spindle load, percent.
    #[schema(required = false)]
    spindle_load_percent: OneOrMore,
}

/// A value by itself, null where it was not measured, or an array of them.
#[derive(Serialize, ToSchema)]
#[serde(untagged)]
#[expect(dead_code, reason = "the schema of what is read by hand")]
enum OneOrMore {
    One(Option<f64>),
    More(Vec<Option<f64>>),
}

/// A message of a machine.
#[derive(Debug, Clone)]
pub enum Incoming {
    /// Begins a cycle.
    Start(Box<StartMessage>),
    /// Samples.
    Samples(SamplesMessage),
    /// Ends a cycle.
    End(Box<EndMessage>),
    /// Goes on after a break.
    Resume(ResumeMessage),
    /// Lives.
    Heartbeat(HeartbeatMessage),
    /// Watches a vibration.
    Monitor(Box<MonitorMessage>),
    /// A block of vibration.
    Vibration(VibrationMessage),
}

/// A message that could not be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unreadable {
    /// Its number, where that could be read.
    pub n: Option<u32>,
    /// Whether it would have begun a cycle.
    pub begins: bool,
    /// What is wrong.
    pub violation: Violation,
}

/// Reads a message of JSON text.
pub fn read(text: &str) -> Result<Incoming, Unreadable> {
    // Samples come a hundred times a second and more, everything else once in a while.
    if text.starts_with("{\"type\":\"samples\"") || text.starts_with("{\"type\": \"samples\"") {
        return parse(text).map(Incoming::Samples);
    }
    #[derive(Deserialize)]
    struct Head<'a> {
        #[serde(rename = "type", borrow)]
        kind: Cow<'a, str>,
    }
    let head: Head<'_> = parse(text)?;
    match head.kind.as_ref() {
        "start" => {
            let start = parse(text).map_err(|unreadable| Unreadable { begins: true, ..unreadable })?;
            Ok(Incoming::Start(Box::new(start)))
        }
        "samples" => parse(text).map(Incoming::Samples),
        "end" => parse(text).map(Box::new).map(Incoming::End),
        "resume" => parse(text).map(Incoming::Resume),
        "heartbeat" => parse(text).map(Incoming::Heartbeat),
        "monitor" => parse(text).map(Box::new).map(Incoming::Monitor),
        "vibration" => parse(text).map(Incoming::Vibration),
        _ => Err(Unreadable {
            n: number_of(text),
            begins: false,
            violation: Violation::new("type", "unknown_type", "is no type of message that is known"),
        }),
    }
}

fn parse<'a, T: Deserialize<'a>>(text: &'a str) -> Result<T, Unreadable> {
    json::read(text.as_bytes()).map_err(|wrong| {
        let violation = match wrong {
            Wrong::Malformed(why) => Violation::new("", "malformed_json", format!("is no JSON: {why}")),
            Wrong::Field(violation) if violation.code == "invalid_value" => {
                Violation { code: "wrong_type", ..violation }
            }
            Wrong::Field(violation) => violation,
        };
        Unreadable { n: number_of(text), begins: false, violation }
    })
}

fn number_of(text: &str) -> Option<u32> {
    #[derive(Deserialize)]
    struct OnlyNumber {
        n: u32,
    }
    serde_json::from_str::<OnlyNumber>(text).ok().map(|only| only.n)
}

/// Adds a column to some values: a number, null, or an array of them; null is kept as what is not a number.
struct Column<'a>(&'a mut Vec<f64>);

impl<'de> DeserializeSeed<'de> for Column<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Column<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number, null or an array of them")
    }

    fn visit_f64<E: serde::de::Error>(self, value: f64) -> Result<(), E> {
        self.0.push(value);
        Ok(())
    }

    #[expect(clippy::cast_precision_loss, reason = "beyond 2^53 every range refuses it")]
    fn visit_u64<E: serde::de::Error>(self, value: u64) -> Result<(), E> {
        self.visit_f64(value as f64)
    }

    #[expect(clippy::cast_precision_loss, reason = "beyond 2^53 every range refuses it")]
    fn visit_i64<E: serde::de::Error>(self, value: i64) -> Result<(), E> {
        self.visit_f64(value as f64)
    }

    fn visit_unit<E: serde::de::Error>(self) -> Result<(), E> {
        self.visit_f64(f64::NAN)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<(), A::Error> {
        while let Some(value) = seq.next_element::<Option<f64>>()? {
            self.0.push(value.unwrap_or(f64::NAN));
        }
        Ok(())
    }
}

impl<'de> Deserialize<'de> for SamplesMessage {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Fields;
        impl<'de> Visitor<'de> for Fields {
            type Value = SamplesMessage;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a message of samples")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<SamplesMessage, A::Error> {
                let (mut n, mut first) = (None, None);
                let mut message = SamplesMessage::default();
                while let Some(name) = map.next_key::<Cow<'de, str>>()? {
                    match name.as_ref() {
                        "type" => drop(map.next_value::<IgnoredAny>()?),
                        "n" => n = Some(map.next_value()?),
                        "first" => first = Some(map.next_value()?),
                        "time_ms" => {
                            message.time_ms.clear();
                            map.next_value_seed(Column(&mut message.time_ms))?;
                        }
                        name => {
                            let Some(channel) = Channel::parse(name) else {
                                return Err(A::Error::custom(no_channel(name)));
                            };
                            if message.ends.iter().any(|(known, _)| *known == channel) {
                                return Err(A::Error::custom(format!("duplicate field `{name}`")));
                            }
                            map.next_value_seed(Column(&mut message.values))?;
                            message.ends.push((channel, message.values.len()));
                        }
                    }
                }
                message.n = n.ok_or_else(|| A::Error::missing_field("n"))?;
                message.first = first.ok_or_else(|| A::Error::missing_field("first"))?;
                Ok(message)
            }
        }
        deserializer.deserialize_map(Fields)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(text: &str) -> SamplesMessage {
        match read(text) {
            Ok(Incoming::Samples(message)) => message,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn samples_come_one_by_one_or_in_groups_in_any_order_of_their_fields() {
        let group = samples(
            r#"{"type":"samples","n":7,"first":40,"depth_mm":[0.1,0.2],"spindle_load_percent":[21,null]}"#,
        );
        let columns: Vec<_> = group.columns().collect();
        assert_eq!((group.n, group.first, columns.len()), (7, 40, 2));
        assert_eq!(columns[0], (Channel::DepthMm, &[0.1, 0.2][..]));
        assert_eq!((columns[1].0, columns[1].1[0]), (Channel::SpindleLoadPercent, 21.0));
        assert!(columns[1].1.len() == 2 && columns[1].1[1].is_nan());
        let one = samples(r#"{"depth_mm":0.1,"first":3,"n":1,"type":"samples","time_ms":40}"#);
        assert_eq!(one.columns().collect::<Vec<_>>(), [(Channel::DepthMm, &[0.1][..])]);
        assert_eq!(one.time_ms, [40.0]);
    }

    #[test]
    fn what_cannot_be_read_is_named_with_its_number() {
        let refused = |text: &str| {
            let refused = read(text).unwrap_err();
            (refused.n, refused.violation.path, refused.violation.code)
        };
        let at = |n, path: &str, code| (n, path.to_owned(), code);
        assert_eq!(refused(""), at(None, "", "malformed_json"));
        assert_eq!(refused("{\"type\":\"samples\""), at(None, "", "malformed_json"));
        assert_eq!(refused(r#"{"type":"sample","n":4}"#), at(Some(4), "type", "unknown_type"));
        assert_eq!(refused(r#"{"n":4}"#), at(Some(4), "type", "missing_field"));
        assert_eq!(
            refused(r#"{"type":"samples","n":4,"first":0,"load":[1]}"#),
            at(Some(4), "load", "unknown_field")
        );
        assert_eq!(
            refused(r#"{"type":"samples","n":4,"depth_mm":[1]}"#),
            at(Some(4), "first", "missing_field")
        );
        let nan = r#"{"type":"samples","n":4,"first":0,"depth_mm":[NaN]}"#;
        assert_eq!(refused(nan), at(None, "depth_mm[0]", "not_finite"));
        let twice = r#"{"type":"samples","n":4,"first":0,"depth_mm":[1],"depth_mm":[1]}"#;
        assert_eq!(refused(twice), at(Some(4), "depth_mm", "duplicate_field"));
        assert_eq!(refused(r#"{"type":"samples","n":-4,"first":0}"#), at(None, "n", "wrong_type"));
        let text = r#"{"type":"samples","n":4,"first":0,"depth_mm":[1,"2"]}"#;
        assert_eq!(refused(text), at(Some(4), "depth_mm[1]", "wrong_type"));
        assert_eq!(refused(r#"{"type":3,"n":4}"#), at(Some(4), "type", "wrong_type"));
        assert_eq!(refused(r#"["end",4]"#), at(None, "", "wrong_type"));
        let start = |field: &str| {
            format!(
                r#"{{"type":"start","n":4,"cycle_id":"c","tool":"T","operation":"O","started_at":"","sent_at":"",
                    "channels":[],{field}}}"#
            )
        };
        for (field, path) in [
            (r#""program":["held",[]]"#, "program"),
            (
                r#""program":{"between":"held","knots":[{"depth_mm":0,"feed_mm_min":1},[1,2]]}"#,
                "program.knots[1]",
            ),
            (r#""profile":["P",1]"#, "profile"),
            (r#""seq":"1""#, "seq"),
        ] {
            assert_eq!(refused(&start(field)), at(Some(4), path, "wrong_type"), "{field}");
        }
        assert_eq!(refused(r#"{"type":"end","n":1,"more":1}"#), at(Some(1), "more", "unknown_field"));
    }
}
