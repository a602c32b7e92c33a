//! Series over cycles: which measures, by what they are grouped, buckets, and what is collected in them.
//!
//! Bounded by the constants below: an answer and the memory for it are small whatever the range holds. Energies of
//! different bases, and with idle power in or out, are different series. HTTP does not belong here.

mod collect;
mod levels;

pub use collect::{Bucketed, LastCycles, Series, bucketed};

use feedwright_core::invalid::Violation;
use feedwright_core::summary::IdlePower;
use feedwright_store::{CyclePoint, PointEnergy};

/// Most buckets of one question: more than a screen has columns.
pub const MAX_BUCKETS: usize = 10_000;
/// Most buckets of all series of one answer.
pub const MAX_CELLS: usize = 100_000;
/// Most cycles that one question looks at.
pub const MAX_CYCLES: usize = 1_000_000;
/// Most cycles that are asked for one by one.
pub const MAX_LAST: u32 = 10_000;
/// Most tools whose wear is folded for one question.
pub const MAX_TOOLS: usize = 500;

macro_rules! measures {
    ($($(#[$doc:meta])* $name:ident, $word:literal, $unit:literal;)*) => {
        /// What is told of cycles.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
        pub enum Measure {
            $($(#[$doc])* $name,)*
        }

        impl Measure {
            /// Every measure, in the order of the enum.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// The word used in the API: the quantity with its unit last.
            pub const fn as_str(self) -> &'static str {
                match self { $(Self::$name => $word,)* }
            }

            /// Its unit in symbols.
            pub const fn unit(self) -> &'static str {
                match self { $(Self::$name => $unit,)* }
            }

            /// The measure of that word.
            pub fn parse(text: &str) -> Option<Self> {
                Self::ALL.iter().copied().find(|measure| measure.as_str() == text)
            }
        }
    };
}

measures! {
    /// Energy, a series per basis.
    Energy, "energy_joules", "J";
    /// Cycle time.
    Duration, "duration_ms", "ms";
    /// The tool's level of wear after the cycle: 1 is the new tool.
    WearLevel, "wear_level_ratio", "1";
    /// Largest spindle load.
    MaxSpindleLoad, "max_spindle_load_percent", "%";
    /// Largest feed-drive load.
    MaxFeedDriveLoad, "max_feed_drive_load_percent", "%";
    /// Largest spindle power.
    MaxSpindlePower, "max_spindle_power_watts", "W";
    /// Largest thrust.
    MaxThrust, "max_thrust_newtons", "N";
    /// Largest torque.
    MaxTorque, "max_torque_newton_metres", "N·m";
    /// Largest depth.
    MaxDepth, "max_depth_mm", "mm";
}

impl Measure {
    /// The measures that a list of words names, separated by commas.
    pub fn list(path: &str, text: &str) -> Result<Vec<Self>, Violation> {
        let mut measures = Vec::new();
        for word in text.split(',').map(str::trim) {
            let measure = Self::parse(word).ok_or_else(|| {
                let all: Vec<_> = Self::ALL.iter().map(|measure| measure.as_str()).collect();
                let message = format!("there is no measure `{word}`, must be among {}", all.join(", "));
                Violation::new(path, "unknown_measure", message)
            })?;
            if !measures.contains(&measure) {
                measures.push(measure);
            }
        }
        Ok(measures)
    }

    /// What it says of a cycle; energies and wear are told otherwise.
    fn of(self, point: &CyclePoint) -> Option<f64> {
        let peaks = point.peaks.as_deref()?;
        match self {
            Self::Energy | Self::WearLevel => None,
            Self::Duration => peaks.duration_ms,
            Self::MaxSpindleLoad => peaks.max_spindle_load_percent,
            Self::MaxFeedDriveLoad => peaks.max_feed_drive_load_percent,
            Self::MaxSpindlePower => peaks.max_spindle_power_watts,
            Self::MaxThrust => peaks.max_thrust_newtons,
            Self::MaxTorque => peaks.max_torque_newton_metres,
            Self::MaxDepth => peaks.max_depth_mm,
        }
    }
}

/// By what cycles are put together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GroupBy {
    /// All of them.
    Fleet,
    /// By machine.
    Machine,
    /// By tool.
    Tool,
    /// By operation.
    Operation,
}

impl GroupBy {
    /// Every way, in the order of the enum.
    pub const ALL: [Self; 4] = [Self::Fleet, Self::Machine, Self::Tool, Self::Operation];

    /// The word used in the API.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Fleet => "fleet",
            Self::Machine => "machine",
            Self::Tool => "tool",
            Self::Operation => "operation",
        }
    }

    /// The way of that word.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|by| by.as_str() == text)
    }

    fn of<'a>(self, machine: &'a str, tool: &'a str, operation: &'a str) -> &'a str {
        match self {
            Self::Fleet => "",
            Self::Machine => machine,
            Self::Tool => tool,
            Self::Operation => operation,
        }
    }
}

/// What tells series apart.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct SeriesKey {
    /// What it tells.
    pub measure: Measure,
    /// For an energy its basis and what was done about idle power.
    pub basis: Option<(&'static str, &'static str)>,
    /// The machine, tool or operation; empty for the fleet.
    pub group: String,
}

impl SeriesKey {
    fn energy(energy: &PointEnergy, group: &str) -> Self {
        Self { measure: Measure::Energy, basis: Some(basis(energy)), group: group.to_owned() }
    }

    fn plain(measure: Measure, group: &str) -> Self {
        Self { measure, basis: None, group: group.to_owned() }
    }
}

/// What an energy rests on, and what was done about idle power.
const fn basis(energy: &PointEnergy) -> (&'static str, &'static str) {
    let idle = match energy.idle {
        IdlePower::NotApplicable => "not_applicable",
        IdlePower::Included => "included",
        IdlePower::Subtracted { .. } => "subtracted",
    };
    (energy.basis.as_str(), idle)
}

/// Width of a bucket in µs out of text as `500ms`, `30s`, `15m`, `1h`, `1d` or `2w`.
pub fn width_us(path: &str, text: &str) -> Result<i64, Violation> {
    let digits = text.bytes().take_while(u8::is_ascii_digit).count();
    let (count, unit) = text.split_at(digits);
    let unit_us = match unit {
        "ms" => 1_000,
        "s" => 1_000_000,
        "m" => 60_000_000,
        "h" => 3_600_000_000,
        "d" => 86_400_000_000,
        "w" => 7 * 86_400_000_000,
        _ => 0,
    };
    let width = count.parse::<i64>().ok().and_then(|count| count.checked_mul(unit_us));
    width.filter(|width| *width > 0).ok_or_else(|| {
        let message = format!("must be a number with ms, s, m, h, d or w, as in 15m or 1d, is `{text}`");
        Violation::new(path, "invalid_duration", message)
    })
}

/// One cycle's value in a series.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Value<'a> {
    /// Which cycle.
    pub point: &'a CyclePoint,
    /// The value.
    pub value: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn widths_are_read_as_grafana_writes_them() {
        for (text, us) in [
            ("500ms", 500_000),
            ("30s", 30_000_000),
            ("1m", 60_000_000),
            ("12h", 12 * 3_600_000_000),
            ("1d", 86_400_000_000),
            ("2w", 14 * 86_400_000_000),
        ] {
            assert_eq!(width_us("bucket", text), Ok(us), "{text}");
        }
        for text in
            ["", "0s", "h", "-1h", "1.5h", "1y", "99999999999999999999s", "9223372036854775807d", "1 h"]
        {
            assert_eq!(width_us("bucket", text).unwrap_err().code, "invalid_duration", "{text}");
        }
    }

    #[test]
    fn measures_and_groups_are_their_words() {
        for measure in Measure::ALL {
            assert_eq!(Measure::parse(measure.as_str()), Some(*measure));
        }
        for by in GroupBy::ALL {
            assert_eq!(GroupBy::parse(by.as_str()), Some(by));
        }
        let both = Measure::list("measures", "energy_joules, duration_ms,energy_joules").unwrap();
        assert_eq!(both, [Measure::Energy, Measure::Duration]);
        assert_eq!(Measure::list("measures", "").unwrap_err().code, "unknown_measure");
    }
}
