//! Adaptive plunge-in of a drill: fast until contact, working feed to breakthrough (Lengerov).
//!
//! [`plunge_feeds`] gives the fastest approach each drill of a tool table bears, [`part_saving`] what it saves per
//! hole and part and whether it pays at all. Contact and breakthrough themselves are found by [`crate::contact`].

mod feed;
mod saving;
mod setup;

pub use feed::{
    Drill, DrillInput, DrillingLaw, LoopLatency, LoopLatencyInput, MAX_DRILLS, Machine, MachineInput,
    Material, MaterialInput, PlungeFeed, PlungeLimit, plunge_feed, plunge_feeds,
};
pub use saving::{
    Hole, HoleInput, HoleSaving, MAX_HOLES, PartSaving, hole_saving, part_saving, relative_saving,
};
pub use setup::{PLUNGE_LAW_VERSION, PlungeSetup};
