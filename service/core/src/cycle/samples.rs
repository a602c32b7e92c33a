//! Columns of samples over one time base.

use super::Channel;
use super::DURATION_RANGE;
use crate::invalid::{Range, Violation};
use crate::machine::IPO_RANGE;

/// Samples that one cycle may hold unless configured: 33 minutes at 100 Hz.
pub const DEFAULT_MAX_SAMPLES: usize = 200_000;

/// Samples that one cycle may hold however a server is configured, and so what one holds that is stored.
pub const MOST_SAMPLES: usize = 10_000_000;

/// When the samples were taken, counted from the start of the cycle.
#[derive(Debug, Clone, PartialEq)]
pub enum TimeBase {
    /// One sample per `period_ms`, the first at the end of the first period.
    Period {
        /// Distance of two samples, ms.
        period_ms: f64,
    },
    /// A time for each sample, not running backwards, ms.
    Stamps {
        /// Times since the start of the cycle, ms.
        time_ms: Vec<f64>,
    },
}

/// Sampled channels, all of one length, in the order of the channels' codes.
#[derive(Debug, Clone, PartialEq)]
pub struct Samples {
    time: TimeBase,
    columns: Vec<(Channel, Vec<f64>)>,
    len: usize,
}

impl Samples {
    /// Checks lengths, ranges and the direction of time. Paths are relative to the cycle's body.
    ///
    /// Returns at most one violation per column, that of its first bad value.
    pub fn new(
        time: TimeBase,
        mut columns: Vec<(Channel, Vec<f64>)>,
        max_samples: usize,
    ) -> Result<Self, Vec<Violation>> {
        let mut wrong = Vec::new();
        columns.sort_by_key(|(channel, _)| *channel);
        let Some(len) = columns.first().map(|(_, values)| values.len()) else {
            return Err(vec![Violation::new("samples", "no_channels", "needs at least one channel")]);
        };
        for pair in columns.windows(2) {
            if pair[0].0 == pair[1].0 {
                let path = format!("samples.{}", pair[0].0.as_str());
                wrong.push(Violation::new(path, "duplicate_channel", "is given twice"));
            }
        }
        // Lengths first: one short column would otherwise be reported as a flood of other things.
        let longest = columns.iter().map(|(_, values)| values.len()).max().unwrap_or(0);
        if longest > max_samples {
            return Err(vec![Violation::new(
                "samples",
                "too_many_samples",
                format!("may hold at most {max_samples} samples, has {longest}"),
            )]);
        }
        for (channel, values) in &columns {
            let path = || format!("samples.{}", channel.as_str());
            if values.is_empty() {
                wrong.push(Violation::new(path(), "empty", "must hold at least one sample"));
            } else if values.len() != longest {
                wrong.push(Violation::new(
                    path(),
                    "length_mismatch",
                    format!("has {} samples where the longest column has {longest}", values.len()),
                ));
            }
        }
        match &time {
            TimeBase::Period { period_ms } => {
                if IPO_RANGE.collect("samples.period_ms", *period_ms, &mut wrong).is_some()
                    && wrong.is_empty()
                {
                    #[expect(
                        clippy::cast_precision_loss,
                        reason = "bounded by the largest number of samples"
                    )]
                    let duration = period_ms * longest as f64;
                    DURATION_RANGE.collect("samples", duration, &mut wrong);
                }
            }
            TimeBase::Stamps { time_ms } => check_stamps(time_ms, longest, &mut wrong),
        }
        for (channel, values) in &mut columns {
            check_column(*channel, channel.range(), values, &mut wrong);
        }
        if wrong.is_empty() { Ok(Self { time, columns, len }) } else { Err(wrong) }
    }

    /// Samples in each column, at least 1.
    pub const fn len(&self) -> usize {
        self.len
    }

    /// Never true: a cycle without samples has no `Samples`.
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The time base.
    pub const fn time(&self) -> &TimeBase {
        &self.time
    }

    /// One channel's values, where it was sampled.
    pub fn column(&self, channel: Channel) -> Option<&[f64]> {
        let at = self.columns.binary_search_by_key(&channel, |(channel, _)| *channel).ok()?;
        Some(&self.columns[at].1)
    }

    /// The channels with their values, in the order of the codes.
    pub fn columns(&self) -> impl Iterator<Item = (Channel, &[f64])> {
        self.columns.iter().map(|(channel, values)| (*channel, values.as_slice()))
    }

    /// Time of sample `index` since the start of the cycle, ms.
    pub fn time_ms(&self, index: usize) -> f64 {
        match &self.time {
            #[expect(clippy::cast_precision_loss, reason = "bounded by the largest number of samples")]
            TimeBase::Period { period_ms } => period_ms * (index + 1) as f64,
            TimeBase::Stamps { time_ms } => time_ms[index],
        }
    }
}

fn check_stamps(time_ms: &[f64], longest: usize, wrong: &mut Vec<Violation>) {
    if time_ms.len() != longest {
        wrong.push(Violation::new(
            "samples.time_ms",
            "length_mismatch",
            format!("has {} samples where the longest column has {longest}", time_ms.len()),
        ));
    }
    let mut before = f64::NEG_INFINITY;
    for (index, &time) in time_ms.iter().enumerate() {
        let path = format_at("samples.time_ms", index);
        if DURATION_RANGE.collect(&path(), time, wrong).is_none() {
            return;
        }
        if time < before {
            wrong.push(Violation::new(
                path(),
                "time_backwards",
                format!("{time} ms comes after {before} ms: time must not run backwards"),
            ));
            return;
        }
        before = time;
    }
}

fn format_at(name: &'static str, index: usize) -> impl Fn() -> String {
    move || format!("{name}[{index}]")
}

/// Values that are held against a range together.
const AT_ONCE: usize = 64;

fn check_column(channel: Channel, range: Range, values: &mut [f64], wrong: &mut Vec<Violation>) {
    for (chunk, values) in values.chunks_mut(AT_ONCE).enumerate() {
        // No branch at each value, so that several are compared at once.
        let all = values.iter_mut().fold(true, |all, value| {
            let good = (*value >= range.min) & (*value <= range.max);
            *value += 0.0;
            all & good
        });
        let bad = |value: &f64| !(*value >= range.min && *value <= range.max);
        if !all && let Some(index) = values.iter().position(bad) {
            let path = format!("samples.{}[{}]", channel.as_str(), chunk * AT_ONCE + index);
            range.collect(&path, values[index], wrong);
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn period(columns: Vec<(Channel, Vec<f64>)>) -> Result<Samples, Vec<Violation>> {
        Samples::new(TimeBase::Period { period_ms: 10.0 }, columns, 1000)
    }

    fn refusal(result: Result<Samples, Vec<Violation>>) -> (String, &'static str) {
        let wrong = result.unwrap_err();
        assert_eq!(wrong.len(), 1, "{wrong:?}");
        (wrong[0].path.clone(), wrong[0].code)
    }

    #[test]
    fn negative_zero_is_zero() {
        let samples = period(vec![(Channel::SpindleLoadPercent, vec![-0.0, 1.0])]).unwrap();
        assert!(samples.column(Channel::SpindleLoadPercent).unwrap()[0].is_sign_positive());
    }

    #[test]
    fn the_first_bad_value_is_named_wherever_it_stands() {
        for at in [0, AT_ONCE - 1, AT_ONCE, 2 * AT_ONCE + 5] {
            let mut load = vec![-0.0; 3 * AT_ONCE];
            load[at] = f64::NAN;
            load[at + 1..].fill(f64::INFINITY);
            let wrong = refusal(period(vec![(Channel::SpindleLoadPercent, load)]));
            assert_eq!(wrong, (format!("samples.spindle_load_percent[{at}]"), "not_finite"));
        }
        let samples = period(vec![(Channel::SpindleLoadPercent, vec![-0.0; 3 * AT_ONCE])]).unwrap();
        let load = samples.column(Channel::SpindleLoadPercent).unwrap();
        assert!(load.iter().all(|value| value.is_sign_positive()));
    }

    #[test]
    fn every_bad_column_names_its_field() {
        use Channel::{DepthMm, SpindleLoadPercent};
        let load = |values: Vec<f64>| period(vec![(SpindleLoadPercent, values)]);
        let at = |text: &str, code| (text.to_owned(), code);
        assert_eq!(refusal(period(vec![])), at("samples", "no_channels"));
        assert_eq!(refusal(load(vec![])), at("samples.spindle_load_percent", "empty"));
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert_eq!(refusal(load(vec![1.0, bad])), at("samples.spindle_load_percent[1]", "not_finite"));
        }
        assert_eq!(
            refusal(load(vec![9_007_199_254_740_993.0])),
            at("samples.spindle_load_percent[0]", "out_of_range")
        );
        assert_eq!(refusal(load(vec![1.0; 1001])), at("samples", "too_many_samples"));
        let uneven = period(vec![(DepthMm, vec![1.0, 2.0]), (SpindleLoadPercent, vec![1.0])]);
        assert_eq!(refusal(uneven), at("samples.spindle_load_percent", "length_mismatch"));
        let twice = period(vec![(DepthMm, vec![1.0]), (DepthMm, vec![1.0])]);
        assert_eq!(refusal(twice), at("samples.depth_mm", "duplicate_channel"));
    }

    #[test]
    fn time_must_not_run_backwards() {
        let stamps = |time_ms: Vec<f64>| {
            let column = vec![0.0; time_ms.len()];
            Samples::new(TimeBase::Stamps { time_ms }, vec![(Channel::DepthMm, column)], 1000)
        };
        assert!(stamps(vec![0.0, 10.0, 10.0, 20.0]).is_ok());
        assert_eq!(
            refusal(stamps(vec![0.0, 10.0, 9.0])),
            ("samples.time_ms[2]".to_owned(), "time_backwards")
        );
        assert_eq!(refusal(stamps(vec![0.0, f64::NAN])), ("samples.time_ms[1]".to_owned(), "not_finite"));
    }
}
