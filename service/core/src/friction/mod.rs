//! Friction drilling: adaptive feed, stages, calibration, wear and a process model.
//!
//! Source: R. Stryczek and P. Błaszczak, "Optimal feed rate control strategies for friction drilling", 2020; equation
//! numbers are the paper's, and a repaired misprint says so where it stands. Everything is a pure function or a
//! state with a step: the caller brings time, samples and, for the model, a seeded [`noise::Noise`].
//!
//! | module | what |
//! |---|---|
//! | [`filter`] | load filter, Eq. 1 |
//! | [`law`] | relative load, correction and override law, Eq. 2–4, with their safety envelope |
//! | [`feed_override`] | limits, and the only type that carries an override out of the core |
//! | [`program`] | feed programs and strategies (F_Const, F_Sec, F_Lin, F_AC) as data |
//! | [`stages`] | contact, breakthrough and stages A to D from the loads |
//! | [`calibration`] | lines from drive load to thrust and torque |
//! | [`energy`] | energy of a hole, Eq. 5–7, on two bases |
//! | [`relation`] | energy or load over depth and feed, learned with uncertainty |
//! | [`wear`] | what a cycle's energy says of the tool at the feeds run, and at the reference feed |
//! | [`whatif`] | a stored cycle under another law, program or limits |
//! | [`twin`] | the process model |
//! | [`compare`] | strategies beside each other on it, Fig. 21 |
//! | [`study`] | lives of many tools on the process model |
//!
//! A configuration is plain parameters checked once by a constructor; an [`error::Invalid`] names the field. To add
//! a law or a detector: a folder with its equations, its config, its state and step, and its tests on the model.
//! Transport, storage and the choice of which cycles count do not belong here.

pub mod calibration;
pub mod compare;
pub mod energy;
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
