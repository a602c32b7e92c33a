//! Holes of one program, many times over: studies of whole lives drill thousands of them.
//!
//! A program without a law moves alike in every hole, whatever the loads. So the motion, the contact integrals and the
//! powers of the feed are computed once; what remains per step is the temperature, the wear and the noise.

use super::cycle::CycleSetup;
use super::model::{Twin, TwinInput};
use crate::friction::energy::torque_energy_j;
use crate::friction::error::Invalid;
use crate::friction::noise::Noise;
use crate::friction::program::Strategy;
use crate::friction::relation::{DepthBin, DepthProfile, RelationConfig};
use std::f64::consts::PI;

/// One step of the motion, with the torque it takes.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Step {
    /// Torque of a new tool in cold nominal material, N·m, and what a unit of wear adds.
    new_nm: f64,
    worn_nm: f64,
    /// Angular speed, rad/s.
    omega: f64,
    /// Torque of spinning up, N·m.
    spin_up_nm: f64,
    /// Where its entries among the [`PreparedHole::shares`] end.
    shares_to: usize,
}

/// A program on a machine, ready to be drilled.
#[derive(Debug, Clone, PartialEq)]
pub struct PreparedHole {
    steps: Vec<Step>,
    /// The bins that each step's energy goes to, with their shares, step after step; none in the air. A step may go through
    /// many bins.
    shares: Vec<(usize, f64)>,
    way: Vec<DepthBin>,
    config: RelationConfig,
    setup: CycleSetup,
    /// From first contact to the end of the path, s.
    duration_s: f64,
}

impl Twin {
    /// Prepares a strategy without a law; `None` where a law answers to the loads.
    ///
    /// # Errors
    /// As [`Twin::drill`].
    pub fn prepare(
        &self,
        strategy: &Strategy,
        setup: &CycleSetup,
        bins: &RelationConfig,
    ) -> Result<Option<PreparedHole>, Invalid> {
        if strategy.law.is_some() {
            return Ok(None);
        }
        let mut way = DepthProfile::new(bins);
        let (mut steps, mut before, mut last_rpm) = (Vec::with_capacity(1024), 0.0, setup.first_rpm());
        let mut shares = Vec::with_capacity(1024);
        let figures = self.drill(strategy, setup, None, |sample| {
            let input = TwinInput {
                depth_mm: sample.depth_mm,
                feed_mm_min: sample.feed_mm_min,
                spindle_rpm: sample.spindle_rpm,
                dt_s: setup.period_s,
            };
            let (new_nm, worn_nm) = self.cold_torque_nm(&input);
            if sample.depth_mm > 0.0 {
                way.add(bins, before, sample.depth_mm, setup.period_s, 0.0);
                let mut alone = DepthProfile::new(bins);
                alone.add(bins, before, sample.depth_mm, setup.period_s, 1.0);
                let hit = alone.bins().iter().enumerate().filter(|(_, bin)| bin.total > 0.0);
                shares.extend(hit.map(|(index, bin)| (index, bin.total)));
                before = sample.depth_mm;
            }
            let change = (sample.spindle_rpm - last_rpm) * 2.0 * PI / 60.0 / setup.period_s;
            last_rpm = sample.spindle_rpm;
            steps.push(Step {
                new_nm,
                worn_nm,
                omega: sample.spindle_rpm * 2.0 * PI / 60.0,
                spin_up_nm: self.params().machine.spindle_inertia_kg_m2 * change,
                shares_to: shares.len(),
            });
        })?;
        let duration_s = figures.duration_s;
        let way = way.bins().to_vec();
        Ok(Some(PreparedHole { steps, shares, way, config: *bins, setup: *setup, duration_s }))
    }

    /// Drills a prepared hole: the energy over depth as the spindle load over idle tells it, and the cycle time in s.
    ///
    /// The same equations as [`Twin::drill`]; only the noises that the spindle load shows are drawn.
    pub fn drill_prepared(
        &self,
        hole: &PreparedHole,
        wear: f64,
        noise: Option<&mut Noise>,
    ) -> (DepthProfile, f64) {
        let (material, levels) = (&self.params().material, &self.params().noise);
        let (dt_s, rpm) = (hole.setup.period_s, hole.setup.spindle_rpm);
        let rated_nm = self.params().machine.spindle_rated_torque_nm();
        let (fluctuates, scatter) = super::model::fluctuation(levels, dt_s);
        let keep = (-dt_s / material.cooling_s).exp();
        let gain = (1.0 - keep) * material.cooling_s / material.heat_capacity_j_per_k;
        let mut noise = noise;
        let strength = match noise.as_deref_mut() {
            Some(noise) if levels.cycle > 0.0 => super::model::strength(1.0 + levels.cycle * noise.normal()),
            _ => 1.0,
        };
        let per_nm = torque_energy_j(1.0, rpm, dt_s);
        let (mut hot, mut fluctuation) = (0.0, 0.0);
        let mut energy = vec![0.0; hole.way.len()];
        let mut shared = 0;
        for step in &hole.steps {
            let mut reading_nm = 0.0;
            if let Some(noise) = noise.as_deref_mut() {
                if levels.process > 0.0 {
                    fluctuation = fluctuates * fluctuation + scatter * noise.normal();
                }
                if levels.load_points > 0.0 {
                    reading_nm = levels.load_points / 100.0 * rated_nm * noise.normal();
                }
            }
            let soft = 1.0 / (1.0 + hot / material.softening_k);
            let torque_nm =
                strength * f64::max(1.0 + fluctuation, 0.0) * soft * (step.new_nm + wear * step.worn_nm);
            hot = keep * hot + gain * torque_nm * step.omega;
            let joules = per_nm * (torque_nm + step.spin_up_nm + reading_nm);
            for (bin, share) in &hole.shares[shared..step.shares_to] {
                energy[*bin] += share * joules;
            }
            shared = step.shares_to;
        }
        let bins = hole.way.iter().zip(energy).map(|(bin, total)| DepthBin { total, ..*bin });
        (DepthProfile::of_bins(&hole.config, bins), hole.duration_s)
    }
}
