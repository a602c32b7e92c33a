//! The one table of routes and roles.

use super::{
    alarms, audit, calibrations, continuity, course, cycles, edge, feed_profiles, fleet, friction, health,
    jobs, library, life, live, machines, openapi, operations, peak_to_peak, plunge, profile_evidence,
    profile_files, profile_optimise, quarantine, recommendations, retention, samples, series, session,
    stream, summaries, tokens, tool_events, tools, turning, viewer, wear, what_if,
};
use crate::auth::{Trust, authorise};
use crate::http::extract::WordAsId;
use crate::http::negotiate::prefers_pages;
use crate::http::problem::Problem;
use crate::state::AppState;
use crate::ui;
use axum::extract::DefaultBodyLimit;
use axum::middleware::from_fn_with_state;
use axum::routing::{MethodRouter, get};
use axum::{Extension, Router, response::IntoResponse, response::Response};
use feedwright_store::Role;
use http::{Extensions, HeaderMap, Method, StatusCode, Uri, Version, header};
use std::collections::HashMap;
use std::sync::LazyLock;
use tower_http::CompressionLevel;
use tower_http::compression::predicate::{NotForContentType, Predicate, SizeAbove};
use tower_http::compression::{CompressionLayer, DefaultPredicate};
use utoipa::Path;
use utoipa::openapi::path::{HttpMethod, PathItem};
use utoipa::openapi::{RefOr, Schema};
use utoipa_axum::router::UtoipaMethodRouter;
use utoipa_axum::{PathItemExt, routes};

/// Who may use a route.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// Everyone, without a token.
    Open,
    /// Tokens of these roles; a machine's only for the machine named in the path.
    Roles(&'static [Role]),
}

/// Reads everything but secrets.
pub const READ: Access = Access::Roles(&[Role::Viewer, Role::Engineer, Role::Approver, Role::Admin]);
/// Reads, and a machine its own.
pub const READ_OR_OWN: Access = Access::Roles(&Role::ALL);
/// A machine writes its own; an admin, who could make its token, replays and repairs.
pub const OWN: Access = Access::Roles(&[Role::Machine, Role::Admin]);
/// Registers, resets, acknowledges, repairs.
pub const ENGINEER: Access = Access::Roles(&[Role::Engineer, Role::Admin]);
/// Approves what others drafted.
pub const APPROVER: Access = Access::Roles(&[Role::Approver]);
/// Brings what is approved into force, and takes it back.
pub const RELEASE: Access = Access::Roles(&[Role::Engineer, Role::Approver, Role::Admin]);
/// Whoever has a token.
pub const EVERYONE: Access = Access::Roles(&Role::ALL);
/// Manages identities.
pub const ADMIN: Access = Access::Roles(&[Role::Admin]);

/// How large a body a route takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum BodyLimit {
    /// `limits.registration_bytes`.
    Registration,
    /// `limits.body_bytes`.
    Cycles,
}

/// One route: method, path, who may use it, and what answers.
pub struct Route {
    method: Method,
    path: String,
    access: Access,
    trust: Trust,
    body: BodyLimit,
    /// Makes its description, unless it is a page. All of them together are megabytes, and the code that makes them is as
    /// large again: who only serves touches neither.
    describe: Option<Describe>,
    /// A word that is a fixed part of another route where this one has an id.
    word: Option<&'static str>,
    handler: MethodRouter<AppState>,
}

/// What `routes!` makes of a handler: its description, and a router that is not needed for that.
type Describe = fn() -> UtoipaMethodRouter<AppState>;

/// A route that describes itself: `route!(module::handler, access)`. Method and path are those of the handler's own
/// `utoipa::path`.
macro_rules! route {
    ($module:ident::$handler:ident, $access:expr) => {
        pastey::paste! {{
            // A function with a name, unlike a closure: a list of what runs tells it from its neighbours.
            fn describe() -> UtoipaMethodRouter<AppState> {
                routes!($module::$handler)
            }
            let methods = $module::[<__path_ $handler>]::methods();
            let handler = MethodRouter::new();
            Route {
                method: method(&methods),
                path: $module::[<__path_ $handler>]::path(),
                access: $access,
                trust: Trust::Known,
                body: BodyLimit::Registration,
                describe: Some(describe),
                word: None,
                handler: methods
                    .iter()
                    .fold(handler, |all, method| all.on(method.to_method_filter(), $module::$handler)),
            }
        }}
    };
}

impl Route {
    /// A page or a file of one: not part of the described API.
    fn page(path: &str, handler: MethodRouter<AppState>) -> Self {
        Self {
            method: Method::GET,
            path: path.to_owned(),
            access: Access::Open,
            trust: Trust::Known,
            body: BodyLimit::Registration,
            describe: None,
            word: None,
            handler,
        }
    }

    /// Takes bodies up to `limits.body_bytes`.
    #[must_use]
    pub fn takes_cycles(self) -> Self {
        Self { body: BodyLimit::Cycles, ..self }
    }

    /// Answers a token that was good lately while the database cannot be asked. Only for what
    /// does no harm where its token was revoked elsewhere just before.
    #[must_use]
    fn in_an_outage(self) -> Self {
        Self { trust: Trust::Lately, ..self }
    }

    /// Answers also for the id that is this word, where the path of another route ends in it: what was stored under that id could not
    /// be read. The id is the last part of its path.
    #[must_use]
    fn also_named(self, word: &'static str) -> Self {
        Self { word: Some(word), ..self }
    }

    /// Where it answers beside its own path, and the id that is the word there.
    fn beside(&self) -> Option<(String, WordAsId)> {
        let (word, (above, id)) = (self.word?, self.path.rsplit_once('/')?);
        let name = id.strip_prefix('{')?.strip_suffix('}')?.into();
        Some((format!("{above}/{word}"), WordAsId { name, word }))
    }

    /// The method.
    pub const fn method(&self) -> &Method {
        &self.method
    }

    /// The path with its parameters in braces.
    pub fn path(&self) -> &str {
        &self.path
    }

    /// Who may use it.
    pub const fn access(&self) -> Access {
        self.access
    }

    /// Whether it is part of the described API; pages and their files are not.
    pub const fn is_described(&self) -> bool {
        self.describe.is_some()
    }
}

/// What a route adds to the description of the API.
pub(super) struct Description {
    pub(super) path: String,
    pub(super) item: PathItem,
    pub(super) schemas: Vec<(String, RefOr<Schema>)>,
    pub(super) access: Access,
}

/// The method of a handler, which has one.
fn method(methods: &[HttpMethod]) -> Method {
    match methods.first() {
        Some(HttpMethod::Put) => Method::PUT,
        Some(HttpMethod::Post) => Method::POST,
        Some(HttpMethod::Delete) => Method::DELETE,
        _ => Method::GET,
    }
}

/// What every route adds to the description of the API.
pub(super) fn descriptions() -> impl Iterator<Item = Description> {
    table().into_iter().filter_map(|route| {
        let (schemas, paths, _) = (route.describe?)();
        let (path, item) = paths.paths.into_iter().next()?;
        Some(Description { path, item, schemas, access: route.access })
    })
}

/// Every route there is.
pub fn table() -> Vec<Route> {
    let mut table = vec![
        route!(machines::put, ENGINEER),
        route!(machines::get, READ_OR_OWN),
        route!(machines::list, READ),
        route!(retention::put, ENGINEER),
        route!(retention::get, READ),
        route!(calibrations::add, ENGINEER),
        route!(calibrations::list, READ),
        route!(tools::put, ENGINEER),
        route!(tools::get, READ),
        route!(tools::list, READ),
        route!(tool_events::add, ENGINEER),
        route!(tool_events::revoke, ENGINEER),
        route!(tool_events::list, READ),
        route!(operations::put, ENGINEER),
        route!(operations::get, READ),
        route!(operations::list, READ),
        route!(alarms::list, READ),
        route!(alarms::acknowledge, ENGINEER),
        route!(alarms::acknowledge_machine, ENGINEER),
        route!(quarantine::list, READ),
        route!(quarantine::get, READ),
        route!(quarantine::settle, ENGINEER).takes_cycles(),
        route!(audit::list, READ),
        route!(tokens::create, ADMIN),
        route!(tokens::list, ADMIN),
        route!(tokens::revoke, ADMIN),
        // Open: the token is in the body, and its handler counts failures as `authorise` does.
        route!(session::begin, Access::Open),
        route!(session::get, EVERYONE),
        route!(session::end, EVERYONE),
        route!(fleet::get, READ),
        route!(fleet::machine, READ),
        route!(health::healthz, Access::Open),
        route!(health::readyz, Access::Open),
        route!(health::metrics, READ).in_an_outage(),
        route!(openapi::document, Access::Open),
        route!(cycles::post_cycle, OWN).takes_cycles(),
        route!(cycles::post_batch, OWN).takes_cycles(),
        route!(cycles::get_cycle, READ_OR_OWN).also_named("batch"),
        route!(samples::get_samples, READ_OR_OWN),
        route!(cycles::list_cycles, READ),
        route!(summaries::get_summaries, READ),
        route!(series::get_series, READ),
        route!(course::get, READ_OR_OWN),
        route!(wear::get_wear, READ),
        route!(wear::get_history, READ),
        route!(life::get, READ),
        route!(recommendations::get_recommendation, READ_OR_OWN),
        route!(recommendations::get_issued, READ_OR_OWN),
        route!(library::put_turning, ENGINEER),
        route!(library::get_turning, READ),
        route!(library::list_turning, READ),
        route!(library::put_plunge, ENGINEER),
        route!(library::get_plunge, READ),
        route!(library::list_plunge, READ),
        route!(turning::plan, READ),
        route!(turning::next, READ).takes_cycles(),
        route!(plunge::feed, READ).takes_cycles(),
        route!(plunge::saving, READ).takes_cycles(),
        route!(plunge::recorded, READ),
        route!(continuity::simulate, READ),
        route!(continuity::map, READ),
        route!(continuity::border, READ),
        route!(continuity::advice, READ),
        route!(peak_to_peak::tuning, READ),
        route!(peak_to_peak::close_loop, READ),
        route!(peak_to_peak::poincare, READ),
        route!(peak_to_peak::recorded, READ).takes_cycles(),
        route!(jobs::get, READ),
        route!(jobs::cancel, READ),
        route!(friction::simulate, READ),
        route!(live::events, READ),
        route!(stream::open, OWN),
        route!(stream::overrides, READ_OR_OWN),
        route!(what_if::of_cycle, READ),
        route!(what_if::of_many, READ),
        route!(calibrations::fit, ENGINEER),
        route!(feed_profiles::draft, ENGINEER),
        route!(feed_profiles::list, READ),
        route!(feed_profiles::get, READ_OR_OWN),
        route!(feed_profiles::versions, READ),
        route!(feed_profiles::version, READ_OR_OWN),
        route!(feed_profiles::compare, READ),
        route!(feed_profiles::shadow, ENGINEER),
        route!(feed_profiles::approve, APPROVER),
        route!(feed_profiles::activate, RELEASE),
        route!(feed_profiles::rollback, RELEASE),
        route!(profile_files::export, READ_OR_OWN),
        route!(profile_files::import, ENGINEER),
        route!(profile_files::read, READ),
        route!(profile_evidence::shadow_report, READ),
        route!(profile_evidence::comparison, READ),
        route!(profile_optimise::start, ENGINEER),
        route!(profile_optimise::outcome, READ),
        Route::page("/docs", get(viewer::index)),
        Route::page("/docs/", get(viewer::root)),
        Route::page("/docs/{*file}", get(viewer::file)),
        Route::page("/ui/{version}/{*file}", get(ui::file)),
    ];
    let page = |(path, name)| Route::page(path, get(move |headers: HeaderMap| ui::page(name, headers)));
    table.extend(ui::PAGES.map(page));
    table
}

/// What a role may use, as in `PUT /v1/tools/{tool}`, in the order of the table.
pub fn allowed(role: Role) -> &'static [String] {
    static ALLOWED: LazyLock<Vec<(Access, String)>> = LazyLock::new(|| {
        let described = table().into_iter().filter(Route::is_described);
        described.map(|route| (route.access, format!("{} {}", route.method, route.path))).collect()
    });
    static BY_ROLE: LazyLock<HashMap<Role, Vec<String>>> = LazyLock::new(|| {
        let may = |role: Role| {
            let open = |access: Access| match access {
                Access::Open => true,
                Access::Roles(roles) => roles.contains(&role),
            };
            ALLOWED.iter().filter(|(access, _)| open(*access)).map(|(_, name)| name.clone()).collect()
        };
        Role::ALL.into_iter().map(|role| (role, may(role))).collect()
    });
    BY_ROLE.get(&role).map_or(&[], Vec::as_slice)
}

/// What a change by a route is told as; `None` for what changes nothing that advice or a verdict rests on: what a machine
/// posts is told by itself, and what viewers post is computed alone.
fn changes(route: &Route) -> Option<&'static str> {
    const TOLD: [&str; 7] =
        ["alarms", "feed-profiles", "machines", "models", "operations", "quarantine", "tools"];
    let may_change = [ENGINEER, APPROVER, RELEASE].contains(&route.access) && route.method != Method::GET;
    let part = route.path.strip_prefix("/v1/")?.split('/').next()?;
    // Drafts are nobody's advice: only the steps of a profile are, which stand under its name.
    if part == "feed-profiles" && !route.path.contains("{profile}/") {
        return None;
    }
    TOLD.into_iter().find(|told| may_change && *told == part)
}

/// Answers of fewer bytes are not worth the work.
const LEAST_SQUEEZED: u16 = 4096;

/// Squeezes what is read, for who asks for it by `Accept-Encoding`: a page with hundreds of machines or thousands of cycles comes
/// over a workshop's radio. What is an event or squeezed by itself goes as it is, and so does what has a strong ETag: that names these
/// bytes and no others (RFC 9110, section 8.8.3.3), and a change has to name it. One thing is small in any case.
fn squeezing() -> CompressionLayer<impl Predicate> {
    let worth = DefaultPredicate::new()
        .and(SizeAbove::new(LEAST_SQUEEZED))
        .and(NotForContentType::const_new("application/vnd.apache."))
        .and(without_strong_etag);
    CompressionLayer::new().quality(CompressionLevel::Fastest).compress_when(worth)
}

fn without_strong_etag(_: StatusCode, _: Version, headers: &HeaderMap, _: &Extensions) -> bool {
    headers.get(header::ETAG).is_none_or(|tag| tag.as_bytes().starts_with(b"W/"))
}

/// The router over the table.
pub fn router(state: AppState) -> Router {
    let limits = state.config.limits;
    let mut router = Router::new();
    for route in table() {
        let (what, beside) = (changes(&route), route.beside());
        let Route { method, path, access, trust, body, mut handler, .. } = route;
        let limit = match body {
            BodyLimit::Registration => limits.registration_bytes,
            BodyLimit::Cycles => limits.body_bytes,
        };
        let guard = from_fn_with_state((state.clone(), access, trust), authorise);
        if let Some(what) = what {
            handler = handler.route_layer(from_fn_with_state((state.clone(), what), super::changes::tell));
        }
        if method == Method::GET && path.starts_with("/v1/") {
            handler = handler.route_layer(squeezing());
        }
        // Layers run from the last to the first: nobody's body is read before their token.
        let handler = handler.route_layer(DefaultBodyLimit::max(limit)).route_layer(guard);
        if let Some((path, id)) = beside {
            router = router.route(&path, handler.clone().route_layer(Extension(id)));
        }
        router = router.route(&path, handler);
    }
    router
        .fallback(unknown_address)
        .method_not_allowed_fallback(wrong_method)
        .layer(from_fn_with_state(state.clone(), edge::answer))
        .with_state(state)
}

/// The router of the metrics' own listener: it needs no token, and has nothing else.
pub fn metrics_router(state: AppState) -> Router {
    Router::new()
        .route("/metrics", get(health::metrics))
        .fallback(unknown_path)
        .method_not_allowed_fallback(wrong_method)
        .layer(from_fn_with_state(state.clone(), edge::answer))
        .with_state(state)
}

/// Somebody who opened it in a browser is shown a page that leads on; whoever asks for data is told in data.
async fn unknown_address(method: Method, uri: Uri, headers: HeaderMap) -> Response {
    let is_page = matches!(method, Method::GET | Method::HEAD) && prefers_pages(&headers);
    if is_page && !uri.path().starts_with("/v1/") {
        return ui::unknown(&headers).await;
    }
    unknown_path(uri).await
}

async fn unknown_path(uri: Uri) -> Response {
    Problem::new(StatusCode::NOT_FOUND, "unknown_path", format!("there is nothing at {}", uri.path()))
        .into_response()
}

async fn wrong_method(method: Method) -> Response {
    let detail = format!("{method} is not possible here");
    Problem::new(StatusCode::METHOD_NOT_ALLOWED, "method_not_allowed", detail).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::dto::feed_profile::profile_id;

    #[test]
    fn what_changes_advice_is_told_and_what_machines_post_or_viewers_compute_is_not() {
        let table = table();
        let told = |method: Method, path: &str| {
            let route = table.iter().find(|route| route.method == method && route.path == path);
            changes(route.unwrap_or_else(|| panic!("{method} {path}")))
        };
        assert_eq!(told(Method::PUT, "/v1/tools/{tool}"), Some("tools"));
        assert_eq!(told(Method::POST, "/v1/tools/{tool}/events"), Some("tools"));
        assert_eq!(told(Method::POST, "/v1/machines/{machine}/acknowledge"), Some("machines"));
        assert_eq!(told(Method::PUT, "/v1/operations/{operation}"), Some("operations"));
        assert_eq!(told(Method::POST, "/v1/machines/{machine}/cycles"), None);
        assert_eq!(told(Method::PUT, "/v1/models/plunge/{model}"), Some("models"));
        assert_eq!(told(Method::POST, "/v1/tokens"), None);
        assert_eq!(told(Method::POST, "/v1/feed-profiles"), None);
        assert_eq!(told(Method::GET, "/v1/tools"), None);
        let of_profiles = table.iter().filter(|route| changes(route) == Some("feed-profiles"));
        let paths: Vec<_> = of_profiles.map(|route| route.path.rsplit('/').next().unwrap()).collect();
        assert!(paths.contains(&"activate") && paths.contains(&"rollback"), "{paths:?}");
    }

    #[test]
    fn no_fixed_part_of_a_path_hides_what_is_stored_under_that_id() {
        let table: Vec<_> = table().into_iter().filter(Route::is_described).collect();
        for route in &table {
            for other in table.iter().filter(|other| other.path != route.path) {
                let parts = || route.path.split('/').zip(other.path.split('/'));
                let is_same_length = route.path.split('/').count() == other.path.split('/').count();
                let words: Vec<_> = parts().filter(|(part, word)| part != word).collect();
                let is_word = |(part, word): &(&str, &str)| part.starts_with('{') && !word.starts_with('{');
                if !is_same_length || !words.iter().all(is_word) {
                    continue;
                }
                let [(part, word)] = words[..] else { panic!("{} and {}", route.path, other.path) };
                let is_answered = route.beside().is_some_and(|(path, _)| path == other.path);
                let is_refused = part == "{profile}" && profile_id("profile", word).is_err();
                assert!(is_answered || is_refused, "{} hides {} {}", other.path, route.method, route.path);
            }
        }
    }
}
