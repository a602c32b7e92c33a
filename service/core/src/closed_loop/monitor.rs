//! Blocks of vibration beside the machine, for set-up and monitoring (Ivanov et al. 2024).
//!
//! The controller's inner loop runs at about 3 kHz and belongs on the control; over a network it would act on a
//! vibration that is long over. Here it runs on what the control has sampled, and says what it would have answered.

use super::reason::{LoopReason, LoopReasons};
use crate::vibratory::peak_to_peak::{Controller, ControllerSettings, VibrationSample};

/// Most samples of one block: 1.2 s at 300 µs.
pub const MOST_BLOCK: usize = 4096;

/// What a block tells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlockAdvice {
    /// Gain b after the block, −1..1.
    pub gain: f64,
    /// Least and greatest gain within it.
    pub gain_range: (f64, f64),
    /// Peak-to-peak displacement after it, mm.
    pub amplitude_mm: f64,
    /// Vibration frequency after it, Hz.
    pub frequency_hz: f64,
    /// Samples that could not be used.
    pub unusable: usize,
    /// Why it is what it is.
    pub reasons: LoopReasons,
    /// The number of the sample that comes next.
    pub next: u64,
}

/// A controller that runs beside the machine.
#[derive(Debug, Clone)]
pub struct Monitor {
    settings: ControllerSettings,
    controller: Controller,
    next: u64,
    last: Option<(u64, Vec<VibrationSample>, BlockAdvice)>,
}

impl Monitor {
    /// A controller at rest.
    #[must_use]
    pub const fn new(settings: ControllerSettings) -> Self {
        Self { settings, controller: Controller::new(settings), next: 0, last: None }
    }

    /// Takes the block whose first sample has the number `first`; at most [`MOST_BLOCK`] samples are looked at.
    ///
    /// A block that does not follow its predecessor starts the controller anew: its times would be wrong. The last
    /// block again, with the same content, gets its answer again. Samples that cannot be used, and a block of none,
    /// leave amplitude and frequency as they were; the gain is 0 after them.
    pub fn take(&mut self, first: u64, block: &[VibrationSample]) -> BlockAdvice {
        let block = &block[..block.len().min(MOST_BLOCK)];
        let mut reasons = LoopReasons::NONE;
        if let Some((number, known, answer)) = &self.last
            && *number == first
        {
            if same(known, block) {
                let reasons = answer.reasons.and(LoopReasons::of(LoopReason::Repeated));
                return BlockAdvice { reasons, ..*answer };
            }
            reasons.add(LoopReason::RepeatDiffers);
        }
        if first != self.next {
            reasons.add(if first > self.next { LoopReason::MissingSamples } else { LoopReason::OutOfOrder });
            self.controller = Controller::new(self.settings);
        }
        let mut unusable = 0;
        let mut gain = 0.0;
        let mut gain_range = (f64::INFINITY, f64::NEG_INFINITY);
        for sample in block {
            match self.controller.step(*sample) {
                Ok(step) => {
                    gain = step.gain;
                    gain_range = (gain_range.0.min(gain), gain_range.1.max(gain));
                }
                Err(_) => {
                    // The actuator is off for a sample that cannot be used.
                    gain = 0.0;
                    gain_range = (gain_range.0.min(0.0), gain_range.1.max(0.0));
                    unusable += 1;
                }
            }
        }
        if unusable > 0 || block.is_empty() {
            reasons.add(LoopReason::UnusableSample);
        }
        if block.is_empty() {
            gain_range = (0.0, 0.0);
        }
        self.next = first.saturating_add(block.len() as u64);
        let answer = BlockAdvice {
            gain,
            gain_range,
            // Of the controller, not of its last step: a sample that cannot be used leaves both as they were.
            amplitude_mm: self.controller.displacement_mm(),
            frequency_hz: self.controller.frequency_rad_s() / std::f64::consts::TAU,
            unusable,
            reasons,
            next: self.next,
        };
        // A block of nothing is none that the next one of its number could repeat.
        if !block.is_empty() {
            self.last = Some((first, block.to_vec(), answer));
        }
        answer
    }
}

fn same(a: &[VibrationSample], b: &[VibrationSample]) -> bool {
    let bits = |s: &VibrationSample| (s.velocity_mm_s.to_bits(), s.acceleration_mm_s2.to_bits());
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| bits(a) == bits(b))
}
