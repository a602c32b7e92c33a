//! Feed profiles: the feed over depth that an operation runs, with its limits and how far it holds.
//!
//! Source of the idea: R. Stryczek and P. Błaszczak, "Optimal feed rate control strategies for friction drilling", 2020,
//! section 4.2 (F_Lin, and choosing F_pr from recorded cycles).
//!
//! | module | what |
//! |---|---|
//! | [`profile`] | a piecewise-linear feed over depth, valid by construction, hashed by content, compared knot by knot |
//! | [`life_cycle`] | draft → shadow → approved → active → superseded |
//! | [`choose`] | which active version is handed out for the next cycle, or why none is |
//! | [`nc`] | a profile as a file for a control, and such a file read back |
//! | [`import`] | feed lists and simple programs as knots |
//! | [`comparison`] | two versions by the cycles that ran them, with intervals |
//! | [`optimise`] | the fastest profile that keeps the set loads, learned from recorded cycles |
//! | [`study`] | how good the optimiser is on process models that it does not know |
//!
//! A profile says what a control runs. Who drafted it, who approved it and which version is in force belong to the
//! store.

pub mod choose;
pub mod comparison;
pub mod import;
pub mod life_cycle;
pub mod nc;
pub mod optimise;
pub mod profile;
pub mod study;
