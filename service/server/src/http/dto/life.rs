//! A tool's life in JSON.

use super::time;
use super::wear::WearBody;
use feedwright_core::units::Strategy;
use feedwright_core::wear::{Exclusion, LevelBasis};
use feedwright_store::{LifeCycle, ToolLife};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// How much of a life.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct LifeQuery {
    /// Newest cycles wanted, 1 to 20 000; 5000 where it is left out.
    #[param(minimum = 1, maximum = 20_000)]
    pub last: Option<u32>,
}

/// The newest cycles of a tool's current life, in columns of equal length.
#[derive(Debug, Serialize, ToSchema)]
pub struct LifeBody {
    /// The verdict after all of them.
    pub wear: WearBody<'static>,
    /// Cycles of this life before the first one here.
    pub before: u64,
    /// When each began, RFC 3339.
    pub started_at: Vec<String>,
    /// The machine of each.
    pub machine: Vec<String>,
    /// The id of each.
    pub cycle_id: Vec<String>,
    /// The operation of each.
    pub operation: Vec<String>,
    /// The strategy that each is compared under: times and depths of another do not compare.
    pub strategy: Vec<Option<&'static str>>,
    /// Energy of each as it is compared, J: of friction drilling from contact to full depth, where depth was sampled.
    pub energy_joules: Vec<Option<f64>>,
    /// That over the baseline it was compared with, also where that was learnt anew since: 1 is the new tool, and of one that was
    /// mounted used what it needed in its own first cycles. Null where there is none.
    pub energy_ratio: Vec<Option<f64>>,
    /// The level that was judged after each, as `wear.level.value` says it of the last: 1 is the new tool. Null before
    /// there was one.
    pub level: Vec<Option<f64>>,
    /// Which level that was: `as_run`, `feed_compensated`, `reference_cycles`; null where nothing decided.
    pub decides: Vec<Option<&'static str>>,
    /// Time of each as it is compared, ms.
    pub duration_ms: Vec<Option<f64>>,
    /// Depth at which the spindle load of each has fallen to half of its maximum, mm.
    pub spindle_load_fall_depth_mm: Vec<Option<f64>>,
    /// Why it does not count; null for one that does, or that later cycles have yet to settle.
    #[schema(example = json!([null, "air_cut"]))]
    pub excluded: Vec<Option<&'static str>>,
}

impl From<&ToolLife> for LifeBody {
    fn from(life: &ToolLife) -> Self {
        let facts = || life.cycles.iter().map(|cycle| &cycle.facts);
        let is_friction = |cycle: &LifeCycle| cycle.settings.is_some_and(|settings| settings.is_friction);
        let joules =
            |cycle: &LifeCycle| cycle.facts.compared(is_friction(cycle)).map(|(_, joules, _)| joules);
        let duration = |cycle: &LifeCycle| match cycle.facts.compared(is_friction(cycle)) {
            Some((_, _, duration_ms)) => duration_ms,
            None => cycle.facts.duration_ms,
        };
        let strategy = |cycle: &LifeCycle| cycle.facts.compared_as(is_friction(cycle));
        let ratio = |cycle: &LifeCycle| life.verdict.ratio_of(&cycle.facts, cycle.settings.as_ref()?);
        Self {
            wear: WearBody::from(&life.verdict).owned(),
            before: life.before,
            started_at: facts().map(|facts| time::show(facts.order.started_at)).collect(),
            machine: facts().map(|facts| facts.order.machine.to_string()).collect(),
            cycle_id: facts().map(|facts| facts.order.cycle.to_string()).collect(),
            operation: facts().map(|facts| facts.operation.to_string()).collect(),
            strategy: life.cycles.iter().map(|cycle| strategy(cycle).map(Strategy::as_str)).collect(),
            energy_joules: life.cycles.iter().map(joules).collect(),
            energy_ratio: life.cycles.iter().map(ratio).collect(),
            level: life.cycles.iter().map(|cycle| cycle.level.map(|level| level.value)).collect(),
            decides: life
                .cycles
                .iter()
                .map(|cycle| cycle.level.and_then(|level| level.decides).map(LevelBasis::as_str))
                .collect(),
            duration_ms: life.cycles.iter().map(duration).collect(),
            spindle_load_fall_depth_mm: facts().map(|facts| facts.fall_depth_mm).collect(),
            excluded: life.cycles.iter().map(|cycle| cycle.excluded.map(Exclusion::as_str)).collect(),
        }
    }
}
