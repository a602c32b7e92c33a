//! The fleet at a glance: what its page shows of every machine, in one answer.

use super::cursor::Paging;
use super::dto::fleet::{FleetBody, FleetCycleBody, FleetMachineBody, FleetOneBody, FleetQuery, RecentQuery};
use super::extract::{PathId, Query};
use super::problem::{Problem, ProblemDocument};
use crate::http::dto::time;
use crate::state::AppState;
use axum::Json;
use axum::extract::State;
use feedwright_core::ids::MachineId;
use feedwright_core::invalid::Violation;

/// Most cycles looked back at for each machine.
const MOST_RECENT: u32 = 200;
/// Cycles looked back at where no number is asked for.
const USUAL_RECENT: u32 = 60;

/// Machines by id, each with its last cycle, the wear of its tool, its last energies and its open alarms.
#[utoipa::path(get, path = "/v1/fleet", tag = "fleet", params(FleetQuery),
    responses((status = 200, description = "A page of the fleet, all of one moment", body = FleetBody)))]
pub(super) async fn get(
    State(state): State<AppState>,
    Query(query): Query<FleetQuery>,
) -> Result<Json<FleetBody>, Problem> {
    let recent = checked(query.recent)?;
    let paging = Paging::<MachineId>::new(&state, "fleet", query.limit, query.cursor.as_deref())?;
    let rows = state.store.fleet(paging.page(), recent).await?;
    let list = paging.list(rows, |row| row.machine.value.id.clone(), |row| FleetMachineBody::from(&row));
    Ok(Json(FleetBody {
        now: time::show(state.clock.now()),
        stale_after_ms: state.config.recommendation.stale_after_ms,
        items: list.items,
        next_cursor: list.next_cursor,
    }))
}

/// One machine of the fleet, with its newest cycles.
#[utoipa::path(get, path = "/v1/fleet/{machine}", tag = "fleet",
    params(("machine" = String, Path, description = "The machine"), RecentQuery),
    responses(
        (status = 200, description = "The machine at a glance", body = FleetOneBody),
        (status = 404, description = "The machine is not registered", body = ProblemDocument<'static>),
    ))]
pub(super) async fn machine(
    State(state): State<AppState>,
    PathId(machine): PathId<MachineId>,
    Query(query): Query<RecentQuery>,
) -> Result<Json<FleetOneBody>, Problem> {
    let row = state.store.fleet_machine(&machine, checked(query.recent)?).await?;
    let row = row.ok_or_else(|| Problem::not_found("machine", machine.as_str()))?;
    let names = |place: usize| if place == 0 { row.names.clone() } else { (None, None) };
    let recent = row.recent.iter().enumerate().map(|(place, cycle)| FleetCycleBody::new(cycle, names(place)));
    Ok(Json(FleetOneBody {
        now: time::show(state.clock.now()),
        stale_after_ms: state.config.recommendation.stale_after_ms,
        recent: recent.collect(),
        machine: FleetMachineBody::from(&row),
    }))
}

fn checked(recent: Option<u32>) -> Result<u32, Problem> {
    let recent = recent.unwrap_or(USUAL_RECENT);
    if (1..=MOST_RECENT).contains(&recent) {
        return Ok(recent);
    }
    let message = format!("must be within 1 to {MOST_RECENT}, is {recent}");
    Err(Problem::invalid_query(Violation::new("recent", "out_of_range", message)))
}
