//! The one table of routes and roles.

use super::{
    alarms, audit, calibrations, continuity, course, cycles, edge, feed_profiles, fleet, friction, health,
    jobs, library, life, live, machines, openapi, operations, peak_to_peak, plunge, profile_evidence,
    profile_files, profile_optimise, quarantine, recommendations, retention, samples, series, session,
    stream, summaries, tokens, tool_events, tools, turning, viewer, wear, what_if,
};
use crate::auth::authorise;
use crate::http::problem::Problem;
use crate::state::AppState;
use crate::ui;
use axum::extract::DefaultBodyLimit;
use axum::middleware::from_fn_with_state;
use axum::routing::{MethodRouter, get};
use axum::{Router, response::IntoResponse, response::Response};
use feedwright_store::Role;
use http::{HeaderMap, Method, StatusCode, Uri};
use std::collections::HashMap;
use std::sync::LazyLock;
use utoipa::openapi::path::PathItem;
use utoipa::openapi::{RefOr, Schema};
use utoipa_axum::router::UtoipaMethodRouter;
use utoipa_axum::routes;

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
    body: BodyLimit,
    is_described: bool,
    description: Option<Box<Description>>,
    handler: MethodRouter<AppState>,
}

/// Whether routes keep their descriptions: all of them together take megabytes, which only who prints them needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Descriptions {
    Kept,
    Dropped,
}

impl Route {
    /// A route that describes itself: `routes!(handler)` with exactly one handler.
    fn new(
        (schemas, paths, handler): UtoipaMethodRouter<AppState>,
        access: Access,
        descriptions: Descriptions,
    ) -> Self {
        let (path, item) = paths.paths.into_iter().next().unwrap_or_default();
        let method = match &item {
            PathItem { put: Some(_), .. } => Method::PUT,
            PathItem { post: Some(_), .. } => Method::POST,
            PathItem { delete: Some(_), .. } => Method::DELETE,
            _ => Method::GET,
        };
        let description = (descriptions == Descriptions::Kept)
            .then(|| Box::new(Description { path: path.clone(), item, schemas, access }));
        Self { method, path, access, body: BodyLimit::Registration, is_described: true, description, handler }
    }

    /// A page or a file of one: not part of the described API.
    fn page(path: &str, handler: MethodRouter<AppState>) -> Self {
        Self {
            method: Method::GET,
            path: path.to_owned(),
            access: Access::Open,
            body: BodyLimit::Registration,
            is_described: false,
            description: None,
            handler,
        }
    }

    /// Takes bodies up to `limits.body_bytes`.
    #[must_use]
    pub fn takes_cycles(self) -> Self {
        Self { body: BodyLimit::Cycles, ..self }
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
        self.is_described
    }
}

/// What a route adds to the description of the API.
pub(super) struct Description {
    pub(super) path: String,
    pub(super) item: PathItem,
    pub(super) schemas: Vec<(String, RefOr<Schema>)>,
    pub(super) access: Access,
}

/// Every route there is.
pub fn table() -> Vec<Route> {
    routes(Descriptions::Dropped)
}

/// What every route adds to the description of the API.
pub(super) fn descriptions() -> impl Iterator<Item = Description> {
    routes(Descriptions::Kept)
        .into_iter()
        .filter_map(|route| route.description.map(|description| *description))
}

fn routes(descriptions: Descriptions) -> Vec<Route> {
    let route = |parts, access| Route::new(parts, access, descriptions);
    let mut table = vec![
        route(routes!(machines::put), ENGINEER),
        route(routes!(machines::get), READ_OR_OWN),
        route(routes!(machines::list), READ),
        route(routes!(retention::put), ENGINEER),
        route(routes!(retention::get), READ),
        route(routes!(calibrations::add), ENGINEER),
        route(routes!(calibrations::list), READ),
        route(routes!(tools::put), ENGINEER),
        route(routes!(tools::get), READ),
        route(routes!(tools::list), READ),
        route(routes!(tool_events::add), ENGINEER),
        route(routes!(tool_events::list), READ),
        route(routes!(operations::put), ENGINEER),
        route(routes!(operations::get), READ),
        route(routes!(operations::list), READ),
        route(routes!(alarms::list), READ),
        route(routes!(alarms::acknowledge), ENGINEER),
        route(routes!(alarms::acknowledge_machine), ENGINEER),
        route(routes!(quarantine::list), READ),
        route(routes!(quarantine::get), READ),
        route(routes!(quarantine::settle), ENGINEER).takes_cycles(),
        route(routes!(audit::list), READ),
        route(routes!(tokens::create), ADMIN),
        route(routes!(tokens::list), ADMIN),
        route(routes!(tokens::revoke), ADMIN),
        // Open: the token is in the body, and its handler counts failures as `authorise` does.
        route(routes!(session::begin), Access::Open),
        route(routes!(session::get), EVERYONE),
        route(routes!(session::end), EVERYONE),
        route(routes!(fleet::get), READ),
        route(routes!(fleet::machine), READ),
        route(routes!(health::healthz), Access::Open),
        route(routes!(health::readyz), Access::Open),
        route(routes!(health::metrics), READ),
        route(routes!(openapi::document), Access::Open),
        route(routes!(cycles::post_cycle), OWN).takes_cycles(),
        route(routes!(cycles::post_batch), OWN).takes_cycles(),
        route(routes!(cycles::get_cycle), READ_OR_OWN),
        route(routes!(samples::get_samples), READ_OR_OWN),
        route(routes!(cycles::list_cycles), READ),
        route(routes!(summaries::get_summaries), READ),
        route(routes!(series::get_series), READ),
        route(routes!(course::get), READ_OR_OWN),
        route(routes!(wear::get_wear), READ),
        route(routes!(wear::get_history), READ),
        route(routes!(life::get), READ),
        route(routes!(recommendations::get_recommendation), READ_OR_OWN),
        route(routes!(recommendations::get_issued), READ_OR_OWN),
        route(routes!(library::put_turning), ENGINEER),
        route(routes!(library::get_turning), READ),
        route(routes!(library::list_turning), READ),
        route(routes!(library::put_plunge), ENGINEER),
        route(routes!(library::get_plunge), READ),
        route(routes!(library::list_plunge), READ),
        route(routes!(turning::plan), READ),
        route(routes!(turning::next), READ).takes_cycles(),
        route(routes!(plunge::feed), READ).takes_cycles(),
        route(routes!(plunge::saving), READ).takes_cycles(),
        route(routes!(plunge::recorded), READ),
        route(routes!(continuity::simulate), READ),
        route(routes!(continuity::map), READ),
        route(routes!(continuity::border), READ),
        route(routes!(continuity::advice), READ),
        route(routes!(peak_to_peak::tuning), READ),
        route(routes!(peak_to_peak::close_loop), READ),
        route(routes!(peak_to_peak::poincare), READ),
        route(routes!(peak_to_peak::recorded), READ).takes_cycles(),
        route(routes!(jobs::get), READ),
        route(routes!(jobs::cancel), READ),
        route(routes!(friction::simulate), READ),
        route(routes!(live::events), READ),
        route(routes!(stream::open), OWN),
        route(routes!(stream::overrides), READ_OR_OWN),
        route(routes!(what_if::of_cycle), READ),
        route(routes!(what_if::of_many), READ),
        route(routes!(calibrations::fit), ENGINEER),
        route(routes!(feed_profiles::draft), ENGINEER),
        route(routes!(feed_profiles::list), READ),
        route(routes!(feed_profiles::get), READ_OR_OWN),
        route(routes!(feed_profiles::versions), READ),
        route(routes!(feed_profiles::version), READ_OR_OWN),
        route(routes!(feed_profiles::compare), READ),
        route(routes!(feed_profiles::shadow), ENGINEER),
        route(routes!(feed_profiles::approve), APPROVER),
        route(routes!(feed_profiles::activate), RELEASE),
        route(routes!(feed_profiles::rollback), RELEASE),
        route(routes!(profile_files::export), READ_OR_OWN),
        route(routes!(profile_files::import), ENGINEER),
        route(routes!(profile_files::read), READ),
        route(routes!(profile_evidence::shadow_report), READ),
        route(routes!(profile_evidence::comparison), READ),
        route(routes!(profile_optimise::start), ENGINEER),
        route(routes!(profile_optimise::outcome), READ),
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

/// The router over the table.
pub fn router(state: AppState) -> Router {
    let limits = state.config.limits;
    let mut router = Router::new();
    for Route { path, access, body, handler, .. } in table() {
        let limit = match body {
            BodyLimit::Registration => limits.registration_bytes,
            BodyLimit::Cycles => limits.body_bytes,
        };
        let guard = from_fn_with_state((state.clone(), access), authorise);
        // Layers run from the last to the first: nobody's body is read before their token.
        let handler = handler.route_layer(DefaultBodyLimit::max(limit)).route_layer(guard);
        router = router.route(&path, handler);
    }
    router
        .fallback(unknown_path)
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

async fn unknown_path(uri: Uri) -> Response {
    Problem::new(StatusCode::NOT_FOUND, "unknown_path", format!("there is nothing at {}", uri.path()))
        .into_response()
}

async fn wrong_method(method: Method) -> Response {
    let detail = format!("{method} is not possible here");
    Problem::new(StatusCode::METHOD_NOT_ALLOWED, "method_not_allowed", detail).into_response()
}
