//! State and step of the process model.

use super::config::{NoiseLevels, TwinParams};
use super::geometry::{Contact, ContactTable};
use crate::friction::energy::{thrust_energy_j, torque_energy_j};
use crate::friction::error::{Invalid, between, positive};
use crate::friction::noise::Noise;
use std::f64::consts::PI;

/// Correlation time of the process fluctuation in s: what a hole's own unevenness lasts.
const FLUCTUATION_S: f64 = 0.1;

/// What the process fluctuation keeps of itself from one step to the next, and the scatter that is added.
pub(super) fn fluctuation(levels: &NoiseLevels, dt_s: f64) -> (f64, f64) {
    let keep = (-dt_s / FLUCTUATION_S).exp();
    (keep, (1.0 - keep * keep).sqrt() * levels.process)
}

/// A material's strength within what is sane.
pub(super) const fn strength(strength: f64) -> f64 {
    strength.clamp(0.1, 10.0)
}

/// A checked model with its contact tables.
#[derive(Debug, Clone, PartialEq)]
pub struct Twin {
    params: TwinParams,
    contact: ContactTable,
}

/// One step's input, as a control would give it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwinInput {
    /// Tip depth below first contact in mm; negative in the air.
    pub depth_mm: f64,
    /// Actual feed in mm/min; 0 is standstill, negative is drawing back.
    pub feed_mm_min: f64,
    /// Spindle speed in rpm.
    pub spindle_rpm: f64,
    /// Time since the step before in s.
    pub dt_s: f64,
}

/// One step's output.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TwinOutput {
    /// Thrust F_a in N, as a dynamometer reads it.
    pub thrust_n: f64,
    /// Torque T_a in N·m, as a dynamometer reads it.
    pub torque_nm: f64,
    /// Feed-drive load L_Z in percent of the rated thrust.
    pub feed_drive_percent: f64,
    /// Spindle load L_C in percent of the rated torque.
    pub spindle_percent: f64,
    /// Rise of the heated zone over the surroundings in K.
    pub temperature_rise_k: f64,
    /// Mechanical power of torque and thrust in W.
    pub power_w: f64,
    /// Energy of this step (Stryczek & Błaszczak 2020, Eq. 5 and 6) in J.
    pub energy_j: f64,
}

/// Memory of the model within one hole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwinState {
    temperature_rise_k: f64,
    wear: f64,
    strength: f64,
    fluctuation: f64,
    last_rpm: f64,
    last_feed_mm_min: f64,
}

impl TwinState {
    /// A cold hole with a tool of this wear (units of the wear law; 0 is new) and a standing spindle.
    ///
    /// # Errors
    /// When the wear is not between 0 and 10.
    pub fn new(wear: f64) -> Result<Self, Invalid> {
        between("wear", wear, 0.0, 10.0)?;
        Ok(Self {
            temperature_rise_k: 0.0,
            wear,
            strength: 1.0,
            fluctuation: 0.0,
            last_rpm: 0.0,
            last_feed_mm_min: 0.0,
        })
    }

    /// The same with a spindle that turns already: what it takes to spin it up was before.
    #[must_use]
    pub fn with_spindle_rpm(self, rpm: f64) -> Self {
        Self { last_rpm: rpm.max(0.0), ..self }
    }

    /// The same hole in material of another strength (1 is nominal), as it varies from piece to piece.
    #[must_use]
    pub fn with_strength(self, strength: f64) -> Self {
        Self { strength: self::strength(strength), ..self }
    }
}

impl Twin {
    /// Checks the parameters and integrates the contact.
    ///
    /// # Errors
    /// With the path of the first parameter that is out of range.
    pub fn new(params: TwinParams) -> Result<Self, Invalid> {
        params.check()?;
        Ok(Self { params, contact: ContactTable::new(&params) })
    }

    /// The checked parameters.
    #[must_use]
    pub const fn params(&self) -> &TwinParams {
        &self.params
    }

    /// Wear after a number of cycles, in units of the wear law.
    #[must_use]
    pub fn wear_after(&self, cycles: f64) -> f64 {
        let wear = &self.params.wear;
        (cycles.max(0.0) / wear.cycles_per_unit).powf(wear.growth_exponent)
    }

    /// One step of a machine that drills: a depth, a feed and a speed in, loads out.
    ///
    /// `noise` adds the configured noise; `None` is the noise-free model. Meant for a line-by-line driver, so
    /// every number is checked.
    ///
    /// # Errors
    /// With the field that is not finite or out of range; the state is then unchanged.
    pub fn step(
        &self,
        state: &mut TwinState,
        input: &TwinInput,
        noise: Option<&mut Noise>,
    ) -> Result<TwinOutput, Invalid> {
        between("depth_mm", input.depth_mm, -10_000.0, 10_000.0)?;
        between("feed_mm_min", input.feed_mm_min, -1e6, 1e6)?;
        between("spindle_rpm", input.spindle_rpm, 0.0, 1e6)?;
        positive("dt_s", input.dt_s, 60.0)?;
        Ok(self.advance(state, input, noise))
    }

    /// Torque of a new tool in cold nominal material, and what a unit of wear adds, N·m.
    pub(super) fn cold_torque_nm(&self, input: &TwinInput) -> (f64, f64) {
        self.cold_torque_of(input, &self.contact.at(input.depth_mm))
    }

    fn cold_torque_of(&self, input: &TwinInput, contact: &Contact) -> (f64, f64) {
        let (material, wear) = (&self.params.material, &self.params.wear);
        let per_revolution =
            if input.spindle_rpm > 1.0 { input.feed_mm_min.max(0.0) / input.spindle_rpm } else { 0.0 };
        let rate = per_revolution / material.reference_feed_mm;
        let torque_rate = rate.powf(material.torque_rate_exponent);
        let drag_rate = if wear.rate_exponent > 0.0 { rate.powf(wear.rate_exponent) } else { 1.0 };
        let turning = if input.spindle_rpm > 0.0 { 1.0 } else { 0.0 };
        let flash_mm3 = self.collar_ring_mm2() * self.collar_middle_mm() * contact.flash;
        // MPa × mm³ is N·mm.
        let new_nm = 1e-3
            * turning
            * (torque_rate
                * (material.forming_mpa * contact.forming_mm3 + material.flash_shear_mpa * flash_mm3)
                + material.friction_mpa * contact.sliding_mm3);
        (new_nm, 1e-3 * turning * wear.drag_mpa * drag_rate * contact.worn_mm3)
    }

    fn collar_ring_mm2(&self) -> f64 {
        let (collar, tool) = (self.params.tool.collar_diameter_mm / 2.0, self.params.tool.diameter_mm / 2.0);
        PI * (collar * collar - tool * tool)
    }

    fn collar_middle_mm(&self) -> f64 {
        f64::midpoint(self.params.tool.collar_diameter_mm / 2.0, self.params.tool.diameter_mm / 2.0)
    }

    /// [`Twin::step`] for input that is known to be in range.
    ///
    /// Torque = strength × softening × (rate × forming + sliding + wear × drag), each with its contact integral;
    /// thrust likewise. The rate is (feed per revolution / reference) to a power, so faster forming is harder
    /// but takes less time; sliding contact does not know the feed, so slow forming costs more energy. The
    /// softening 1/(1 + ΔT/T½) follows one lumped temperature that the torque's power heats.
    pub(super) fn advance(
        &self,
        state: &mut TwinState,
        input: &TwinInput,
        noise: Option<&mut Noise>,
    ) -> TwinOutput {
        let (material, wear, machine) = (&self.params.material, &self.params.wear, &self.params.machine);
        let contact = self.contact.at(input.depth_mm);
        let omega = input.spindle_rpm * 2.0 * PI / 60.0;
        let per_revolution =
            if input.spindle_rpm > 1.0 { input.feed_mm_min.max(0.0) / input.spindle_rpm } else { 0.0 };
        let rate = per_revolution / material.reference_feed_mm;
        let thrust_rate = rate.powf(material.thrust_rate_exponent);
        let soft = 1.0 / (1.0 + state.temperature_rise_k / material.softening_k);

        let mut samples = [0.0; 4];
        if let Some(noise) = noise {
            let levels = &self.params.noise;
            if levels.process > 0.0 {
                let (keep, scatter) = fluctuation(levels, input.dt_s);
                state.fluctuation = keep * state.fluctuation + scatter * noise.normal();
            }
            let scales = [levels.thrust_n, levels.torque_nm, levels.load_points, levels.load_points];
            for (sample, scale) in samples.iter_mut().zip(scales) {
                if scale > 0.0 {
                    *sample = scale * noise.normal();
                }
            }
        }
        let strength = state.strength * (1.0 + state.fluctuation).max(0.0) * soft;
        let turning = if omega > 0.0 { 1.0 } else { 0.0 };
        let (new_nm, worn_nm) = self.cold_torque_of(input, &contact);
        let torque_nm = strength * (new_nm + state.wear * worn_nm);
        let thrust_n = strength
            * thrust_rate
            * (material.normal_mpa * (1.0 + state.wear * wear.thrust_rise) * contact.thrust_mm2
                + material.flash_normal_mpa * self.collar_ring_mm2() * contact.flash);

        let power = torque_nm * omega;
        let keep = (-input.dt_s / material.cooling_s).exp();
        let steady = power * material.cooling_s / material.heat_capacity_j_per_k;
        state.temperature_rise_k = keep * state.temperature_rise_k + (1.0 - keep) * steady;

        let spin_up = machine.spindle_inertia_kg_m2 * (input.spindle_rpm - state.last_rpm) * 2.0 * PI
            / 60.0
            / input.dt_s;
        let rated_nm = machine.spindle_rated_torque_nm();
        let inertia_n =
            machine.feed_mass_kg * (input.feed_mm_min - state.last_feed_mm_min) / 60e3 / input.dt_s;
        state.last_rpm = input.spindle_rpm;
        state.last_feed_mm_min = input.feed_mm_min;
        let feed_mm = input.feed_mm_min / 60.0 * input.dt_s;
        let (thrust_read, torque_read) = (thrust_n + samples[0], torque_nm + samples[1]);
        TwinOutput {
            thrust_n: thrust_read,
            torque_nm: torque_read,
            feed_drive_percent: machine.feed_idle_percent
                + 100.0 * (thrust_n + inertia_n) / machine.feed_rated_thrust_n
                + samples[2],
            spindle_percent: machine.spindle_idle_percent * turning
                + 100.0 * (torque_nm + spin_up) / rated_nm
                + samples[3],
            temperature_rise_k: state.temperature_rise_k,
            power_w: power + thrust_n * input.feed_mm_min.max(0.0) / 60e3,
            energy_j: torque_energy_j(torque_read, input.spindle_rpm, input.dt_s)
                + thrust_energy_j(thrust_read, feed_mm),
        }
    }
}
