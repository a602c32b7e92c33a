//! Rows of the fleet's last cycles.

use super::{FactsRow, id, word};
use crate::error::StoreResult;
use crate::record::FleetCycle;
use feedwright_core::cycle::Outcome;
use feedwright_core::units::Timestamp;

/// A cycle with what a glance needs of it.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct FleetCycleRow {
    #[sqlx(flatten)]
    pub(crate) facts: FactsRow,
    tool_id: String,
    received_at_us: i64,
    outcome: String,
}

impl FleetCycleRow {
    pub(crate) fn cycle(&self) -> StoreResult<FleetCycle> {
        let (facts, settings) = self.facts.facts()?;
        Ok(FleetCycle {
            facts,
            settings,
            tool: id("tool_id", &self.tool_id)?,
            received_at: Timestamp::from_micros(self.received_at_us),
            outcome: word("outcome", &self.outcome, Outcome::parse)?,
        })
    }
}
