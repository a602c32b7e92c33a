//! The comment at the head of a file: what it is, its limits and units, a warning; and back.

use super::{Dialect, ExportOptions, LawInControl, Stamp, decimal};
use crate::cycle::ProfileVersion;
use crate::feed::profile::{Fields, Profile, ProfileHash, parse_decimal};
use crate::ids::ProfileId;
use crate::invalid::Violation;
use crate::machine::FeedLimits;

/// First line; another one would be another format.
const FIRST: &str = "feedwright-export 1";
/// Last line.
const LAST: &str = "end";
/// Characters of a comment line: LinuxCNC reads lines of 255.
const LINE: usize = 100;

/// What begins and ends a comment.
const fn brackets(dialect: Dialect) -> (&'static str, &'static str) {
    match dialect {
        Dialect::Sinumerik | Dialect::HeidenhainAfc => ("; ", ""),
        Dialect::Csv => ("# ", ""),
        Dialect::TwincatNci | Dialect::TwincatCnc | Dialect::Linuxcnc | Dialect::Fanuc => ("(", ")"),
    }
}

/// What a person has to know; no word of it is read back.
fn notes(dialect: Dialect) -> Vec<&'static str> {
    let mut notes = vec![
        "warning: try it without a workpiece and with a low override first.",
        "the control's limits and the emergency stop stay the safety layer.",
        "do not edit: a changed file no longer has its hash. change the profile instead.",
        "units: mm, mm/min, percent of the machine's ratings.",
    ];
    if dialect == Dialect::HeidenhainAfc {
        notes
            .push("this row sets adaptive feed control, it holds no feed over depth: program that yourself.");
        notes.push("enter the row into afc.tab. it limits by spindle power alone, in percent of the programmed feed.");
        return notes;
    }
    notes.push("depth d below first contact is z = -d, z0 is first contact. absolute, feed per minute.");
    if dialect != Dialect::Csv {
        notes.push(
            "the caller has the tool above the hole at or above the clearance, its length compensated,",
        );
        notes.push("the work offset active and the spindle at its speed: none of it is done here.");
    }
    match dialect {
        Dialect::Sinumerik => notes.push("subprogram. no exact stop may be active: g64 is set here."),
        Dialect::TwincatNci => notes.push("program. the feed is in mm/min by the channel's setting."),
        Dialect::TwincatCnc => notes.push("subprogram. g193 needs the linear slope, which is set here."),
        Dialect::Linuxcnc => notes.push("program. ends with m2."),
        Dialect::Fanuc => notes.push("subprogram body: give it its o number. ends with m99."),
        Dialect::HeidenhainAfc | Dialect::Csv => {}
    }
    notes
}

/// The lines of a header, as they are before they are made a comment.
fn lines(dialect: Dialect, profile: &Profile, stamp: &Stamp, options: &ExportOptions) -> Vec<String> {
    let mut lines = vec![
        FIRST.to_owned(),
        format!("dialect {}", dialect.as_str()),
        format!("profile {}", stamp.version.profile),
        format!("version {}", stamp.version.version),
        format!("hash {}", stamp.hash),
    ];
    lines.extend(notes(dialect).into_iter().map(|note| format!("! {note}")));
    if !matches!(dialect, Dialect::HeidenhainAfc | Dialect::Csv) {
        lines.push(format!("clearance_mm {}", decimal(options.clearance_mm)));
    }
    if dialect.is_stepped() {
        lines.push(format!("feed_error {}", decimal(options.feed_error)));
    }
    if let Some(law) = options.law {
        lines.push(format!("law_intensity {}", decimal(law.intensity)));
        lines.push(format!("law_override_max_percent {}", decimal(law.override_max_percent)));
    }
    if let Some(machine) = options.machine {
        lines.push(format!("machine_feed_min_mm_min {}", decimal(machine.min_mm_min())));
        lines.push(format!("machine_feed_max_mm_min {}", decimal(machine.max_mm_min())));
        lines.push(format!("machine_override_min_percent {}", decimal(machine.override_min_percent())));
        lines.push(format!("machine_override_max_percent {}", decimal(machine.override_max_percent())));
    }
    lines.extend(profile.header().into_iter().map(|(name, value)| format!("{name} {value}")));
    if dialect.is_stepped() || dialect == Dialect::HeidenhainAfc {
        lines.extend(profile.knot_lines().into_iter().map(|(name, value)| format!("{name} {value}")));
    }
    lines.push(LAST.to_owned());
    lines
}

/// Writes the header as comment lines; longer ones go on after a `+`.
pub(super) fn header(dialect: Dialect, profile: &Profile, stamp: &Stamp, options: &ExportOptions) -> String {
    let (open, close) = brackets(dialect);
    let mut out = String::new();
    for line in lines(dialect, profile, stamp, options) {
        let line = if dialect == Dialect::Fanuc { to_upper(&line) } else { line };
        let mut rest = line.as_str();
        let mut more = "";
        loop {
            // Every character is ASCII: ids by their grammar, texts by their escape.
            let (part, after) = rest.split_at(rest.len().min(LINE));
            out.extend([open, more, part, close, "\n"]);
            rest = after;
            more = "+ ";
            if rest.is_empty() {
                break;
            }
        }
    }
    out
}

/// FANUC's comments take capitals, and a colon is its program number: letters are raised, what was one is escaped.
fn to_upper(line: &str) -> String {
    if let Some(note) = line.strip_prefix("! ") {
        return format!("! {}", note.to_ascii_uppercase().replace(['\'', ':', '='], " "));
    }
    let mut out = String::with_capacity(line.len());
    let mut escape = 0;
    for letter in line.chars() {
        if letter == '=' {
            escape = 3;
        }
        match letter {
            _ if escape > 0 => {
                escape -= 1;
                out.push(letter);
            }
            'A'..='Z' | ':' => out.push_str(&format!("={:02X}", u32::from(letter))),
            _ => out.push(letter.to_ascii_uppercase()),
        }
    }
    out
}

/// The line back; `None` for a broken escape.
fn from_upper(line: &str) -> Option<String> {
    let mut out = String::with_capacity(line.len());
    let mut rest = line;
    while let Some(letter) = rest.chars().next() {
        if letter == '=' {
            let escape = rest.get(..3)?;
            let value = u8::from_str_radix(escape.get(1..)?, 16).ok()?;
            if value.is_ascii_uppercase() || value == b':' {
                out.push(char::from(value));
            } else {
                out.push_str(escape);
            }
            rest = rest.get(3..)?;
        } else {
            out.push(letter.to_ascii_lowercase());
            rest = rest.get(letter.len_utf8()..)?;
        }
    }
    Some(out)
}

/// What the header of a file says.
pub(super) struct Found {
    pub(super) dialect: Dialect,
    pub(super) stamp: Stamp,
    pub(super) options: ExportOptions,
    pub(super) fields: Fields,
    /// Lines of the file that it takes.
    pub(super) lines: usize,
}

/// Reads the header.
pub(super) fn read(text: &str) -> Result<Found, Vec<Violation>> {
    let bad = |at: usize, why: &str| vec![Violation::new(format!("line {at}"), "not_an_export", why)];
    let first = text.lines().next().unwrap_or_default();
    let style =
        [Dialect::Sinumerik, Dialect::Csv, Dialect::Linuxcnc, Dialect::Fanuc].into_iter().find(|style| {
            let meant = if *style == Dialect::Fanuc { to_upper(FIRST) } else { FIRST.to_owned() };
            inner(*style, first) == Some(meant.as_str())
        });
    let style = style.ok_or_else(|| bad(1, "is not the first line of a file that was exported here"))?;
    let mut fields = Fields::default();
    let mut named: Vec<(String, String)> = Vec::new();
    let mut logical: Vec<(usize, String)> = Vec::new();
    let mut taken = 0;
    for (at, line) in text.lines().enumerate() {
        taken = at + 1;
        let part = inner(style, line).ok_or_else(|| bad(taken, "is no comment of the head"))?;
        match (part.strip_prefix("+ "), logical.last_mut()) {
            (Some(more), Some((_, line))) => line.push_str(more),
            _ => logical.push((taken, part.to_owned())),
        }
        let end = if style == Dialect::Fanuc { "END" } else { LAST };
        if part == end {
            break;
        }
    }
    for (at, line) in logical.into_iter().skip(1) {
        if line == LAST || line == "END" || line.starts_with("! ") {
            continue;
        }
        let line = if style == Dialect::Fanuc { from_upper(&line) } else { Some(line) };
        let line = line.ok_or_else(|| bad(at, "holds a broken escape"))?;
        let (name, value) = line.split_once(' ').ok_or_else(|| bad(at, "is no field"))?;
        match name {
            "knot" => fields.knot(value).map_err(|why| bad(at, &why))?,
            "dialect"
            | "profile"
            | "version"
            | "hash"
            | "clearance_mm"
            | "feed_error"
            | "law_intensity"
            | "law_override_max_percent"
            | "machine_feed_min_mm_min"
            | "machine_feed_max_mm_min"
            | "machine_override_min_percent"
            | "machine_override_max_percent" => named.push((name.to_owned(), value.to_owned())),
            _ => fields.take(name, value).map_err(|why| bad(at, &why))?,
        }
    }
    let get = |name: &str| named.iter().find(|(known, _)| known == name).map(|(_, value)| value.as_str());
    let missing =
        |name: &str| vec![Violation::new(name, "not_an_export", "is missing in the head or is none")];
    let number = |name: &'static str, otherwise: f64| match get(name) {
        None => Ok(otherwise),
        Some(text) => parse_decimal(text).ok_or_else(|| missing(name)),
    };
    let usual = ExportOptions::default();
    let law = match get("law_intensity") {
        None => None,
        Some(_) => Some(LawInControl {
            intensity: number("law_intensity", 0.0)?,
            override_max_percent: number("law_override_max_percent", 100.0)?,
        }),
    };
    let machine = match get("machine_feed_max_mm_min") {
        None => None,
        Some(_) => {
            let stated = |name: &'static str| get(name).and_then(parse_decimal).ok_or_else(|| missing(name));
            Some(FeedLimits::new(
                stated("machine_feed_min_mm_min")?,
                stated("machine_feed_max_mm_min")?,
                stated("machine_override_min_percent")?,
                stated("machine_override_max_percent")?,
            )?)
        }
    };
    Ok(Found {
        dialect: get("dialect").and_then(Dialect::parse).ok_or_else(|| missing("dialect"))?,
        stamp: Stamp {
            version: ProfileVersion {
                profile: get("profile")
                    .and_then(|text| ProfileId::try_from(text).ok())
                    .ok_or_else(|| missing("profile"))?,
                version: get("version")
                    .and_then(|text| text.parse().ok())
                    .ok_or_else(|| missing("version"))?,
            },
            hash: get("hash").and_then(ProfileHash::parse).ok_or_else(|| missing("hash"))?,
        },
        options: ExportOptions {
            clearance_mm: number("clearance_mm", usual.clearance_mm)?,
            feed_error: number("feed_error", usual.feed_error)?,
            law,
            machine,
        },
        fields,
        lines: taken,
    })
}

fn inner(style: Dialect, line: &str) -> Option<&str> {
    let (open, close) = brackets(style);
    line.strip_prefix(open)?.strip_suffix(close)
}
