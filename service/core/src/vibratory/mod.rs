//! Vibratory drilling: chips are segmented by axial vibration of the drill, kept up by feedback of its velocity.
//!
//! - [`continuity`]: the dimensionless process with chip segmentation, control of the share of time in cut, maps,
//!   stability border and advice (Gouskov et al. 2015);
//! - [`peak_to_peak`]: the controller of the vibration's peak-to-peak value (Ivanov et al. 2024), which also runs on
//!   a controller board without `std`;
//! - [`loop_model`]: the dimensional process that closes that loop, Poincaré maps; [`tuning`] of the controller;
//! - [`recorded`]: frequency, amplitude and continuity of recorded blocks.

#[cfg(feature = "std")]
pub mod continuity;
#[cfg(feature = "std")]
pub mod loop_model;
pub mod peak_to_peak;
#[cfg(feature = "std")]
pub mod recorded;
#[cfg(feature = "std")]
pub mod tuning;
