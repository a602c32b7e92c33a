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
    /// Where each row was: number and depth of its sample.
    places: [(usize, f64); LONGEST_SMOOTHING],
    /// Way, feed drive's and spindle's load of each row, each its share of the mean. By column: what is written singly and
    /// read in pairs, as rows would be, makes the processor wait.
    columns: [[f64; LONGEST_SMOOTHING]; 3],
    count: usize,
    /// Where the next row goes.
    next: usize,
}

impl Average {
    pub(super) const fn new() -> Self {
        Self {
            places: [(0, 0.0); LONGEST_SMOOTHING],
            columns: [[0.0; LONGEST_SMOOTHING]; 3],
            count: 0,
            next: 0,
        }
    }

    /// Takes a row in place of the oldest of `length` rows, the same number throughout.
    pub(super) fn push(&mut self, length: usize, row: Row) {
        #[expect(clippy::cast_precision_loss, reason = "at most 31 rows")]
        let share = 1.0 / length as f64;
        self.places[self.next] = (row.index, row.depth_mm);
        for (column, value) in self.columns.iter_mut().zip([row.way_mm, row.feed_drive, row.spindle]) {
            column[self.next] = share * value;
        }
        self.count += 1;
        self.next = if self.next + 1 >= length { 0 } else { self.next + 1 };
    }

    /// The mean over the last `length` rows at the middle one, once there are as many.
    pub(super) fn mean(&self, length: usize) -> Option<Row> {
        if self.count < length {
            return None;
        }
        let middle = self.next + length / 2;
        let (index, depth_mm) = self.places[if middle >= length { middle - length } else { middle }];
        let columns = self.columns.each_ref().map(|column| &column[..length]);
        let mut means = [0.0; 3];
        for row in 0..length {
            for (mean, column) in means.iter_mut().zip(columns) {
                *mean += column[row];
            }
        }
        let [way_mm, feed_drive, spindle] = means;
        Some(Row { index, depth_mm, way_mm, feed_drive, spindle })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_mean_is_that_of_the_last_rows_at_their_middle(
            loads in proptest::collection::vec(-100.0..100.0_f64, 1..100),
            half in 0..=LONGEST_SMOOTHING / 2,
        ) {
            let length = 2 * half + 1;
            let mut average = Average::new();
            for (index, &load) in loads.iter().enumerate() {
                average.push(length, Row { index, spindle: load, ..Row::default() });
                let mean = average.mean(length);
                prop_assert_eq!(mean.is_some(), index + 1 >= length);
                if let Some(mean) = mean {
                    let last = &loads[index + 1 - length..=index];
                    #[expect(clippy::cast_precision_loss, reason = "at most 31 rows")]
                    let plain = last.iter().sum::<f64>() / length as f64;
                    prop_assert_eq!(mean.index, index - half);
                    prop_assert!((mean.spindle - plain).abs() < 1e-9);
                }
            }
        }
    }
}
