//! A centred moving average over a stream.

use super::config::LONGEST_SMOOTHING;

/// One averaged row: where its middle sample was, and the means.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Row {
    pub(super) index: usize,
    pub(super) depth_mm: f64,
    /// Way per sample in mm.
    pub(super) way_mm: f64,
    pub(super) feed_drive: f64,
    pub(super) spindle: f64,
}

/// The last rows of a stream; gives the mean around the middle one once it is full, so that smoothing delays a
/// finding but does not move it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Average {
    rows: [Row; LONGEST_SMOOTHING],
    count: usize,
}

impl Average {
    pub(super) const fn new() -> Self {
        let empty = Row { index: 0, depth_mm: 0.0, way_mm: 0.0, feed_drive: 0.0, spindle: 0.0 };
        Self { rows: [empty; LONGEST_SMOOTHING], count: 0 }
    }

    /// Takes a row and returns the mean over the last `length` rows at the middle one, once there are as many.
    pub(super) fn push(&mut self, length: usize, row: Row) -> Option<Row> {
        self.rows[self.count % length] = row;
        self.count += 1;
        if self.count < length {
            return None;
        }
        let middle = self.rows[(self.count + length / 2) % length];
        let mut mean = Row { index: middle.index, depth_mm: middle.depth_mm, ..Row::default() };
        #[expect(clippy::cast_precision_loss, reason = "at most 31 rows")]
        let share = 1.0 / length as f64;
        for row in &self.rows[..length] {
            mean.way_mm += share * row.way_mm;
            mean.feed_drive += share * row.feed_drive;
            mean.spindle += share * row.spindle;
        }
        Some(mean)
    }
}
