//! Nodes over depth on which everything is learned and planned.

/// Smallest distance of two nodes, mm: finer than any load follows the depth.
const STEP_MM: f64 = 0.1;

/// Most nodes, so that a deep hole costs no more than a shallow one.
const MOST_NODES: f64 = 260.0;

/// Evenly spaced depths from contact to the end of the path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Grid {
    step_mm: f64,
    count: usize,
}

impl Grid {
    /// Nodes from 0 to `end_mm`, which is positive and checked by the settings, so spaced that `corners_mm` come close
    /// to nodes.
    pub(crate) fn new(end_mm: f64, corners_mm: &[f64]) -> Self {
        let usual = whole((end_mm / STEP_MM.max(end_mm / MOST_NODES)).round()).max(4);
        let misfit = |parts: usize| {
            let step = end_mm / parts as f64;
            // A corner just below a node costs next to nothing, one just above it nearly a whole step.
            corners_mm.iter().map(|corner| ((corner / step - 1e-9).ceil() - corner / step).abs()).sum::<f64>()
        };
        let mut parts = usual;
        for candidate in usual - usual / 8..=usual {
            if misfit(candidate) < misfit(parts) - 1e-9 {
                parts = candidate;
            }
        }
        Self { step_mm: end_mm / parts as f64, count: parts + 1 }
    }

    /// Number of nodes.
    pub(crate) const fn count(&self) -> usize {
        self.count
    }

    /// Distance of two nodes, mm.
    pub(crate) const fn step_mm(&self) -> f64 {
        self.step_mm
    }

    /// Depth of a node, mm.
    pub(crate) fn depth_mm(&self, node: usize) -> f64 {
        node as f64 * self.step_mm
    }

    /// Depth of the last node, mm.
    pub(crate) fn end_mm(&self) -> f64 {
        self.depth_mm(self.count - 1)
    }

    /// The node nearest to a depth.
    pub(crate) fn nearest(&self, depth_mm: f64) -> usize {
        whole((depth_mm / self.step_mm).round()).min(self.count - 1)
    }
}

/// A number that is not negative, as an index.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "not negative, saturating")]
pub(crate) fn whole(value: f64) -> usize {
    value.max(0.0) as usize
}
