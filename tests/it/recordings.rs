//! Recordings of real machines: what is said of their tools.

mod judged;
