//! Feed programs, adaptive laws, strategies and load limits.

use super::super::word::StrategyWord;
use super::refused;
use feedwright_core::friction::error::Invalid;
use feedwright_core::friction::feed_override::{OverrideBounds, OverrideRange};
use feedwright_core::friction::law::{Heating, LawConfig, LawParams};
use feedwright_core::friction::program::{Between, FeedProgram, Knot, Strategy};
use feedwright_core::friction::twin::PaperStrategies;
use feedwright_core::friction::whatif::LoadLimits;
use feedwright_core::invalid::Violation;
use feedwright_core::units;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What the feed does between two knots.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BetweenWord {
    /// A knot's feed holds until the next one.
    Held,
    /// The feed runs linearly in depth.
    Linear,
}

/// A point of a feed program.
#[derive(Debug, Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ProgramKnotBody {
    /// Tip depth below contact, mm.
    pub depth_mm: f64,
    /// Programmed feed, mm/min.
    pub feed_mm_min: f64,
}

/// Programmed feed over depth: 1 to 256 knots, depths increasing.
#[derive(Debug, Clone, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ProgramBody {
    /// What the feed does between knots.
    pub between: BetweenWord,
    /// The knots.
    pub knots: Vec<ProgramKnotBody>,
}

impl From<&FeedProgram> for ProgramBody {
    fn from(program: &FeedProgram) -> Self {
        let knot = |knot: &Knot| ProgramKnotBody { depth_mm: knot.depth_mm, feed_mm_min: knot.feed_mm_min };
        Self {
            between: match program.between() {
                Between::Held => BetweenWord::Held,
                Between::Linear => BetweenWord::Linear,
            },
            knots: program.knots().iter().map(knot).collect(),
        }
    }
}

impl ProgramBody {
    /// The program; `at` is its own path.
    pub fn to_program(&self, at: &str) -> Result<FeedProgram, Violation> {
        let between = match self.between {
            BetweenWord::Held => Between::Held,
            BetweenWord::Linear => Between::Linear,
        };
        let knot = |knot: &ProgramKnotBody| Knot { depth_mm: knot.depth_mm, feed_mm_min: knot.feed_mm_min };
        FeedProgram::new(between, self.knots.iter().map(knot).collect())
            .map_err(|error| refused(&error, |field| format!("{at}.{field}")))
    }
}

/// The adaptive law (Stryczek & Błaszczak 2020, Eq. 1–4). What is left out is in a simulation the paper's (loads of 30 and 40 %, 2 s of
/// heating, override 5 to 200 %, intensity 8.47), and in a what-if what the service runs streams by: the set loads of profile and
/// operation, and the rest by its configuration (`stream.intensity` and others). Answers name the law in force.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LawBody {
    /// Preferred feed-drive load L_set, %.
    pub set_feed_drive_percent: Option<f64>,
    /// Preferred spindle load L_set, %.
    pub set_spindle_percent: Option<f64>,
    /// Intensity b of Eq. 3. The paper gives none; its figures of power need 4 or more.
    pub intensity: Option<f64>,
    /// Lower limit of the override, %; the machine's own holds as well.
    pub override_min_percent: Option<f64>,
    /// Upper limit of the override, %, towards which Eq. 4 rises; the machine's own holds as well.
    pub override_max_percent: Option<f64>,
    /// Largest rise per sample, points.
    pub rise_limit_points: Option<f64>,
    /// The law is off for so long after contact, ms.
    pub heating_ms: Option<f64>,
}

impl From<&LawParams> for LawBody {
    /// Every value in force that can be asked for: asked again it is the same law.
    fn from(law: &LawParams) -> Self {
        let range = law.bounds.profile();
        Self {
            set_feed_drive_percent: law.set_feed_drive_percent,
            set_spindle_percent: law.set_spindle_percent,
            intensity: Some(law.intensity),
            override_min_percent: Some(range.min_percent()),
            override_max_percent: Some(range.max_percent()),
            rise_limit_points: law.rise_limit_points,
            heating_ms: match law.heating {
                Heating::None => Some(0.0),
                Heating::Time { ms } => Some(ms),
                Heating::Depth { .. } => None,
            },
        }
    }
}

impl LawBody {
    /// The law over `base`, within the machine's override range; `at` is its own path.
    pub fn over(
        &self,
        base: LawParams,
        machine: Option<OverrideRange>,
        at: &str,
    ) -> Result<LawConfig, Violation> {
        let wrong = |error: Invalid| {
            refused(&error, |field| match field {
                "min_percent" => format!("{at}.override_min_percent"),
                "max_percent" => format!("{at}.override_max_percent"),
                "heating.ms" => format!("{at}.heating_ms"),
                field => format!("{at}.{field}"),
            })
        };
        let profile = base.bounds.profile();
        let profile = OverrideRange::new(
            self.override_min_percent.unwrap_or(profile.min_percent()),
            self.override_max_percent.unwrap_or(profile.max_percent()),
        )
        .map_err(wrong)?;
        LawConfig::new(LawParams {
            set_feed_drive_percent: self.set_feed_drive_percent.or(base.set_feed_drive_percent),
            set_spindle_percent: self.set_spindle_percent.or(base.set_spindle_percent),
            intensity: self.intensity.unwrap_or(base.intensity),
            bounds: OverrideBounds::new(machine.unwrap_or(profile), profile),
            rise_limit_points: self.rise_limit_points.or(base.rise_limit_points),
            heating: self.heating_ms.map_or(base.heating, |ms| Heating::Time { ms }),
            ..base
        })
        .map_err(wrong)
    }
}

/// A strategy over one of the paper's. Left out wholly it is F_AC.
#[derive(Debug, Clone, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct StrategyBody {
    /// Which of the paper's strategies fills what is left out.
    pub base: Option<StrategyWord>,
    /// What it is called in the answer; the base's name where it is left out.
    pub name: Option<String>,
    /// Programmed feed over depth; the base's where it is left out.
    pub program: Option<ProgramBody>,
    /// The law on top; with `{}` the paper's. Where it is left out, `f_ac` has its own and the others none.
    pub law: Option<LawBody>,
}

impl From<&Strategy> for StrategyBody {
    /// Every value in force.
    fn from(strategy: &Strategy) -> Self {
        // Of no base it would be F_AC, with its law.
        let base = strategy.law.is_none().then_some(StrategyWord(units::Strategy::FConst));
        Self {
            base,
            name: Some(strategy.name.clone()),
            program: Some((&strategy.program).into()),
            law: strategy.law.as_ref().map(|law| law.params().into()),
        }
    }
}

/// Longest name of a strategy.
const MAX_NAME: usize = 64;

impl StrategyBody {
    /// One of the paper's strategies as it is.
    pub fn paper(base: units::Strategy) -> Self {
        Self { base: Some(StrategyWord(base)), ..Self::default() }
    }

    /// The strategy down to `end_depth_mm` on a machine that samples every `period_ms`; `at` is its own path.
    pub fn to_strategy(&self, at: &str, end_depth_mm: f64, period_ms: f64) -> Result<Strategy, Violation> {
        let internal = |error: Invalid| refused(&error, str::to_owned);
        let paper = PaperStrategies::new().map_err(internal)?;
        let base = match self.base.map_or(units::Strategy::FAc, |word| word.0) {
            units::Strategy::FConst => &paper.constant,
            units::Strategy::FSec => &paper.stepped,
            units::Strategy::FLin => &paper.linear,
            units::Strategy::FAc => &paper.adaptive,
        };
        let name = self.name.as_deref().unwrap_or(&base.name);
        if name.trim().is_empty() || name.chars().count() > MAX_NAME || name.chars().any(char::is_control) {
            let text = format!("must have 1 to {MAX_NAME} characters and no control characters");
            return Err(Violation::new(format!("{at}.name"), "invalid_length", text));
        }
        let program = match &self.program {
            Some(program) => program.to_program(&format!("{at}.program"))?,
            None => base.program.clone(),
        };
        // A law that believes in another period would take every sample for a gap.
        let timed = |params: LawParams| LawParams { period_ms, longest_gap_ms: 2.5 * period_ms, ..params };
        let law = match (&self.law, &base.law) {
            (None, None) => None,
            (given, own) => {
                let base = match (own, &paper.adaptive.law) {
                    (Some(law), _) | (None, Some(law)) => *law.params(),
                    (None, None) => LawParams::paper(30.0, 40.0).map_err(internal)?,
                };
                let law = format!("{at}.law");
                Some(given.unwrap_or_default().over(timed(base), None, &law)?)
            }
        };
        Strategy::new(name, program, end_depth_mm, law)
            .map_err(|error| refused(&error, |field| format!("model.operation.{field}")))
    }
}

/// What counts as an overload.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LoadLimitsBody {
    /// Feed-drive load, %; no limit where it is left out.
    pub feed_drive_percent: Option<f64>,
    /// Spindle load, %; no limit where it is left out.
    pub spindle_percent: Option<f64>,
}

impl LoadLimitsBody {
    /// The limits.
    pub fn to_limits(self) -> Result<LoadLimits, Violation> {
        let limits =
            LoadLimits { feed_drive_percent: self.feed_drive_percent, spindle_percent: self.spindle_percent };
        limits.check().map_err(|error| refused(&error, str::to_owned))?;
        Ok(limits)
    }
}
