//! How worn tools were after each cycle: folded again, since a level is never stored beside a cycle that a late one
//! could change.

use super::{GroupBy, MAX_CYCLES, MAX_TOOLS};
use crate::http::problem::Problem;
use feedwright_core::ids::ToolId;
use feedwright_core::invalid::Violation;
use feedwright_core::units::Timestamp;
use feedwright_store::{CycleFilter, CycleKey, LevelPoint, Store};
use std::collections::{BTreeMap, BTreeSet};

pub(super) struct Level {
    pub(super) group: String,
    pub(super) at: Timestamp,
    pub(super) level: f64,
}

async fn all(
    store: &dyn Store,
    filter: &CycleFilter,
    tools: &BTreeSet<ToolId>,
    mut each: impl FnMut(&ToolId, LevelPoint, f64),
) -> Result<(), Problem> {
    if tools.len() > MAX_TOOLS {
        let message = format!(
            "the wear of {} tools would have to be folded, of at most {MAX_TOOLS} it may be: ask for one machine, tool \
             or operation, or a shorter range",
            tools.len()
        );
        return Err(Violation::new("measures", "too_many_tools", message).into());
    }
    let from = filter.from.unwrap_or(Timestamp::from_micros(i64::MIN));
    let to = filter.to.unwrap_or(Timestamp::from_micros(i64::MAX));
    let most = u32::try_from(MAX_CYCLES).unwrap_or(u32::MAX);
    for tool in tools {
        for point in store.levels(tool, from, to, most).await? {
            let asked = filter.machine.as_ref().is_none_or(|machine| *machine == point.key.1)
                && filter.operation.as_ref().is_none_or(|operation| *operation == point.operation);
            if let (true, Some(level)) = (asked, point.level) {
                each(tool, point, level);
            }
        }
    }
    Ok(())
}

pub(super) async fn of_tools(
    store: &dyn Store,
    filter: &CycleFilter,
    tools: &BTreeSet<ToolId>,
    by: GroupBy,
) -> Result<Vec<Level>, Problem> {
    let mut levels = Vec::new();
    all(store, filter, tools, |tool, point, level| {
        let group = by.of(point.key.1.as_str(), tool.as_str(), point.operation.as_str()).to_owned();
        levels.push(Level { group, at: point.key.0, level });
    })
    .await?;
    Ok(levels)
}

pub(super) async fn by_cycle(
    store: &dyn Store,
    filter: &CycleFilter,
    tools: &BTreeSet<ToolId>,
) -> Result<BTreeMap<CycleKey, f64>, Problem> {
    let mut levels = BTreeMap::new();
    all(store, filter, tools, |_, point, level| {
        levels.insert(point.key, level);
    })
    .await?;
    Ok(levels)
}
