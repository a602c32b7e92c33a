//! The science of Feedwright: cycles, wear, recommendations and the control laws, as pure functions.
//!
//! Nothing here reads a clock, a file, the environment or a random source; time is an argument, and the same
//! input gives the same bits. Storage, JSON and HTTP do not belong here. One folder per machining process:
//! a new one is a folder with its paper's equations, its tests beside it, and a line in the list below.
//!
//! Without the feature `std` only what a controller board needs is compiled, for targets such as
//! `thumbv7em-none-eabihf`; a module that needs `std` says so below.

#![cfg_attr(not(any(feature = "std", test)), no_std)]

pub mod contact;
pub mod field_error;
mod shown;
pub mod vibratory;

#[cfg(feature = "std")]
pub mod closed_loop;
#[cfg(feature = "std")]
pub mod cycle;
#[cfg(feature = "std")]
pub mod feed;
#[cfg(feature = "std")]
pub mod friction;
#[cfg(feature = "std")]
pub mod ids;
#[cfg(feature = "std")]
pub mod invalid;
#[cfg(feature = "std")]
pub mod machine;
#[cfg(feature = "std")]
pub mod operation;
#[cfg(feature = "std")]
pub mod plunge;
#[cfg(feature = "std")]
pub mod recommend;
#[cfg(feature = "std")]
pub mod series;
#[cfg(feature = "std")]
pub mod summary;
#[cfg(feature = "std")]
pub mod tool;
#[cfg(feature = "std")]
pub mod turning;
#[cfg(feature = "std")]
pub mod units;
#[cfg(feature = "std")]
pub mod wear;
