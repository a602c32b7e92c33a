//! One text for one content: what is hashed, and what an exported file carries.
//!
//! The text holds everything that decides what a control runs and when the profile holds, and nothing else: the same
//! feeds drafted twice are the same content, whoever drafted them and whatever they are called.

use super::{
    Conditions, Knot, KnotInput, LimitsInput, Profile, ProfileInput, SectionInput, SectionKind, Thousandths,
    WearBandInput,
};
use crate::ids::OperationId;
use crate::invalid::Violation;
use std::fmt;
use std::fmt::Write as _;

/// First line of the text; another one would be another format.
pub const CANONICAL_FORMAT: &str = "feedwright-feed-profile 1";

/// 256-bit hash of a profile's canonical text. It is made where a hash function is at hand, not in this crate.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ProfileHash([u8; 32]);

impl ProfileHash {
    /// Wraps the bytes of a hash.
    #[must_use]
    pub const fn from_bytes(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// Its bytes.
    #[must_use]
    pub const fn bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// The hash of 64 lower-case hexadecimal digits.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let digits = text.as_bytes();
        let mut bytes = [0; 32];
        if digits.len() != 64 {
            return None;
        }
        let value = |digit: u8| match digit {
            b'0'..=b'9' => Some(digit - b'0'),
            b'a'..=b'f' => Some(digit - b'a' + 10),
            _ => None,
        };
        for (byte, pair) in bytes.iter_mut().zip(digits.chunks_exact(2)) {
            *byte = value(pair[0])? << 4 | value(pair[1])?;
        }
        Some(Self(bytes))
    }
}

impl fmt::Display for ProfileHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for ProfileHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ProfileHash({self})")
    }
}

/// Characters that stand for themselves in any control's comment: no bracket, no percent sign, no semicolon, no line
/// end can come out of a text that passed through here.
fn stands_for_itself(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'_' | b':' | b'+' | b'-' | b'/' | b',')
}

/// A text in which every other byte is `=` and two upper-case hexadecimal digits.
pub(crate) fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for byte in text.bytes() {
        if stands_for_itself(byte) {
            out.push(char::from(byte));
        } else {
            // Writing to a String cannot fail.
            let _ = write!(out, "={byte:02X}");
        }
    }
    out
}

/// The text back; `None` where it was not made by [`escaped`].
pub(crate) fn unescaped(text: &str) -> Option<String> {
    let bytes = text.as_bytes();
    let mut out = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while at < bytes.len() {
        if bytes[at] == b'=' {
            let pair = text.get(at + 1..at + 3)?;
            if !pair.bytes().all(|digit| matches!(digit, b'0'..=b'9' | b'A'..=b'F')) {
                return None;
            }
            let byte = u8::from_str_radix(pair, 16).ok()?;
            if stands_for_itself(byte) {
                return None;
            }
            out.push(byte);
            at += 3;
        } else if stands_for_itself(bytes[at]) {
            out.push(bytes[at]);
            at += 1;
        } else {
            return None;
        }
    }
    String::from_utf8(out).ok()
}

/// Thousandths as a decimal with three places: `12.500`.
pub(crate) fn decimal(value: Thousandths) -> String {
    format!("{}.{:03}", value / 1000, value % 1000)
}

/// A decimal with three places, and nothing else.
pub(crate) fn parse_decimal(text: &str) -> Option<f64> {
    let (units, places) = text.split_once('.')?;
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    (digits(units) && digits(places) && places.len() == 3 && units.len() <= 7).then(|| text.parse().ok())?
}

const NOT_STATED: &str = "-";

impl Profile {
    /// Everything but the knots, as (name, value) lines in their order.
    #[must_use]
    pub(crate) fn header(&self) -> Vec<(&'static str, String)> {
        let optional = |value: Option<Thousandths>| value.map_or_else(|| NOT_STATED.to_owned(), decimal);
        // A text of one hyphen would read as none.
        let text = |value: &Option<String>| match value.as_deref() {
            None => NOT_STATED.to_owned(),
            Some("-") => "=2D".to_owned(),
            Some(text) => escaped(text),
        };
        let Self { limits, wear, conditions, .. } = self;
        let mut lines = vec![
            ("operation", self.operation.to_string()),
            ("tool_type", escaped(&self.tool_type)),
            ("program", text(&conditions.program)),
            ("work_material", text(&conditions.work_material)),
            ("spindle_speed_rpm", optional(conditions.spindle_speed_rpm)),
            ("feed_min_mm_min", decimal(limits.feed_min)),
            ("feed_max_mm_min", decimal(limits.feed_max)),
            ("acceleration_mm_s2", decimal(limits.acceleration)),
            ("override_min_percent", decimal(limits.override_min)),
            ("override_max_percent", decimal(limits.override_max)),
            ("spindle_load_set_percent", optional(limits.spindle_load_set)),
            ("feed_drive_load_set_percent", optional(limits.feed_drive_load_set)),
            ("wear_from_level", optional(wear.from)),
            ("wear_to_level", decimal(wear.to)),
        ];
        let section = |section: &super::Section| {
            ("section", format!("{} {}", section.kind.as_str(), decimal(section.to)))
        };
        lines.extend(self.sections.iter().map(section));
        lines
    }

    /// The knots as lines, `depth feed`.
    #[must_use]
    pub(crate) fn knot_lines(&self) -> Vec<(&'static str, String)> {
        let line = |knot: &Knot| ("knot", format!("{} {}", decimal(knot.depth), decimal(knot.feed)));
        self.knots.iter().map(line).collect()
    }

    /// The one text of this content: UTF-8, a line per field, decimals with three places.
    #[must_use]
    pub fn canonical(&self) -> String {
        let mut text = String::from(CANONICAL_FORMAT);
        text.push('\n');
        for (name, value) in self.header().into_iter().chain(self.knot_lines()) {
            let _ = writeln!(text, "{name} {value}");
        }
        text
    }

    /// A profile out of its canonical text.
    ///
    /// # Errors
    /// With the line that is not what [`Profile::canonical`] writes, or as [`Profile::new`].
    pub fn from_canonical(text: &str) -> Result<Self, Vec<Violation>> {
        let mut lines = text.lines();
        if lines.next() != Some(CANONICAL_FORMAT) {
            let message = format!("must begin with `{CANONICAL_FORMAT}`");
            return Err(vec![Violation::new("line 1", "unknown_format", message)]);
        }
        let mut fields = Fields::default();
        for (at, line) in lines.enumerate() {
            let (name, value) = line.split_once(' ').unwrap_or((line, ""));
            let taken = match name {
                "knot" => fields.knot(value),
                _ => fields.take(name, value),
            };
            taken.map_err(|why| vec![Violation::new(format!("line {}", at + 2), "not_canonical", why)])?;
        }
        let profile = fields.profile()?;
        // Order, repetition and rounding: whatever is not the one text of this content is refused.
        if profile.canonical() != text {
            let message = "is not the canonical text of its content";
            return Err(vec![Violation::new("text", "not_canonical", message)]);
        }
        Ok(profile)
    }
}

/// What was read of a profile so far: lines of the canonical text, in a file or in comments.
#[derive(Debug, Clone, Default)]
pub(crate) struct Fields {
    named: Vec<(String, String)>,
    sections: Vec<SectionInput>,
    /// Knots, from lines or from a program's blocks.
    pub(crate) knots: Vec<KnotInput>,
}

impl Fields {
    /// Takes a line that is no knot.
    pub(crate) fn take(&mut self, name: &str, value: &str) -> Result<(), String> {
        if name == "section" {
            let read = value.split_once(' ').and_then(|(kind, to)| {
                Some(SectionInput { kind: SectionKind::parse(kind)?, to_mm: parse_decimal(to)? })
            });
            self.sections.push(read.ok_or("a section is a kind and the depth at which it ends")?);
            if self.sections.len() > super::MOST_SECTIONS {
                return Err("too many sections".to_owned());
            }
            return Ok(());
        }
        if !NAMES.contains(&name) {
            return Err(format!("`{}` is no field of a profile", escaped(name)));
        }
        if self.named.iter().any(|(known, _)| known == name) {
            return Err(format!("{name} stands twice"));
        }
        self.named.push((name.to_owned(), value.to_owned()));
        Ok(())
    }

    /// Takes a knot, `depth feed`.
    pub(crate) fn knot(&mut self, value: &str) -> Result<(), String> {
        let read = value
            .split_once(' ')
            .and_then(|(depth, feed)| Some((parse_decimal(depth)?, parse_decimal(feed)?)));
        let (depth_mm, feed_mm_min) = read.ok_or("a knot is a depth and a feed, each with three decimals")?;
        if self.knots.len() >= super::MOST_KNOTS {
            return Err("too many knots".to_owned());
        }
        self.knots.push(KnotInput { depth_mm, feed_mm_min });
        Ok(())
    }

    fn value(&self, name: &str) -> Result<&str, Vec<Violation>> {
        let found = self.named.iter().find(|(known, _)| known == name).map(|(_, value)| value.as_str());
        found.ok_or_else(|| vec![Violation::new(name, "missing", "is not there")])
    }

    fn number(&self, name: &str) -> Result<f64, Vec<Violation>> {
        parse_decimal(self.value(name)?)
            .ok_or_else(|| vec![Violation::new(name, "not_canonical", "must be a decimal with three places")])
    }

    fn optional(&self, name: &str) -> Result<Option<f64>, Vec<Violation>> {
        if self.value(name)? == NOT_STATED { Ok(None) } else { self.number(name).map(Some) }
    }

    fn text(&self, name: &str) -> Result<Option<String>, Vec<Violation>> {
        match self.value(name)? {
            NOT_STATED => Ok(None),
            "=2D" => Ok(Some("-".to_owned())),
            text => unescaped(text)
                .map(Some)
                .ok_or_else(|| vec![Violation::new(name, "not_canonical", "is not an escaped text")]),
        }
    }

    /// The profile, checked like any other.
    pub(crate) fn profile(self) -> Result<Profile, Vec<Violation>> {
        let operation = OperationId::parse("operation", self.value("operation")?).map_err(|one| vec![one])?;
        let tool_type = unescaped(self.value("tool_type")?)
            .ok_or_else(|| vec![Violation::new("tool_type", "not_canonical", "is not an escaped text")])?;
        let limits = LimitsInput {
            feed_min_mm_min: self.number("feed_min_mm_min")?,
            feed_max_mm_min: self.number("feed_max_mm_min")?,
            acceleration_mm_s2: self.number("acceleration_mm_s2")?,
            override_min_percent: self.number("override_min_percent")?,
            override_max_percent: self.number("override_max_percent")?,
            spindle_load_set_percent: self.optional("spindle_load_set_percent")?,
            feed_drive_load_set_percent: self.optional("feed_drive_load_set_percent")?,
        };
        let wear = WearBandInput {
            from_level: self.optional("wear_from_level")?,
            to_level: self.number("wear_to_level")?,
        };
        let conditions = Conditions {
            program: self.text("program")?,
            work_material: self.text("work_material")?,
            spindle_speed_rpm: self.optional("spindle_speed_rpm")?,
        };
        let Self { sections, knots, .. } = self;
        Profile::new(ProfileInput { operation, tool_type, knots, sections, limits, wear, conditions })
    }
}

/// Names of the lines that are neither section nor knot.
const NAMES: [&str; 14] = [
    "operation",
    "tool_type",
    "program",
    "work_material",
    "spindle_speed_rpm",
    "feed_min_mm_min",
    "feed_max_mm_min",
    "acceleration_mm_s2",
    "override_min_percent",
    "override_max_percent",
    "spindle_load_set_percent",
    "feed_drive_load_set_percent",
    "wear_from_level",
    "wear_to_level",
];
