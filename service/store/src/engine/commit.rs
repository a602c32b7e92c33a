//! A group of cycles in one transaction: stored or known, folded, alarmed, answered.

use super::memory::Memory;
use super::registry::GroupRegistry;
use super::transaction::GroupTransaction;
use super::wear::{self, Budget, Heads, ToolWear, Versions};
use super::{Conn, Writer, alarms, cycles, dialect, feed_profiles, models};
use crate::codec;
use crate::error::{StoreError, StoreResult};
use crate::history::beginning;
use crate::locks::Locks;
use crate::record::{
    ActiveProfiles, AlarmKind, Committed, ContentHash, CycleAnswer, IssuedRecommendation, NewCycle,
    StoredCycle,
};
use crate::registry::Registry;
use crate::rows::{AlarmChange, BlockRow, CutRow, CycleRow, FactsRow, IssuedRow, Place, Rest, SavedWear};
use crate::work::Written;
use feedwright_core::cycle::{Cycle, Flag};
use feedwright_core::ids::{CycleId, MachineId, OperationId, RecommendationId, ToolId};
use feedwright_core::recommend::{Damaged, Knowledge, Question, RecommendSettings, recommend};
use feedwright_core::summary::{Context, CycleSummary, summarise};
use feedwright_core::units::Timestamp;
use feedwright_core::wear::Verdict;
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::sync::{Arc, LazyLock};

/// What became of one cycle before it is answered.
enum Placed {
    New(Arc<CycleRow>, Box<CycleSummary>),
    Known(Box<StoredCycle>),
    Done(Committed),
}

/// What a group came to.
pub(super) struct Counted {
    /// In the order of the group.
    pub(super) answers: Vec<Committed>,
    /// Whether it raises or clears alarms, or would where they are not open already.
    pub(super) changes_alarms: bool,
}

/// What a group locks before it is asked for anything.
pub(super) fn locks(group: &[NewCycle]) -> Locks {
    let cycles = || group.iter().map(|new| &new.cycle);
    Locks::group(
        cycles().map(|cycle| &cycle.machine),
        cycles().map(|cycle| &cycle.operation),
        cycles().map(|cycle| &cycle.tool),
    )
}

/// Commits a group, whose locks are taken: answers stand in the order of the group. What `memory` holds is true after the commit
/// only.
pub(super) async fn group(
    writer: &mut Writer,
    group: &[NewCycle],
    now: Timestamp,
    settings: RecommendSettings,
    (registry, memory): (&Registry, &mut Memory),
) -> StoreResult<(Counted, Written)> {
    let tools: BTreeSet<_> = group.iter().map(|new| &new.cycle.tool).collect();
    if dialect::MAY_ASSUME
        && let Some((heads, around)) = memory.assume(registry, group)
        && let Some(assumption) = dialect::assume(&heads, &tools)
    {
        let mut transaction = GroupTransaction::assumed(writer, assumption);
        let outcome = count(&mut transaction, group, (now, settings), (&heads, &around, memory)).await;
        if !transaction.is_refuted() {
            return outcome;
        }
        dialect::undo(writer).await;
        memory.doubt(group);
    }
    let conn = dialect::asked(writer)?;
    // Asked under the locks of `locks`: who changes what this group rests on waits for its end, or has ended before.
    let heads = wear::heads(conn, registry, &tools).await?;
    let around = GroupRegistry::load(conn, registry, heads.generation, group).await?;
    let mut transaction = GroupTransaction::begun(conn, heads.is_distributed);
    count(&mut transaction, group, (now, settings), (&heads, &around, memory)).await
}

/// Places, folds, answers and writes a group under its heads.
async fn count(
    transaction: &mut GroupTransaction<'_>,
    group: &[NewCycle],
    (now, settings): (Timestamp, RecommendSettings),
    (heads, registry, memory): (&Heads, &GroupRegistry, &mut Memory),
) -> StoreResult<(Counted, Written)> {
    memory.begin(heads);
    let (placed, blocks) = place_all(transaction, group, registry).await?;
    let (verdicts, wear, alarms) =
        count_all(transaction, group, &placed, (registry, &heads.versions, memory)).await?;
    let knowledge = know_all(transaction, group, (registry, memory), heads.any_profile).await?;
    let mut answers = Vec::with_capacity(group.len());
    let mut issued = Vec::with_capacity(group.len());
    for (new, placed) in group.iter().zip(placed) {
        let (summary, received_at, stored) = match placed {
            Placed::Done(committed) => {
                answers.push(committed);
                continue;
            }
            Placed::New(_, summary) => (*summary, new.received_at, true),
            Placed::Known(known) => (known.summary, known.received_at, false),
        };
        let known = knowledge.get(&(&new.cycle.operation, &new.cycle.tool)).unwrap_or(&UNKNOWN);
        let tool = (verdicts.get(&new.cycle.tool), known);
        let answer = answer(&new.cycle, (summary, received_at), registry, tool, (now, settings))?;
        let advice = memory.advice_of(&answer.recommendation.recommendation)?;
        issued.push(IssuedRow::of(&answer.recommendation, advice)?);
        answers.push(if stored { Committed::Stored(answer) } else { Committed::Known(answer) });
    }
    let changes_alarms = !alarms.is_empty();
    let rest = Rest::of(blocks, (wear, alarms), issued, |row| memory.is_new_advice(row.advice.hash));
    let written = transaction.write(&rest, now).await?;
    Ok((Counted { answers, changes_alarms }, written))
}

/// What is known for an operation with a tool: for its process, and its active feed profiles.
struct Known {
    process: Knowledge,
    profiles: Arc<ActiveProfiles>,
}

static UNKNOWN: LazyLock<Known> =
    LazyLock::new(|| Known { process: Knowledge::None, profiles: Arc::default() });

/// What the processes of a group need to know, once per operation and tool: the whole group is placed by now.
async fn know_all<'a>(
    transaction: &mut GroupTransaction<'_>,
    group: &'a [NewCycle],
    (registry, memory): (&GroupRegistry, &mut Memory),
    any_profile: bool,
) -> StoreResult<BTreeMap<(&'a OperationId, &'a ToolId), Known>> {
    let mut known = BTreeMap::new();
    for cycle in group.iter().map(|new| &new.cycle) {
        let key = (&cycle.operation, &cycle.tool);
        if let Entry::Vacant(unknown) = known.entry(key) {
            let operation = registry.operation(&cycle.operation);
            let process = if operation.is_some_and(models::are_needed) {
                models::knowledge(transaction.conn().await?, operation, &cycle.tool).await?
            } else {
                Knowledge::None
            };
            let remembered = || memory.profiles(&cycle.operation, &cycle.tool);
            let profiles = match any_profile.then(remembered) {
                None => Arc::default(),
                Some(Some(profiles)) => profiles,
                Some(None) => {
                    let conn = transaction.conn().await?;
                    let active = feed_profiles::active(conn, &cycle.operation, &cycle.tool).await?;
                    let active = Arc::new(active);
                    // Where a group may not be taken for granted, a server of before may change what is active.
                    if dialect::MAY_ASSUME {
                        memory.keep_profiles(&cycle.operation, &cycle.tool, &active);
                    }
                    active
                }
            };
            unknown.insert(Known { process, profiles });
        }
    }
    Ok(known)
}

/// Stores what is new of the group, and tells the rest from it; with the blocks of samples that are to be written.
async fn place_all<'a>(
    transaction: &mut GroupTransaction<'_>,
    group: &'a [NewCycle],
    registry: &GroupRegistry,
) -> StoreResult<(Vec<Placed>, Vec<BlockRow<'a>>)> {
    // Ascending keys, so that two servers with the same cycles cannot wait for each other.
    let mut rows: BTreeMap<(&MachineId, &CycleId), (usize, Arc<CycleRow>, CycleSummary)> = BTreeMap::new();
    for (index, new) in group.iter().enumerate() {
        let cycle = &new.cycle;
        if !registry.machines.contains_key(&cycle.machine) {
            continue;
        }
        // Of two with one key in one group the first is the one that is stored.
        if let Entry::Vacant(first) = rows.entry((&cycle.machine, &cycle.id)) {
            let summary = summary_of(new, registry)?;
            first.insert((index, Arc::new(CycleRow::of(new, &summary)?.in_range()?), summary));
        }
    }
    let keyed: Vec<Arc<CycleRow>> = rows.values().map(|(_, row, _)| Arc::clone(row)).collect();
    let known_before: HashSet<(String, String)> = if transaction.takes_as_new(&keyed) {
        HashSet::new()
    } else {
        dialect::insert_cycles(transaction.conn().await?, &keyed).await?.into_iter().collect()
    };
    let is_new = |row: &CycleRow| {
        known_before.is_empty() || !known_before.contains(&(row.machine_id.clone(), row.cycle_id.clone()))
    };
    let fresh: Vec<_> = rows.into_values().filter(|(_, row, _)| is_new(row)).collect();
    let mut blocks = Vec::with_capacity(fresh.len());
    for (index, row, _) in &fresh {
        let block = group[*index].encoded.samples.as_deref();
        blocks.extend(block.map(|block| BlockRow::of(row, block)).transpose()?);
    }
    for (index, _, _) in &fresh {
        if let Some(cut) = CutRow::of(&group[*index].cycle)? {
            models::insert_cut(transaction.conn().await?, &cut).await?;
        }
    }
    let mut placed: Vec<Option<Placed>> = group.iter().map(|_| None).collect();
    for (index, row, summary) in fresh {
        placed[index] = Some(Placed::New(row, Box::new(summary)));
    }
    let mut all = Vec::with_capacity(group.len());
    for (new, placed) in group.iter().zip(placed) {
        all.push(match placed {
            Some(placed) => placed,
            None if !registry.machines.contains_key(&new.cycle.machine) => {
                Placed::Done(Committed::UnknownMachine)
            }
            None => known(transaction.conn().await?, new).await?,
        });
    }
    Ok((all, blocks))
}

/// The summary of a cycle that is stored now: under another generation of the registry than it was made under, it is
/// made again, so that it rests on what is in force.
fn summary_of(new: &NewCycle, registry: &GroupRegistry) -> StoreResult<CycleSummary> {
    let cycle = &new.cycle;
    let again = new.generation.filter(|generation| *generation != registry.generation);
    let mut summary = match (again, registry.machines.get(&cycle.machine)) {
        (Some(_), Some(known)) => {
            let operation = registry.operations.get(&cycle.operation).map(|known| known.at(cycle.started_at));
            let context = Context {
                machine: &known.machine,
                calibration: known.calibration.as_deref(),
                operation: operation.as_deref(),
            };
            summarise(&with_samples(new)?, context)
        }
        _ => new.summary.clone(),
    };
    summary.flags.insert_if(!registry.tools.contains(&cycle.tool), Flag::ToolUnregistered);
    summary.flags.insert_if(new.cut_short, Flag::Incomplete);
    summary.flags.insert_if(new.cut_short, Flag::CutShort);
    Ok(summary)
}

/// A cycle whose key is stored already: known, or in conflict.
async fn known(conn: &mut Conn, new: &NewCycle) -> StoreResult<Placed> {
    let cycle = &new.cycle;
    match cycles::get(conn, &cycle.machine, &cycle.id).await? {
        Some(known) if is_content_of(&known.hash, new)? => Ok(Placed::Known(Box::new(known))),
        Some(known) => Ok(Placed::Done(Committed::Conflict { stored_hash: known.hash })),
        None => Err(StoreError::Unavailable("a cycle of the same key came and went".into())),
    }
}

/// Whether a stored hash, of whichever version, is that of this cycle.
fn is_content_of(stored: &ContentHash, new: &NewCycle) -> StoreResult<bool> {
    if *stored == new.encoded.hash {
        return Ok(true);
    }
    // A conflict, which is rare, or what an earlier version of the hash was stored of.
    Ok(codec::is_hash_of(stored, &with_samples(new)?))
}

/// The cycle with its samples, which are in its block.
fn with_samples(new: &NewCycle) -> StoreResult<Cycle> {
    let block = new.encoded.samples.as_deref();
    let samples = block.map(|block| codec::decode_samples(block, usize::MAX)).transpose()?;
    Ok(Cycle::clone(&new.cycle).with_samples(samples))
}

/// Folds what is new into the tools of the group; returns the verdict on each registered tool, and the folds and alarms to
/// write.
async fn count_all(
    transaction: &mut GroupTransaction<'_>,
    group: &[NewCycle],
    placed: &[Placed],
    (registry, versions, memory): (&GroupRegistry, &BTreeMap<ToolId, Versions>, &mut Memory),
) -> StoreResult<(BTreeMap<ToolId, Arc<Verdict>>, Vec<Arc<SavedWear>>, Vec<AlarmChange>)> {
    let mut fresh: BTreeMap<&ToolId, BTreeMap<&MachineId, Vec<FactsRow>>> = BTreeMap::new();
    for (new, placed) in group.iter().zip(placed) {
        let cycle = &new.cycle;
        if !registry.tools.contains(&cycle.tool) || matches!(placed, Placed::Done(_)) {
            continue;
        }
        let machines = fresh.entry(&cycle.tool).or_default();
        if let Placed::New(row, summary) = placed {
            let facts = FactsRow::of(row, summary, registry.as_it_stands(&cycle.operation));
            machines.entry(&cycle.machine).or_default().push(facts);
        }
    }
    let mut verdicts = BTreeMap::new();
    let (mut changed, mut alarms) = (Vec::new(), Vec::new());
    // Of all of its tools together: whoever posts waits for all of them.
    let mut budget = Budget::at_once();
    for (tool, machines) in fresh {
        let anything_new = !machines.is_empty();
        let mut wear = match memory.take(tool, versions.get(tool)) {
            Some(wear) => wear,
            None => ToolWear::load_locked(transaction.conn().await?, tool, &mut budget).await?,
        };
        let verdict = count_tool(transaction, &mut wear, machines, &mut budget).await?;
        let folds = wear.take_changed()?;
        // Folds of earlier rules are made anew by a repeat too, and nobody comes to them later.
        if (anything_new || !folds.is_empty()) && !verdict.is_being_counted() {
            let open = match &mut wear.alarms {
                Some(open) => open,
                unknown => unknown.insert(alarms::open_of(transaction.conn().await?, tool).await?),
            };
            alarms.extend(alarms::changes(tool, &verdict, open));
        }
        verdicts.insert(tool.clone(), Arc::new(verdict));
        changed.extend(folds);
        memory.keep(tool.clone(), wear);
    }
    for (new, placed) in group.iter().zip(placed) {
        if let Placed::New(_, summary) = placed
            && summary.flags.contains(Flag::LoadOver400)
        {
            let message = format!("cycle {}: a load exceeded 400 %", new.cycle.id);
            let (machine, tool) = (&new.cycle.machine, &new.cycle.tool);
            alarms.push(AlarmChange::raise(AlarmKind::Overload, Some(machine), Some(tool), message));
        }
    }
    Ok((verdicts, changed, alarms))
}

async fn count_tool(
    transaction: &mut GroupTransaction<'_>,
    wear: &mut ToolWear,
    machines: BTreeMap<&MachineId, Vec<FactsRow>>,
    budget: &mut Budget,
) -> StoreResult<Verdict> {
    // An event that names a cycle of this group has just moved from its own time to that cycle's place: every
    // machine's fold changes from the earlier of the two on.
    let mut moved: Option<Place> = None;
    let mut before = wear.events.clone();
    // Others are at a time, which is no cycle's place.
    let names_cycles = before.iter().any(|event| event.place.cycle.is_some());
    for row in machines.values().flatten().filter(|_| names_cycles) {
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
                if rows.len() > 1 {
                    let keyed = rows.into_iter().map(|row| Ok((row.order()?, row)));
                    let mut keyed = keyed.collect::<StoreResult<Vec<_>>>()?;
                    keyed.sort_by(|(a, _), (b, _)| a.cmp(b));
                    rows = keyed.into_iter().map(|(_, row)| row).collect();
                }
                wear.count_new(transaction, machine, &rows, budget).await?;
            }
            Some(moved) => {
                let mut from = moved.clone();
                for row in &rows {
                    from = from.min(Place::of(&row.order()?));
                }
                // The cached fold may end before `from`, and these rows lie beyond its end.
                wear.forget(machine);
                let new = (&from, rows.len() as u64);
                wear.refold(transaction.conn().await?, machine, new, budget).await?;
            }
        }
    }
    if let Some(moved) = &moved {
        for machine in wear.machines() {
            wear.refold(transaction.conn().await?, &machine, (moved, 0), budget).await?;
        }
    }
    if wear.is_unreadable() {
        wear.refold_unreadable(transaction.conn().await?, budget).await?;
    }
    match wear.known_verdict() {
        Some(verdict) => Ok(verdict),
        None => wear.verdict(transaction.conn().await?, budget).await,
    }
}

/// A UUIDv7 of the moment: recommendations sort by when they were made.
/// `ending` as the recommendation wants it.
pub(super) fn recommendation_id(now: Timestamp, ending: &str) -> StoreResult<RecommendationId> {
    let micros = u64::try_from(now.micros()).unwrap_or(0);
    let nanos = u32::try_from(micros % 1_000_000 * 1000).unwrap_or(0);
    let time = uuid::Timestamp::from_unix(uuid::NoContext, micros / 1_000_000, nanos);
    crate::rows::id("recommendation_id", &format!("{}{ending}", uuid::Uuid::new_v7(time)))
}

fn answer(
    cycle: &Cycle,
    (summary, received_at): (CycleSummary, Timestamp),
    registry: &GroupRegistry,
    (verdict, known): (Option<&Arc<Verdict>>, &Known),
    (now, settings): (Timestamp, RecommendSettings),
) -> StoreResult<Box<CycleAnswer>> {
    let verdict = verdict.cloned().unwrap_or_else(|| Arc::new(wear::not_registered()));
    let machine = registry
        .machines
        .get(&cycle.machine)
        .map(|known| &*known.machine)
        .ok_or_else(|| StoreError::Damaged { what: "a cycle of no machine".to_owned() })?;
    let operation = registry.operation(&cycle.operation);
    let tool_registered = registry.tools.contains(&cycle.tool);
    let mut damaged = registry.damaged(cycle);
    if known.profiles.are_damaged {
        damaged.push(Damaged::FeedProfile);
    }
    let recommendation = recommend(&Question {
        now,
        machine,
        operation_id: &cycle.operation,
        operation,
        tool_id: &cycle.tool,
        tool_registered,
        verdict: &verdict,
        knowledge: &known.process,
        profiles: &known.profiles.profiles,
        ran: cycle.profile.as_ref(),
        damaged: &damaged,
        settings,
    });
    let id = recommendation_id(now, recommendation.id_ending())?;
    let recommendation = IssuedRecommendation { id, recommendation };
    Ok(Box::new(CycleAnswer {
        summary,
        received_at,
        registered: tool_registered && operation.is_some(),
        verdict,
        recommendation,
    }))
}
