//! Quality flags: what is unusual about a cycle that is stored all the same.

use std::fmt;

macro_rules! flags {
    ($($(#[$doc:meta])* $name:ident = $bit:literal, $word:literal;)*) => {
        /// One quality flag. Its bit is part of the stored format and never changes.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
        #[repr(u32)]
        pub enum Flag {
            $($(#[$doc])* $name = 1 << $bit,)*
        }

        impl Flag {
            /// Every flag, in the order of the bits.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// The word used in the API.
            pub const fn as_str(self) -> &'static str {
                match self { $(Self::$name => $word,)* }
            }
        }
    };
}

flags! {
    /// The actual feed was 0 for a time: a hold.
    FeedHold = 0, "feed_hold";
    /// The override was 0 for a time.
    OverrideZero = 1, "override_zero";
    /// A load was below zero: regeneration, or a sensor's offset.
    NegativeLoad = 2, "negative_load";
    /// A power was below zero: regeneration, or a sensor's offset.
    NegativePower = 3, "negative_power";
    /// The depth went back and forth.
    DepthReversal = 4, "depth_reversal";
    /// A load exceeded 400 %.
    LoadOver400 = 5, "load_over_400_percent";
    /// Samples are missing in between.
    Gaps = 6, "gaps";
    /// The machine says it was aborted.
    Aborted = 7, "aborted";
    /// It did not reach the operation's depth as that was on receipt, or was cut short.
    Incomplete = 8, "incomplete";
    /// It began before its tool was mounted, or before any machine of this kind existed.
    ClockSuspect = 9, "clock_suspect";
    /// Its tool was not registered when it arrived.
    ToolUnregistered = 10, "tool_unregistered";
    /// Its operation was not registered when it arrived.
    OperationUnregistered = 11, "operation_unregistered";
    /// No energy can be told: neither power nor a rating is known.
    NoEnergy = 12, "no_energy";
    /// A load lies beyond the range of the machine's fitted lines.
    BeyondCalibration = 13, "beyond_calibration";
    /// The control reports a length or depth, or calls a reference cycle, what its samples contradict; or it names another
    /// process than its operation's.
    Contradictory = 14, "contradictory";
    /// The machine says that it is a reference cycle.
    ReferenceCycle = 15, "reference_cycle";
    /// The machine says that it is no reference cycle, whatever advice it names.
    NoReferenceCycle = 16, "no_reference_cycle";
    /// The server kept only a part of it: it had more samples or lasted longer than is kept, or its end never came in.
    CutShort = 17, "cut_short";
    /// An energy of it is larger than any machine could have spent: it is not told on that basis.
    ImplausibleEnergy = 18, "implausible_energy";
}

/// A set of quality flags.
#[derive(Clone, Copy, PartialEq, Eq, Default)]
pub struct Flags(u32);

impl Flags {
    /// The empty set.
    pub const NONE: Self = Self(0);

    /// The set of those bits; unknown bits are dropped.
    pub fn from_bits(bits: u32) -> Self {
        Self(Flag::ALL.iter().fold(0, |known, &flag| known | (bits & flag as u32)))
    }

    /// The bits as they are stored.
    pub const fn bits(self) -> u32 {
        self.0
    }

    /// Adds `flag`.
    pub const fn insert(&mut self, flag: Flag) {
        self.0 |= flag as u32;
    }

    /// Adds `flag` where `holds`.
    pub const fn insert_if(&mut self, holds: bool, flag: Flag) {
        if holds {
            self.insert(flag);
        }
    }

    /// Whether `flag` is in the set.
    pub const fn contains(self, flag: Flag) -> bool {
        self.0 & flag as u32 != 0
    }

    /// The flags in the set.
    pub fn iter(self) -> impl Iterator<Item = Flag> {
        Flag::ALL.iter().copied().filter(move |&flag| self.contains(flag))
    }
}

impl fmt::Debug for Flags {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_set().entries(self.iter()).finish()
    }
}
