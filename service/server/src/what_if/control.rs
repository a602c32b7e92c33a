//! The control that ran and the one that is asked about, and the core's answer.

use super::cycle::{ContactCycle, Unusable};
use super::relation::Learned;
use crate::http::dto::friction::control::{LawBody, ProgramBody};
use crate::http::dto::friction::refused;
use feedwright_core::closed_loop::control::{LawSettings, range_of};
use feedwright_core::cycle::ProfileVersion;
use feedwright_core::feed::profile::{LimitsInput, Profile};
use feedwright_core::friction::error::{Invalid, InvalidCode};
use feedwright_core::friction::feed_override::{HIGHEST_OVERRIDE_PERCENT, OverrideBounds, OverrideRange};
use feedwright_core::friction::law::{LawConfig, LawParams};
use feedwright_core::friction::program::FeedProgram;
use feedwright_core::friction::twin::AxisLimits;
use feedwright_core::friction::whatif::{
    ANY_FEED, Control, LoadLimits, PredictedSample, WhatIf, predicted_course, what_if,
};
use feedwright_core::ids::OperationId;
use feedwright_core::invalid::Violation;
use feedwright_store::{StoredCycle, Surroundings};
use std::sync::Arc;

/// A cycle may end so much deeper than a profile that covers it: the axis overshoots, and depths are rounded, mm.
const DEEPER_MM: f64 = 0.1;

/// What is asked of every cycle.
#[derive(Debug, Clone)]
pub struct Asked {
    /// Another program; the cycle's own where it is `None`.
    pub program: Option<FeedProgram>,
    /// The stored profile that the program is of: what it was reviewed for is all it is asked about.
    pub profile: Option<Arc<AskedProfile>>,
    /// A law on top; none where it is `None`.
    pub law: Option<AskedLaw>,
    /// What the feed axis can do.
    pub axis: AxisLimits,
    /// What counts as an overload.
    pub limits: LoadLimits,
    /// Overload that raises no alarm yet, s.
    pub tolerated_overload_s: f64,
    /// Whether the predicted samples are told too.
    pub samples: bool,
}

/// A law that is asked about.
#[derive(Debug, Clone)]
pub struct AskedLaw {
    /// What is named of it.
    pub named: LawBody,
    /// The rest: what streams of this service are run by.
    pub usual: LawSettings,
}

/// A version of a stored profile that is asked about.
#[derive(Debug, Clone, PartialEq)]
pub struct AskedProfile {
    /// Which.
    pub version: ProfileVersion,
    /// Its content.
    pub content: Profile,
}

impl AskedProfile {
    /// Whether it says anything about a cycle of that operation down to that depth.
    pub fn covers(&self, operation: &OperationId, deepest_mm: f64) -> Result<(), Unusable> {
        if self.content.operation() != operation {
            return Err(Unusable::OtherOperation);
        }
        if deepest_mm > self.content.end_depth_mm() + DEEPER_MM {
            return Err(Unusable::ProfileTooShort);
        }
        Ok(())
    }

    /// The sentence of that answer.
    fn says(&self, why: Unusable) -> Invalid {
        let text = match why {
            Unusable::OtherOperation => {
                format!("the profile is for operation {}, the cycle is of another", self.content.operation())
            }
            _ => format!(
                "the profile ends at {} mm, the cycle goes deeper: nobody knows the feed there",
                self.content.end_depth_mm()
            ),
        };
        Invalid::new("control.profile", InvalidCode::Extrapolation, text)
    }
}

impl Asked {
    /// Reads the program, which comes with its own path, and tries the law once, so that what is wrong with them is told before anything is read.
    pub fn new(
        program: Option<(&ProgramBody, &str)>,
        law: Option<AskedLaw>,
        axis: AxisLimits,
        limits: LoadLimits,
        tolerated_overload_s: f64,
    ) -> Result<Self, Violation> {
        let program = program.map(|(program, at)| program.to_program(at)).transpose()?;
        if let Some(AskedLaw { named, usual }) = &law {
            let internal = |error: Invalid| refused(&error, str::to_owned);
            let (low, high) = usual.program_range;
            let range = OverrideRange::new(low, high).map_err(internal)?;
            let (set_feed_drive_percent, set_spindle_percent) = PAPER_LOADS;
            let base = LawParams {
                set_feed_drive_percent,
                set_spindle_percent,
                ..usual.params(OverrideBounds::new(range, range), PAPER_PERIOD_MS, PAPER_PERIOD_MS)
            };
            named.over(base, None, "control.law")?;
        }
        Ok(Self { program, profile: None, law, axis, limits, tolerated_overload_s, samples: false })
    }

    /// The other control for one cycle. Where neither program nor law is asked for it is the feed that ran, and
    /// only the limits differ.
    fn control(
        &self,
        cycle: &ContactCycle,
        around: &Surroundings,
        own: &Control,
    ) -> Result<Control, Invalid> {
        let profile = self.profile.as_ref().map(|profile| profile.content.limits());
        let law = self.law.as_ref().map(|law| law_for(law, profile, cycle, around)).transpose()?;
        let program = match (&self.program, &law) {
            (Some(program), _) => program.clone(),
            (None, Some(_)) => cycle.programmed()?,
            (None, None) => own.program.clone(),
        };
        let machine = &around.machine.limits;
        let (slowest, fastest) =
            profile.map_or(ANY_FEED, |limits| (limits.feed_min_mm_min, limits.feed_max_mm_min));
        let feeds_mm_min = (machine.min_mm_min().max(slowest), machine.max_mm_min().min(fastest));
        Ok(Control { program, law, feeds_mm_min })
    }
}

/// Preferred loads of feed drive and spindle (Stryczek & Błaszczak 2020, section 4.3), where nobody has set any.
const PAPER_LOADS: (Option<f64>, Option<f64>) = (Some(30.0), Some(40.0));
/// The paper's interpolator.
const PAPER_PERIOD_MS: f64 = 10.0;

/// The lower of two loads, where both are set.
fn lower(one: Option<f64>, other: Option<f64>) -> Option<f64> {
    match (one, other) {
        (Some(one), Some(other)) => Some(one.min(other)),
        (one, other) => one.or(other),
    }
}

/// The law that a stream of the service would run, with what is named of it: over the lower of the profile's and the operation's set
/// loads, the paper's where nobody has set any, within the override ranges of machine and profile.
fn law_for(
    law: &AskedLaw,
    profile: Option<LimitsInput>,
    cycle: &ContactCycle,
    around: &Surroundings,
) -> Result<LawConfig, Invalid> {
    let core =
        |violation: Violation| Invalid::new(violation.path, InvalidCode::OutOfRange, violation.message);
    let AskedLaw { named, usual } = law;
    let operation = around.operation.as_ref();
    let period_ms = cycle.period_s * 1e3;
    let set = (
        lower(
            profile.and_then(|limits| limits.feed_drive_load_set_percent),
            operation.and_then(|operation| operation.feed_drive_load_set_percent),
        ),
        lower(
            profile.and_then(|limits| limits.spindle_load_set_percent),
            operation.and_then(|operation| operation.spindle_load_set_percent),
        ),
    );
    let is_set =
        set != (None, None) || named.set_feed_drive_percent.is_some() || named.set_spindle_percent.is_some();
    let (set_feed_drive_percent, set_spindle_percent) = if is_set { set } else { PAPER_LOADS };
    let machine = range_of(&around.machine.limits)?;
    let (low, high) = match profile {
        Some(limits) => {
            (limits.override_min_percent, limits.override_max_percent.min(HIGHEST_OVERRIDE_PERCENT))
        }
        None => usual.program_range,
    };
    let bounds = OverrideBounds::new(machine, OverrideRange::new(low, high)?);
    let base = LawParams {
        set_feed_drive_percent,
        set_spindle_percent,
        ..usual.params(bounds, period_ms, around.machine.ipo_period_ms)
    };
    named.over(base, Some(machine), "control.law").map_err(core)
}

/// One cycle's answer with what it rests on.
#[derive(Debug, Clone)]
pub struct Prediction {
    /// The cycle.
    pub stored: StoredCycle,
    /// Its contact.
    pub cycle: ContactCycle,
    /// What the relation was learned from.
    pub learned: Arc<Learned>,
    /// The core's answer.
    pub answer: WhatIf,
    /// What is predicted, sample by sample, where that was asked for.
    pub course: Option<Vec<PredictedSample>>,
    /// The stored profile that was asked about.
    pub profile: Option<Arc<AskedProfile>>,
    /// The law that was asked about.
    pub law: Option<LawConfig>,
}

/// Predicts one cycle.
///
/// # Errors
/// Why the core refuses it.
pub fn predict(
    asked: &Asked,
    around: &Surroundings,
    stored: StoredCycle,
    cycle: ContactCycle,
    learned: Arc<Learned>,
) -> Result<Prediction, (Unusable, Invalid)> {
    let refused = |error: Invalid| match error.code() {
        InvalidCode::NotIdentifiable => (Unusable::NoRelation, error),
        _ => (Unusable::Refused, error),
    };
    if let Some(profile) = &asked.profile {
        profile
            .covers(&stored.cycle.operation, cycle.deepest_mm())
            .map_err(|why| (why, profile.says(why)))?;
    }
    let own = Control::of(cycle.feed_that_ran().map_err(refused)?);
    let other = asked.control(&cycle, around, &own).map_err(refused)?;
    let answer = what_if(&cycle.core(), &learned.relations, &asked.axis, &asked.limits, &own, &other);
    let answer = answer.map_err(refused)?;
    let course =
        asked.samples.then(|| predicted_course(&cycle.core(), &learned.relations, &asked.axis, &other));
    let course = course.transpose().map_err(refused)?;
    Ok(Prediction { stored, cycle, learned, answer, course, profile: asked.profile.clone(), law: other.law })
}
