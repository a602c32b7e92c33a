//! Bodies of the API: what JSON looks like, and how it becomes values of the core.
//!
//! A body that is read denies unknown fields and turns into a core value with every violation named by its path.
//! Names carry their unit. Nothing here decides anything.

pub mod alarm;
pub mod audit;
pub mod calibration;
pub mod continuity;
pub mod course;
pub mod cycle;
pub mod feed_profile;
pub mod fit;
pub mod fleet;
pub mod friction;
pub mod job;
pub mod library;
pub mod life;
pub mod machine;
pub mod mirror;
pub mod operation;
pub mod optimise;
pub mod peak_to_peak;
pub mod plunge;
pub mod profile_evidence;
pub mod profile_file;
pub mod profile_json;
pub mod quarantine;
pub mod recommendation;
pub mod retention;
pub mod series;
pub mod session;
pub mod text;
pub mod time;
pub mod token;
pub mod tool;
pub mod turning;
pub mod wear;
pub mod what_if;
pub mod word;

use feedwright_core::invalid::Violation;
use feedwright_core::units::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// Which page of a list.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct PageQuery {
    /// Most rows wanted, up to `limits.max_page_size` of the configuration, which is 1000 unless set otherwise; 100
    /// (`limits.default_page_size`) where it is left out.
    #[param(minimum = 1, maximum = 10_000)]
    pub limit: Option<u32>,
    /// `next_cursor` of the page before.
    pub cursor: Option<String>,
}

/// Something with its version, as it is answered.
#[derive(Debug, Serialize, ToSchema)]
pub struct Registered<T> {
    /// Its id.
    pub id: String,
    /// Its version; the ETag holds it too.
    pub version: u64,
    /// When this version came into force, RFC 3339.
    pub updated_at: String,
    /// Whether the disk has changed it since it was written: nothing is decided by it until it is put anew. Left out where it is not
    /// known to be.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub damaged: bool,
    /// What was registered.
    #[serde(flatten)]
    pub body: T,
}

impl<T> Registered<T> {
    /// As it is answered: its id, its version with when that came into force, and whether it is damaged.
    fn of(id: &str, (version, updated_at, damaged): (u64, Timestamp, bool), body: T) -> Self {
        Self { id: id.to_owned(), version, updated_at: time::show(updated_at), damaged, body }
    }
}

/// Joins what a body found wrong with what the core finds wrong with its value.
fn checked<T>(
    value: T,
    mut wrong: Vec<Violation>,
    check: impl FnOnce(T) -> Result<T, Vec<Violation>>,
) -> Result<T, Vec<Violation>> {
    match check(value) {
        Ok(value) if wrong.is_empty() => Ok(value),
        Ok(_) => Err(wrong),
        Err(more) => {
            wrong.extend(more);
            Err(wrong)
        }
    }
}
