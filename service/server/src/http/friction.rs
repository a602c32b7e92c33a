//! The process model of friction drilling, asked over HTTP.

use super::body::Json;
use super::compute::compute;
use super::dto::friction::control::StrategyBody;
use super::dto::friction::model::located;
use super::dto::friction::simulation::{
    ComparedStrategy, DEFAULTS, SimulatedSamples, SimulationAnswer, SimulationRequest,
};
use super::problem::{Problem, ProblemDocument};
use feedwright_core::friction::compare::{MOST_COMPARED, compare, drill, radar};
use feedwright_core::friction::error::Invalid;
use feedwright_core::friction::program::Strategy;
use feedwright_core::invalid::Violation;
use feedwright_core::units;

/// Simulates one hole, and compares strategies on the same machine, tool and sheet.
///
/// Everything may be left out: `{}` is the paper's adaptive feed with a new tool beside the paper's four strategies.
/// The answer names every value in force. The model and what it misses are described in docs/friction.md.
#[utoipa::path(post, path = "/v1/friction/simulate", tag = "friction", request_body = SimulationRequest,
    responses(
        (status = 200, description = "The cycle, its stages and energy, and the comparison", body = SimulationAnswer),
        (status = 422, description = "Values that make no machine, tool, sheet or strategy, or a hole that would \
            never be finished", body = ProblemDocument<'static>),
        (status = 503, description = "Other computations are under way", body = ProblemDocument<'static>),
    ))]
pub(super) async fn simulate(
    Json(request): Json<SimulationRequest>,
) -> Result<axum::Json<SimulationAnswer>, Problem> {
    compute(move || Ok(axum::Json(answer(&request)?))).await
}

fn answer(request: &SimulationRequest) -> Result<SimulationAnswer, Violation> {
    let seed = request.seed()?;
    let model = request.model.into_model(seed.is_some()).map_err(inside)?;
    let limits = request.limits.to_limits()?;
    let setup = model.setup;
    let period_ms = setup.period_s * 1e3;
    let strategy = request.strategy.to_strategy("strategy", model.end_depth_mm, period_ms)?;
    let others = strategies(request, model.end_depth_mm, period_ms)?;
    let mut samples = request.samples.then(|| SimulatedSamples { period_ms, ..Default::default() });
    let cycle = drill(&model.twin, &strategy, &setup, &limits, seed, |sample| {
        if let Some(samples) = &mut samples {
            samples.push(sample);
        }
    })
    .map_err(|error| drilling(&error))?;
    let outcomes = compare(&model.twin, &others, &setup, &limits, seed).map_err(|error| drilling(&error))?;
    let comparison =
        outcomes.iter().zip(radar(&outcomes)).map(|(one, radar)| ComparedStrategy::new(one, radar));
    Ok(SimulationAnswer {
        cycle: (&cycle).into(),
        samples,
        comparison: comparison.collect(),
        model: (&model).into(),
        strategy: (&strategy).into(),
        defaults: DEFAULTS,
    })
}

/// A violation within `model`.
fn inside(wrong: Violation) -> Violation {
    Violation { path: format!("model.{}", wrong.path), ..wrong }
}

/// A refusal while drilling: of the setup, of a limit, or of a strategy that never ends.
fn drilling(error: &Invalid) -> Violation {
    let wrong = located(error);
    let is_setup = ["tool.", "operation.", "machine."].iter().any(|part| wrong.path.starts_with(part));
    if is_setup { inside(wrong) } else { wrong }
}

fn strategies(
    request: &SimulationRequest,
    end_depth_mm: f64,
    period_ms: f64,
) -> Result<Vec<Strategy>, Violation> {
    let paper = || units::Strategy::ALL.map(StrategyBody::paper).to_vec();
    let bodies = request.compare.clone().unwrap_or_else(paper);
    if bodies.len() > MOST_COMPARED {
        let text = format!("at most {MOST_COMPARED} strategies, not {}", bodies.len());
        return Err(Violation::new("compare", "too_many", text));
    }
    let one = |(place, body): (usize, &StrategyBody)| {
        body.to_strategy(&format!("compare[{place}]"), end_depth_mm, period_ms)
    };
    bodies.iter().enumerate().map(one).collect()
}
