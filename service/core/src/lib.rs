//! The science of Feedwright: cycles, wear, recommendations and the control laws, as pure functions.
//!
//! Nothing here reads a clock, a file, the environment or a random source; time is an argument, and the same
//! input gives the same bits. Storage, JSON and HTTP do not belong here. One folder per machining process:
//! a new one is a folder with its paper's equations, its tests beside it, and a line in the list below.

pub mod friction;
