//! The cycle store: one trait, two engines, and the codec of sample blocks.
//!
//! Everything that is acknowledged is committed; times are arguments; HTTP and JSON bodies do not belong here.
//! SQL that both engines understand stands once, in `engine/`; an engine's own folder holds only what differs.
//! A new noun is a record in `record.rs`, its methods in [`Store`], its table in both migration folders (same
//! number and name), its statements in `engine/`, and its story in the suite that runs on both engines.

pub mod codec;
pub mod durable;
mod error;
mod fault;
mod feed_profile;
mod gate;
mod history;
mod lanes;
mod locks;
mod notice;
mod past;
mod point;
mod postgres;
mod precondition;
mod recent;
mod record;
mod registry;
mod row_sum;
mod rows;
mod slot;
mod sqlite;
mod store;
mod stored_text;
pub mod transfer;
pub mod wire;
mod work;

pub use error::{StoreError, StoreResult};
pub use feed_profile::*;
pub use notice::{Listener, Notices};
pub use past::PAST;
pub use point::*;
pub use postgres::{CommonClock, PostgresOptions, PostgresStore, unknown_parameter};
pub use record::*;
pub use row_sum::{SumPage, SummedTo};
pub use sqlite::{SqliteOptions, SqliteStore, faults_of_file};
pub use store::Store;
pub use stored_text::StoredText;
