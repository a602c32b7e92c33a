//! What is kept of a turning cut, and what an edge's history is read back as.

use super::{library::setup_of, optional_float};
use crate::error::StoreResult;
use feedwright_core::cycle::{Cycle, ReportedCut};
use feedwright_core::recommend::EdgeCycle;

/// A row of `cycle_cuts`.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct CutRow {
    pub(crate) machine_id: String,
    pub(crate) cycle_id: String,
    pub(crate) cutting_speed_m_min: Option<f64>,
    pub(crate) feed_mm_rev: Option<f64>,
    pub(crate) spindle_power_watts: Option<f64>,
    pub(crate) thrust_newtons: Option<f64>,
    pub(crate) edge_wear_mm: Option<f64>,
}

impl CutRow {
    /// The row of a cycle; none where nothing of a cut was reported.
    pub(crate) fn of(cycle: &Cycle) -> StoreResult<Option<Self>> {
        let cut = &cycle.reported.cut;
        if cut.is_empty() {
            return Ok(None);
        }
        Ok(Some(Self {
            machine_id: cycle.machine.as_str().to_owned(),
            cycle_id: cycle.id.as_str().to_owned(),
            cutting_speed_m_min: optional_float("cutting_speed_m_min", cut.cutting_speed_m_min)?,
            feed_mm_rev: optional_float("feed_mm_rev", cut.feed_mm_rev)?,
            spindle_power_watts: optional_float("spindle_power_watts", cut.spindle_power_watts)?,
            thrust_newtons: optional_float("thrust_newtons", cut.thrust_newtons)?,
            edge_wear_mm: optional_float("edge_wear_mm", cut.edge_wear_mm)?,
        }))
    }
}

/// What was reported of a cut, read back.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct ReportedCutRow {
    cutting_speed_m_min: Option<f64>,
    feed_mm_rev: Option<f64>,
    spindle_power_watts: Option<f64>,
    thrust_newtons: Option<f64>,
    edge_wear_mm: Option<f64>,
}

impl From<ReportedCutRow> for ReportedCut {
    fn from(row: ReportedCutRow) -> Self {
        Self {
            cutting_speed_m_min: row.cutting_speed_m_min,
            feed_mm_rev: row.feed_mm_rev,
            spindle_power_watts: row.spindle_power_watts,
            thrust_newtons: row.thrust_newtons,
            edge_wear_mm: row.edge_wear_mm,
        }
    }
}

/// One cycle of an edge with its operation's setup.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct EdgeCycleRow {
    setup: Option<String>,
    duration_ms: Option<f64>,
    cutting_speed_m_min: Option<f64>,
    spindle_rpm: Option<f64>,
    feed_mm_rev: Option<f64>,
    spindle_power_watts: Option<f64>,
    spindle_joules: Option<f64>,
    force_newtons: Option<f64>,
    edge_wear_mm: Option<f64>,
}

impl EdgeCycleRow {
    pub(crate) fn cycle(&self) -> StoreResult<EdgeCycle> {
        Ok(EdgeCycle {
            setup: setup_of(self.setup.as_deref())?.0,
            duration_ms: self.duration_ms,
            speed_m_min: self.cutting_speed_m_min,
            spindle_rpm: self.spindle_rpm.filter(|rpm| *rpm > 0.0),
            feed_mm_rev: self.feed_mm_rev,
            power_watts: self.spindle_power_watts,
            spindle_joules: self.spindle_joules,
            // A dynamometer that hung idle says nothing of the cut.
            force_newtons: self.force_newtons.filter(|force| *force > 0.0),
            wear_mm: self.edge_wear_mm,
        })
    }
}
