//! The profile itself: knots, sections, limits, and the conditions in which it holds.
//!
//! Depths and feeds are whole thousandths (0.001 mm, 0.001 mm/min), the resolution that controls program in. Every
//! profile can therefore be written as a program and read back without a digit lost, and its hash is exact.

mod canonical;
mod check;
mod diff;
mod shape;
#[cfg(test)]
pub(crate) mod tests;

pub use canonical::{CANONICAL_FORMAT, ProfileHash};
pub(crate) use canonical::{Fields, parse_decimal};
pub use diff::{Change, KnotChange, ProfileDiff, SectionDiff, Setting, diff};
pub use shape::ramp_time_s;

use crate::friction::program::{Between, FeedProgram};
use crate::ids::OperationId;
use crate::invalid::Violation;

/// Most knots of a profile: as many as any program has that is simulated or told over the stream.
pub use crate::friction::program::MOST_KNOTS;
/// Most sections of a profile.
pub const MOST_SECTIONS: usize = 16;
/// Longest text of a condition or a tool type, in bytes.
pub const LONGEST_TEXT: usize = 200;

/// Depths, feeds, percents and levels as whole thousandths of their unit.
pub(crate) type Thousandths = u32;

/// What happens to the work over a stretch of depth (Stryczek & Błaszczak 2020, stages A to D).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum SectionKind {
    /// Contact and heating, at the tool maker's feed: stage A.
    Heating,
    /// The hole and its bushing are formed: stage B.
    Forming,
    /// The cylinder of a long tool travels without forming: stage C.
    IdleTravel,
    /// The collar forms the flange: stage D.
    Flange,
}

impl SectionKind {
    /// Every kind, in the order in which they follow each other.
    pub const ALL: [Self; 4] = [Self::Heating, Self::Forming, Self::IdleTravel, Self::Flange];

    /// The word used in the API, in storage and in exported files.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Heating => "heating",
            Self::Forming => "forming",
            Self::IdleTravel => "idle_travel",
            Self::Flange => "flange",
        }
    }

    /// The kind of that word.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.as_str() == text)
    }
}

/// A knot as it is given: depth below first contact, positive into the work, and the feed there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnotInput {
    /// Tip depth, mm.
    pub depth_mm: f64,
    /// Feed, mm/min.
    pub feed_mm_min: f64,
}

/// A section as it is given: it begins where the one before ends, the first one at first contact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SectionInput {
    /// What happens in it.
    pub kind: SectionKind,
    /// Depth at which it ends, mm; the last one's is the depth of the profile.
    pub to_mm: f64,
}

/// Limits that the profile keeps, and that its operation was planned with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LimitsInput {
    /// Slowest feed, mm/min, above 0.
    pub feed_min_mm_min: f64,
    /// Fastest feed, mm/min.
    pub feed_max_mm_min: f64,
    /// Largest acceleration along the path, mm/s². Checked at an override of 100 %; one of o % takes (o/100)² of it.
    pub acceleration_mm_s2: f64,
    /// Lowest override under which the profile may run, %, above 0 and at most 100.
    pub override_min_percent: f64,
    /// Highest override under which it may run, %, at least 100. That the axis follows every slope there is not checked.
    pub override_max_percent: f64,
    /// Set load L_set of the spindle drive, %.
    pub spindle_load_set_percent: Option<f64>,
    /// Set load L_set of the feed drive, %.
    pub feed_drive_load_set_percent: Option<f64>,
}

/// The tool wear for which a profile is meant, as the level of wear: energy of a hole over that of the new tool.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WearBandInput {
    /// Level from which it is meant; `None` for the new tool.
    pub from_level: Option<f64>,
    /// Level up to which it holds. Beyond, it must not be run.
    pub to_level: f64,
}

/// What has to be so for the profile to hold; what is not stated here is not asked.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Conditions<N> {
    /// NC program of the operation.
    pub program: Option<String>,
    /// Work material of the operation.
    pub work_material: Option<String>,
    /// Commanded spindle speed, rpm.
    pub spindle_speed_rpm: Option<N>,
}

/// A profile before it was checked: the same fields, nothing promised.
#[derive(Debug, Clone, PartialEq)]
pub struct ProfileInput {
    /// What is machined.
    pub operation: OperationId,
    /// Kind of tool, as [`crate::tool::Tool::tool_type`].
    pub tool_type: String,
    /// 2 to [`MOST_KNOTS`] knots from depth 0 to the end; the feed runs linearly in depth between them.
    pub knots: Vec<KnotInput>,
    /// 1 to [`MOST_SECTIONS`] sections that together cover the depth.
    pub sections: Vec<SectionInput>,
    /// Limits.
    pub limits: LimitsInput,
    /// Tool wear.
    pub wear: WearBandInput,
    /// Conditions.
    pub conditions: Conditions<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Knot {
    depth: Thousandths,
    feed: Thousandths,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Section {
    kind: SectionKind,
    to: Thousandths,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Limits {
    feed_min: Thousandths,
    feed_max: Thousandths,
    acceleration: Thousandths,
    override_min: Thousandths,
    override_max: Thousandths,
    spindle_load_set: Option<Thousandths>,
    feed_drive_load_set: Option<Thousandths>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct WearBand {
    from: Option<Thousandths>,
    to: Thousandths,
}

/// A feed profile that was checked: piecewise-linear feed over depth for one operation and tool type. Immutable.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Profile {
    operation: OperationId,
    tool_type: String,
    knots: Vec<Knot>,
    sections: Vec<Section>,
    limits: Limits,
    wear: WearBand,
    conditions: Conditions<Thousandths>,
}

/// Thousandths as the unit itself; exact to the last bit for whoever rounds back.
fn whole(thousandths: Thousandths) -> f64 {
    f64::from(thousandths) / 1000.0
}

impl Profile {
    /// Checks a profile. Values are rounded to thousandths first, so that what is checked is what is kept.
    ///
    /// # Errors
    /// With every violation: no depth at 0, depths that do not ascend, feeds outside the limits, an acceleration
    /// between two knots that the axis cannot reach, sections that leave a gap, limits that contradict each other.
    pub fn new(input: ProfileInput) -> Result<Self, Vec<Violation>> {
        check::profile(input)
    }

    /// What is machined.
    #[must_use]
    pub const fn operation(&self) -> &OperationId {
        &self.operation
    }

    /// Kind of tool.
    #[must_use]
    pub fn tool_type(&self) -> &str {
        &self.tool_type
    }

    /// The knots in order of depth.
    pub fn knots(&self) -> impl ExactSizeIterator<Item = KnotInput> + DoubleEndedIterator + '_ {
        self.knots.iter().map(|knot| KnotInput { depth_mm: whole(knot.depth), feed_mm_min: whole(knot.feed) })
    }

    /// The sections in order of depth.
    pub fn sections(&self) -> impl ExactSizeIterator<Item = SectionInput> + '_ {
        self.sections.iter().map(|section| SectionInput { kind: section.kind, to_mm: whole(section.to) })
    }

    /// Its limits.
    #[must_use]
    pub fn limits(&self) -> LimitsInput {
        let limits = &self.limits;
        LimitsInput {
            feed_min_mm_min: whole(limits.feed_min),
            feed_max_mm_min: whole(limits.feed_max),
            acceleration_mm_s2: whole(limits.acceleration),
            override_min_percent: whole(limits.override_min),
            override_max_percent: whole(limits.override_max),
            spindle_load_set_percent: limits.spindle_load_set.map(whole),
            feed_drive_load_set_percent: limits.feed_drive_load_set.map(whole),
        }
    }

    /// The wear for which it is meant.
    #[must_use]
    pub fn wear(&self) -> WearBandInput {
        WearBandInput { from_level: self.wear.from.map(whole), to_level: whole(self.wear.to) }
    }

    /// The conditions in which it holds.
    #[must_use]
    pub fn conditions(&self) -> Conditions<f64> {
        Conditions {
            program: self.conditions.program.clone(),
            work_material: self.conditions.work_material.clone(),
            spindle_speed_rpm: self.conditions.spindle_speed_rpm.map(whole),
        }
    }

    /// Everything as plain values, to change and check again.
    #[must_use]
    pub fn to_input(&self) -> ProfileInput {
        ProfileInput {
            operation: self.operation.clone(),
            tool_type: self.tool_type.clone(),
            knots: self.knots().collect(),
            sections: self.sections().collect(),
            limits: self.limits(),
            wear: self.wear(),
            conditions: self.conditions(),
        }
    }

    /// The same feeds as a program that the process model, the law and the what-if run.
    ///
    /// # Errors
    /// Never for a checked profile; the program's own ranges are wider.
    pub fn program(&self) -> Result<FeedProgram, crate::friction::error::Invalid> {
        let pairs: Vec<(f64, f64)> = self.knots().map(|knot| (knot.depth_mm, knot.feed_mm_min)).collect();
        FeedProgram::from_pairs(Between::Linear, &pairs)
    }
}
