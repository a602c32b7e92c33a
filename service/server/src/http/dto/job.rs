//! Long computations in JSON.

use crate::http::dto::time;
use crate::jobs::{Snapshot, Stage};
use serde::Serialize;
use utoipa::ToSchema;

/// A long computation. Once it is done, `result` holds what the question's endpoint answers when it is short.
#[derive(Debug, Serialize, ToSchema)]
pub struct JobBody {
    /// Its id.
    pub id: String,
    /// What is computed, as in `vibratory_map`.
    pub kind: &'static str,
    /// `waiting`, `running`, `done`, `cancelled` or `failed`.
    pub state: &'static str,
    /// Points done.
    pub done: usize,
    /// Points in all.
    pub total: usize,
    /// When it was asked for first.
    pub created_at: String,
    /// The result, once it is done. Its text is put in as it was computed.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Object>)]
    pub result: Option<()>,
}

impl From<&Snapshot> for JobBody {
    fn from(job: &Snapshot) -> Self {
        Self {
            id: job.id.clone(),
            kind: job.kind,
            state: match job.stage {
                Stage::Waiting => "waiting",
                Stage::Running => "running",
                Stage::Done(_) => "done",
                Stage::Cancelled => "cancelled",
                Stage::Failed => "failed",
            },
            done: job.done,
            total: job.total,
            created_at: time::show(job.created_at),
            result: None,
        }
    }
}
