//! The generation of what is registered, and what a group needs of it: from memory where that is of the generation
//! in force, else from the tables.

use super::{Conn, Db, dialect, machines, operations, tools};
use crate::error::StoreResult;
use crate::record::{NewCycle, Surroundings};
use crate::registry::{KnownMachine, Registry};
use feedwright_core::ids::{MachineId, OperationId, ToolId};
use feedwright_core::operation::{DatedOperation, Operation};
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

async fn machine(
    conn: &mut Conn,
    registry: &Registry,
    generation: i64,
    id: &MachineId,
) -> StoreResult<Option<KnownMachine>> {
    if let Some(known) = registry.machine(generation, id) {
        return Ok(Some(known));
    }
    let Some(found) = machines::get(conn, id).await? else {
        return Ok(None);
    };
    let calibration = machines::newest_calibration(conn, id).await?.map(Arc::new);
    let known = KnownMachine { machine: Arc::new(found.value), calibration };
    registry.learn_machine(generation, id, known.clone());
    Ok(Some(known))
}

async fn operation(
    conn: &mut Conn,
    registry: &Registry,
    generation: i64,
    id: &OperationId,
) -> StoreResult<Option<Arc<DatedOperation>>> {
    if let Some(known) = registry.operation(generation, id) {
        return Ok(known);
    }
    let found = operations::dated(conn, id).await?.map(|found| Arc::new(found.value));
    registry.learn_operation(generation, id, found.clone());
    Ok(found)
}

async fn tool(
    conn: &mut Conn,
    registry: &Registry,
    generation: i64,
    id: &ToolId,
) -> StoreResult<Option<Arc<Tool>>> {
    if let Some(known) = registry.tool(generation, id) {
        return Ok(known);
    }
    let found = tools::get(conn, id).await?.map(|found| Arc::new(found.value));
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
    let around = Surroundings {
        machine: (*known.machine).clone(),
        calibration: known.calibration.as_deref().cloned(),
        operation: operation.map(|operation| operation.at(at).into_owned()),
        tool: tool(conn, registry, generation, of_tool).await?.as_deref().cloned(),
    };
    Ok(Some((around, generation)))
}

/// What is registered around a group.
pub(super) struct GroupRegistry {
    pub(super) generation: i64,
    pub(super) machines: BTreeMap<MachineId, KnownMachine>,
    pub(super) operations: BTreeMap<OperationId, Arc<DatedOperation>>,
    pub(super) tools: BTreeSet<ToolId>,
}

impl GroupRegistry {
    /// An operation as it is.
    pub(super) fn operation(&self, id: &OperationId) -> Option<&Operation> {
        self.operations.get(id).map(|known| &***known)
    }

    /// What is around a group, where all of it is in memory.
    pub(super) fn remembered(registry: &Registry, generation: i64, group: &[NewCycle]) -> Option<Self> {
        let mut found = Self {
            generation,
            machines: BTreeMap::new(),
            operations: BTreeMap::new(),
            tools: BTreeSet::new(),
        };
        for cycle in group.iter().map(|new| &new.cycle) {
            if !found.machines.contains_key(&cycle.machine) {
                found.machines.insert(cycle.machine.clone(), registry.machine(generation, &cycle.machine)?);
            }
            if !found.operations.contains_key(&cycle.operation)
                && let Some(known) = registry.operation(generation, &cycle.operation)?
            {
                found.operations.insert(cycle.operation.clone(), known);
            }
            if !found.tools.contains(&cycle.tool) && registry.tool(generation, &cycle.tool)?.is_some() {
                found.tools.insert(cycle.tool.clone());
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
        let mut found = Self {
            generation,
            machines: BTreeMap::new(),
            operations: BTreeMap::new(),
            tools: BTreeSet::new(),
        };
        for id in group.iter().map(|new| &new.cycle.machine).collect::<BTreeSet<_>>() {
            if let Some(known) = machine(conn, registry, generation, id).await? {
                found.machines.insert(id.clone(), known);
            }
        }
        for id in group.iter().map(|new| &new.cycle.operation).collect::<BTreeSet<_>>() {
            if let Some(known) = operation(conn, registry, generation, id).await? {
                found.operations.insert(id.clone(), known);
            }
        }
        for id in group.iter().map(|new| &new.cycle.tool).collect::<BTreeSet<_>>() {
            if tool(conn, registry, generation, id).await?.is_some() {
                found.tools.insert(id.clone());
            }
        }
        Ok(found)
    }
}
