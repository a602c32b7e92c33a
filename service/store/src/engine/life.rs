//! A tool's current life, cycle by cycle: the fold is walked again and watched.

use super::wear::{facts_after, is_registered, not_registered};
use super::{Conn, tools};
use crate::error::StoreResult;
use crate::history::{Walk, verdict_after};
use crate::record::{LifeCycle, ToolLife};
use feedwright_core::ids::{CycleId, MachineId, ToolId};
use feedwright_core::wear::Exclusion;
use std::collections::{HashMap, VecDeque};

/// The newest `most` cycles of the life that runs.
pub(super) async fn of(conn: &mut Conn, tool: &ToolId, most: u32) -> StoreResult<ToolLife> {
    if !is_registered(conn, tool).await? {
        return Ok(ToolLife { verdict: not_registered(), before: 0, cycles: Vec::new() });
    }
    let (events, _) = tools::placed_events(conn, tool).await?;
    let mut walk = Walk::new(&events);
    let (mut lives, mut before) = (walk.lives(), 0);
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
                (lives, before) = (walk.lives(), 0);
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
                before += 1;
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
    let ended = walk.lives();
    let verdict = verdict_after(walk.fold(), &events);
    // An event after the last cycle has begun another life, which has no cycle yet.
    if events.iter().filter(|event| event.kind.begins_life()).count() > ended {
        return Ok(ToolLife { verdict, before: 0, cycles: Vec::new() });
    }
    Ok(ToolLife { verdict, before, cycles })
}
