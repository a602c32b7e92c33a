//! A profile as a file for a control, and such a file read back.
//!
//! Every file begins with a comment: which version this is, its hash, its limits, its units, a warning. Whatever a person
//! entered is escaped there, so that no name can end a comment or begin a block. Numbers have a decimal point, always and
//! in every locale. What is read back is compared with the whole file written again: a file that was changed by hand is
//! refused with the line.
//!
//! One file per dialect. The spindle is not started here, nor is a tool called: who calls the file has the tool above the
//! hole at or above the clearance, its length compensated, Z0 at first contact and the spindle at its speed.

mod afc;
mod closed_loop;
mod comment;
mod csv;
mod law;
mod linear;
mod steps;
#[cfg(test)]
mod tests;

pub use closed_loop::{Mover, Run, closed_loop};
pub use law::{FitError, OverridePolynomial};
pub use steps::{FeedStep, MOST_STEPS, steps};

use super::profile::{Profile, ProfileHash};
use crate::cycle::ProfileVersion;
use crate::invalid::{Range, Violation};
use crate::machine::FeedLimits;

/// Longest file that is read back, bytes: several times the longest that is written.
pub const LONGEST_FILE: usize = 1 << 20;

/// Heights above first contact to which a file rapids.
const CLEARANCE_RANGE: Range = Range::new(0.1, 100.0, "mm");
/// Feed errors of stepped blocks, as a part of the feed.
const FEED_ERROR_RANGE: Range = Range::new(0.001, 0.1, "of the feed");
/// Intensities b of the law.
const INTENSITY_RANGE: Range = Range::new(0.01, 100.0, "");

/// A kind of file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Dialect {
    /// SINUMERIK: blocks under `FLIN`.
    Sinumerik,
    /// TwinCAT NC I: blocks under `FLIN`.
    TwincatNci,
    /// TwinCAT CNC: `G193` in every block.
    TwincatCnc,
    /// LinuxCNC: short blocks with stepped feeds.
    Linuxcnc,
    /// FANUC: short blocks with stepped feeds.
    Fanuc,
    /// Heidenhain: a row of AFC.TAB; it holds no path profile.
    HeidenhainAfc,
    /// A list of knots.
    Csv,
}

impl Dialect {
    /// Every dialect, in the order of the enum.
    pub const ALL: [Self; 7] = [
        Self::Sinumerik,
        Self::TwincatNci,
        Self::TwincatCnc,
        Self::Linuxcnc,
        Self::Fanuc,
        Self::HeidenhainAfc,
        Self::Csv,
    ];

    /// The word used in the API and in files.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Sinumerik => "sinumerik",
            Self::TwincatNci => "twincat_nci",
            Self::TwincatCnc => "twincat_cnc",
            Self::Linuxcnc => "linuxcnc",
            Self::Fanuc => "fanuc",
            Self::HeidenhainAfc => "heidenhain_afc",
            Self::Csv => "csv",
        }
    }

    /// The dialect of that word.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|dialect| dialect.as_str() == text)
    }

    /// How its files are called.
    #[must_use]
    pub const fn extension(self) -> &'static str {
        match self {
            Self::Sinumerik => "spf",
            Self::TwincatNci | Self::TwincatCnc => "nc",
            Self::Linuxcnc => "ngc",
            Self::Fanuc => "txt",
            Self::HeidenhainAfc => "tab.txt",
            Self::Csv => "csv",
        }
    }

    /// Whether the feed is stepped, so that a feed error has to be given.
    #[must_use]
    pub const fn is_stepped(self) -> bool {
        matches!(self, Self::Linuxcnc | Self::Fanuc)
    }
}

/// The override law in the control, for [`Dialect::Sinumerik`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LawInControl {
    /// Intensity b of the law whose shape is fitted (Stryczek & Błaszczak 2020, Eq. 3).
    pub intensity: f64,
    /// Highest override, %: never above the profile's own limit.
    pub override_max_percent: f64,
}

/// How a file is written.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExportOptions {
    /// Height above first contact to which it rapids, mm.
    pub clearance_mm: f64,
    /// Largest error of a stepped feed, as a part of the profile's feed.
    pub feed_error: f64,
    /// The override law in the control, where it can hold one.
    pub law: Option<LawInControl>,
    /// Limits of the machine that it is for; a profile that leaves them is refused. The file states them where it moves the
    /// override, which is then kept within them too.
    pub machine: Option<FeedLimits>,
}

impl Default for ExportOptions {
    fn default() -> Self {
        Self { clearance_mm: 1.0, feed_error: 0.01, law: None, machine: None }
    }
}

/// Which version a file holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stamp {
    /// Which.
    pub version: ProfileVersion,
    /// Hash of its content.
    pub hash: ProfileHash,
}

/// A file that was read back: it is what is written for this version, to the letter.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadBack {
    /// Its kind.
    pub dialect: Dialect,
    /// Which version it holds.
    pub stamp: Stamp,
    /// How it was written.
    pub options: ExportOptions,
    /// The profile.
    pub profile: Profile,
}

/// Options in whole thousandths, so that a file that states them can be written again.
fn rounded(
    dialect: Dialect,
    profile: &Profile,
    options: &ExportOptions,
) -> Result<ExportOptions, Vec<Violation>> {
    let mut wrong = Vec::new();
    let mut number = |path: &str, range: &Range, value: f64| {
        let value = if value.is_finite() { (value * 1000.0).round() / 1000.0 } else { value };
        range.collect(path, value, &mut wrong).unwrap_or(value)
    };
    let clearance_mm = number("clearance_mm", &CLEARANCE_RANGE, options.clearance_mm);
    let feed_error = number("feed_error", &FEED_ERROR_RANGE, options.feed_error);
    let law = options.law.map(|law| LawInControl {
        intensity: number("law.intensity", &INTENSITY_RANGE, law.intensity),
        override_max_percent: number(
            "law.override_max_percent",
            &Range::new(100.0, profile.limits().override_max_percent.min(law::HIGHEST_PERCENT), "%"),
            law.override_max_percent,
        ),
    });
    if law.is_some() && dialect != Dialect::Sinumerik {
        let why = "only sinumerik files can hold the override law";
        wrong.push(Violation::new("law", "not_in_this_dialect", why));
    }
    if law.is_some()
        && (profile.limits().spindle_load_set_percent, profile.limits().feed_drive_load_set_percent)
            == (None, None)
    {
        wrong.push(Violation::new(
            "law",
            "no_set_load",
            "the profile states no set load: there is no law to hold",
        ));
    }
    if law.is_some() && law::begins_mm(profile) >= profile.end_depth_mm() {
        let why = "the profile is heating to its end: the law begins behind the heating, and nothing is left for it to act on";
        wrong.push(Violation::new("law", "heating_only", why));
    }
    let machine = options.machine.and_then(|machine| {
        let within = within(profile, &machine).map_err(|one| wrong.push(one));
        let inwards = inwards(&machine).map_err(|one| wrong.push(one));
        within.and(inwards).ok()
    });
    // Other files leave the override alone: what they hold is the same on every machine.
    let machine = machine.filter(|_| law.is_some() || dialect == Dialect::HeidenhainAfc);
    if wrong.is_empty() { Ok(ExportOptions { clearance_mm, feed_error, law, machine }) } else { Err(wrong) }
}

/// Refuses a profile with feeds that the machine does not run.
///
/// # Errors
/// `outside_machine`, at `machine`.
pub fn within(profile: &Profile, machine: &FeedLimits) -> Result<(), Violation> {
    let (slowest, fastest) = (profile.slowest_mm_min(), profile.fastest_mm_min());
    let (min, max) = (machine.min_mm_min(), machine.max_mm_min());
    if min <= slowest && fastest <= max {
        return Ok(());
    }
    let why = format!("runs {slowest} to {fastest} mm/min, the machine {min} to {max} mm/min");
    Err(Violation::new("machine", "outside_machine", why))
}

/// Limits in whole thousandths, as a file states them, and never wider than they were.
fn inwards(machine: &FeedLimits) -> Result<FeedLimits, Violation> {
    let limits = FeedLimits::new(
        up(machine.min_mm_min()),
        down(machine.max_mm_min()),
        up(machine.override_min_percent()),
        down(machine.override_max_percent()),
    );
    limits
        .map_err(|_| Violation::new("machine", "outside_machine", "its limits leave no feed in thousandths"))
}

/// Part of a thousandth that counts as the thousandth itself: many of them are no binary number.
const SLACK: f64 = 1e-4;

fn up(value: f64) -> f64 {
    (value * 1000.0 - SLACK).ceil() / 1000.0
}

fn down(value: f64) -> f64 {
    (value * 1000.0 + SLACK).floor() / 1000.0
}

/// Overrides in percent that neither the profile nor the machine forbids, whole thousandths that contain 100 %.
///
/// Feed limits bound them too: the fastest feed of the profile may only be raised up to its own limit and to the machine's,
/// the slowest one only be lowered down to the machine's. Below its own least feed a profile may be slowed: whoever brakes
/// a jammed tool does not stop there.
fn override_range(profile: &Profile, machine: Option<&FeedLimits>) -> (f64, f64) {
    let limits = profile.limits();
    let raised = down(limits.feed_max_mm_min / profile.fastest_mm_min() * 100.0).max(100.0);
    let (low, high) = (limits.override_min_percent, limits.override_max_percent.min(raised));
    let Some(machine) = machine else { return (low, high) };
    let slowed = up(machine.min_mm_min() / profile.slowest_mm_min() * 100.0);
    let raised = down(machine.max_mm_min() / profile.fastest_mm_min() * 100.0);
    let low = low.max(machine.override_min_percent()).max(slowed);
    let high = high.min(machine.override_max_percent()).min(raised);
    // A profile that the machine can run has its own feed within both.
    (low.min(100.0), high.max(100.0))
}

/// Writes a profile as a file.
///
/// # Errors
/// With every option that is refused, `outside_machine` where the machine cannot run the feeds; `too_many_steps`,
/// `too_steep` or `feed_decimals` where stepped blocks cannot keep the feed error.
pub fn write(
    dialect: Dialect,
    profile: &Profile,
    stamp: &Stamp,
    options: &ExportOptions,
) -> Result<String, Vec<Violation>> {
    let options = rounded(dialect, profile, options)?;
    let mut out = comment::header(dialect, profile, stamp, &options);
    match dialect {
        Dialect::Sinumerik | Dialect::TwincatNci | Dialect::TwincatCnc => {
            linear::write(dialect, profile, &options, &mut out).map_err(|one| vec![one])?;
        }
        Dialect::Linuxcnc | Dialect::Fanuc => {
            steps::write(dialect, profile, &options, &mut out).map_err(|one| vec![one])?;
        }
        Dialect::HeidenhainAfc => afc::write(profile, stamp, &options, &mut out),
        Dialect::Csv => csv::write(profile, &mut out),
    }
    Ok(out)
}

/// Reads a file back: its profile, and proof that the file is what is written for it.
///
/// `hash` makes the hash of a content; this crate holds no hash function.
///
/// # Errors
/// With the line that is not what is written there, or what is wrong with the profile.
pub fn read(text: &str, hash: impl Fn(&Profile) -> ProfileHash) -> Result<ReadBack, Vec<Violation>> {
    if text.len() > LONGEST_FILE {
        let why = format!("has {} bytes, at most {LONGEST_FILE} are read", text.len());
        return Err(vec![Violation::new("text", "too_long", why)]);
    }
    // Whatever a transfer made of the line ends.
    let text = text.replace("\r\n", "\n");
    let mut found = comment::read(&text)?;
    let blocks = text.lines().enumerate().skip(found.lines).map(|(at, line)| (at + 1, line));
    match found.dialect {
        Dialect::Sinumerik | Dialect::TwincatNci | Dialect::TwincatCnc => {
            linear::knots(blocks, &mut found.fields).map_err(|one| vec![one])?;
        }
        Dialect::Csv => csv::knots(blocks, &mut found.fields).map_err(|one| vec![one])?,
        // Their knots stand in the comment: the blocks are checked against them below.
        Dialect::Linuxcnc | Dialect::Fanuc | Dialect::HeidenhainAfc => {}
    }
    let comment::Found { dialect, stamp, options, fields, .. } = found;
    let profile = fields.profile()?;
    if hash(&profile) != stamp.hash {
        let why = "the content is not what its hash stands for: the file was changed";
        return Err(vec![Violation::new("hash", "hash_mismatch", why)]);
    }
    let mut again = write(dialect, &profile, &stamp, &options)?;
    if dialect == Dialect::Fanuc {
        again = steps::with_its_start(again, &text);
    }
    let (mut is, mut meant) = (text.lines(), again.lines());
    let mut at = 0;
    loop {
        at += 1;
        match (is.next(), meant.next()) {
            (None, None) => return Ok(ReadBack { dialect, stamp, options, profile }),
            (is, meant) if is == meant => {}
            (_, meant) => {
                let why = match meant {
                    Some(meant) => format!("is not `{meant}`, which is written there: the file was changed"),
                    None => "stands after the end: the file was changed".to_owned(),
                };
                return Err(vec![Violation::new(format!("line {at}"), "changed", why)]);
            }
        }
    }
}

/// A length or feed with three decimals, as every control reads it.
fn decimal(value: f64) -> String {
    // Rust writes a point in every locale.
    format!("{:.3}", value + 0.0)
}
