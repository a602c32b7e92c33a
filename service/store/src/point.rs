//! Points of series: what cycles amounted to, in few numbers each.

use crate::record::CycleKey;
use feedwright_core::ids::{OperationId, ToolId};
use feedwright_core::summary::{EnergyBasis, IdlePower};
use std::ops::Deref;
use std::sync::Arc;

/// What a cycle amounted to, as a point of series.
#[derive(Debug, Clone, PartialEq)]
pub struct CyclePoint {
    /// When it began, on which machine, its id.
    pub key: CycleKey,
    /// Its tool.
    pub tool: ToolId,
    /// Its operation.
    pub operation: OperationId,
    /// Energy by basis, best basis first.
    pub energy: Vec<PointEnergy>,
    /// What else is told of it; `None` where a reader asked for energies alone.
    pub peaks: Option<Box<PointPeaks>>,
}

/// A cycle's energy on one basis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointEnergy {
    /// How it was told.
    pub basis: EnergyBasis,
    /// The whole, J.
    pub total_joules: f64,
    /// What was done about idle power.
    pub idle: IdlePower,
}

/// How long a cycle took, and the largest of its channels.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PointPeaks {
    /// Cycle time, ms.
    pub duration_ms: Option<f64>,
    /// Largest depth, mm.
    pub max_depth_mm: Option<f64>,
    /// Largest spindle load, %.
    pub max_spindle_load_percent: Option<f64>,
    /// Largest feed-drive load, %.
    pub max_feed_drive_load_percent: Option<f64>,
    /// Largest spindle power, W.
    pub max_spindle_power_watts: Option<f64>,
    /// Largest thrust, N.
    pub max_thrust_newtons: Option<f64>,
    /// Largest torque, N·m.
    pub max_torque_newton_metres: Option<f64>,
}

/// How much of its points a reader wants.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PointColumns {
    /// Energies; the rest may be left out.
    Energy,
    /// Everything.
    All,
}

/// Points, oldest first, shared with whoever asked for the same.
#[derive(Debug, Clone)]
pub struct LastPoints {
    all: Arc<Vec<CyclePoint>>,
    from: usize,
}

impl LastPoints {
    /// The newest `limit` of them.
    pub(crate) fn newest(all: Arc<Vec<CyclePoint>>, limit: usize) -> Self {
        let from = all.len().saturating_sub(limit);
        Self { all, from }
    }
}

impl From<Vec<CyclePoint>> for LastPoints {
    fn from(points: Vec<CyclePoint>) -> Self {
        Self { all: Arc::new(points), from: 0 }
    }
}

impl Deref for LastPoints {
    type Target = [CyclePoint];

    fn deref(&self) -> &[CyclePoint] {
        self.all.get(self.from..).unwrap_or_default()
    }
}
