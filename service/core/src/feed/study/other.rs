//! A second process model that shares nothing with the first: what other people's machines might do.
//!
//! Loads are sums of bumps over depth, each with its own exponent of the feed, beside parts that know no feed. Two heats
//! – a skin that forgets within half a second and a body that lasts – soften exponentially towards a floor. The feed
//! drive's idle load rises with the feed. Loads come late and through a first-order lag, in steps of the control's
//! resolution, with short-lived unevenness and bursts of sticking. The axis follows with a servo's lag.

use super::plant::{Plant, Run};
use crate::friction::error::{Invalid, InvalidCode};
use crate::friction::noise::Noise;
use crate::friction::program::Knot;

/// Samples after which a hole counts as stuck.
const MOST_STEPS: usize = 400_000;

/// Step of the integration, s.
const STEP_S: f64 = 0.002;

/// One contribution to a load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bump {
    /// Middle, mm.
    pub at_mm: f64,
    /// Width of the rise, mm.
    pub rise_mm: f64,
    /// Width of the fall, mm.
    pub fall_mm: f64,
    /// Load over idle at the reference feed, cold, percent.
    pub percent: f64,
    /// Exponent of the feed; 0 knows no feed.
    pub exponent: f64,
}

impl Bump {
    fn load(&self, depth_mm: f64, feed_ratio: f64) -> f64 {
        let off = depth_mm - self.at_mm;
        let width = if off < 0.0 { self.rise_mm } else { self.fall_mm };
        let shape = 1.0 / (1.0 + (off / width).powi(4));
        let feed = if self.exponent > 0.0 { feed_ratio.powf(self.exponent) } else { 1.0 };
        self.percent * shape * feed
    }
}

/// The model's values.
#[derive(Debug, Clone, PartialEq)]
pub struct OtherModel {
    /// Contributions to the feed-drive load.
    pub feed_drive: Vec<Bump>,
    /// Contributions to the spindle load.
    pub spindle: Vec<Bump>,
    /// Drag of a worn tool on the spindle at a wear of 1.
    pub drag: Bump,
    /// Wear of the tool, 0 new.
    pub wear: f64,
    /// Feed at which the bumps are told, mm/min.
    pub reference_feed_mm_min: f64,
    /// End of the path, mm.
    pub end_mm: f64,
    /// Share of the strength that heat cannot take.
    pub floor: f64,
    /// Spindle percent-seconds in the skin, and in the body, that take 63 % of the rest.
    pub soften_percent_s: [f64; 2],
    /// How long skin and body remember, s.
    pub memory_s: [f64; 2],
    /// Idle loads, percent.
    pub idle_percent: [f64; 2],
    /// Rise of the feed drive's idle load per 1000 mm/min, points.
    pub viscous_percent: f64,
    /// Delay of the loads, s.
    pub delay_s: f64,
    /// Lag of the loads, s.
    pub lag_s: f64,
    /// Resolution of the loads, points.
    pub resolution: f64,
    /// Servo lag of the axis, s.
    pub servo_s: f64,
    /// Largest acceleration, mm/s².
    pub acceleration_mm_s2: f64,
    /// Sampling, s.
    pub period_s: f64,
    /// Unevenness within a cycle, relative, lasting 50 ms.
    pub uneven: f64,
    /// Unevenness from cycle to cycle, relative.
    pub common: f64,
    /// Noise of reading, points.
    pub reading: f64,
    /// Bursts of sticking per second, each a tenth more torque for 30 ms.
    pub bursts_per_s: f64,
}

impl OtherModel {
    fn feed_at(knots: &[Knot], depth_mm: f64) -> f64 {
        let after = knots.partition_point(|knot| knot.depth_mm <= depth_mm);
        let Some(left) = after.checked_sub(1).map(|at| knots[at]) else { return knots[0].feed_mm_min };
        knots.get(after).map_or(left.feed_mm_min, |right| {
            let part = (depth_mm - left.depth_mm) / (right.depth_mm - left.depth_mm);
            left.feed_mm_min + part * (right.feed_mm_min - left.feed_mm_min)
        })
    }
}

impl Plant for OtherModel {
    fn drill(&self, knots: &[Knot], mut noise: Option<&mut Noise>) -> Result<Run, Invalid> {
        let mut run = Run { period_s: self.period_s, ..Run::default() };
        let strength = noise.as_deref_mut().map_or(1.0, |noise| 1.0 + self.common * noise.normal());
        let (mut depth, mut speed, mut time) = (-1.5, knots[0].feed_mm_min / 60.0, 0.0);
        let (mut heats, mut lagged, mut uneven, mut burst_s) =
            ([0.0_f64; 2], [self.idle_percent[0], 0.0], 0.0, 0.0);
        lagged[1] = self.idle_percent[1];
        let mut late: std::collections::VecDeque<[f64; 2]> = std::collections::VecDeque::new();
        let (mut contact, mut next_sample) = (None, 0.0);
        let keep = (-STEP_S / 0.05_f64).exp();
        for _ in 0..MOST_STEPS {
            time += STEP_S;
            let wanted = Self::feed_at(knots, depth) / 60.0;
            let way = (self.end_mm - depth).max(0.0);
            let most = self.acceleration_mm_s2 * STEP_S;
            let toward = ((wanted - speed) * STEP_S / self.servo_s).clamp(-most, most);
            speed = (speed + toward).min((2.0 * self.acceleration_mm_s2 * way).sqrt()).max(0.02);
            depth += speed * STEP_S;
            let ratio = speed * 60.0 / self.reference_feed_mm_min;
            let mut load = [0.0; 2];
            if depth > 0.0 {
                contact.get_or_insert(time);
                let cold = 1.0
                    - (1.0 - self.floor)
                        * (1.0
                            - (-heats[0] / self.soften_percent_s[0] - heats[1] / self.soften_percent_s[1])
                                .exp());
                if let Some(noise) = noise.as_deref_mut() {
                    uneven = keep * uneven + (1.0 - keep * keep).sqrt() * self.uneven * noise.normal();
                    if noise.uniform() < self.bursts_per_s * STEP_S {
                        burst_s = 0.03;
                    }
                }
                burst_s -= STEP_S;
                let sticking = if burst_s > 0.0 { 1.1 } else { 1.0 };
                let sum = |bumps: &[Bump]| bumps.iter().map(|bump| bump.load(depth, ratio)).sum::<f64>();
                let all = strength * (1.0 + uneven) * cold;
                let drag = self.wear * self.drag.load(depth, ratio);
                load = [sum(&self.feed_drive) * all, (sum(&self.spindle) + drag) * all * sticking];
            }
            for (heat, memory) in heats.iter_mut().zip(self.memory_s) {
                *heat = *heat * (-STEP_S / memory).exp() + load[1] * STEP_S;
            }
            let idle =
                [self.idle_percent[0] + self.viscous_percent * speed * 60.0 / 1000.0, self.idle_percent[1]];
            let share = 1.0 - (-STEP_S / self.lag_s).exp();
            for drive in 0..2 {
                lagged[drive] += share * (load[drive] + idle[drive] - lagged[drive]);
            }
            late.push_back(lagged);
            let hold = super::steps(self.delay_s / STEP_S);
            while late.len() > hold + 1 {
                late.pop_front();
            }
            let done = self.end_mm - depth <= 0.003;
            if time >= next_sample || done {
                next_sample = time + self.period_s - STEP_S / 2.0;
                let seen = late.front().copied().unwrap_or(lagged);
                run.time_s.push(time);
                run.depth_mm.push(depth);
                run.feed_mm_min.push((speed * 60.0).round());
                for (drive, seen) in seen.into_iter().enumerate() {
                    let read = noise.as_deref_mut().map_or(0.0, |noise| self.reading * noise.normal());
                    let value = seen + read;
                    let value = if noise.is_some() {
                        (value / self.resolution).round() * self.resolution
                    } else {
                        value
                    };
                    run.load_percent[drive].push(value);
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
