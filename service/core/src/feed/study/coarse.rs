//! A third process model, as plain as a shop's spreadsheet and as coarse as an old control.
//!
//! Loads are straight lines over depth between corners, times a part that knows no feed and one that grows in proportion to
//! it, so their exponent changes with the feed. The work softens with the time in contact, whatever the load. Wear raises
//! both loads towards the end of the path. The noise is a ripple beside a slow drift; loads come in coarse steps, late
//! values repeat, samples are uneven in time, and the feed is not recorded: it follows from depth and time. The axis
//! keeps its acceleration and lags behind by nothing else.

use super::plant::{Plant, Run};
use crate::friction::error::{Invalid, InvalidCode};
use crate::friction::noise::Noise;
use crate::friction::program::Knot;

/// Steps after which a hole counts as stuck.
const MOST_STEPS: usize = 400_000;

/// Step of the integration, s.
const STEP_S: f64 = 0.002;

/// How long the drift of a cycle lasts, s.
const DRIFT_S: f64 = 0.3;

/// The model's values.
#[derive(Debug, Clone, PartialEq)]
pub struct CoarseModel {
    /// Corners of the loads over depth at the reference feed, cold: (mm, feed drive over idle, spindle over idle), percent.
    pub corners: Vec<(f64, [f64; 2])>,
    /// Share of each load that knows no feed.
    pub fixed: [f64; 2],
    /// Feed at which the corners are told, mm/min.
    pub reference_feed_mm_min: f64,
    /// End of the path, mm.
    pub end_mm: f64,
    /// Share of the strength that time in contact takes, and its time constant, s.
    pub softening: (f64, f64),
    /// Rise of each load at the end of the path for a wear of 1, relative.
    pub worn: [f64; 2],
    /// Wear of the tool, 0 new.
    pub wear: f64,
    /// Idle loads, percent.
    pub idle_percent: [f64; 2],
    /// Resolution of the loads, points.
    pub resolution: f64,
    /// Samples for which a load is repeated.
    pub repeats: usize,
    /// Largest acceleration, mm/s².
    pub acceleration_mm_s2: f64,
    /// Sampling, s.
    pub period_s: f64,
    /// Ripple of the loads: amplitude, relative, and period, s.
    pub ripple: (f64, f64),
    /// Drift within a cycle, relative.
    pub drift: f64,
    /// Unevenness from cycle to cycle, relative.
    pub common: f64,
    /// Noise of reading, points.
    pub reading: f64,
}

impl CoarseModel {
    fn cold(&self, depth_mm: f64) -> [f64; 2] {
        let after = self.corners.partition_point(|corner| corner.0 <= depth_mm);
        let Some(left) = after.checked_sub(1).map(|at| self.corners[at]) else { return self.corners[0].1 };
        self.corners.get(after).map_or(left.1, |right| {
            let part = (depth_mm - left.0) / (right.0 - left.0);
            [0, 1].map(|drive| left.1[drive] + part * (right.1[drive] - left.1[drive]))
        })
    }

    fn feed_at(knots: &[Knot], depth_mm: f64) -> f64 {
        let after = knots.partition_point(|knot| knot.depth_mm <= depth_mm);
        let Some(left) = after.checked_sub(1).map(|at| knots[at]) else { return knots[0].feed_mm_min };
        knots.get(after).map_or(left.feed_mm_min, |right| {
            let part = (depth_mm - left.depth_mm) / (right.depth_mm - left.depth_mm);
            left.feed_mm_min + part * (right.feed_mm_min - left.feed_mm_min)
        })
    }

    pub(super) fn load(&self, depth_mm: f64, feed_ratio: f64, contact_s: f64) -> [f64; 2] {
        let soft = 1.0 - self.softening.0 * (1.0 - (-contact_s / self.softening.1).exp());
        let cold = self.cold(depth_mm);
        [0, 1].map(|drive| {
            let feed = self.fixed[drive] + (1.0 - self.fixed[drive]) * feed_ratio;
            let worn = 1.0 + self.wear * self.worn[drive] * (depth_mm / self.end_mm).clamp(0.0, 1.0);
            cold[drive] * feed * soft * worn
        })
    }
}

impl Plant for CoarseModel {
    fn drill(&self, knots: &[Knot], mut noise: Option<&mut Noise>) -> Result<Run, Invalid> {
        let mut run = Run { period_s: self.period_s, ..Run::default() };
        let strength = noise.as_deref_mut().map_or(1.0, |noise| 1.0 + self.common * noise.normal());
        let phase = noise.as_deref_mut().map_or(0.0, |noise| noise.uniform() * std::f64::consts::TAU);
        let (mut depth, mut speed, mut time) = (-1.5, knots[0].feed_mm_min / 60.0, 0.0);
        let (mut contact, mut next_sample, mut drift) = (None, 0.0, 0.0);
        let mut told = [0.0; 2];
        let keep = (-STEP_S / DRIFT_S).exp();
        for _ in 0..MOST_STEPS {
            time += STEP_S;
            let most = self.acceleration_mm_s2 * STEP_S;
            let wanted = Self::feed_at(knots, depth) / 60.0;
            let way = (self.end_mm - depth).max(0.0);
            speed += (wanted - speed).clamp(-most, most);
            speed = speed.min((2.0 * self.acceleration_mm_s2 * way).sqrt()).max(0.02);
            depth += speed * STEP_S;
            let mut load = [0.0; 2];
            if depth > 0.0 {
                let begun = *contact.get_or_insert(time);
                let mut uneven = 0.0;
                if let Some(noise) = noise.as_deref_mut() {
                    drift = keep * drift + (1.0 - keep * keep).sqrt() * self.drift * noise.normal();
                    let turn = time / self.ripple.1 * std::f64::consts::TAU + phase;
                    uneven = drift + self.ripple.0 * turn.sin();
                }
                let ratio = speed * 60.0 / self.reference_feed_mm_min;
                load = self.load(depth, ratio, time - begun).map(|load| load * strength * (1.0 + uneven));
            }
            let done = self.end_mm - depth <= 0.003;
            if time >= next_sample || done {
                let uneven = noise.as_deref_mut().map_or(0.0, |noise| 0.3 * (noise.uniform() - 0.5));
                next_sample = time + self.period_s * (1.0 + uneven) - STEP_S / 2.0;
                if run.time_s.len().is_multiple_of(self.repeats.max(1)) {
                    told = [0, 1].map(|drive| load[drive] + self.idle_percent[drive]);
                    if let Some(noise) = noise.as_deref_mut() {
                        told = told.map(|load| {
                            let read = load + self.reading * noise.normal();
                            (read / self.resolution).round() * self.resolution
                        });
                    }
                }
                run.time_s.push(time);
                run.depth_mm.push((depth * 1000.0).round() / 1000.0);
                for (column, told) in run.load_percent.iter_mut().zip(told) {
                    column.push(told);
                }
            }
            if done {
                run.duration_s = time - contact.unwrap_or(time);
                return Ok(run);
            }
        }
        Err(Invalid::new("knots", InvalidCode::OutOfRange, "the hole is not finished"))
    }
}
