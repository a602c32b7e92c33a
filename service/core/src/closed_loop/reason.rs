//! Why an answer is what it is: the law's own reasons, and those of the loop around it.

use crate::friction::law;

/// The law's reasons are the lower half of the word.
const SHIFT: u32 = 32;

macro_rules! reasons {
    ($($(#[$doc:meta])* $name:ident = $bit:literal, $code:literal;)*) => {
        /// A reason of the loop; codes and bits are stable.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[repr(u8)]
        pub enum LoopReason {
            $($(#[$doc])* $name = $bit,)*
        }

        impl LoopReason {
            /// Every reason of the loop, in the order of their bits.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// The code as it appears in an answer.
            #[must_use]
            pub const fn code(self) -> &'static str {
                match self { $(Self::$name => $code,)* }
            }
        }
    };
}

reasons! {
    /// Samples are missing before this one.
    MissingSamples = 0, "missing_samples";
    /// A sample of this number with the same content was answered before; this is that answer.
    Repeated = 1, "repeated";
    /// A sample of this number came before with other content.
    RepeatDiffers = 2, "repeat_differs";
    /// A sample came after later ones; it is kept where one was missing.
    OutOfOrder = 3, "out_of_order";
    /// The sample is older than permitted.
    TooOld = 4, "too_old";
    /// The sample lies ahead of the time that has passed.
    FromFuture = 5, "from_future";
    /// The cycle has more samples than are kept.
    TooManySamples = 6, "too_many_samples";
    /// The cycle runs longer than permitted.
    CycleTooLong = 7, "cycle_too_long";
    /// Neither a feed profile nor a program was named.
    NoProgram = 8, "no_program";
    /// The feed profile is not the active version.
    ProfileNotActive = 9, "profile_not_active";
    /// The programmed feed that the machine reports is not that of the program.
    ProgramMismatch = 10, "program_mismatch";
    /// What a load in percent refers to is not declared.
    UnknownRating = 11, "unknown_rating";
    /// The operation declares no preferred load.
    NoSetLoad = 12, "no_set_load";
    /// The process has no law that closes a loop here.
    NoLaw = 13, "no_law";
    /// The tool is not registered.
    ToolUnregistered = 14, "tool_unregistered";
    /// The operation is not registered.
    OperationUnregistered = 15, "operation_unregistered";
    /// The tool is worn: the override may fall, not rise above 100 %.
    ToolWorn = 16, "tool_worn";
    /// The tool may be broken.
    BrokenSuspected = 17, "broken_suspected";
    /// What the tool cuts, or the tool, seems to have changed.
    ConditionsChanged = 18, "conditions_changed";
    /// The database does not answer.
    DatabaseUnavailable = 19, "database_unavailable";
    /// Whether another stream holds this machine is not known.
    LeaseUnknown = 20, "lease_unknown";
    /// A message could not be read.
    Malformed = 21, "malformed";
    /// The memory of this cycle began anew in its midst.
    Restarted = 22, "restarted";
    /// The plunge: the idle band of the feed drive is being learnt, so contact cannot be told yet.
    IdleUnknown = 23, "idle_unknown";
    /// The plunge: the operation lacks what a plunge feed needs, the drill bears none, or the loop is too slow: even the
    /// machine's slowest feed bites deeper than is permitted.
    NoPlungeFeed = 24, "no_plunge_feed";
    /// The plunge: the answer would come too late for the permitted bite at the full plunge feed.
    BiteLimited = 25, "bite_limited";
    /// Samples of the plunge were not usable.
    UnusableSample = 26, "unusable_sample";
    /// An earlier overload of this machine has not been acknowledged.
    OverloadUnacknowledged = 27, "overload_unacknowledged";
    /// The feed profile was made for another program, material, speed, depth or machine.
    ProfileMismatch = 28, "profile_mismatch";
    /// The tool is worn beyond what the feed profile was made for: the override may fall, not rise above 100 %.
    ProfileBeyondWear = 29, "profile_beyond_wear";
    /// The tool's wear is not known, and the feed profile holds only up to some: as beyond it.
    ProfileWearUnknown = 30, "profile_wear_unknown";
    /// Machine, operation, tool or feed profile were changed while the cycle ran.
    ChangedMeanwhile = 31, "changed_meanwhile";
}

impl LoopReason {
    const fn bit(self) -> u64 {
        1 << (SHIFT + self as u32)
    }
}

/// The set of reasons of one answer; a word, so that an answer allocates nothing.
///
/// Bits 0 to 31 are the law's in the order of [`law::Reason::ALL`], bits 32 to 63 the loop's by their numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LoopReasons(u64);

impl LoopReasons {
    /// No reason.
    pub const NONE: Self = Self(0);

    /// One reason.
    #[must_use]
    pub const fn of(reason: LoopReason) -> Self {
        Self(reason.bit())
    }

    /// One reason of the law.
    #[must_use]
    pub const fn of_law(reason: law::Reason) -> Self {
        Self(1 << reason as u32)
    }

    /// Adds a reason.
    pub const fn add(&mut self, reason: LoopReason) {
        self.0 |= reason.bit();
    }

    /// The set without a reason.
    #[must_use]
    pub const fn without(self, reason: LoopReason) -> Self {
        Self(self.0 & !reason.bit())
    }

    /// Both sets together.
    #[must_use]
    pub const fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Whether a reason of the loop is in the set.
    #[must_use]
    pub const fn contains(self, reason: LoopReason) -> bool {
        self.0 & reason.bit() != 0
    }

    /// Whether a reason of the law is in the set.
    #[must_use]
    pub const fn has_law(self, reason: law::Reason) -> bool {
        self.0 & (1 << reason as u32) != 0
    }

    /// Whether there is none.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The set of those bits, as they were stored; unknown ones have no code.
    #[must_use]
    pub const fn from_bits(bits: u64) -> Self {
        Self(bits)
    }

    /// The set as bits, as the binary encoding carries it.
    #[must_use]
    pub const fn bits(self) -> u64 {
        self.0
    }

    /// The codes, the loop's first.
    pub fn codes(self) -> impl Iterator<Item = &'static str> {
        let of_loop = places(self.0 >> SHIFT).filter_map(|bit| LoopReason::ALL.get(bit)).map(|r| r.code());
        let of_law = places(self.0 & ((1 << SHIFT) - 1)).filter_map(|bit| law::Reason::ALL.get(bit));
        of_loop.chain(of_law.map(|reason| reason.code()))
    }

    /// How good the data behind an answer with these reasons is.
    #[must_use]
    pub fn quality(self) -> Quality {
        use law::Reason as Law;
        let any = |of_loop: &[LoopReason], of_law: &[Law]| {
            of_loop.iter().any(|reason| self.contains(*reason))
                || of_law.iter().any(|reason| self.has_law(*reason))
        };
        if any(&[LoopReason::TooOld, LoopReason::FromFuture, LoopReason::OutOfOrder], &[]) {
            Quality::Stale
        } else if any(
            &[LoopReason::Malformed, LoopReason::UnusableSample],
            &[Law::MissingLoad, Law::NotFiniteLoad, Law::ImplausibleLoad, Law::UnknownDepth],
        ) {
            Quality::Missing
        } else if any(
            &[
                LoopReason::MissingSamples,
                LoopReason::RepeatDiffers,
                LoopReason::IdleUnknown,
                LoopReason::Restarted,
            ],
            &[Law::Gap, Law::Settling, Law::Heating],
        ) || (self.contains(LoopReason::BiteLimited) && self.contains(LoopReason::NoPlungeFeed))
        {
            // The last: a plunge whose answers come too late for the bite.
            Quality::Limited
        } else {
            Quality::Good
        }
    }
}

/// The places of the bits of a word, lowest first.
fn places(mut word: u64) -> impl Iterator<Item = usize> {
    core::iter::from_fn(move || {
        let place = word.trailing_zeros();
        // None is left where there are as many zeros as places.
        (word != 0).then(|| {
            word &= word - 1;
            place as usize
        })
    })
}

impl From<law::Reasons> for LoopReasons {
    fn from(reasons: law::Reasons) -> Self {
        Self(reasons.bits() as u64)
    }
}

/// How good the data behind an answer is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quality {
    /// Fresh and whole.
    Good,
    /// Usable, but the law may not raise on it yet.
    Limited,
    /// Not of now.
    Stale,
    /// Not there, or not usable.
    Missing,
}

impl Quality {
    /// The word used in answers.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Limited => "limited",
            Self::Stale => "stale",
            Self::Missing => "missing",
        }
    }
}
