//! Friction drilling.

pub mod error;
pub mod feed_override;
pub mod filter;
pub mod law;
pub mod noise;
