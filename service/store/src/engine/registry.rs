//! The generation of what is registered, and what a group needs of it: from memory where that is of the generation
//! in force, else from the tables.

use super::{Conn, Db, dialect, machines, operations, tools};
use crate::error::{StoreError, StoreResult};
use crate::record::{NewCycle, Surroundings, Versioned};
use crate::registry::{Found, KnownMachine, Registry};
use feedwright_core::cycle::Cycle;
use feedwright_core::ids::{MachineId, OperationId, ToolId};
use feedwright_core::machine::Machine;
use feedwright_core::operation::{DatedOperation, Operation};
use feedwright_core::recommend::Damaged;
use feedwright_core::tool::Tool;
use feedwright_core::units::Timestamp;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

/// The generation in force, as this transaction sees it.
async fn generation(conn: &mut Conn, registry: &Registry) -> StoreResult<i64> {
    let sql = concat!(
        "SELECT ",
        dialect::incarnation!(),
        ", CAST(SUM(changes) AS BIGINT) FROM registry_generation"
    );
    let (server, changes) = sqlx::query_as::<Db, _>(sql).fetch_one(&mut *conn).await?;
    Ok(registry.generation(server, changes))
}

/// Rows that changes are counted in.
const ROWS: i64 = 16;

/// Begins the next generation. The last statement of a change: whoever else counts in the same row waits for its end.
pub(super) async fn changed(conn: &mut Conn) -> StoreResult<()> {
    static NEXT: AtomicI64 = AtomicI64::new(0);
    let row = NEXT.fetch_add(1, Ordering::Relaxed).rem_euclid(ROWS);
    sqlx::query::<Db>("UPDATE registry_generation SET changes = changes + 1 WHERE registry_id = $1")
        .bind(row)
        .execute(&mut *conn)
        .await?;
    Ok(())
}

/// What was read of a name, to decide by. A row that does not decode is as damaged as one whose sum is another.
pub(super) fn to_decide_by<T>(read: StoreResult<Option<Versioned<T>>>) -> StoreResult<Found<Versioned<T>>> {
    match read {
        Ok(None) => Ok(Found::Absent),
        Ok(Some(found)) if found.is_damaged => Ok(Found::Damaged(Some(found))),
        Ok(Some(found)) => Ok(Found::Sound(found)),
        Err(StoreError::Damaged { .. }) => Ok(Found::Damaged(None)),
        Err(error) => Err(error),
    }
}

/// What a put finds of its name.
pub(super) struct Existing<T> {
    pub(super) version: u64,
    /// None where it does not decode.
    pub(super) value: Option<T>,
    pub(super) updated_at: Option<Timestamp>,
    /// Whether it is not what was written: then whatever is put is another content.
    pub(super) is_damaged: bool,
}

impl<T: PartialEq> Existing<T> {
    /// As a put is decided: its version, and whether it is that.
    pub(super) fn held(&self, put: &T) -> (u64, bool) {
        (self.version, !self.is_damaged && self.value.as_ref() == Some(put))
    }
}

/// What was read of a name that is put; of what does not decode its version alone.
pub(super) async fn existing<T>(
    conn: &mut Conn,
    read: StoreResult<Option<Versioned<T>>>,
    (kind, id): (&str, &str),
) -> StoreResult<Option<Existing<T>>> {
    let damaged = match read {
        Ok(found) => {
            return Ok(found.map(|found| Existing {
                version: found.version,
                value: Some(found.value),
                updated_at: Some(found.updated_at),
                is_damaged: found.is_damaged,
            }));
        }
        Err(error @ StoreError::Damaged { .. }) => error,
        Err(error) => return Err(error),
    };
    let sql = match kind {
        "machines" => "SELECT version FROM machines WHERE machine_id = $1",
        "tools" => "SELECT version FROM tools WHERE tool_id = $1",
        "operations" => "SELECT version FROM operations WHERE operation_id = $1",
        "turning models" => "SELECT version FROM models WHERE kind = 'turning' AND model_id = $1",
        "plunge models" => "SELECT version FROM models WHERE kind = 'plunge' AND model_id = $1",
        _ => return Err(damaged),
    };
    let version: Option<i64> = sqlx::query_scalar::<Db, _>(sql).bind(id).fetch_optional(&mut *conn).await?;
    let version = version.and_then(|version| u64::try_from(version).ok()).ok_or(damaged)?;
    Ok(Some(Existing { version, value: None, updated_at: None, is_damaged: true }))
}

/// A machine with its newest fitted lines, to decide by.
pub(super) async fn machine_to_decide_by(
    conn: &mut Conn,
    id: &MachineId,
) -> StoreResult<Option<KnownMachine>> {
    let mut damaged = Vec::new();
    let machine = match to_decide_by(machines::get(conn, id).await)? {
        Found::Absent => return Ok(None),
        Found::Sound(found) => found.value,
        Found::Damaged(_) => {
            damaged.push(Damaged::Machine);
            Machine::unknown(id.clone())
        }
    };
    let calibration = match machines::newest_calibration(conn, id).await {
        Ok(Some(found)) if !found.is_damaged => Some(Arc::new(found.calibration)),
        Ok(None) => None,
        Ok(Some(_)) | Err(StoreError::Damaged { .. }) => {
            damaged.push(Damaged::Calibration);
            None
        }
        Err(error) => return Err(error),
    };
    Ok(Some(KnownMachine { machine: Arc::new(machine), calibration, damaged }))
}

async fn machine(
    conn: &mut Conn,
    registry: &Registry,
    generation: i64,
    id: &MachineId,
) -> StoreResult<Option<KnownMachine>> {
    if let Some(known) = registry.machine(generation, id) {
        return Ok(Some(known));
    }
    let Some(known) = machine_to_decide_by(conn, id).await? else {
        return Ok(None);
    };
    tell(&known.damaged, id.as_str());
    registry.learn_machine(generation, id, known.clone());
    Ok(Some(known))
}

/// Tells of what is damaged, as often as it is read anew.
fn tell(damaged: &[Damaged], id: &str) {
    for what in damaged {
        let what = what.as_str();
        tracing::error!(
            id,
            "what is stored of the {what} is damaged, and nothing is decided by it: put it anew"
        );
    }
}

async fn operation(
    conn: &mut Conn,
    registry: &Registry,
    generation: i64,
    id: &OperationId,
) -> StoreResult<Found<Arc<DatedOperation>>> {
    if let Some(known) = registry.operation(generation, id) {
        return Ok(known);
    }
    let mut found = to_decide_by(operations::dated(conn, id).await)?.map(|found| Arc::new(found.value));
    if found.is_damaged() {
        tell(&[Damaged::Operation], id.as_str());
    }
    if found == Found::Damaged(None) {
        found = Found::Damaged(operations::as_folds_read_it(conn, id).await?.map(Arc::new));
    }
    registry.learn_operation(generation, id, found.clone());
    Ok(found)
}

async fn tool(
    conn: &mut Conn,
    registry: &Registry,
    generation: i64,
    id: &ToolId,
) -> StoreResult<Found<Arc<Tool>>> {
    if let Some(known) = registry.tool(generation, id) {
        return Ok(known);
    }
    let found = to_decide_by(tools::get(conn, id).await)?.map(|found| Arc::new(found.value));
    if found.is_damaged() {
        tell(&[Damaged::Tool], id.as_str());
    }
    registry.learn_tool(generation, id, found.clone());
    Ok(found)
}

/// Reads what is around a cycle that began at a time in one snapshot, and keeps it.
pub(super) async fn around(
    conn: &mut Conn,
    registry: &Registry,
    (of_machine, of_operation, of_tool): (&MachineId, &OperationId, &ToolId),
    at: Timestamp,
) -> StoreResult<Option<(Surroundings, i64)>> {
    let generation = generation(conn, registry).await?;
    let Some(known) = machine(conn, registry, generation, of_machine).await? else {
        return Ok(None);
    };
    let operation = operation(conn, registry, generation, of_operation).await?;
    let operation = operation.map(|operation| operation.at(at).into_owned());
    let tool = tool(conn, registry, generation, of_tool).await?.map(|tool| (*tool).clone());
    let around = crate::registry::surroundings(&known, operation, tool);
    Ok(Some((around, generation)))
}

/// What is registered around a group.
#[derive(Default)]
pub(super) struct GroupRegistry {
    pub(super) generation: i64,
    pub(super) machines: BTreeMap<MachineId, KnownMachine>,
    /// Those that are sound.
    pub(super) operations: BTreeMap<OperationId, Arc<DatedOperation>>,
    /// Sound and damaged ones.
    pub(super) tools: BTreeSet<ToolId>,
    /// As they stand, where they decode.
    damaged_operations: BTreeMap<OperationId, Option<Arc<DatedOperation>>>,
    damaged_tools: BTreeSet<ToolId>,
}

impl GroupRegistry {
    /// An operation as it is.
    pub(super) fn operation(&self, id: &OperationId) -> Option<&Operation> {
        self.operations.get(id).map(|known| &***known)
    }

    /// An operation as its row stands: a fold that is made of what is stored goes by that too.
    pub(super) fn as_it_stands(&self, id: &OperationId) -> Option<&DatedOperation> {
        let damaged = || self.damaged_operations.get(id)?.as_deref();
        self.operations.get(id).map(AsRef::as_ref).or_else(damaged)
    }

    fn add_operation(&mut self, id: &OperationId, found: Found<Arc<DatedOperation>>) {
        match found {
            Found::Absent => {}
            Found::Sound(known) => {
                self.operations.insert(id.clone(), known);
            }
            Found::Damaged(known) => {
                self.damaged_operations.insert(id.clone(), known);
            }
        }
    }

    fn add_tool(&mut self, id: &ToolId, found: &Found<Arc<Tool>>) {
        if found.is_damaged() {
            self.damaged_tools.insert(id.clone());
        }
        if *found != Found::Absent {
            self.tools.insert(id.clone());
        }
    }

    /// What is damaged of a cycle's machine, operation and tool.
    pub(super) fn damaged(&self, cycle: &Cycle) -> Vec<Damaged> {
        let mut damaged =
            self.machines.get(&cycle.machine).map(|known| known.damaged.clone()).unwrap_or_default();
        if self.damaged_operations.contains_key(&cycle.operation) {
            damaged.push(Damaged::Operation);
        }
        if self.damaged_tools.contains(&cycle.tool) {
            damaged.push(Damaged::Tool);
        }
        damaged
    }

    /// What is around a group, where all of it is in memory.
    pub(super) fn remembered(registry: &Registry, generation: i64, group: &[NewCycle]) -> Option<Self> {
        let mut found = Self { generation, ..Self::default() };
        for cycle in group.iter().map(|new| &new.cycle) {
            if !found.machines.contains_key(&cycle.machine) {
                found.machines.insert(cycle.machine.clone(), registry.machine(generation, &cycle.machine)?);
            }
            if !found.operations.contains_key(&cycle.operation) {
                found.add_operation(&cycle.operation, registry.operation(generation, &cycle.operation)?);
            }
            if !found.tools.contains(&cycle.tool) {
                found.add_tool(&cycle.tool, &registry.tool(generation, &cycle.tool)?);
            }
        }
        Some(found)
    }

    pub(super) async fn load(
        conn: &mut Conn,
        registry: &Registry,
        generation: i64,
        group: &[NewCycle],
    ) -> StoreResult<Self> {
        let mut found = Self { generation, ..Self::default() };
        for id in group.iter().map(|new| &new.cycle.machine).collect::<BTreeSet<_>>() {
            if let Some(known) = machine(conn, registry, generation, id).await? {
                found.machines.insert(id.clone(), known);
            }
        }
        for id in group.iter().map(|new| &new.cycle.operation).collect::<BTreeSet<_>>() {
            found.add_operation(id, operation(conn, registry, generation, id).await?);
        }
        for id in group.iter().map(|new| &new.cycle.tool).collect::<BTreeSet<_>>() {
            found.add_tool(id, &tool(conn, registry, generation, id).await?);
        }
        Ok(found)
    }
}
