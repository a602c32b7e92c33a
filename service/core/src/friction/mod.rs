//! Friction drilling.

pub mod calibration;
pub mod error;
pub mod feed_override;
pub mod filter;
pub mod law;
pub mod noise;
pub mod program;
pub mod relation;
pub mod stages;
pub mod study;
pub mod twin;
pub mod wear;
pub mod whatif;
