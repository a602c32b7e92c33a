//! Why an override is what it is.

use crate::friction::feed_override::Clamp;

/// One reason behind a step's override; the codes are stable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Reason {
    /// The law is off while the material heats up.
    Heating,
    /// The load is below the preferred one: the law raises, within the limits.
    LoadBelowSet,
    /// The load is the preferred one: the override stays.
    LoadAtSet,
    /// The load is above the preferred one: the law lowers.
    LoadAboveSet,
    /// The rise was cut to the permitted points per sample.
    RiseLimited,
    /// After bad data the law may not raise yet.
    Settling,
    /// A load that the law needs was not there.
    MissingLoad,
    /// A load was not a finite number.
    NotFiniteLoad,
    /// A load was beyond anything a drive reports.
    ImplausibleLoad,
    /// The depth that ends the heating was not there or no number.
    UnknownDepth,
    /// The time was not a finite number, did not advance, or jumped.
    Gap,
    /// This sample is an overload.
    Overload,
    /// An earlier overload of this cycle still holds the override at neutral.
    OverloadHeld,
    /// The profile's lower limit acted.
    ClampedProfileMin,
    /// The profile's upper limit acted.
    ClampedProfileMax,
    /// The machine's lower limit acted.
    ClampedMachineMin,
    /// The machine's upper limit acted.
    ClampedMachineMax,
    /// The slowest feed of the machine or of the profile acted: the override may fall no further at this depth.
    ClampedFeedMin,
    /// The fastest feed of the machine or of the profile acted: the override may rise no further at this depth.
    ClampedFeedMax,
}

impl Reason {
    /// Every reason, in the order of their bits.
    pub const ALL: [Self; 19] = [
        Self::Heating,
        Self::LoadBelowSet,
        Self::LoadAtSet,
        Self::LoadAboveSet,
        Self::RiseLimited,
        Self::Settling,
        Self::MissingLoad,
        Self::NotFiniteLoad,
        Self::ImplausibleLoad,
        Self::UnknownDepth,
        Self::Gap,
        Self::Overload,
        Self::OverloadHeld,
        Self::ClampedProfileMin,
        Self::ClampedProfileMax,
        Self::ClampedMachineMin,
        Self::ClampedMachineMax,
        Self::ClampedFeedMin,
        Self::ClampedFeedMax,
    ];

    /// The code as it appears in an answer.
    #[must_use]
    pub const fn code(self) -> &'static str {
        match self {
            Self::Heating => "heating",
            Self::LoadBelowSet => "load_below_set",
            Self::LoadAtSet => "load_at_set",
            Self::LoadAboveSet => "load_above_set",
            Self::RiseLimited => "rise_limited",
            Self::Settling => "settling",
            Self::MissingLoad => "missing_load",
            Self::NotFiniteLoad => "not_finite_load",
            Self::ImplausibleLoad => "implausible_load",
            Self::UnknownDepth => "unknown_depth",
            Self::Gap => "gap",
            Self::Overload => "overload",
            Self::OverloadHeld => "overload_held",
            Self::ClampedProfileMin => "clamped_profile_min",
            Self::ClampedProfileMax => "clamped_profile_max",
            Self::ClampedMachineMin => "clamped_machine_min",
            Self::ClampedMachineMax => "clamped_machine_max",
            Self::ClampedFeedMin => "clamped_feed_min",
            Self::ClampedFeedMax => "clamped_feed_max",
        }
    }

    const fn bit(self) -> u32 {
        1 << self as u8
    }
}

impl From<Clamp> for Reason {
    fn from(clamp: Clamp) -> Self {
        match clamp {
            Clamp::ProfileMin => Self::ClampedProfileMin,
            Clamp::ProfileMax => Self::ClampedProfileMax,
            Clamp::MachineMin => Self::ClampedMachineMin,
            Clamp::MachineMax => Self::ClampedMachineMax,
            Clamp::NotFinite => Self::NotFiniteLoad,
        }
    }
}

/// The set of reasons of one step; a word, so that a step allocates nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Reasons(u32);

impl Reasons {
    /// Adds a reason.
    pub const fn add(&mut self, reason: Reason) {
        self.0 |= reason.bit();
    }

    /// Whether a reason is in the set.
    #[must_use]
    pub const fn contains(self, reason: Reason) -> bool {
        self.0 & reason.bit() != 0
    }

    /// The set as bits, in the order of [`Reason::ALL`] from the lowest.
    #[must_use]
    pub const fn bits(self) -> u32 {
        self.0
    }

    /// Whether there is none.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The reasons in the order of [`Reason::ALL`].
    pub fn iter(self) -> impl Iterator<Item = Reason> {
        Reason::ALL.into_iter().filter(move |reason| self.contains(*reason))
    }
}
