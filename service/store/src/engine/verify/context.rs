//! Machine, operation and fitted lines as they were when a cycle was received, as far as that can be known.

use super::super::{Conn, machines, operations, registry};
use crate::error::{StoreError, StoreResult};
use crate::record::{Page, StoredCalibration, Versioned};
use crate::registry::Found;
use crate::rows::CycleRow;
use feedwright_core::cycle::{Cycle, Flag};
use feedwright_core::ids::{MachineId, OperationId};
use feedwright_core::machine::{Calibration, Machine};
use feedwright_core::operation::{DatedOperation, Operation};
use feedwright_core::units::Timestamp;
use std::collections::HashMap;
use std::sync::Arc;

/// How far the clocks of several servers may be apart, or that of one may have been off, µs, as for retention and events. What changed
/// within it may have changed before or after.
const CLOCKS_APART_US: i64 = 600_000_000;

/// What was read already: a page has many cycles of few machines and operations.
#[derive(Default)]
pub(super) struct Contexts {
    machines: HashMap<MachineId, Arc<Around>>,
    operations: HashMap<OperationId, Found<Arc<Versioned<DatedOperation>>>>,
}

struct Around {
    /// Of one that is damaged nothing is known.
    machine: Versioned<Machine>,
    /// Oldest first.
    calibrations: Vec<StoredCalibration>,
    /// Whether the machine or fitted lines are not what was written.
    is_damaged: bool,
}

/// What a summary rests on besides its cycle.
pub(super) struct Known {
    around: Arc<Around>,
    calibration: Option<usize>,
    /// As it was when the cycle began.
    operation: Option<Operation>,
    /// Whether it is what was in force when the cycle was received.
    pub(super) same: bool,
}

/// When something changed, beside when a cycle was received.
#[derive(PartialEq, Eq)]
enum When {
    Before,
    About,
    After,
}

fn when(changed: Timestamp, received_us: i64) -> When {
    match changed.micros().saturating_sub(received_us) {
        later if later > CLOCKS_APART_US => When::After,
        later if later < -CLOCKS_APART_US => When::Before,
        _ => When::About,
    }
}

impl Known {
    pub(super) fn machine(&self) -> &Machine {
        &self.around.machine.value
    }

    pub(super) fn calibration(&self) -> Option<&Calibration> {
        self.calibration.and_then(|at| self.around.calibrations.get(at)).map(|fitted| &fitted.calibration)
    }

    pub(super) fn operation(&self) -> Option<&Operation> {
        self.operation.as_ref()
    }
}

impl Contexts {
    /// What was in force when the cycle was received; what is in force now where that is not known any more.
    pub(super) async fn of(&mut self, conn: &mut Conn, row: &CycleRow, cycle: &Cycle) -> StoreResult<Known> {
        let around = self.around(conn, &cycle.machine).await?;
        let operation = self.operation(conn, &cycle.operation).await?;
        let received = row.received_at_us;
        // No cycle comes before its machine is registered: the first version was in force from the first cycle on.
        let machine = &around.machine;
        let mut same = machine.version == 1 || when(machine.updated_at, received) == When::Before;
        same &= !around.is_damaged;
        let mut calibration = None;
        for (at, fitted) in around.calibrations.iter().enumerate() {
            match when(fitted.fitted_at, received) {
                When::Before => calibration = Some(at),
                When::About => same = false,
                When::After => {}
            }
        }
        let unregistered = row.flags & Flag::OperationUnregistered as i64 != 0;
        let operation = match operation {
            Found::Absent => None,
            Found::Damaged(_) => {
                // Received while it was damaged, a cycle is flagged as of one that is not registered.
                same &= unregistered;
                None
            }
            // Registered by then or not: the flag says so, whatever clock told when. Its first version, and one that was there
            // before, is the one that was in force.
            Found::Sound(_) if unregistered => None,
            Found::Sound(operation) => {
                same &= operation.version == 1 || when(operation.updated_at, received) == When::Before;
                Some(operation.value.at(cycle.started_at).into_owned())
            }
        };
        Ok(Known { around, calibration, operation, same })
    }

    async fn around(&mut self, conn: &mut Conn, id: &MachineId) -> StoreResult<Arc<Around>> {
        if let Some(known) = self.machines.get(id) {
            return Ok(known.clone());
        }
        let mut is_damaged = false;
        let machine = match registry::to_decide_by(machines::get(conn, id).await)? {
            Found::Sound(machine) => machine,
            Found::Absent => {
                return Err(StoreError::Damaged { what: format!("its machine `{id}` is not there") });
            }
            Found::Damaged(_) => {
                is_damaged = true;
                let (value, updated_at) = (Machine::unknown(id.clone()), Timestamp::from_micros(0));
                Versioned { value, version: 0, updated_at, is_damaged }
            }
        };
        let all = Page { after: None, limit: u32::MAX };
        let calibrations = match machines::calibrations(conn, id, &all).await {
            Err(StoreError::Damaged { .. }) => {
                is_damaged = true;
                Vec::new()
            }
            calibrations => calibrations?,
        };
        is_damaged |= calibrations.iter().any(|fitted| fitted.is_damaged);
        let around = Arc::new(Around { machine, calibrations, is_damaged });
        self.machines.insert(id.clone(), around.clone());
        Ok(around)
    }

    async fn operation(
        &mut self,
        conn: &mut Conn,
        id: &OperationId,
    ) -> StoreResult<Found<Arc<Versioned<DatedOperation>>>> {
        if let Some(known) = self.operations.get(id) {
            return Ok(known.clone());
        }
        let operation = registry::to_decide_by(operations::dated(conn, id).await)?.map(Arc::new);
        self.operations.insert(id.clone(), operation.clone());
        Ok(operation)
    }
}
