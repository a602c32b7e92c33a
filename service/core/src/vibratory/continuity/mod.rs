//! Cutting continuity: the process with chip segmentation and its control (Gouskov et al. 2015).
//!
//! Everything is dimensionless, as in the paper: lengths in feeds per edge, time in periods of edge passing, force
//! in spring force per feed. [`advise`] translates from and to a machine's units.

mod advice;
mod border;
mod map;
mod process;

pub use advice::{
    Advice, AdviceInput, AdviceQuestion, HeadAdvice, MAX_SIMULATIONS, SpeedPoint, SpeedWindow, advise,
    advise_head, best_of,
};
pub use border::{BorderPoint, border_at, border_minimum, segmentation_amplitude};
pub use map::{Cancelled, Map, MapAxis, MapInput, MapQuestion, run_map};
pub use process::{
    ContinuityControl, Diverged, Process, ProcessInput, Simulated, Steady, TracePoint, Traced, simulate,
    simulate_many, trace,
};

#[cfg(test)]
mod tests;
