//! A centred moving average over a stream.

use super::config::LONGEST_SMOOTHING;
use super::detect::Mark;

/// The last rows of `N` columns of a stream; gives the mean around the middle one once it is full, so that smoothing delays a
/// finding but does not move it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Average<const N: usize> {
    /// Where each row was.
    places: [Mark; LONGEST_SMOOTHING],
    /// What stands in each row, each its share of the mean. By column: what is written singly and read in pairs, as rows would be,
    /// makes the processor wait.
    columns: [[f64; LONGEST_SMOOTHING]; N],
    count: usize,
    /// Where the next row goes.
    next: usize,
}

impl<const N: usize> Average<N> {
    pub(super) const fn new() -> Self {
        Self {
            places: [Mark { index: 0, depth_mm: 0.0 }; LONGEST_SMOOTHING],
            columns: [[0.0; LONGEST_SMOOTHING]; N],
            count: 0,
            next: 0,
        }
    }

    /// Takes a row in place of the oldest of `length` rows, the same number throughout.
    pub(super) fn push(&mut self, length: usize, place: Mark, row: [f64; N]) {
        #[expect(clippy::cast_precision_loss, reason = "at most 31 rows")]
        let share = 1.0 / length as f64;
        self.places[self.next] = place;
        for (column, value) in self.columns.iter_mut().zip(row) {
            column[self.next] = share * value;
        }
        self.count += 1;
        self.next = if self.next + 1 >= length { 0 } else { self.next + 1 };
    }

    /// The mean over the last `length` rows, and where the middle one was, once there are as many.
    pub(super) fn mean(&self, length: usize) -> Option<(Mark, [f64; N])> {
        if self.count < length {
            return None;
        }
        let middle = self.next + length / 2;
        let place = self.places[if middle >= length { middle - length } else { middle }];
        let columns = self.columns.each_ref().map(|column| &column[..length]);
        let mut means = [0.0; N];
        for row in 0..length {
            for (mean, column) in means.iter_mut().zip(columns) {
                *mean += column[row];
            }
        }
        Some((place, means))
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
                average.push(length, Mark { index, depth_mm: 0.0 }, [0.0, load]);
                let mean = average.mean(length);
                prop_assert_eq!(mean.is_some(), index + 1 >= length);
                if let Some((at, [_, mean])) = mean {
                    let last = &loads[index + 1 - length..=index];
                    #[expect(clippy::cast_precision_loss, reason = "at most 31 rows")]
                    let plain = last.iter().sum::<f64>() / length as f64;
                    prop_assert_eq!(at.index, index - half);
                    prop_assert!((mean - plain).abs() < 1e-9);
                }
            }
        }
    }
}
