//! Errors as the API tells them: RFC 9457 problem documents with a stable code.
//!
//! A new error is a [`Problem`] made where it is found, with a code that no other meaning has; an error of the store
//! is mapped in [`From<StoreError>`] and nowhere else. Rendering happens once, in the outermost layer, which knows
//! the request's id and logs the private part.

use axum::response::{IntoResponse, Response};
use feedwright_core::ids::{CycleId, MachineId};
use feedwright_core::invalid::{Violation, bounded};
use feedwright_store::StoreError;
use http::{HeaderName, HeaderValue, StatusCode, header};
use serde::Serialize;
use std::borrow::Cow;
use std::time::Duration;
use utoipa::ToSchema;

/// Most violations listed in one document; a column of 200 000 bad values would otherwise be answered in full.
pub const MAX_VIOLATIONS: usize = 100;
/// Longest detail, bytes.
const MOST_DETAIL: usize = 2000;

/// An error on its way to the client.
#[derive(Debug, Clone)]
pub struct Problem {
    /// Status of the answer.
    pub status: StatusCode,
    /// Stable code.
    pub code: &'static str,
    /// A sentence for a person; public.
    pub detail: Cow<'static, str>,
    /// What is wrong with which field.
    pub errors: Vec<Violation>,
    /// Further members of the document, as in `quarantine_id`.
    pub members: serde_json::Map<String, serde_json::Value>,
    /// Headers of the answer.
    pub headers: Vec<(HeaderName, HeaderValue)>,
    /// What only the log may know.
    pub private: Option<String>,
}

/// A problem document (RFC 9457). Further members may follow, as in `quarantine_id`.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Problem)]
pub struct ProblemDocument<'a> {
    /// Names the kind of problem.
    #[serde(rename = "type")]
    #[schema(example = "urn:feedwright:problem:not_found")]
    pub kind: String,
    /// The status in words.
    pub title: &'a str,
    /// The status.
    pub status: u16,
    /// What happened, for a person.
    pub detail: &'a str,
    /// Stable, machine-readable code.
    #[schema(example = "not_found")]
    pub code: &'a str,
    /// What is wrong with which field.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub errors: Vec<FieldError<'a>>,
    /// Names the request in the log.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub request_id: Option<&'a str>,
    /// Further members.
    #[serde(flatten)]
    #[schema(ignore)]
    pub members: &'a serde_json::Map<String, serde_json::Value>,
}

/// What is wrong with one field.
#[derive(Debug, Serialize, ToSchema)]
pub struct FieldError<'a> {
    /// Path from the root of the body, as in `samples.spindle_load_percent[17]`.
    pub path: &'a str,
    /// Stable code.
    pub code: &'a str,
    /// What was expected and what was found.
    pub message: &'a str,
}

impl Problem {
    /// A problem with a status, a stable code and a public sentence.
    pub fn new(status: StatusCode, code: &'static str, detail: impl Into<Cow<'static, str>>) -> Self {
        // It may repeat what came in, which may be as long as a body.
        let detail = match detail.into() {
            Cow::Owned(text) => Cow::Owned(bounded(text, MOST_DETAIL)),
            told => told,
        };
        Self {
            status,
            code,
            detail,
            errors: Vec::new(),
            members: serde_json::Map::new(),
            headers: Vec::new(),
            private: None,
        }
    }

    /// 400 with a code.
    pub fn bad_request(code: &'static str, detail: impl Into<Cow<'static, str>>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, code, detail)
    }

    /// 400 with the parameter of the query that is wrong.
    pub fn invalid_query(violation: Violation) -> Self {
        let detail = violation.to_string();
        Self { errors: vec![violation], ..Self::bad_request("invalid_query", detail) }
    }

    /// 404: there is no such thing.
    pub fn not_found(what: &str, id: &str) -> Self {
        Self::new(StatusCode::NOT_FOUND, "not_found", format!("there is no {what} `{id}`"))
    }

    /// 422 with the fields that are wrong.
    pub fn invalid(mut errors: Vec<Violation>) -> Self {
        let found = errors.len();
        errors.truncate(MAX_VIOLATIONS);
        let detail = match errors.as_slice() {
            [only] if found == 1 => only.to_string(),
            [first, ..] => format!("{found} fields are not accepted; the first: {first}"),
            [] => "the content is not accepted".to_owned(),
        };
        // One fault has its own code; several are told apart in the list.
        let code = match errors.as_slice() {
            [only] if found == 1 => only.code,
            _ => "invalid_content",
        };
        Self { errors, ..Self::new(StatusCode::UNPROCESSABLE_ENTITY, code, detail) }
    }

    /// 500, with what only the log may know.
    pub fn internal(private: impl Into<String>) -> Self {
        let problem = Self::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            "internal_error",
            "something went wrong here; the log has the details under the request's id",
        );
        problem.private(private)
    }

    /// 503, to be tried again after `seconds`.
    pub fn unavailable(code: &'static str, detail: impl Into<Cow<'static, str>>, seconds: u64) -> Self {
        Self::new(StatusCode::SERVICE_UNAVAILABLE, code, detail).retry_after(Duration::from_secs(seconds))
    }

    /// 503: the database is away.
    pub fn database_unavailable() -> Self {
        Self::unavailable(
            "database_unavailable",
            "the database does not answer, or has no room; nothing was changed",
            2,
        )
    }

    /// 503: the database answers, and a read waited in vain for others to end.
    fn too_many_reads() -> Self {
        Self::unavailable(
            "too_many_reads",
            "other reads are under way, and this one did not have its turn in time",
            2,
        )
    }

    /// What reading the samples of one cycle of many failed with: where they are damaged it says which cycle's they are.
    pub fn of_samples(error: StoreError, machine: &MachineId, cycle: &CycleId) -> Self {
        let are_damaged = matches!(error, StoreError::Damaged { .. });
        let problem = Self::from(error.of_cycle(machine.as_str(), cycle.as_str()));
        if !are_damaged {
            return problem;
        }
        let detail = format!(
            "the samples of cycle {machine}/{cycle} cannot be read: damaged, or of a newer version; `feedwright check` \
             tells what else is"
        );
        Self { detail: detail.into(), ..problem }
    }

    /// Whether it is told because the database is away, or too busy.
    pub fn is_of_outage(&self) -> bool {
        matches!(self.code, "database_unavailable" | "too_many_reads" | "outcome_unknown")
    }

    /// Says when to try again, in whole seconds, at least one.
    #[must_use]
    pub fn retry_after(self, wait: Duration) -> Self {
        let seconds = wait.as_secs() + u64::from(wait.subsec_nanos() > 0);
        self.header(header::RETRY_AFTER, HeaderValue::from(seconds.max(1)))
    }

    /// Adds a header.
    #[must_use]
    pub fn header(mut self, name: HeaderName, value: HeaderValue) -> Self {
        self.headers.push((name, value));
        self
    }

    /// Adds a member to the document.
    #[must_use]
    pub fn member(mut self, name: &str, value: impl Into<serde_json::Value>) -> Self {
        self.members.insert(name.to_owned(), value.into());
        self
    }

    /// Adds what only the log may know.
    #[must_use]
    pub fn private(mut self, private: impl Into<String>) -> Self {
        self.private = Some(private.into());
        self
    }

    /// The problem document as JSON: what is answered, and what the quarantine keeps beside a body.
    pub fn document(&self, request_id: Option<&str>) -> String {
        let errors = self.errors.iter();
        let document = ProblemDocument {
            kind: format!("urn:feedwright:problem:{}", self.code),
            title: self.status.canonical_reason().unwrap_or("Error"),
            status: self.status.as_u16(),
            detail: &self.detail,
            code: self.code,
            errors: errors.map(|e| FieldError { path: &e.path, code: e.code, message: &e.message }).collect(),
            request_id,
            members: &self.members,
        };
        // A map with string keys and no floats cannot fail to serialise.
        serde_json::to_string(&document).unwrap_or_default()
    }

    /// The answer, complete.
    pub(crate) fn render(&self, request_id: Option<&str>) -> Response {
        let mut response = Response::new(axum::body::Body::from(self.document(request_id)));
        *response.status_mut() = self.status;
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/problem+json"));
        for (name, value) in &self.headers {
            headers.append(name, value.clone());
        }
        response
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let mut response = self.render(None);
        // The outermost layer renders it again, with the request's id.
        response.extensions_mut().insert(self);
        response
    }
}

impl From<Violation> for Problem {
    fn from(violation: Violation) -> Self {
        Self::invalid(vec![violation])
    }
}

impl From<Vec<Violation>> for Problem {
    fn from(violations: Vec<Violation>) -> Self {
        Self::invalid(violations)
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        let private = private(&error);
        let etag = |version: u64| HeaderValue::try_from(format!("\"{version}\""));
        let of_other_reads = error.is_of_other_reads();
        let problem = match error {
            StoreError::Unavailable(_) if of_other_reads => Self::too_many_reads(),
            StoreError::Unavailable(_) => Self::database_unavailable(),
            StoreError::OutcomeUnknown(_) => Self::unavailable(
                "outcome_unknown",
                "the database was lost while committing; send the same again to find out",
                2,
            ),
            StoreError::NotWritable(_) => {
                Self::unavailable("database_not_writable", "the database does not take writes", 30)
            }
            StoreError::NotReadable(_) => {
                Self::unavailable("database_not_readable", "the database cannot be read from its disk", 30)
            }
            StoreError::Refused { constraint } => Self::new(
                StatusCode::UNPROCESSABLE_ENTITY,
                "refused_by_database",
                format!("the database refuses it: {constraint}"),
            ),
            StoreError::Damaged { .. } => Self::new(
                StatusCode::INTERNAL_SERVER_ERROR,
                "stored_data_damaged",
                "what is stored cannot be read: damaged, or of a newer version",
            ),
            StoreError::VersionMismatch { current } => {
                let problem = Self::new(
                    StatusCode::PRECONDITION_FAILED,
                    "version_mismatch",
                    if current == 0 {
                        "it does not exist".to_owned()
                    } else {
                        format!("version {current} is in force: read it, then change that")
                    },
                )
                .member("current_version", current);
                match etag(current) {
                    Ok(etag) if current > 0 => problem.header(header::ETAG, etag),
                    _ => problem,
                }
            }
            StoreError::VersionRequired { current } => Self::new(
                StatusCode::PRECONDITION_REQUIRED,
                "version_required",
                "it exists with other content: name the version you change with If-Match",
            )
            .member("current_version", current),
            StoreError::Conflict { code, why } => Self::new(StatusCode::CONFLICT, code, why),
            StoreError::Full { what } => Self::unavailable("full", format!("the {what} is full"), 60),
            StoreError::Database(_) => Self::internal(""),
        };
        // Preconditions are the client's affair and not worth a line in the log.
        if problem.status.is_server_error() { problem.private(private) } else { problem }
    }
}

/// The whole chain of causes, for the log.
fn private(error: &StoreError) -> String {
    let mut text = error.to_string();
    let mut cause = std::error::Error::source(error);
    while let Some(error) = cause {
        text.push_str(": ");
        text.push_str(&error.to_string());
        cause = error.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_read_that_the_disk_refuses_is_no_write() {
        let of = |error| {
            let problem = Problem::from(error);
            (problem.status.as_u16(), problem.code, problem.headers.len())
        };
        assert_eq!(of(StoreError::NotReadable("EIO".into())), (503, "database_not_readable", 1));
        assert_eq!(of(StoreError::NotWritable("EIO".into())), (503, "database_not_writable", 1));
    }

    #[test]
    fn damaged_samples_are_told_of_their_cycle_and_once() {
        let damaged = StoreError::Damaged { what: "sample block: checksum differs".to_owned() };
        let (machine, cycle) = ("M1".try_into().unwrap(), "c7".try_into().unwrap());
        let problem = Problem::of_samples(damaged, &machine, &cycle);
        assert_eq!(problem.code, "stored_data_damaged");
        assert!(problem.detail.contains("the samples of cycle M1/c7 cannot be read"), "{}", problem.detail);
        let logged = "stored data is damaged: cycle M1/c7: sample block: checksum differs";
        assert_eq!(problem.private.as_deref(), Some(logged));
    }
}
