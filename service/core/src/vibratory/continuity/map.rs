//! Maps of ψ, A and Pmax over (p, kc), with or without control (Gouskov et al. 2015, Fig. 4).

use std::num::NonZeroUsize;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use crate::field_error::{FieldError, Problem, count, within};

use super::process::{LANES, Process, ProcessInput, Simulated, simulate_many};

/// Most points of a map: three minutes on two idle cores with the paper's settings.
const MAX_POINTS: usize = 250_000;

/// Most steps of all points together: what that many points take with the paper's settings.
const MAX_MAP_STEPS: u64 = 250_000 * 500 * 100;

/// Evenly spaced values, both ends included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapAxis {
    /// First value.
    pub min: f64,
    /// Last value.
    pub max: f64,
    /// Number of values, at least 2.
    pub count: u32,
}

impl MapAxis {
    fn values(self, field: &'static str, min: f64, max: f64) -> Result<Vec<f64>, FieldError> {
        within(field, self.min, min, max)?;
        within(field, self.max, min, max)?;
        if self.min > self.max {
            return Err(FieldError::new(field, Problem::Inverted));
        }
        count(field, self.count as usize, 2, MAX_POINTS)?;
        let step = (self.max - self.min) / f64::from(self.count - 1);
        Ok((0..self.count).map(|i| self.min + step * f64::from(i)).collect())
    }
}

/// Unchecked map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapInput {
    /// Frequency ratios p.
    pub frequency_ratio: MapAxis,
    /// Cutting coefficients kc.
    pub cutting_coefficient: MapAxis,
    /// Settings of every point; its own p and kc do not count.
    pub process: ProcessInput,
}

/// Checked map.
#[derive(Debug, Clone, PartialEq)]
pub struct MapQuestion {
    ratios: Vec<f64>,
    coefficients: Vec<f64>,
    process: Process,
}

impl MapQuestion {
    /// Checks a map.
    ///
    /// # Errors
    /// The first bad field; more than 250 000 points, or as many steps as they take with the paper's
    /// settings, are `too_many`.
    pub fn new(input: MapInput) -> Result<Self, FieldError> {
        let ratios = input.frequency_ratio.values("frequency_ratio", 0.01, 100.0)?;
        let coefficients = input.cutting_coefficient.values("cutting_coefficient", 0.0, 100.0)?;
        count("frequency_ratio", ratios.len() * coefficients.len(), 4, MAX_POINTS)?;
        let process = ProcessInput {
            frequency_ratio: ratios[ratios.len() - 1],
            cutting_coefficient: coefficients[0],
            ..input.process
        };
        let steps = u64::from(process.periods) * u64::from(process.steps_per_period);
        let points = ratios.len() * coefficients.len();
        if steps.saturating_mul(points as u64) > MAX_MAP_STEPS {
            let max = usize::try_from(MAX_MAP_STEPS / steps.max(1)).unwrap_or(MAX_POINTS);
            return Err(FieldError::new("process.periods", Problem::TooMany { count: points, max }));
        }
        Ok(Self { ratios, coefficients, process: Process::new(process)? })
    }

    /// Frequency ratios, ascending.
    #[must_use]
    pub fn ratios(&self) -> &[f64] {
        &self.ratios
    }

    /// Cutting coefficients, ascending.
    #[must_use]
    pub fn coefficients(&self) -> &[f64] {
        &self.coefficients
    }

    /// Number of points.
    #[must_use]
    pub fn points(&self) -> usize {
        self.ratios.len() * self.coefficients.len()
    }

    /// Steady values of `range` of the points, counted row by row: p runs fastest.
    #[must_use]
    pub fn some(&self, range: std::ops::Range<usize>) -> Vec<Simulated> {
        let columns = self.ratios.len();
        let processes: Vec<Process> = range
            .filter(|point| *point < self.points())
            // Checked with the largest p, so every smaller one is fine too.
            .filter_map(|point| {
                self.process.at(self.ratios[point % columns], self.coefficients[point / columns]).ok()
            })
            .collect();
        simulate_many(&processes)
    }
}

/// A computed map.
#[derive(Debug, Clone, PartialEq)]
pub struct Map {
    /// Frequency ratios p, the columns.
    pub ratios: Vec<f64>,
    /// Cutting coefficients kc, the rows.
    pub coefficients: Vec<f64>,
    /// Steady values, or that the point diverged, row by row.
    pub points: Vec<Simulated>,
}

impl Map {
    /// Values at a row (kc) and column (p); none beyond the map's ends.
    #[must_use]
    pub fn at(&self, row: usize, column: usize) -> Option<&Simulated> {
        if column >= self.ratios.len() {
            return None;
        }
        self.points.get(row * self.ratios.len() + column)
    }
}

/// A map that was given up because its cancel flag was raised.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cancelled;

impl std::fmt::Display for Cancelled {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("the map was cancelled")
    }
}

impl std::error::Error for Cancelled {}

/// Computes a map on `workers` threads.
///
/// `progress` hears how many points of how many are done, from any of the threads; `cancel` is looked at before every
/// four points, some 20 ms with the paper's settings. The result does not depend on the number of workers.
///
/// # Errors
/// [`Cancelled`] when the flag was raised.
pub fn run_map(
    question: &MapQuestion,
    workers: NonZeroUsize,
    progress: &(dyn Fn(usize, usize) + Sync),
    cancel: &AtomicBool,
) -> Result<Map, Cancelled> {
    let total = question.points();
    let batches = total.div_ceil(LANES);
    let (next, done) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let finished: Mutex<Vec<(usize, Vec<Simulated>)>> = Mutex::new(Vec::with_capacity(batches));
    std::thread::scope(|scope| {
        for _ in 0..workers.get().min(batches) {
            scope.spawn(|| {
                while !cancel.load(Ordering::Relaxed) {
                    let batch = next.fetch_add(1, Ordering::Relaxed);
                    if batch >= batches {
                        break;
                    }
                    let points = question.some(batch * LANES..(batch + 1) * LANES);
                    let so_far = done.fetch_add(points.len(), Ordering::Relaxed) + points.len();
                    if let Ok(mut finished) = finished.lock() {
                        finished.push((batch, points));
                    }
                    progress(so_far, total);
                }
            });
        }
    });
    let mut parts = finished.into_inner().unwrap_or_default();
    if parts.len() < batches {
        return Err(Cancelled);
    }
    parts.sort_unstable_by_key(|(batch, _)| *batch);
    Ok(Map {
        ratios: question.ratios.clone(),
        coefficients: question.coefficients.clone(),
        points: parts.into_iter().flat_map(|(_, points)| points).collect(),
    })
}
