//! The description of the API is checked in, complete and fresh.

use super::app::{App, operation};
use feedwright_server::http::openapi::json;
use feedwright_server::http::routes::table;
use feedwright_store::Role;
use http::StatusCode;
use serde_json::Value;
use std::collections::BTreeSet;

const CHECKED_IN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../openapi/openapi.json");

#[test]
fn the_checked_in_description_is_fresh() {
    let fresh = json().unwrap();
    // Saves a build of the binary for whoever has just built the tests.
    if std::env::var_os("FEEDWRIGHT_BLESS").is_some() {
        std::fs::write(CHECKED_IN, &fresh).unwrap();
    }
    let stored = std::fs::read_to_string(CHECKED_IN).unwrap_or_default();
    assert!(
        stored == fresh,
        "openapi/openapi.json is stale: run `cargo run -- openapi > openapi/openapi.json`"
    );
}

#[tokio::test]
async fn it_describes_every_route_of_the_api_and_no_other() {
    let served = App::new().await.get("/openapi.json").await;
    let described: Value = served.json();
    let paths = described["paths"].as_object().unwrap();
    let described: BTreeSet<_> = paths
        .iter()
        .flat_map(|(path, item)| {
            item.as_object().unwrap().keys().map(move |method| format!("{} {path}", method.to_uppercase()))
        })
        .collect();
    let mounted: BTreeSet<_> = table()
        .iter()
        .filter(|route| route.is_described())
        .map(|route| format!("{} {}", route.method(), route.path()))
        .collect();
    assert_eq!(described, mounted);
}

#[test]
fn every_reference_leads_somewhere_and_every_operation_has_a_name_of_its_own() {
    let document: Value = serde_json::from_str(&json().unwrap()).unwrap();
    let mut references = Vec::new();
    let mut names = Vec::new();
    collect(&document, &mut references, &mut names);
    assert!(!references.is_empty());
    for reference in references {
        let pointer = reference.strip_prefix('#').unwrap();
        assert!(document.pointer(pointer).is_some(), "{reference} leads nowhere");
    }
    let unique: BTreeSet<_> = names.iter().collect();
    assert_eq!(unique.len(), names.len(), "{names:?}");
}

/// OpenAPI 3.1, Response Object: a reader of the standard refuses the document otherwise.
#[test]
fn every_answer_is_described() {
    let document: Value = serde_json::from_str(&json().unwrap()).unwrap();
    let operations =
        document["paths"].as_object().unwrap().values().flat_map(|item| item.as_object().unwrap());
    let answers =
        operations.flat_map(|(_, operation)| operation["responses"].as_object().into_iter().flatten());
    let mut seen = 0;
    for (status, answer) in answers {
        assert!(answer["description"].as_str().is_some_and(|text| !text.is_empty()), "{status}: {answer}");
        seen += 1;
    }
    assert!(seen > 200, "{seen}");
}

#[test]
fn every_number_fits_what_it_is_told_as() {
    fn look(part: &Value, seen: &mut usize) {
        if part["format"] == "int32" {
            let within =
                |limit: &Value| limit.as_f64().is_some_and(|limit| limit.abs() <= f64::from(i32::MAX));
            assert!(within(&part["maximum"]) || part["minimum"] != 0, "{part}");
        }
        if part["format"] == "int64" && part["minimum"] == 0 {
            *seen += 1;
        }
        match part {
            Value::Object(parts) => parts.values().for_each(|part| look(part, seen)),
            Value::Array(parts) => parts.iter().for_each(|part| look(part, seen)),
            _ => {}
        }
    }
    let mut seen = 0;
    look(&serde_json::from_str(&json().unwrap()).unwrap(), &mut seen);
    assert!(seen > 50, "{seen}");
}

/// Whoever makes a client of the description is told the same as by a refusal.
#[tokio::test]
async fn numbers_are_refused_beyond_the_bounds_that_are_described() {
    let app = App::registered().await;
    let document: Value = serde_json::from_str(&json().unwrap()).unwrap();
    let mut asked = 0;
    for (template, item) in document["paths"].as_object().unwrap() {
        let path = template.replace("{machine}", "M1").replace("{tool}", "T1");
        let parameters = item["get"]["parameters"].as_array().into_iter().flatten();
        let numbers = parameters.filter(|parameter| parameter["schema"]["minimum"].is_number());
        for number in numbers.filter(|_| !path.contains('{')) {
            let (name, (least, most)) = (number["name"].as_str().unwrap(), bounds(&number["schema"]));
            let needed = if path == "/v1/plunge/recorded" { "operation=O1&" } else { "" };
            let told = async |value: i64| {
                let asked = format!("{path}?{needed}{name}={value}");
                app.call(Role::Admin, "GET", &asked, &[], None).await.json()["errors"][0]["path"] == name
            };
            assert!(told(least - 1).await && told(most + 1).await, "{path} {name}");
            assert!(!told(least).await, "{path} {name}");
            asked += 1;
        }
    }
    assert!(asked > 15, "{asked}");
    let settings = document["components"]["schemas"]["WearSettingsBody"]["properties"].as_object().unwrap();
    for (name, setting) in settings.iter().filter(|(_, setting)| setting["minimum"].is_number()) {
        let (least, most) = bounds(setting);
        for (value, status) in [
            (least - 1, StatusCode::UNPROCESSABLE_ENTITY),
            (least, StatusCode::CREATED),
            (most, StatusCode::CREATED),
            (most + 1, StatusCode::UNPROCESSABLE_ENTITY),
        ] {
            let mut body = operation();
            body["wear"] = serde_json::json!({ name: value });
            let answer = app.put(&format!("/v1/operations/{name}-{value}"), body).await;
            assert_eq!(answer.status, status, "{name} {value}: {answer:?}");
        }
    }
}

/// The least and the largest value of a number.
fn bounds(schema: &Value) -> (i64, i64) {
    (schema["minimum"].as_i64().unwrap(), schema["maximum"].as_i64().unwrap())
}

fn collect(at: &Value, references: &mut Vec<String>, names: &mut Vec<String>) {
    match at {
        Value::Object(object) => {
            for (key, value) in object {
                match (key.as_str(), value) {
                    ("$ref", Value::String(to)) => references.push(to.clone()),
                    ("operationId", Value::String(name)) => names.push(name.clone()),
                    _ => collect(value, references, names),
                }
            }
        }
        Value::Array(array) => array.iter().for_each(|value| collect(value, references, names)),
        _ => {}
    }
}
