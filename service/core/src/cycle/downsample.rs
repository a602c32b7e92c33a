//! Fewer rows of a cycle for a screen, so that what a person looks for is still there.
//!
//! Both methods choose rows and change no value: what is drawn was sampled.

/// How rows are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Downsampling {
    /// The smallest and the largest value of each channel in every stretch: no peak is lost.
    MinMax,
    /// Largest triangle three buckets (Steinarsson 2013, section 4.2), for each channel by itself: the shape of the
    /// line with fewest points, but a peak of one sample may go.
    Lttb,
}

impl Downsampling {
    /// Every method, in the order of the enum.
    pub const ALL: [Self; 2] = [Self::MinMax, Self::Lttb];

    /// The word used in the API.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::MinMax => "min_max",
            Self::Lttb => "lttb",
        }
    }

    /// The method of that word.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|method| method.as_str() == text)
    }

    /// Fewest rows that it can choose from so many channels.
    pub const fn least_points(self, channels: usize) -> usize {
        match self {
            // A stretch with two rows of each channel, and both ends.
            Self::MinMax => 2 * channels + 2,
            // Both ends and one row in between of each channel.
            Self::Lttb => 3 * channels,
        }
    }

    /// Indices of at most `points` rows, ascending, both ends among them; all rows where they are no more than that.
    ///
    /// `x` is what the channels are drawn over; all columns are of its length. Fewer than [`Self::least_points`] are
    /// taken for that many.
    pub fn rows(self, x: &[f64], columns: &[&[f64]], points: usize) -> Vec<usize> {
        let points = points.max(self.least_points(columns.len()));
        if x.len() <= points || columns.is_empty() {
            return (0..x.len()).collect();
        }
        let mut chosen = vec![0, x.len() - 1];
        match self {
            Self::MinMax => {
                let stretches = (points - 2) / (2 * columns.len());
                for column in columns {
                    min_max(column, stretches, &mut chosen);
                }
            }
            Self::Lttb => {
                for column in columns {
                    lttb(x, column, points / columns.len(), &mut chosen);
                }
            }
        }
        chosen.sort_unstable();
        chosen.dedup();
        chosen
    }
}

/// The place of the smallest and of the largest value of each of so many stretches, the first where there are several.
fn min_max(values: &[f64], stretches: usize, chosen: &mut Vec<usize>) {
    for stretch in 0..stretches {
        let (from, to) = (stretch * values.len() / stretches, (stretch + 1) * values.len() / stretches);
        let (mut low, mut high) = (from, from);
        for at in from..to {
            if values[at] < values[low] {
                low = at;
            }
            if values[at] > values[high] {
                high = at;
            }
        }
        chosen.extend([low, high]);
    }
}

/// Steinarsson 2013, section 4.2: of each bucket the point that spans the largest triangle with the point chosen
/// before it and the mean of the bucket after it. `points` counts both ends and is at least 3.
#[expect(clippy::cast_precision_loss, reason = "numbers of samples are far below 2^53")]
fn lttb(x: &[f64], y: &[f64], points: usize, chosen: &mut Vec<usize>) {
    let (inner, buckets) = (x.len() - 2, points - 2);
    // The ends are buckets of their own.
    let begin = |bucket: usize| 1 + bucket * inner / buckets;
    let mut before = 0;
    for bucket in 0..buckets {
        let (from, to) = (begin(bucket), begin(bucket + 1));
        let next = to..if bucket + 1 == buckets { x.len() } else { begin(bucket + 2) };
        let n = next.len() as f64;
        let mean_x = x[next.clone()].iter().sum::<f64>() / n;
        let mean_y = y[next].iter().sum::<f64>() / n;
        let area = |at: usize| {
            ((x[before] - mean_x) * (y[at] - y[before]) - (x[before] - x[at]) * (mean_y - y[before])).abs()
        };
        let mut largest = from;
        let mut most = area(from);
        for at in from + 1..to {
            let area = area(at);
            if area > most {
                (largest, most) = (at, area);
            }
        }
        chosen.push(largest);
        before = largest;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn times(len: usize) -> Vec<f64> {
        (0..len).map(|at| at as f64 * 10.0).collect()
    }

    #[test]
    fn a_peak_of_one_sample_survives_min_max() {
        let mut load = vec![5.0; 100_000];
        (load[33_333], load[77_777]) = (180.0, -12.0);
        let rows = Downsampling::MinMax.rows(&times(load.len()), &[&load], 200);
        assert!(rows.contains(&33_333) && rows.contains(&77_777), "{rows:?}");
        assert!(rows.len() <= 200);
    }

    #[test]
    fn lttb_keeps_the_corners_of_a_line() {
        // Three straight lines: the corners span the largest triangles of their buckets.
        let y: Vec<f64> = (0..=100)
            .map(|at: i32| {
                f64::from(if at <= 30 {
                    at
                } else if at <= 60 {
                    60 - at
                } else {
                    at - 60
                })
            })
            .collect();
        let rows = Downsampling::Lttb.rows(&times(y.len()), &[&y], 12);
        assert_eq!(rows.len(), 12);
        assert!(rows.contains(&30) && rows.contains(&60), "{rows:?}");
    }

    #[test]
    fn few_rows_are_all_given() {
        let y = [1.0, 2.0, 3.0];
        for method in Downsampling::ALL {
            assert_eq!(method.rows(&times(3), &[&y], 1000), [0, 1, 2]);
            assert_eq!(method.rows(&[], &[&[]], 1000), Vec::<usize>::new());
            assert_eq!(Downsampling::parse(method.as_str()), Some(method));
        }
    }

    proptest! {
        #[test]
        fn rows_ascend_within_the_bound_and_min_max_loses_no_extreme(
            columns in (1_usize..4, 1_usize..400).prop_flat_map(|(channels, len)| {
                prop::collection::vec(prop::collection::vec(-1e4_f64..1e4, len), channels)
            }),
            points in 0_usize..60,
        ) {
            let columns: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
            let x = times(columns[0].len());
            for method in Downsampling::ALL {
                let rows = method.rows(&x, &columns, points);
                let most = points.max(method.least_points(columns.len()));
                prop_assert!(rows.len() <= most, "{} > {most}", rows.len());
                prop_assert!(rows.windows(2).all(|pair| pair[0] < pair[1]));
                prop_assert_eq!((rows.first(), rows.last()), (Some(&0), Some(&(x.len() - 1))));
                if method == Downsampling::MinMax {
                    for column in &columns {
                        let of = |fold: fn(f64, f64) -> f64| {
                            let all = column.iter().copied().reduce(fold);
                            let left = rows.iter().map(|&at| column[at]).reduce(fold);
                            (all, left)
                        };
                        for (all, left) in [of(f64::min), of(f64::max)] {
                            prop_assert_eq!(all, left);
                        }
                    }
                }
            }
        }
    }
}
