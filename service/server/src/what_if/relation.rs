//! Load–feed relations, learned from the first cycles of a tool's life under a key.

use super::cycle::{ContactCycle, IdleLoads, Unusable};
use crate::http::problem::Problem;
use feedwright_core::cycle::Samples;
use feedwright_core::friction::relation::{MOST_BINS, RelationConfig, RelationParams};
use feedwright_core::friction::whatif::LoadRelations;
use feedwright_core::ids::{CycleId, MachineId, OperationId, ToolId};
use feedwright_core::summary::Context;
use feedwright_core::units::{Strategy, Timestamp};
use feedwright_store::{CycleFilter, CycleMeta, Page, Store, StoreResult, StoredCycle, Surroundings};
use std::collections::HashMap;
use std::sync::Arc;

/// Cycles that a relation is learned from: more hardly move it, and the tool has to be new.
pub const MOST_LEARNED: usize = 20;

/// Rows of a tool's life that are looked at for them: a life may begin with other operations' cycles.
pub const MOST_SCANNED: u32 = 500;

/// Events of a tool that are looked at for the beginning of a life: a tool is not changed more often.
const MOST_EVENTS: u32 = 1000;

/// Relative difference of commanded speeds that are one key's.
const SAME_SPEED: f64 = 0.02;

/// Depths that relations reach to, mm: the last is the core's deepest. Which one a cycle is read from depends on nothing but its own
/// depth, so that it is answered the same alone and among others; and they are few, so that cycles of about one depth share one.
const REACHES_MM: [f64; 3] = [64.0, 512.0, 1000.0];

/// What the cycles of a relation have in common. The profile's version is left out on purpose: cycles at other
/// feeds of the same tool are what tells how the loads depend on the feed.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Key {
    machine: MachineId,
    tool: ToolId,
    operation: OperationId,
    speed_bits: Option<u64>,
    strategy: Option<Strategy>,
    law: Option<String>,
    life_began: Option<Timestamp>,
    /// Which of [`REACHES_MM`].
    reach: usize,
}

/// A relation with what it was learned from.
#[derive(Debug, Clone)]
pub struct Learned {
    /// The relation.
    pub relations: LoadRelations,
    /// The cycles it was learned from, oldest first.
    pub from: Vec<CycleId>,
}

/// Cycles of the store with what is needed around them, each relation learned once.
pub struct Library {
    store: Arc<dyn Store>,
    idle: Option<IdleLoads>,
    surroundings: HashMap<(MachineId, OperationId, ToolId), Option<Arc<Surroundings>>>,
    lives: HashMap<ToolId, Vec<Timestamp>>,
    learned: HashMap<Key, Option<Arc<Learned>>>,
}

impl Library {
    /// A library over the store; `idle` holds for every cycle where it is given.
    pub fn new(store: Arc<dyn Store>, idle: Option<IdleLoads>) -> Self {
        Self { store, idle, surroundings: HashMap::new(), lives: HashMap::new(), learned: HashMap::new() }
    }

    /// Machine, calibration and operation of a cycle; `None` where the machine is not registered.
    pub async fn around(&mut self, meta: &CycleMeta) -> StoreResult<Option<Arc<Surroundings>>> {
        let key = (meta.machine.clone(), meta.operation.clone(), meta.tool.clone());
        if let Some(known) = self.surroundings.get(&key) {
            return Ok(known.clone());
        }
        let found = self.store.surroundings(&meta.machine, &meta.operation, &meta.tool).await?;
        // Without the machine's limits nothing is foretold.
        let found = found.filter(|around| around.damaged.is_empty()).map(Arc::new);
        self.surroundings.insert(key, found.clone());
        Ok(found)
    }

    /// A stored cycle, cut to its contact.
    pub async fn contact(&mut self, stored: &StoredCycle) -> Result<Result<ContactCycle, Unusable>, Problem> {
        let meta = &stored.cycle;
        if stored.samples_are_gone() {
            return Ok(Err(Unusable::SamplesDropped));
        }
        if !stored.has_samples {
            return Ok(Err(Unusable::NoSamples));
        }
        let Some(around) = self.around(meta).await? else { return Ok(Err(Unusable::Refused)) };
        let samples = self.store.cycle_samples(&meta.machine, &meta.id).await;
        let samples: Option<Samples> =
            samples.map_err(|error| Problem::of_samples(error, &meta.machine, &meta.id))?;
        // Retention may have come between the two questions.
        let Some(samples) = samples else { return Ok(Err(Unusable::SamplesDropped)) };
        let context = Context {
            machine: &around.machine,
            calibration: around.calibration.as_ref(),
            operation: around.operation.as_ref(),
        };
        Ok(ContactCycle::new(meta, &samples, context, self.idle))
    }

    /// The relation for a cycle; `None` where nothing teaches one.
    pub async fn learned(
        &mut self,
        stored: &StoredCycle,
        cycle: &ContactCycle,
    ) -> Result<Option<Arc<Learned>>, Problem> {
        let meta = &stored.cycle;
        let Some(reach) = REACHES_MM.iter().position(|reach_mm| cycle.deepest_mm() <= *reach_mm) else {
            return Ok(None);
        };
        // A cycle that names no speed ran at its operation's.
        let operation_rpm =
            self.around(meta).await?.and_then(|around| around.operation.as_ref()?.spindle_speed_rpm);
        let key = Key {
            machine: meta.machine.clone(),
            tool: meta.tool.clone(),
            operation: meta.operation.clone(),
            speed_bits: meta.spindle_speed_rpm.or(operation_rpm).map(f64::to_bits),
            strategy: meta.strategy,
            law: meta.law_version.clone(),
            life_began: self.life_of(meta).await?,
            reach,
        };
        if let Some(known) = self.learned.get(&key) {
            return Ok(known.clone());
        }
        let learned =
            self.learn(meta, (operation_rpm, key.life_began), REACHES_MM[reach]).await?.map(Arc::new);
        self.learned.insert(key, learned.clone());
        Ok(learned)
    }

    /// When the life began in which a cycle was run; `None` where no event begins one.
    async fn life_of(&mut self, meta: &CycleMeta) -> StoreResult<Option<Timestamp>> {
        if !self.lives.contains_key(&meta.tool) {
            let page = Page { after: None, limit: MOST_EVENTS };
            let mut begun = Vec::new();
            for stored in self.store.tool_events(&meta.tool, page).await? {
                if stored.revoked.is_some() || !stored.event.kind.begins_life() {
                    continue;
                }
                let first = match &stored.event.first_cycle {
                    Some((machine, id)) => self.store.cycle(machine, id).await?,
                    None => None,
                };
                begun.push(first.map_or(stored.event.at, |first| first.cycle.started_at));
            }
            self.lives.insert(meta.tool.clone(), begun);
        }
        let begun = self.lives.get(&meta.tool).into_iter().flatten();
        Ok(begun.copied().filter(|at| *at <= meta.started_at).max())
    }

    async fn learn(
        &mut self,
        meta: &CycleMeta,
        (operation_rpm, from): (Option<f64>, Option<Timestamp>),
        reach_mm: f64,
    ) -> Result<Option<Learned>, Problem> {
        let filter = CycleFilter {
            machine: Some(meta.machine.clone()),
            tool: Some(meta.tool.clone()),
            operation: Some(meta.operation.clone()),
            from,
            to: None,
        };
        let rows = self.store.cycles(&filter, Page { after: None, limit: MOST_SCANNED }).await?;
        let base = RelationParams::load(reach_mm);
        #[expect(clippy::cast_precision_loss, reason = "512 bins")]
        let narrowest_mm = base.depth_mm / MOST_BINS as f64;
        let params = RelationParams { bin_mm: base.bin_mm.max(narrowest_mm), ..base };
        let Ok(config) = RelationConfig::new(params) else { return Ok(None) };
        let mut relations = LoadRelations::new(config);
        let mut taught = Vec::new();
        for row in rows.iter().filter(|row| is_alike(meta, &row.cycle, operation_rpm)) {
            if taught.len() == MOST_LEARNED {
                break;
            }
            let Ok(cycle) = self.contact(row).await? else { continue };
            if relations.observe(&cycle.core(), cycle.source).is_ok() {
                taught.push(row.cycle.id.clone());
            }
        }
        Ok((!taught.is_empty()).then_some(Learned { relations, from: taught }))
    }
}

/// Whether two cycles of an operation ran alike, at the operation's speed where they name none.
fn is_alike(one: &CycleMeta, other: &CycleMeta, operation_rpm: Option<f64>) -> bool {
    let speed = match (one.spindle_speed_rpm.or(operation_rpm), other.spindle_speed_rpm.or(operation_rpm)) {
        (Some(a), Some(b)) => (a - b).abs() <= SAME_SPEED * a.abs().max(b.abs()),
        (a, b) => a.is_none() && b.is_none(),
    };
    speed && one.strategy == other.strategy && one.law_version == other.law_version
}
