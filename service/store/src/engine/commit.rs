//! A group of cycles in one transaction: stored or known, folded, alarmed, answered.

use super::wear::{self, ToolWear};
use super::{Conn, alarms, cycles, dialect, machines, models, operations, recommendations};
use crate::error::StoreResult;
use crate::history::beginning;
use crate::locks::Locks;
use crate::record::{AlarmKind, Committed, CycleAnswer, IssuedRecommendation, NewCycle, StoredCycle};
use crate::rows::{CutRow, CycleRow, FactsRow, Place};
use feedwright_core::cycle::{Cycle, Flag};
use feedwright_core::ids::{MachineId, OperationId, RecommendationId, ToolId};
use feedwright_core::machine::Machine;
use feedwright_core::operation::Operation;
use feedwright_core::recommend::{Knowledge, Question, RecommendSettings, recommend};
use feedwright_core::summary::CycleSummary;
use feedwright_core::units::Timestamp;
use feedwright_core::wear::Verdict;
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};

/// What is registered around a group.
struct Registry {
    machines: BTreeMap<MachineId, Machine>,
    operations: BTreeMap<OperationId, Operation>,
    tools: BTreeSet<ToolId>,
}

impl Registry {
    async fn load(conn: &mut Conn, group: &[NewCycle]) -> StoreResult<Self> {
        let operation_ids: BTreeSet<_> = group.iter().map(|new| &new.cycle.operation).collect();
        let tool_ids: BTreeSet<_> = group.iter().map(|new| &new.cycle.tool).collect();
        dialect::lock(conn, &Locks::group(operation_ids.iter().copied(), tool_ids.iter().copied())).await?;
        let mut registry =
            Self { machines: BTreeMap::new(), operations: BTreeMap::new(), tools: BTreeSet::new() };
        for machine in group.iter().map(|new| &new.cycle.machine).collect::<BTreeSet<_>>() {
            if let Some(found) = machines::get(conn, machine).await? {
                registry.machines.insert(machine.clone(), found.value);
            }
        }
        for operation in operation_ids {
            if let Some(found) = operations::get(conn, operation).await? {
                registry.operations.insert(operation.clone(), found.value);
            }
        }
        for tool in tool_ids {
            if wear::is_registered(conn, tool).await? {
                registry.tools.insert(tool.clone());
            }
        }
        Ok(registry)
    }
}

/// What became of one cycle before it is answered.
enum Placed {
    New(Box<CycleRow>, Box<CycleSummary>),
    Known(Box<StoredCycle>),
    Done(Committed),
}

/// Commits a group: answers stand in the order of the group.
pub(super) async fn group(
    conn: &mut Conn,
    group: &[NewCycle],
    now: Timestamp,
    settings: RecommendSettings,
) -> StoreResult<Vec<Committed>> {
    let registry = Registry::load(conn, group).await?;
    let placed = place_all(conn, group, &registry).await?;
    let verdicts = count_all(conn, group, &placed, &registry, now).await?;
    let knowledge = know_all(conn, group, &registry).await?;
    let mut answers = Vec::with_capacity(group.len());
    for (new, placed) in group.iter().zip(placed) {
        let (summary, received_at, stored) = match placed {
            Placed::Done(committed) => {
                answers.push(committed);
                continue;
            }
            Placed::New(_, summary) => (*summary, new.received_at, true),
            Placed::Known(known) => (known.summary, known.received_at, false),
        };
        let known = knowledge.get(&(&new.cycle.operation, &new.cycle.tool)).unwrap_or(&Knowledge::None);
        let tool = (verdicts.get(&new.cycle.tool), known);
        let answer =
            answer(conn, &new.cycle, (summary, received_at), &registry, tool, (now, settings)).await?;
        answers.push(if stored { Committed::Stored(answer) } else { Committed::Known(answer) });
    }
    Ok(answers)
}

/// What the processes of a group need to know, once per operation and tool: the whole group is placed by now.
async fn know_all<'a>(
    conn: &mut Conn,
    group: &'a [NewCycle],
    registry: &Registry,
) -> StoreResult<BTreeMap<(&'a OperationId, &'a ToolId), Knowledge>> {
    let mut known = BTreeMap::new();
    for cycle in group.iter().map(|new| &new.cycle) {
        let key = (&cycle.operation, &cycle.tool);
        if let Entry::Vacant(unknown) = known.entry(key) {
            let operation = registry.operations.get(&cycle.operation);
            unknown.insert(models::knowledge(conn, operation, &cycle.tool).await?);
        }
    }
    Ok(known)
}

async fn place_all(conn: &mut Conn, group: &[NewCycle], registry: &Registry) -> StoreResult<Vec<Placed>> {
    // Ascending keys, so that two servers with the same cycles cannot wait for each other.
    let mut order: Vec<usize> = (0..group.len()).collect();
    order.sort_by_key(|&index| (&group[index].cycle.machine, &group[index].cycle.id, index));
    let mut placed: Vec<(usize, Placed)> = Vec::with_capacity(group.len());
    for index in order {
        placed.push((index, place(conn, &group[index], registry).await?));
    }
    placed.sort_by_key(|(index, _)| *index);
    Ok(placed.into_iter().map(|(_, placed)| placed).collect())
}

async fn place(conn: &mut Conn, new: &NewCycle, registry: &Registry) -> StoreResult<Placed> {
    let cycle = &new.cycle;
    if !registry.machines.contains_key(&cycle.machine) {
        return Ok(Placed::Done(Committed::UnknownMachine));
    }
    let mut summary = new.summary.clone();
    summary.flags.insert_if(!registry.tools.contains(&cycle.tool), Flag::ToolUnregistered);
    let row = CycleRow::of(new, summary.flags)?;
    if cycles::insert(conn, &row).await? {
        if let Some(block) = &new.encoded.samples {
            cycles::insert_samples(conn, &row, block).await?;
        }
        if let Some(cut) = CutRow::of(cycle)? {
            models::insert_cut(conn, &cut).await?;
        }
        return Ok(Placed::New(Box::new(row), Box::new(summary)));
    }
    match cycles::get(conn, &cycle.machine, &cycle.id).await? {
        Some(known) if known.hash == new.encoded.hash => Ok(Placed::Known(Box::new(known))),
        Some(known) => Ok(Placed::Done(Committed::Conflict { stored_hash: known.hash })),
        None => Err(crate::error::StoreError::Unavailable("a cycle of the same key came and went".into())),
    }
}

/// Folds what is new into the tools of the group; returns the verdict on each registered tool.
async fn count_all(
    conn: &mut Conn,
    group: &[NewCycle],
    placed: &[Placed],
    registry: &Registry,
    now: Timestamp,
) -> StoreResult<BTreeMap<ToolId, Verdict>> {
    let mut fresh: BTreeMap<&ToolId, BTreeMap<&MachineId, Vec<FactsRow>>> = BTreeMap::new();
    for (new, placed) in group.iter().zip(placed) {
        let cycle = &new.cycle;
        if !registry.tools.contains(&cycle.tool) || matches!(placed, Placed::Done(_)) {
            continue;
        }
        let machines = fresh.entry(&cycle.tool).or_default();
        if let Placed::New(row, _) = placed {
            let facts = FactsRow::of(row, registry.operations.get(&cycle.operation));
            machines.entry(&cycle.machine).or_default().push(facts);
        }
    }
    let mut verdicts = BTreeMap::new();
    for (tool, machines) in fresh {
        let anything_new = !machines.is_empty();
        let verdict = count_tool(conn, tool, machines, now).await?;
        if anything_new {
            alarms::follow_verdict(conn, tool, &verdict, now).await?;
        }
        verdicts.insert(tool.clone(), verdict);
    }
    for (new, placed) in group.iter().zip(placed) {
        if let Placed::New(_, summary) = placed
            && summary.flags.contains(Flag::LoadOver400)
        {
            let message = format!("cycle {}: a load exceeded 400 %", new.cycle.id);
            let (machine, tool) = (&new.cycle.machine, &new.cycle.tool);
            alarms::raise(conn, AlarmKind::Overload, Some(machine), Some(tool), &message, now).await?;
        }
    }
    Ok(verdicts)
}

async fn count_tool(
    conn: &mut Conn,
    tool: &ToolId,
    machines: BTreeMap<&MachineId, Vec<FactsRow>>,
    now: Timestamp,
) -> StoreResult<Verdict> {
    let mut wear = ToolWear::load_locked(conn, tool).await?;
    // An event that names a cycle of this group has just moved from its own time to that cycle's place: every
    // machine's fold changes from the earlier of the two on.
    let mut moved: Option<Place> = None;
    let mut before = wear.events.clone();
    for row in machines.values().flatten() {
        let place = Place::of(&row.order()?);
        for event in before.iter_mut().filter(|event| event.place == place) {
            event.place = Place::at(event.at);
            let from = event.place.clone().min(place.clone());
            moved = Some(moved.map_or(from.clone(), |moved| moved.min(from)));
        }
    }
    before.sort();
    if moved.is_some() && beginning(&before) != beginning(&wear.events) {
        moved = Some(wear::BEGINNING);
    }
    for (machine, mut rows) in machines {
        match &moved {
            None => {
                let mut keyed =
                    rows.drain(..).map(|row| Ok((row.order()?, row))).collect::<StoreResult<Vec<_>>>()?;
                keyed.sort_by(|(a, _), (b, _)| a.cmp(b));
                let rows: Vec<FactsRow> = keyed.into_iter().map(|(_, row)| row).collect();
                wear.count_new(conn, machine, &rows, now).await?;
            }
            Some(moved) => {
                let mut from = moved.clone();
                for row in &rows {
                    from = from.min(Place::of(&row.order()?));
                }
                // The cached fold may end before `from`, and these rows lie beyond its end.
                wear.forget(machine);
                wear.refold(conn, machine, &from, now).await?;
            }
        }
    }
    if let Some(moved) = &moved {
        for machine in wear.machines() {
            wear.refold(conn, &machine, moved, now).await?;
        }
    }
    wear.verdict(conn).await
}

/// A UUIDv7 of the moment: recommendations sort by when they were made.
/// `ending` as the recommendation wants it.
pub(super) fn recommendation_id(now: Timestamp, ending: &str) -> StoreResult<RecommendationId> {
    let micros = u64::try_from(now.micros()).unwrap_or(0);
    let nanos = u32::try_from(micros % 1_000_000 * 1000).unwrap_or(0);
    let time = uuid::Timestamp::from_unix(uuid::NoContext, micros / 1_000_000, nanos);
    crate::rows::id("recommendation_id", &format!("{}{ending}", uuid::Uuid::new_v7(time)))
}

async fn answer(
    conn: &mut Conn,
    cycle: &Cycle,
    (summary, received_at): (CycleSummary, Timestamp),
    registry: &Registry,
    (verdict, knowledge): (Option<&Verdict>, &Knowledge),
    (now, settings): (Timestamp, RecommendSettings),
) -> StoreResult<Box<CycleAnswer>> {
    let verdict = verdict.cloned().unwrap_or_else(wear::not_registered);
    let machine = registry
        .machines
        .get(&cycle.machine)
        .ok_or_else(|| crate::error::StoreError::Damaged { what: "a cycle of no machine".to_owned() })?;
    let operation = registry.operations.get(&cycle.operation);
    let tool_registered = registry.tools.contains(&cycle.tool);
    let recommendation = recommend(&Question {
        now,
        machine,
        operation_id: &cycle.operation,
        operation,
        tool_id: &cycle.tool,
        tool_registered,
        verdict: &verdict,
        knowledge,
        settings,
    });
    let id = recommendation_id(now, recommendation.id_ending())?;
    let recommendation = IssuedRecommendation { id, recommendation };
    recommendations::issue(conn, &recommendation).await?;
    Ok(Box::new(CycleAnswer {
        summary,
        received_at,
        registered: tool_registered && operation.is_some(),
        verdict,
        recommendation,
    }))
}
