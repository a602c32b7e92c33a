//! What handlers take out of paths and queries.

use super::dto::text::{MAX_NAME, required};
use super::problem::Problem;
use crate::json::named_field;
use axum::extract::rejection::QueryRejection;
use axum::extract::{FromRequestParts, RawPathParams};
use feedwright_core::ids::{CycleId, MachineId, ModelId, OperationId, ProfileId, RecommendationId, ToolId};
use feedwright_core::invalid::Violation;
use http::request::Parts;
use percent_encoding::percent_decode_str;
use serde::de::DeserializeOwned;
use std::error::Error;
use std::sync::Arc;

/// An identifier that stands in the path under its own name.
pub trait InPath: Sized {
    /// The parameter's name in the path.
    const NAME: &'static str;

    /// Reads it.
    fn read(text: &str) -> Result<Self, Violation>;
}

macro_rules! in_path {
    ($($id:ty, $name:literal;)*) => {$(
        impl InPath for $id {
            const NAME: &'static str = $name;

            fn read(text: &str) -> Result<Self, Violation> {
                Self::parse($name, text)
            }
        }
    )*};
}

in_path! {
    MachineId, "machine";
    ToolId, "tool";
    OperationId, "operation";
    CycleId, "cycle_id";
    RecommendationId, "recommendation_id";
    ModelId, "model";
    ProfileId, "profile";
}

/// A number of a row.
impl InPath for i64 {
    const NAME: &'static str = "id";

    fn read(text: &str) -> Result<Self, Violation> {
        text.parse().map_err(|_| Violation::new("id", "invalid_id", "must be a whole number"))
    }
}

/// The number of a version, counted from 1.
impl InPath for u32 {
    const NAME: &'static str = "version";

    fn read(text: &str) -> Result<Self, Violation> {
        let version = text.parse().ok().filter(|version| *version > 0);
        version.ok_or_else(|| Violation::new("version", "invalid_version", "must be a whole number from 1"))
    }
}

/// The id of a row as the store made it.
impl InPath for String {
    const NAME: &'static str = "id";

    fn read(text: &str) -> Result<Self, Violation> {
        feedwright_core::ids::CycleId::parse("id", text).map(|id| id.as_str().to_owned())
    }
}

/// An identifier that is not a parameter of the matched path but a fixed part of it.
#[derive(Debug, Clone)]
pub struct WordAsId {
    /// The parameter's name.
    pub name: Arc<str>,
    /// The identifier.
    pub word: &'static str,
}

/// One identifier of the path; a handler may take several of different types.
#[derive(Debug)]
pub struct PathId<T>(pub T);

impl<T: InPath, S: Send + Sync> FromRequestParts<S> for PathId<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let params = RawPathParams::from_request_parts(parts, state).await.map_err(|_| path_not_utf8())?;
        let text = params.iter().find(|(name, _)| *name == T::NAME).map(|(_, text)| text);
        let word = || parts.extensions.get::<WordAsId>().filter(|id| *id.name == *T::NAME).map(|id| id.word);
        let text =
            text.or_else(word).ok_or_else(|| Problem::internal(format!("the path has no {}", T::NAME)))?;
        let id = T::read(text);
        id.map(Self).map_err(|violation| {
            let detail = violation.to_string();
            Problem { errors: vec![violation], ..Problem::bad_request("invalid_path", detail) }
        })
    }
}

/// 400: no id can be read out of the path.
pub fn path_not_utf8() -> Problem {
    Problem::bad_request("invalid_path", "the path is not UTF-8")
}

/// The query; its type denies unknown parameters. What is no text is refused: read as far as it is some, it would be another question.
#[derive(Debug)]
pub struct Query<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for Query<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        parts.uri.query().map_or(Ok(()), must_be_utf8)?;
        let read = axum::extract::Query::<T>::from_request_parts(parts, state).await;
        read.map(|query| Self(query.0)).map_err(|rejection| match violation(&rejection) {
            Some(violation) => Problem::invalid_query(violation),
            None => Problem::bad_request("invalid_query", rejection.body_text()),
        })
    }
}

/// Refuses a query that decodes to bytes which are no UTF-8, with the parameter where that has a name.
fn must_be_utf8(query: &str) -> Result<(), Problem> {
    let decoded = |text| percent_decode_str(text).decode_utf8().ok();
    let Some(wrong) = query.split('&').find(|pair| decoded(pair).is_none()) else { return Ok(()) };
    let name = wrong.split_once('=').and_then(|(name, _)| decoded(name));
    Err(match name {
        Some(name) => Problem::invalid_query(Violation::new(name, "invalid_value", "is not UTF-8")),
        None => Problem::bad_request("invalid_query", "the query is not UTF-8"),
    })
}

/// Which parameter is wrong, and how; `None` where the query is none at all.
fn violation(rejection: &QueryRejection) -> Option<Violation> {
    let mut cause = rejection.source();
    let error = loop {
        let error = cause?;
        match error.downcast_ref::<serde_path_to_error::Error<serde::de::value::Error>>() {
            Some(found) => break found,
            None => cause = error.source(),
        }
    };
    let sentence = error.inner().to_string();
    if let Some((name, code)) = named_field(&sentence) {
        return Some(Violation::new(name, code, sentence.clone()));
    }
    Some(Violation::new(error.path().to_string(), "invalid_value", number_in_words(sentence)))
}

/// What the standard library says of a number that it cannot read, in the words of those who send one.
fn number_in_words(sentence: String) -> String {
    let words = match sentence.as_str() {
        "invalid digit found in string" | "cannot parse integer from empty string" => {
            "expected a whole number"
        }
        "invalid float literal" | "cannot parse float from empty string" => "expected a number",
        "number too large to fit in target type" => "is too large",
        "provided string was not `true` or `false`" => "expected true or false",
        _ => return sentence,
    };
    words.to_owned()
}

/// Reads an identifier of the query: 400 with its name.
pub fn query_id<T: for<'a> TryFrom<&'a str, Error = Violation>>(
    text: Option<&str>,
) -> Result<Option<T>, Problem> {
    text.map(T::try_from).transpose().map_err(Problem::invalid_query)
}

/// A name in a query, as the ones that are registered: text that no database has is told alike whichever keeps the others.
pub fn query_name(path: &str, text: Option<String>) -> Result<Option<String>, Problem> {
    let Some(text) = text else { return Ok(None) };
    let mut wrong = Vec::new();
    let name = required(path, &text, MAX_NAME, &mut wrong);
    wrong.pop().map_or(Ok(Some(name)), |wrong| Err(Problem::invalid_query(wrong)))
}
