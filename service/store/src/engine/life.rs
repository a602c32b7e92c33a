//! A tool's current life, cycle by cycle: the fold is walked again and watched, from the last state on the way that comes before
//! what is shown.
//!
//! A cycle is left out by itself or by later ones, never by one before it, and the fold is the same wherever the walk to it began:
//! so what is told of the newest cycles does not depend on how much of the life before them is walked. How many come before them
//! the fold knows.

use super::wear::{self, ToolWear, facts_after, is_registered, not_registered};
use super::{Conn, Db};
use crate::error::StoreResult;
use crate::history::{Walk, verdict_after};
use crate::record::{LifeCycle, ToolLife};
use crate::rows::{Place, PlacedEvent, count};
use feedwright_core::ids::{CycleId, MachineId, ToolId};
use feedwright_core::units::Timestamp;
use feedwright_core::wear::Exclusion;
use std::collections::{HashMap, VecDeque};

/// The newest `most` cycles of the life that runs, where few others have to be folded for them.
pub(super) async fn at_once(conn: &mut Conn, tool: &ToolId, most: u32) -> StoreResult<Option<ToolLife>> {
    read(conn, tool, most, u64::from(most) + wear::AT_ONCE).await
}

/// The newest `most` cycles of the life that runs, however many have to be folded for them.
pub(super) async fn of(conn: &mut Conn, tool: &ToolId, most: u32) -> StoreResult<ToolLife> {
    Ok(read(conn, tool, most, u64::MAX).await?.unwrap_or_else(of_no_cycle))
}

fn of_no_cycle() -> ToolLife {
    ToolLife { verdict: not_registered(), before: 0, cycles: Vec::new() }
}

/// The life; `None` where more cycles than `bound` had to be folded for it.
async fn read(conn: &mut Conn, tool: &ToolId, most: u32, bound: u64) -> StoreResult<Option<ToolLife>> {
    if !is_registered(conn, tool).await? {
        return Ok(Some(of_no_cycle()));
    }
    let known = ToolWear::load(conn, tool).await?;
    let events = &known.events;
    let first = first_shown(conn, tool, most, events).await?;
    let mut walk = match known.state_before(conn, &first).await? {
        Some((fold, folded)) => Walk::resume(fold, folded, events),
        None => Walk::new(events),
    };
    if known.folded().saturating_sub(walk.folded()) > bound {
        return Ok(None);
    }
    let mut lives = walk.lives();
    let mut cycles: VecDeque<LifeCycle> = VecDeque::new();
    let mut excluded: HashMap<MachineId, HashMap<CycleId, Exclusion>> = HashMap::new();
    loop {
        let page = facts_after(conn, tool, None, walk.fold().last()).await?;
        if page.is_empty() {
            break;
        }
        for row in &page {
            walk.step(row)?;
            if walk.lives() != lives {
                lives = walk.lives();
                cycles.clear();
                excluded.clear();
            }
            for (machine, cycle, why) in walk.fold().last_excluded() {
                let known = excluded.get(machine).and_then(|of| of.get(cycle));
                if known != Some(why) {
                    excluded.entry(machine.clone()).or_default().insert(cycle.clone(), *why);
                }
            }
            if cycles.len() == most as usize
                && let Some(LifeCycle { facts, .. }) = cycles.pop_front()
            {
                excluded.get_mut(&facts.order.machine).and_then(|of| of.remove(&facts.order.cycle));
            }
            let (facts, settings) = row.facts()?;
            let level = walk.fold().judged_level();
            cycles.push_back(LifeCycle { facts, settings, excluded: None, level });
        }
    }
    let mut cycles: Vec<LifeCycle> = cycles.into();
    for LifeCycle { facts, excluded: why, .. } in &mut cycles {
        *why = excluded.get(&facts.order.machine).and_then(|of| of.get(&facts.order.cycle)).copied();
    }
    let verdict = verdict_after(walk.fold(), events);
    // It has no cycle yet.
    if walk.is_life_over() {
        return Ok(Some(ToolLife { verdict, before: 0, cycles: Vec::new() }));
    }
    let before = walk.fold().cycles().saturating_sub(cycles.len() as u64);
    Ok(Some(ToolLife { verdict, before, cycles }))
}

/// A place before all that is shown, and after what is not: that of the newest cycles, or where the life began, if that is later.
async fn first_shown(
    conn: &mut Conn,
    tool: &ToolId,
    most: u32,
    events: &[PlacedEvent],
) -> StoreResult<Place> {
    // An index has it, without a row of the table.
    let at: Option<i64> = sqlx::query_scalar::<Db, _>(
        "SELECT started_at_us FROM cycles WHERE tool_id = $1 ORDER BY started_at_us DESC LIMIT 1 OFFSET $2",
    )
    .bind(tool.as_str())
    .bind(count("most", u64::from(most.saturating_sub(1)))?)
    .fetch_optional(&mut *conn)
    .await?;
    let newest = at.map_or(wear::BEGINNING, |at| Place::at(Timestamp::from_micros(at)));
    let life = events.iter().rfind(|event| event.kind.begins_life());
    Ok(life.map_or(wear::BEGINNING, |event| event.place.clone()).max(newest))
}
