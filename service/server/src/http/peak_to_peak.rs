//! Vibratory drilling by peak-to-peak control: tuning, closed loop, Poincaré data, recorded blocks (Ivanov et al. 2024).
//!
//! For setting up and for monitoring. The controller itself runs beside the drive, every 300 µs: not here.

use super::body::Json;
use super::dto::job::JobBody;
use super::dto::mirror::{To, WarningBody, violation};
use super::dto::peak_to_peak::{
    BlockAnswer, BlockQuestion, LoopAnswer, LoopQuestion, PoincareAnswer, PoincareQuestion, TuningAnswer,
    TuningQuestion, controller, of_process,
};
use super::jobs::{computed, json};
use super::problem::Problem;
use crate::jobs::{INLINE_STEPS, Question};
use crate::state::AppState;
use axum::extract::State;
use axum::response::Response;
use feedwright_core::field_error::FieldError;
use feedwright_core::invalid::Violation;
use feedwright_core::vibratory::loop_model::{LoopRun, MAX_SPEEDS, PoincareColumn, loop_steps, run_loop};
use feedwright_core::vibratory::peak_to_peak::ControllerSettings;
use feedwright_core::vibratory::recorded::{BlockInput, analyse};
use feedwright_core::vibratory::tuning::tune;

/// Advises A0, G and the filters of the controller for a machine.
#[utoipa::path(post, path = "/v1/vibratory/tuning", tag = "vibratory", request_body = TuningQuestion,
    responses((status = 200, body = TuningAnswer)))]
pub(super) async fn tuning(
    Json(question): Json<TuningQuestion>,
) -> Result<axum::Json<TuningAnswer>, Problem> {
    let tuning = tune(&question.to()).map_err(|error| violation("", error))?;
    let mut warnings = Vec::new();
    if !tuning.not_covered_rpm.is_empty() {
        let speeds: Vec<_> = tuning.not_covered_rpm.iter().map(ToString::to_string).collect();
        let message = format!("the target is not expected to segment chips at {} 1/min", speeds.join(", "));
        warnings.push(WarningBody::new("speeds_not_covered", message));
    }
    if tuning.board_too_slow {
        let message = "the board leaves fewer than 20 samples per vibration";
        warnings.push(WarningBody::new("board_too_slow", message));
    }
    Ok(axum::Json(TuningAnswer {
        settings: (*tuning.settings.data()).to(),
        actuator_gain_n_s_m: tuning.actuator_gain_n_s_m,
        needed_mm: tuning.needed_mm,
        warnings,
    }))
}

/// Steps of a run without and with control; 422 where that is more than one run may take.
fn cost(run: &LoopRun, control: &ControllerSettings) -> Result<u64, Problem> {
    let steps = loop_steps(run, None).saturating_add(loop_steps(run, Some(control)));
    if steps <= INLINE_STEPS {
        return Ok(steps);
    }
    let message = format!("makes {steps} integration steps per speed, at most {INLINE_STEPS} are accepted");
    Err(Violation::new("process.duration_s", "too_many", message).into())
}

fn both(run: &LoopRun, control: &ControllerSettings) -> Result<PoincareColumn, FieldError> {
    let (free, controlled) = (run_loop(run, None)?, run_loop(run, Some(control))?);
    Ok(PoincareColumn { spindle_rpm: run.data().spindle_rpm, free, controlled })
}

/// Runs the drilling process without and with the controller at one spindle speed.
#[utoipa::path(post, path = "/v1/vibratory/loop", tag = "vibratory", request_body = LoopQuestion,
    responses((status = 200, body = LoopAnswer)))]
pub(super) async fn close_loop(
    State(state): State<AppState>,
    Json(question): Json<LoopQuestion>,
) -> Result<axum::Json<LoopAnswer>, Problem> {
    let control = controller(question.controller)?;
    let run = question.process.run(question.spindle_rpm)?;
    cost(&run, &control)?;
    let done = state.jobs.inline(&state.lifecycle, move || both(&run, &control)).await?;
    let PoincareColumn { free, controlled, .. } = done.map_err(of_process)?;
    let warnings = question.process.warnings();
    Ok(axum::Json(LoopAnswer { free: free.to(), controlled: controlled.to(), warnings }))
}

/// Poincaré data over spindle speed, without and with the controller (Fig. 11, 14 and 15; Table 6).
///
/// A few speeds are answered at once; many become a job, as a map does.
#[utoipa::path(post, path = "/v1/vibratory/poincare", tag = "vibratory", request_body = PoincareQuestion,
    responses((status = 200, body = PoincareAnswer), (status = 202, description = "It became a job", body = JobBody)))]
pub(super) async fn poincare(
    State(state): State<AppState>,
    Json(question): Json<PoincareQuestion>,
) -> Result<Response, Problem> {
    let parameters = format!("{question:?}");
    let PoincareQuestion { speeds_rpm, process, controller: settings } = question;
    if speeds_rpm.is_empty() || speeds_rpm.len() > MAX_SPEEDS {
        let message = format!("must have 1 to {MAX_SPEEDS} elements, has {}", speeds_rpm.len());
        return Err(Violation::new("speeds_rpm", "invalid_length", message).into());
    }
    let control = controller(settings)?;
    let of_the_list = |index: usize, bad: Violation| match bad.path.as_str() {
        "spindle_rpm" => Violation { path: format!("speeds_rpm[{index}]"), ..bad },
        _ => bad,
    };
    let mut runs = Vec::with_capacity(speeds_rpm.len());
    let mut steps = 0;
    for (index, rpm) in speeds_rpm.iter().enumerate() {
        let run = process.run(*rpm).map_err(|bad| of_the_list(index, bad))?;
        steps += cost(&run, &control)?;
        // An edge that passes within a few integration steps is found out here rather than in the job.
        let moment = run_loop(&first_moment(&run)?, Some(&control));
        moment.map_err(|error| of_the_list(index, of_process(error)))?;
        runs.push(run);
    }
    let warnings = process.warnings();
    let about = Question { kind: "vibratory_poincare", parameters, total: runs.len(), steps };
    computed(&state, about, move |progress| {
        let columns = progress.all(runs.len(), |index| both(&runs[index], &control).ok())?;
        json(&PoincareAnswer { columns: columns.into_iter().flatten().collect::<Vec<_>>().to(), warnings })
    })
    .await
}

/// The same run, over as soon as it has begun.
fn first_moment(run: &LoopRun) -> Result<LoopRun, Violation> {
    let short =
        feedwright_core::vibratory::loop_model::LoopInput { duration_s: 1e-3, steady_s: 1e-3, ..*run.data() };
    LoopRun::new(short).map_err(of_process)
}

/// Finds frequency, amplitude and, where force is known, cutting continuity of a recorded block of vibration.
#[utoipa::path(post, path = "/v1/vibratory/recorded", tag = "vibratory", request_body = BlockQuestion,
    responses((status = 200, body = BlockAnswer)))]
pub(super) async fn recorded(
    State(state): State<AppState>,
    Json(block): Json<BlockQuestion>,
) -> Result<axum::Json<BlockAnswer>, Problem> {
    let work = move || {
        analyse(&BlockInput {
            signal: block.signal.into(),
            values: &block.values,
            period_s: block.period_s,
            force_n: block.force_n.as_deref(),
            contact_force_n: block.contact_force_n,
            band_hz: block.band_hz,
        })
    };
    let found = state.jobs.inline(&state.lifecycle, work).await?;
    Ok(axum::Json(found.map_err(|error| violation("", error))?.to()))
}
