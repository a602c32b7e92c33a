//! Time and small quantities that have a type of their own.
//!
//! Other quantities are plain `f64` whose name ends in the unit (`depth_mm`, `spindle_load_percent`).

use std::fmt;

/// A point in time: microseconds since 1970-01-01T00:00:00Z, never a clock read in this crate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Timestamp(i64);

impl Timestamp {
    /// From microseconds since the Unix epoch.
    pub const fn from_micros(micros: i64) -> Self {
        Self(micros)
    }

    /// Microseconds since the Unix epoch.
    pub const fn micros(self) -> i64 {
        self.0
    }

    /// This time plus `millis` milliseconds, saturating at the ends of the range.
    pub const fn plus_millis(self, millis: i64) -> Self {
        Self(self.0.saturating_add(millis.saturating_mul(1000)))
    }

    /// Milliseconds from `earlier` to this time; negative where `earlier` is later.
    pub const fn millis_since(self, earlier: Self) -> i64 {
        self.0.saturating_sub(earlier.0) / 1000
    }
}

impl fmt::Display for Timestamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} µs", self.0)
    }
}

/// What is done to the work: decides which control law and which recommendation applies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Process {
    /// Friction drilling (Stryczek & Błaszczak 2020).
    Friction,
    /// Conventional drilling.
    Drilling,
    /// Drilling with plunge-in control (Lengerov).
    Plunge,
    /// Rough turning (Alaskari & Oraby 2017).
    Turning,
    /// Vibratory drilling (Gouskov 2015, Ivanov 2024).
    Vibratory,
    /// Milling; kept and judged by energy, without a control law of its own.
    Milling,
}

impl Process {
    /// Every process, in the order of the enum.
    pub const ALL: [Self; 6] =
        [Self::Friction, Self::Drilling, Self::Plunge, Self::Turning, Self::Vibratory, Self::Milling];

    /// The word used in the API and in storage.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Friction => "friction",
            Self::Drilling => "drilling",
            Self::Plunge => "plunge",
            Self::Turning => "turning",
            Self::Vibratory => "vibratory",
            Self::Milling => "milling",
        }
    }

    /// The process of that word.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|process| process.as_str() == text)
    }
}

/// How the feed of a cycle was chosen (Stryczek & Błaszczak 2020, section 4).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Strategy {
    /// One feed for the whole cycle.
    FConst,
    /// Feed stepped by section, as tool makers advise.
    FSec,
    /// Feed piecewise linear in depth.
    FLin,
    /// [`Strategy::FLin`] times the override of the adaptive law.
    FAc,
}

impl Strategy {
    /// Every strategy, in the order of the enum.
    pub const ALL: [Self; 4] = [Self::FConst, Self::FSec, Self::FLin, Self::FAc];

    /// The word used in the API and in storage.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::FConst => "f_const",
            Self::FSec => "f_sec",
            Self::FLin => "f_lin",
            Self::FAc => "f_ac",
        }
    }

    /// The strategy of that word.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|strategy| strategy.as_str() == text)
    }
}
