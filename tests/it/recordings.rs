//! Recordings of real machines: what is said of their tools, and that replaying them loses and doubles nothing.

mod judged;
mod replayed;
