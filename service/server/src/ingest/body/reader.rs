//! One pass over the usual body of a cycle: plain strings, numbers as fixed-point integers, columns straight into
//! their vectors. What is unusual in any way (escapes, exponents, more than 15 digits, nulls, a field that is unknown,
//! missing or given twice, broken JSON) is `None` here and read again by `serde_json`, which alone says what is wrong.
//! So this reader can refuse, but never accept what serde would not, nor read another value.

use super::super::number::Number;
use super::short;
use super::{Body, ProfileBody, ReportedBody, SamplesBody, Started};
use feedwright_core::cycle::Channel;

/// Digits that a number may have: every integer of so many is exact as f64, so a quotient by a power of ten, exact as
/// well, is rounded once and has the bits that a correct reader gives (Clinger, 1990).
const MOST_DIGITS: usize = 15;

const POWERS: [f64; MOST_DIGITS + 1] =
    [1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15];

/// Room for a column before the first one has told how long they are.
const FIRST_ROOM: usize = 512;

/// The body, where it is a usual one.
pub(super) fn read(json: &[u8]) -> Option<Body> {
    let mut reader = Reader { json, at: 0 };
    let body = reader.body()?;
    reader.skip_space();
    (reader.at == json.len()).then_some(body)
}

/// Fields of a body while they are collected.
#[derive(Default)]
struct Fields {
    cycle_id: Option<String>,
    tool: Option<String>,
    operation: Option<String>,
    started_at: Option<String>,
    seq: Option<u64>,
    process: Option<String>,
    strategy: Option<String>,
    law_version: Option<String>,
    profile: Option<ProfileBody>,
    recommendation_id: Option<String>,
    spindle_speed_rpm: Option<Number>,
    outcome: Option<String>,
    samples: Option<SamplesBody>,
    reported: Option<ReportedBody>,
}

/// Sets a field that must not be set yet.
fn once<T>(field: &mut Option<T>, value: T) -> Option<()> {
    field.replace(value).is_none().then_some(())
}

struct Reader<'a> {
    json: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    fn body(&mut self) -> Option<Body> {
        let mut fields = Fields::default();
        self.object(|reader, name| match name {
            "cycle_id" => once(&mut fields.cycle_id, reader.text()?),
            "tool" => once(&mut fields.tool, reader.text()?),
            "operation" => once(&mut fields.operation, reader.text()?),
            "started_at" => once(&mut fields.started_at, reader.text()?),
            "seq" => once(&mut fields.seq, reader.count()?),
            "process" => once(&mut fields.process, reader.text()?),
            "strategy" => once(&mut fields.strategy, reader.text()?),
            "law_version" => once(&mut fields.law_version, reader.text()?),
            "profile" => once(&mut fields.profile, reader.profile()?),
            "recommendation_id" => once(&mut fields.recommendation_id, reader.text()?),
            "spindle_speed_rpm" => once(&mut fields.spindle_speed_rpm, Number(reader.number()?.0)),
            "outcome" => once(&mut fields.outcome, reader.text()?),
            "samples" => once(&mut fields.samples, reader.samples()?),
            "reported" => once(&mut fields.reported, reader.reported()?),
            _ => None,
        })?;
        Some(Body {
            cycle_id: fields.cycle_id?,
            tool: fields.tool?,
            operation: fields.operation?,
            started_at: Started::Text(fields.started_at?),
            seq: fields.seq,
            process: fields.process,
            strategy: fields.strategy,
            law_version: fields.law_version,
            profile: fields.profile,
            recommendation_id: fields.recommendation_id,
            // Rare: a body that has it is left to the reader that knows everything.
            reference_cycle: None,
            spindle_speed_rpm: fields.spindle_speed_rpm,
            outcome: fields.outcome,
            samples: fields.samples,
            reported: fields.reported,
        })
    }

    fn profile(&mut self) -> Option<ProfileBody> {
        let (mut id, mut version) = (None, None);
        self.object(|reader, name| match name {
            "id" => once(&mut id, reader.text()?),
            "version" => once(&mut version, u32::try_from(reader.count()?).ok()?),
            _ => None,
        })?;
        Some(ProfileBody { id: id?, version: version? })
    }

    fn reported(&mut self) -> Option<ReportedBody> {
        let mut body = ReportedBody::default();
        self.object(|reader, name| {
            let field = match name {
                "energy_joules" => &mut body.energy_joules,
                "duration_ms" => &mut body.duration_ms,
                "max_depth_mm" => &mut body.max_depth_mm,
                "max_spindle_load_percent" => &mut body.max_spindle_load_percent,
                "max_feed_drive_load_percent" => &mut body.max_feed_drive_load_percent,
                "mean_spindle_load_percent" => &mut body.mean_spindle_load_percent,
                "mean_feed_drive_load_percent" => &mut body.mean_feed_drive_load_percent,
                "operator_override_percent" => &mut body.operator_override_percent,
                "cutting_speed_m_min" => &mut body.cutting_speed_m_min,
                "feed_mm_rev" => &mut body.feed_mm_rev,
                "spindle_power_watts" => &mut body.spindle_power_watts,
                "thrust_newtons" => &mut body.thrust_newtons,
                "edge_wear_mm" => &mut body.edge_wear_mm,
                _ => return None,
            };
            once(field, Number(reader.number()?.0))
        })?;
        Some(body)
    }

    fn samples(&mut self) -> Option<SamplesBody> {
        let mut body = SamplesBody::default();
        let mut room = FIRST_ROOM;
        self.object(|reader, name| {
            match name {
                "period_ms" => return once(&mut body.period_ms, reader.number()?.0),
                "time_ms" => {
                    let (values, places) = reader.numbers(room)?;
                    once(&mut body.time_ms, values)?;
                    places.into_iter().for_each(|places| body.places.note(None, places));
                }
                _ => {
                    let channel = Channel::parse(name)?;
                    if body.columns.iter().any(|(known, _)| *known == channel) {
                        return None;
                    }
                    let (values, places) = reader.numbers(room)?;
                    body.columns.push((channel, values));
                    places.into_iter().for_each(|places| body.places.note(Some(channel), places));
                }
            }
            // A column that was read is as long as the next: room for it was made with bytes that did come.
            room = body.columns.first().map_or(room, |(_, values)| values.len().max(FIRST_ROOM));
            Some(())
        })?;
        Some(body)
    }

    fn object(&mut self, mut field: impl FnMut(&mut Self, &'a str) -> Option<()>) -> Option<()> {
        self.token(b'{')?;
        self.skip_space();
        if self.peek()? == b'}' {
            self.at += 1;
            return Some(());
        }
        loop {
            self.skip_space();
            let name = self.string()?;
            self.token(b':')?;
            self.skip_space();
            field(self, name)?;
            self.skip_space();
            match self.next()? {
                b',' => {}
                b'}' => return Some(()),
                _ => return None,
            }
        }
    }

    /// The numbers of an array, and the most places behind the point that any of them has.
    fn numbers(&mut self, room: usize) -> Option<(Vec<f64>, Option<u8>)> {
        self.token(b'[')?;
        self.skip_space();
        let mut values = Vec::with_capacity(room);
        if self.peek()? == b']' {
            self.at += 1;
            return Some((values, None));
        }
        let (mut spaced, mut all_places) = (false, 0_u32);
        loop {
            let rest = self.json.get(self.at..)?;
            let (rest, places) = if spaced {
                short::run::<true>(rest, &mut values)
            } else {
                short::run::<false>(rest, &mut values)
            };
            all_places |= places;
            self.at = self.json.len() - rest.len();
            self.skip_space();
            let (value, length, places) = self.any_number()?;
            values.push(value);
            all_places |= places;
            self.at += length;
            self.skip_space();
            match self.next()? {
                b',' => {}
                b']' => {
                    return Some((
                        values,
                        all_places.checked_ilog2().and_then(|most| u8::try_from(most).ok()),
                    ));
                }
                _ => return None,
            }
            spaced = self.peek()? == b' ';
            self.skip_space();
        }
    }

    /// A number, its length, and 1 shifted by its places. What follows it is looked at by the caller.
    #[inline(never)]
    fn any_number(&self) -> Option<(f64, usize, u32)> {
        let rest = self.json.get(self.at..)?;
        let (negative, text) = rest.strip_prefix(b"-").map_or((false, rest), |behind| (true, behind));
        if let Some((value, length, _, places)) = short::reached(text).and_then(short::number) {
            return Some(if negative { (-value, length + 1, places) } else { (value, length, places) });
        }
        let mut reader = Reader { json: rest, at: 0 };
        let (value, places) = reader.number()?;
        Some((value, reader.at, 1 << places))
    }

    /// A number without exponent, and its places. What follows it is looked at by the caller.
    fn number(&mut self) -> Option<(f64, usize)> {
        let negative = self.peek()? == b'-';
        let begin = self.at + usize::from(negative);
        let (mut mantissa, mut at) = digits(self.json, begin, 0);
        let whole = at - begin;
        if whole == 0 || whole > 1 && self.json[begin] == b'0' {
            return None;
        }
        let mut places = 0;
        if self.json.get(at) == Some(&b'.') {
            let point = at;
            (mantissa, at) = digits(self.json, point + 1, mantissa);
            places = at - point - 1;
            if places == 0 {
                return None;
            }
        }
        if whole + places > MOST_DIGITS || matches!(self.json.get(at), Some(b'e' | b'E')) {
            return None;
        }
        self.at = at;
        #[expect(clippy::cast_precision_loss, reason = "below 10^15")]
        let mantissa = mantissa as f64;
        let value = if places == 0 { mantissa } else { mantissa / POWERS[places] };
        Some((if negative { -value } else { value }, places))
    }

    /// A whole number that is not negative.
    fn count(&mut self) -> Option<u64> {
        let begin = self.at;
        let (value, at) = digits(self.json, begin, 0);
        let length = at - begin;
        let plain = (1..=MOST_DIGITS).contains(&length) && (length == 1 || self.json[begin] != b'0');
        if !plain || matches!(self.json.get(at), Some(b'.' | b'e' | b'E')) {
            return None;
        }
        self.at = at;
        Some(value)
    }

    fn text(&mut self) -> Option<String> {
        self.string().map(str::to_owned)
    }

    /// A string of printable ASCII without escapes.
    fn string(&mut self) -> Option<&'a str> {
        self.token(b'"')?;
        let rest = self.json.get(self.at..)?;
        let length =
            rest.iter().position(|byte| !matches!(byte, b' '..=b'~') || matches!(byte, b'"' | b'\\'))?;
        if rest[length] != b'"' {
            return None;
        }
        self.at += length + 1;
        std::str::from_utf8(&rest[..length]).ok()
    }

    /// Skips space and takes that byte.
    fn token(&mut self, wanted: u8) -> Option<()> {
        self.skip_space();
        (self.next()? == wanted).then_some(())
    }

    fn next(&mut self) -> Option<u8> {
        let byte = self.peek()?;
        self.at += 1;
        Some(byte)
    }

    fn peek(&self) -> Option<u8> {
        self.json.get(self.at).copied()
    }

    fn skip_space(&mut self) {
        while matches!(self.peek(), Some(b' ' | b'\n' | b'\t' | b'\r')) {
            self.at += 1;
        }
    }
}

/// Appends the digits from `at` on to `value`; returns it with the place after them. More digits than fit wrap around:
/// the caller counts them.
fn digits(json: &[u8], mut at: usize, mut value: u64) -> (u64, usize) {
    while let Some(digit) = json.get(at).map(|byte| byte.wrapping_sub(b'0')).filter(|digit| *digit < 10) {
        value = value.wrapping_mul(10).wrapping_add(u64::from(digit));
        at += 1;
    }
    (value, at)
}

#[cfg(test)]
mod tests {
    use super::super::super::number::Numbers;
    use super::*;
    use feedwright_store::codec::Places;
    use proptest::prelude::*;

    /// The reader may refuse what serde takes, but what it takes serde takes too, to the bit.
    fn agrees(json: &[u8]) -> Result<bool, TestCaseError> {
        let Some(mut read) = read(json) else { return Ok(false) };
        // Serde does not tell them.
        read.samples.iter_mut().for_each(|samples| samples.places = Places::default());
        let expected = serde_json::from_slice::<Body>(json);
        let shown = expected.as_ref().map(|body| format!("{body:?}")).map_err(ToString::to_string);
        // Shown, because 0.0 == -0.0 and their text differs.
        prop_assert_eq!(Ok(format!("{read:?}")), shown, "{}", String::from_utf8_lossy(json));
        Ok(true)
    }

    fn number() -> impl Strategy<Value = String> {
        prop_oneof![
            8 => (-99_999_999_i64..99_999_999, 0_usize..6).prop_map(|(m, places)| {
                let scale = 10_i64.pow(u32::try_from(places).unwrap());
                #[expect(clippy::cast_precision_loss, reason = "small")]
                let value = m as f64 / scale as f64;
                format!("{value:.places$}")
            }),
            4 => "-?[0-9]{1,6}(\\.[0-9]{1,5})?",
            1 => any::<f64>().prop_map(|value| format!("{value}")),
            1 => any::<f64>().prop_map(|value| format!("{value:e}")),
            1 => "-?(0|[1-9][0-9]{0,20})(\\.[0-9]{1,20})?",
            1 => "[-+0-9.eE]{0,8}",
        ]
    }

    fn space() -> impl Strategy<Value = &'static str> {
        prop_oneof![6 => Just(""), 1 => Just(" "), 1 => Just("\n\t"), 1 => Just("\r")]
    }

    fn body() -> impl Strategy<Value = String> {
        let columns = prop::collection::vec(
            (
                prop::sample::select(vec![
                    "depth_mm",
                    "spindle_load_percent",
                    "time_ms",
                    "thrust_newtons",
                    "nothing",
                ]),
                prop::collection::vec(number(), 0..12),
            ),
            0..4,
        );
        let fields = prop::collection::vec(
            prop_oneof![
                number().prop_map(|n| format!(r#""seq":{n}"#)),
                number().prop_map(|n| format!(r#""spindle_speed_rpm":{n}"#)),
                "[a-zA-Z \\\\\"]{0,6}".prop_map(|text| format!(r#""process":"{text}""#)),
                Just(r#""strategy":null"#.to_owned()),
                Just(r#""outcome":"aborted""#.to_owned()),
                (number(), number())
                    .prop_map(|(a, b)| format!(r#""reported":{{"energy_joules":{a},"duration_ms":{b}}}"#)),
                number().prop_map(|n| format!(r#""profile":{{"id":"P1","version":{n}}}"#)),
                Just(r#""tool":"T2""#.to_owned()),
            ],
            0..4,
        );
        (columns, fields, number(), space()).prop_map(|(columns, fields, period, space)| {
            let mut out = format!(
                r#"{space}{{"cycle_id":{space}"c1"{space},"tool":"T1","operation":"O1","started_at":"2026-05-04T06:00:00Z""#
            );
            for field in &fields {
                out.push(',');
                out.push_str(space);
                out.push_str(field);
            }
            out.push_str(&format!(r#","samples":{{"period_ms":{period}"#));
            for (name, values) in &columns {
                out.push_str(&format!(r#",{space}"{name}":[{space}{}{space}]"#, values.join(&format!("{space},"))));
            }
            out.push_str(&format!("}}}}{space}"));
            out
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn bodies_are_read_as_serde_reads_them(json in body()) {
            agrees(json.as_bytes())?;
        }

        #[test]
        fn mutated_bodies_are_read_as_serde_reads_them(
            json in body(), cuts in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0_u8..4), 1..4)
        ) {
            let mut bytes = json.into_bytes();
            for (at, byte, how) in cuts {
                let at = at.index(bytes.len().max(1));
                match how {
                    0 => bytes.truncate(at),
                    1 => bytes.insert(at.min(bytes.len()), byte),
                    2 if at < bytes.len() => bytes[at] = b"{}[],:\"0.-e \\n"[usize::from(byte) % 14],
                    _ if at < bytes.len() => { bytes.remove(at); }
                    _ => {}
                }
            }
            agrees(&bytes)?;
        }

        #[test]
        fn numbers_have_the_bits_that_serde_gives_them(
            texts in prop::collection::vec(number(), 0..6), space in space(), behind in "[ ]{0,20}",
        ) {
            let json = format!("[{}]{behind}", texts.join(&format!("{space},{space}")));
            let mut reader = Reader { json: json.as_bytes(), at: 0 };
            let bits = |values: Vec<f64>| values.into_iter().map(f64::to_bits).collect::<Vec<_>>();
            if let Some((values, places)) = reader.numbers(0) {
                prop_assert_eq!(reader.at, json.trim_end().len());
                let Numbers(expected) = serde_json::from_str(&json).unwrap();
                prop_assert_eq!(bits(values), bits(expected.clone()), "{}", json);
                let behind = |text: &String| text.split_once('.').map_or(0, |(_, places)| places.len());
                // A text of nothing is no number: an array of it alone is an empty one.
                let most = texts.iter().map(behind).max().filter(|_| !expected.is_empty());
                prop_assert_eq!(places.map(usize::from), most);
            } else {
                let unusual = |text: &String| text.contains(['e', 'E', '+']) || text.len() > MOST_DIGITS;
                prop_assert!(texts.iter().any(unusual) || serde_json::from_str::<Numbers>(&json).is_err(), "{}", json);
            }
        }
    }

    #[test]
    fn the_usual_body_is_read_here() {
        let json = br#" {"cycle_id":"c1","tool":"T1","operation":"O1","started_at":"2026-05-04T06:00:00.250Z","seq":17,
            "strategy":"f_lin","spindle_speed_rpm":2500,"profile":{"id":"P","version":3},
            "samples":{"period_ms":10,"depth_mm":[-0.5, 0.125,12,-0],"spindle_load_percent":[4.1,12.7,0.0,99.99]},
            "reported":{"energy_joules":1234.5}} "#;
        assert!(agrees(json).unwrap());
        for unusual in [
            r#"{"cycle_id":"c\u0031"}"#,
            r#"{"cycle_id":"c1"}"#,
            "",
            "{",
            "[]",
            r#"{"cycle_id":"c1","tool":"T1","operation":"O1","started_at":"x","seq":null}"#,
        ] {
            assert!(!agrees(unusual.as_bytes()).unwrap(), "{unusual}");
        }
    }
}
