//! Alarms: listed, and acknowledged one by one or, for overloads, by machine.

use super::cursor::{List, Paging};
use super::dto::alarm::{Acknowledged, AlarmQuery, AlarmView};
use super::extract::{PathId, Query, query_id};
use super::problem::Problem;
use crate::auth::Caller;
use crate::state::AppState;
use crate::stream::overload;
use axum::Json;
use axum::extract::State;
use feedwright_core::ids::MachineId;
use feedwright_store::{Alarm, AlarmFilter, AlarmKind, RowNumber};

/// Lists alarms in the order they were raised.
///
/// Without `open` each alarm is on one page, whoever goes on from page to page: one that is raised while an older number is still being
/// committed is listed after that. With it the list is of those that are open, or cleared, at the moment: one that changes meanwhile
/// may be before the page that comes next, so begin anew to see what is open now.
#[utoipa::path(get, path = "/v1/alarms", tag = "alarms", params(AlarmQuery),
    responses((status = 200, body = List<AlarmView>)))]
pub(super) async fn list(
    State(state): State<AppState>,
    Query(query): Query<AlarmQuery>,
) -> Result<Json<List<AlarmView>>, Problem> {
    let filter = AlarmFilter {
        open: query.open,
        machine: query_id(query.machine.as_deref())?,
        tool: query_id(query.tool.as_deref())?,
    };
    let paging = Paging::new(&state, format!("alarms {filter:?}"), query.limit, query.cursor.as_deref())?;
    let rows = match query.open {
        None => state.store.alarm_history(&filter, paging.page()).await?,
        // What is open is shown at once, whatever is committed later.
        Some(_) => state.store.alarms(&filter, paging.page()).await?,
    };
    Ok(Json(paging.list(rows, |row| row.id, AlarmView::from)))
}

/// Acknowledges one alarm.
#[utoipa::path(post, path = "/v1/alarms/{id}/acknowledge", tag = "alarms", params(("id" = i64, Path)),
    responses((status = 200, body = AlarmView)))]
pub(super) async fn acknowledge(
    State(state): State<AppState>,
    caller: Caller,
    PathId(id): PathId<RowNumber>,
) -> Result<Json<AlarmView>, Problem> {
    Ok(Json(acknowledge_one(&state, &caller, id).await?.into()))
}

/// Acknowledges the overloads of a machine that are open and not acknowledged.
#[utoipa::path(post, path = "/v1/machines/{machine}/acknowledge", tag = "alarms",
    params(("machine" = String, Path)), responses((status = 200, body = Acknowledged)))]
pub(super) async fn acknowledge_machine(
    State(state): State<AppState>,
    caller: Caller,
    PathId(machine): PathId<MachineId>,
) -> Result<Json<Acknowledged>, Problem> {
    if state.store.machine(&machine).await?.is_none() {
        return Err(Problem::not_found("machine", machine.as_str()));
    }
    let mut acknowledged = Vec::new();
    for alarm in state.store.open_overloads(&machine).await? {
        acknowledged.push(acknowledge_one(&state, &caller, alarm).await?.into());
    }
    Ok(Json(Acknowledged { acknowledged }))
}

async fn acknowledge_one(state: &AppState, caller: &Caller, id: RowNumber) -> Result<Alarm, Problem> {
    let (actor, now) = (caller.actor(), state.clock.now());
    let alarm = state.commit(|store| async move { store.acknowledge_alarm(id, &actor, now).await }).await?;
    state.live.alarms_may_have_changed();
    if let Some(machine) =
        alarm.as_ref().filter(|alarm| alarm.kind == AlarmKind::Overload).and_then(|a| a.machine.as_ref())
    {
        overload::settle(state, machine).await;
    }
    alarm.ok_or_else(|| Problem::not_found("alarm", &id.to_string()))
}
