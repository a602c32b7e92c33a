//! The description of the API, made from the table of routes.

mod merge;

use super::problem::ProblemDocument;
use super::routes::{Access, Description, descriptions};
use super::unsigned;
use axum::response::{IntoResponse, Response};
use http::header;
use std::collections::BTreeSet;
use std::sync::LazyLock;
use utoipa::openapi::path::{Operation, PathItem};
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{
    Components, ContentBuilder, InfoBuilder, OpenApi, Paths, Ref, RefOr, ResponseBuilder, Schema,
};
use utoipa::{PartialSchema, ToSchema};

/// What an error is told as.
const PROBLEM: &str = "application/problem+json";

/// The description as JSON, made once.
static JSON: LazyLock<Result<String, String>> = LazyLock::new(json);

/// The description of the API: OpenAPI 3.1.
#[utoipa::path(get, path = "/openapi.json", tag = "service", responses((status = 200, body = Object)))]
pub(super) async fn document() -> Response {
    match JSON.as_ref() {
        Ok(json) => ([(header::CONTENT_TYPE, "application/json")], json.as_str()).into_response(),
        Err(error) => super::problem::Problem::internal(error.as_str()).into_response(),
    }
}

/// The description as JSON, as it is checked in.
pub fn json() -> Result<String, String> {
    let json = describe()?.to_pretty_json().map_err(|error| error.to_string())?;
    Ok(json + "\n")
}

/// The description; an error names what two types share, since one of them would be told wrong.
fn describe() -> Result<OpenApi, String> {
    let info = InfoBuilder::new()
        .title("Feedwright")
        .version("1")
        .description(Some(
            "Machining cycles in; tool wear and recommendations out.\n\nAn `integer` is written without a fraction and without an \
             exponent: `1.0` and `1e0`, which JSON Schema takes for integers too, are refused (422, `wrong_type`; 400 in a query).",
        ))
        .build();
    let mut paths = Paths::new();
    let mut components = Components::new();
    let mut nested = Vec::new();
    ProblemDocument::schemas(&mut nested);
    components.schemas.insert(ProblemDocument::name().into_owned(), ProblemDocument::schema());
    let mut shared = BTreeSet::new();
    add(&mut components, nested, &mut shared);
    for Description { path, mut item, schemas, access } in descriptions() {
        for (method, operation) in operations(&mut item) {
            // Handlers of different nouns share their names; paths are unique.
            operation.operation_id = Some(operation_id(method, &path));
            secure(operation, access);
            describe_answers(operation);
            unsigned::hold_those_of(operation);
        }
        add(&mut components, schemas, &mut shared);
        match paths.paths.get_mut(&path) {
            Some(known) => known.merge_operations(item),
            None => {
                paths.paths.insert(path, item);
            }
        }
    }
    if !shared.is_empty() {
        return Err(format!("several types are called {shared:?}: their names have to tell them apart"));
    }
    merge::merge(&mut components.schemas);
    components.schemas.values_mut().for_each(unsigned::hold);
    let bearer = HttpBuilder::new().scheme(HttpAuthScheme::Bearer).bearer_format("fwt").build();
    components.add_security_scheme("token", SecurityScheme::Http(bearer));
    let mut openapi = OpenApi::new(info, paths);
    openapi.components = Some(components);
    Ok(openapi)
}

/// Adds schemas by their names; `shared` takes the names of those that are not the same.
fn add(components: &mut Components, schemas: Vec<(String, RefOr<Schema>)>, shared: &mut BTreeSet<String>) {
    for (name, schema) in schemas {
        if components.schemas.get(&name).is_some_and(|known| *known != schema) {
            shared.insert(name);
        } else {
            components.schemas.insert(name, schema);
        }
    }
}

/// Every answer is described, as OpenAPI wants it: those whose handler says nothing of them by what they are.
fn describe_answers(operation: &mut Operation) {
    for (status, response) in &mut operation.responses.responses {
        if let RefOr::T(response) = response
            && response.description.is_empty()
        {
            let usual = match status.as_str() {
                "200" => "What was asked for",
                "201" => "It was made",
                "204" => "It was done; there is nothing to tell",
                _ => "See its problem document",
            };
            response.description = usual.to_owned();
        }
    }
}

fn operations(item: &mut PathItem) -> impl Iterator<Item = (&'static str, &mut Operation)> {
    let all = [
        ("get", &mut item.get),
        ("put", &mut item.put),
        ("post", &mut item.post),
        ("delete", &mut item.delete),
    ];
    all.into_iter().filter_map(|(method, operation)| Some((method, operation.as_mut()?)))
}

/// As in `get_tools_tool_events`.
fn operation_id(method: &str, path: &str) -> String {
    let parts =
        path.split(|c: char| !c.is_ascii_alphanumeric()).filter(|part| !part.is_empty() && *part != "v1");
    parts.fold(method.to_owned(), |id, part| id + "_" + part)
}

/// Says who may use it, and that every error is a problem document.
fn secure(operation: &mut Operation, access: Access) {
    if let Access::Roles(roles) = access {
        operation.security = Some(vec![SecurityRequirement::new("token", Vec::<String>::new())]);
        let roles: Vec<_> = roles.iter().map(|role| role.as_str()).collect();
        let line = format!("Roles: {}.", roles.join(", "));
        let before = operation.description.take().filter(|text| !text.is_empty());
        operation.description = Some(before.map_or(line.clone(), |text| format!("{text}\n\n{line}")));
    }
    let schema = RefOr::Ref(Ref::from_schema_name(ProblemDocument::name()));
    for response in operation.responses.responses.values_mut() {
        if let RefOr::T(utoipa::openapi::Response { content, .. }) = response
            && let Some(RefOr::T(json)) = content.get("application/json")
            && json.schema.as_ref() == Some(&schema)
            && let Some(problem) = content.shift_remove("application/json")
        {
            content.insert(PROBLEM.to_owned(), problem);
        }
    }
    let content = ContentBuilder::new().schema(Some(schema)).build();
    let response = ResponseBuilder::new()
        .description("What went wrong, as a problem document (RFC 9457).")
        .content(PROBLEM, content)
        .build();
    operation.responses.responses.insert("default".to_owned(), RefOr::T(response));
}
