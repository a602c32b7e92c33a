//! The feed axis: programmed feed times override, with the override's latency and a limited acceleration.

use crate::friction::error::{Invalid, InvalidCode, positive};

/// Longest override latency that the model can hold, in IPO cycles.
pub const LONGEST_LATENCY_IPO: usize = 16;

/// Remaining way at which the path counts as ended, mm: the resolution of a control.
const END_MM: f64 = 0.001;

/// What the feed axis can do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisLimits {
    /// Largest acceleration in mm/s².
    pub acceleration_mm_s2: f64,
    /// IPO cycles between an override and its effect on the feed.
    pub override_latency_ipo: u32,
}

impl AxisLimits {
    pub(crate) fn check(&self) -> Result<(), Invalid> {
        positive("acceleration_mm_s2", self.acceleration_mm_s2, 1e5)?;
        if self.override_latency_ipo as usize > LONGEST_LATENCY_IPO {
            let text = format!("at most {LONGEST_LATENCY_IPO} IPO cycles");
            return Err(Invalid::new("override_latency_ipo", InvalidCode::OutOfRange, text));
        }
        Ok(())
    }
}

/// Position and speed of the tool tip, and the overrides that are still on their way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisState {
    depth_mm: f64,
    speed_mm_s: f64,
    acceleration_mm_s2: f64,
    pending: [f64; LONGEST_LATENCY_IPO],
    next: usize,
}

impl AxisState {
    /// An axis at rest at a depth (negative above the sheet), with an override of 100 % in force.
    #[must_use]
    pub const fn at_rest(depth_mm: f64) -> Self {
        let pending = [100.0; LONGEST_LATENCY_IPO];
        Self { depth_mm, speed_mm_s: 0.0, acceleration_mm_s2: 0.0, pending, next: 0 }
    }

    /// An axis that already moves, as one does at first contact; 100 % is in force.
    #[must_use]
    pub const fn moving(depth_mm: f64, feed_mm_min: f64) -> Self {
        Self { speed_mm_s: feed_mm_min / 60.0, ..Self::at_rest(depth_mm) }
    }

    /// Tip depth in mm.
    #[must_use]
    pub const fn depth_mm(&self) -> f64 {
        self.depth_mm
    }

    /// Actual feed in mm/min.
    #[must_use]
    pub const fn feed_mm_min(&self) -> f64 {
        self.speed_mm_s * 60.0
    }

    /// Acceleration of the last step in mm/s².
    #[must_use]
    pub const fn acceleration_mm_s2(&self) -> f64 {
        self.acceleration_mm_s2
    }

    /// Moves for `dt_s` seconds towards `programmed_mm_min` × `override_percent`, braking for `end_mm`.
    ///
    /// The override acts after the axis's latency. Returns whether the end is reached.
    pub fn step(
        &mut self,
        limits: &AxisLimits,
        programmed_mm_min: f64,
        override_percent: f64,
        end_mm: f64,
        dt_s: f64,
    ) -> bool {
        let latency = (limits.override_latency_ipo as usize).min(LONGEST_LATENCY_IPO);
        let acting = if latency == 0 {
            override_percent
        } else {
            let oldest = self.pending[self.next];
            self.pending[self.next] = override_percent;
            self.next = (self.next + 1) % latency;
            oldest
        };
        let limit = limits.acceleration_mm_s2;
        let wanted = programmed_mm_min / 60.0 * acting / 100.0;
        let change = (wanted - self.speed_mm_s).clamp(-limit * dt_s, limit * dt_s);
        let way = (end_mm - self.depth_mm).max(0.0);
        // Fast enough to arrive, slow enough to stop: v·dt/2 of this step and v²/2a after it fit into the way.
        let half = limit * dt_s / 2.0;
        let braking = ((half * half + limit * (2.0 * way - self.speed_mm_s * dt_s)).max(0.0)).sqrt() - half;
        let speed = (self.speed_mm_s + change).min(braking.max(0.0)).max(0.0);
        self.acceleration_mm_s2 = (speed - self.speed_mm_s) / dt_s;
        self.depth_mm = (self.depth_mm + (speed + self.speed_mm_s) / 2.0 * dt_s).min(end_mm);
        self.speed_mm_s = speed;
        end_mm - self.depth_mm <= END_MM
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_override_acts_after_its_latency_and_with_limited_acceleration() {
        let limits = AxisLimits { override_latency_ipo: 3, acceleration_mm_s2: 50.0 };
        let mut axis = AxisState::at_rest(0.0);
        for _ in 0..50 {
            axis.step(&limits, 300.0, 100.0, 100.0, 0.01);
        }
        assert!((axis.feed_mm_min() - 300.0).abs() < 1e-9);
        let feeds: Vec<f64> = (0..6)
            .map(|_| {
                axis.step(&limits, 300.0, 200.0, 100.0, 0.01);
                axis.feed_mm_min()
            })
            .collect();
        assert!(feeds[..3].iter().all(|feed| (feed - 300.0).abs() < 1e-9), "{feeds:?}");
        assert!((feeds[3] - 330.0).abs() < 1e-9, "0.5 mm/s more per IPO: {feeds:?}");
    }

    #[test]
    fn the_axis_stops_at_its_end_without_passing_it() {
        let limits = AxisLimits { override_latency_ipo: 2, acceleration_mm_s2: 300.0 };
        let mut axis = AxisState::at_rest(0.0);
        let mut steps = 0;
        while !axis.step(&limits, 1000.0, 100.0, 5.0, 0.01) {
            steps += 1;
            assert!(axis.depth_mm() <= 5.0 && steps < 200);
        }
        assert!((axis.depth_mm() - 5.0).abs() < 0.002);
        assert!(axis.feed_mm_min() < 120.0, "still {} mm/min", axis.feed_mm_min());
    }
}
