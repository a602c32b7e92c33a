//! Holds what is sent and answered in every story against the description of the API: a field that is told and not
//! described, or described and not told, fails the story in which it is seen.

use feedwright_server::http::openapi::json;
use jsonschema::Validator;
use serde_json::{Value, json};
use std::collections::HashMap;
use std::sync::{Arc, LazyLock, Mutex};

/// Bodies larger than this are lists of what smaller ones have held before.
const LARGEST: usize = 1 << 20;

static DOCUMENT: LazyLock<Value> = LazyLock::new(|| serde_json::from_str(&json().unwrap()).unwrap());

/// Validators by the pointer to their schema.
static VALIDATORS: LazyLock<Mutex<HashMap<String, Arc<Validator>>>> = LazyLock::new(Mutex::default);

/// A request or an answer: its media type and its bytes.
pub(crate) struct Content<'a> {
    pub(crate) kind: &'a str,
    pub(crate) bytes: &'a [u8],
}

/// Panics where the exchange is not as it is described; what is no route of the API is passed over.
#[track_caller]
pub(crate) fn holds(
    method: &str,
    path: &str,
    sent: Option<Content<'_>>,
    status: u16,
    answered: &Content<'_>,
) {
    let Some(template) = template(path, &method.to_lowercase()) else { return };
    let operation = &DOCUMENT["paths"][template][method.to_lowercase()];
    let at = format!("/paths/{}/{}", escaped(template), method.to_lowercase());
    let status_told = operation["responses"].get(status.to_string());
    assert!(
        status_told.is_some() || status >= 400,
        "{method} {template} answers {status}, which is not described"
    );
    let key = if status_told.is_some() { status.to_string() } else { "default".to_owned() };
    check(&format!("{at}/responses/{key}"), answered, &format!("the answer {status} to {method} {path}"));
    if let Some(sent) = sent
        && status < 300
        && !sent.bytes.is_empty()
    {
        check(&format!("{at}/requestBody"), &sent, &format!("what was accepted by {method} {path}"));
    }
}

#[track_caller]
fn check(at: &str, content: &Content<'_>, what: &str) {
    if content.bytes.is_empty() {
        return;
    }
    let kind = content.kind.split(';').next().unwrap_or_default().trim();
    let described = DOCUMENT.pointer(at).unwrap_or_else(|| panic!("{what} is not described"));
    let media = described["content"].get(kind);
    assert!(media.is_some(), "{what} is {kind:?}, which is not described: {}", described["content"]);
    if (kind != "application/json" && !kind.ends_with("+json")) || content.bytes.len() > LARGEST {
        return;
    }
    let value: Value =
        serde_json::from_slice(content.bytes).unwrap_or_else(|error| panic!("{what} is no JSON: {error}"));
    let validator = validator(&format!("{at}/content/{}/schema", escaped(kind)));
    let wrong: Vec<String> = validator
        .iter_errors(&value)
        .take(5)
        .map(|error| format!("{}: {error}", error.instance_path()))
        .collect();
    assert!(wrong.is_empty(), "{what} is not as it is described: {wrong:#?}\n{value}");
}

fn validator(at: &str) -> Arc<Validator> {
    let mut validators = VALIDATORS.lock().unwrap();
    let known = validators.entry(at.to_owned()).or_insert_with(|| {
        let schema = DOCUMENT.pointer(at).unwrap_or_else(|| panic!("{at} has no schema"));
        let whole = json!({
            "$schema": "https://json-schema.org/draft/2020-12/schema",
            "allOf": [schema],
            "components": DOCUMENT["components"],
        });
        Arc::new(jsonschema::validator_for(&whole).unwrap())
    });
    Arc::clone(known)
}

/// The path described with a method that a path is one of; that with the most words of its own where there are several.
fn template(path: &str, method: &str) -> Option<&'static str> {
    let parts: Vec<&str> = path.split('?').next()?.split('/').collect();
    DOCUMENT["paths"]
        .as_object()?
        .iter()
        .filter(|(_, operations)| operations.get(method).is_some())
        .map(|(template, _)| template)
        .filter(|template| {
            let own: Vec<&str> = template.split('/').collect();
            own.len() == parts.len()
                && own.iter().zip(&parts).all(|(own, part)| own.starts_with('{') || own == part)
        })
        .min_by_key(|template| template.matches('{').count())
        .map(String::as_str)
}

/// A name as a step of a JSON pointer.
fn escaped(name: &str) -> String {
    name.replace('~', "~0").replace('/', "~1")
}

#[test]
fn what_is_not_described_is_found() {
    let found = |status: u16, bytes: &'static [u8]| {
        let answered = Content { kind: "application/json", bytes };
        std::panic::catch_unwind(|| holds("GET", "/v1/machines/M1/retention", None, status, &answered))
            .is_err()
    };
    assert!(found(201, b"{}"), "a status that is not described");
    assert!(found(200, b"{}"), "fields that are missing");
    assert!(!found(200, br#"{"from":"server","dropped":[]}"#));
    assert!(found(200, br#"{"from":"server","dropped":[],"more":1}"#), "a field that is not described");
    assert!(found(404, b"{}"), "an error that is no problem document");
}
