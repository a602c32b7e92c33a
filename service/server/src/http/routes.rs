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
    item: Option<PathItem>,
    schemas: Vec<(String, RefOr<Schema>)>,
    handler: MethodRouter<AppState>,
}

impl Route {
    /// A route that describes itself: `routes!(handler)` with exactly one handler.
    fn new((schemas, paths, handler): UtoipaMethodRouter<AppState>, access: Access) -> Self {
        let (path, item) = paths.paths.into_iter().next().unwrap_or_default();
        let method = match &item {
            PathItem { put: Some(_), .. } => Method::PUT,
            PathItem { post: Some(_), .. } => Method::POST,
            PathItem { delete: Some(_), .. } => Method::DELETE,
            _ => Method::GET,
        };
        Self { method, path, access, body: BodyLimit::Registration, item: Some(item), schemas, handler }
    }

    /// A page or a file of one: not part of the described API.
    fn page(path: &str, handler: MethodRouter<AppState>) -> Self {
        Self {
            method: Method::GET,
            path: path.to_owned(),
            access: Access::Open,
            body: BodyLimit::Registration,
            item: None,
            schemas: Vec::new(),
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
        self.item.is_some()
    }

    /// What it adds to the description of the API.
    pub(super) fn description(self) -> Option<Description> {
        let Self { path, item, schemas, access, .. } = self;
        item.map(|item| Description { path, item, schemas, access })
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
    let mut table = vec![
        Route::new(routes!(machines::put), ENGINEER),
        Route::new(routes!(machines::get), READ_OR_OWN),
        Route::new(routes!(machines::list), READ),
        Route::new(routes!(retention::put), ENGINEER),
        Route::new(routes!(retention::get), READ),
        Route::new(routes!(calibrations::add), ENGINEER),
        Route::new(routes!(calibrations::list), READ),
        Route::new(routes!(tools::put), ENGINEER),
        Route::new(routes!(tools::get), READ),
        Route::new(routes!(tools::list), READ),
        Route::new(routes!(tool_events::add), ENGINEER),
        Route::new(routes!(tool_events::list), READ),
        Route::new(routes!(operations::put), ENGINEER),
        Route::new(routes!(operations::get), READ),
        Route::new(routes!(operations::list), READ),
        Route::new(routes!(alarms::list), READ),
        Route::new(routes!(alarms::acknowledge), ENGINEER),
        Route::new(routes!(alarms::acknowledge_machine), ENGINEER),
        Route::new(routes!(quarantine::list), READ),
        Route::new(routes!(quarantine::get), READ),
        Route::new(routes!(quarantine::settle), ENGINEER).takes_cycles(),
        Route::new(routes!(audit::list), READ),
        Route::new(routes!(tokens::create), ADMIN),
        Route::new(routes!(tokens::list), ADMIN),
        Route::new(routes!(tokens::revoke), ADMIN),
        // Open: the token is in the body, and its handler counts failures as `authorise` does.
        Route::new(routes!(session::begin), Access::Open),
        Route::new(routes!(session::get), EVERYONE),
        Route::new(routes!(session::end), EVERYONE),
        Route::new(routes!(fleet::get), READ),
        Route::new(routes!(fleet::machine), READ),
        Route::new(routes!(health::healthz), Access::Open),
        Route::new(routes!(health::readyz), Access::Open),
        Route::new(routes!(health::metrics), READ),
        Route::new(routes!(openapi::document), Access::Open),
        Route::new(routes!(cycles::post_cycle), OWN).takes_cycles(),
        Route::new(routes!(cycles::post_batch), OWN).takes_cycles(),
        Route::new(routes!(cycles::get_cycle), READ_OR_OWN),
        Route::new(routes!(samples::get_samples), READ_OR_OWN),
        Route::new(routes!(cycles::list_cycles), READ),
        Route::new(routes!(summaries::get_summaries), READ),
        Route::new(routes!(series::get_series), READ),
        Route::new(routes!(course::get), READ_OR_OWN),
        Route::new(routes!(wear::get_wear), READ),
        Route::new(routes!(wear::get_history), READ),
        Route::new(routes!(life::get), READ),
        Route::new(routes!(recommendations::get_recommendation), READ_OR_OWN),
        Route::new(routes!(recommendations::get_issued), READ_OR_OWN),
        Route::new(routes!(library::put_turning), ENGINEER),
        Route::new(routes!(library::get_turning), READ),
        Route::new(routes!(library::list_turning), READ),
        Route::new(routes!(library::put_plunge), ENGINEER),
        Route::new(routes!(library::get_plunge), READ),
        Route::new(routes!(library::list_plunge), READ),
        Route::new(routes!(turning::plan), READ),
        Route::new(routes!(turning::next), READ).takes_cycles(),
        Route::new(routes!(plunge::feed), READ).takes_cycles(),
        Route::new(routes!(plunge::saving), READ).takes_cycles(),
        Route::new(routes!(plunge::recorded), READ),
        Route::new(routes!(continuity::simulate), READ),
        Route::new(routes!(continuity::map), READ),
        Route::new(routes!(continuity::border), READ),
        Route::new(routes!(continuity::advice), READ),
        Route::new(routes!(peak_to_peak::tuning), READ),
        Route::new(routes!(peak_to_peak::close_loop), READ),
        Route::new(routes!(peak_to_peak::poincare), READ),
        Route::new(routes!(peak_to_peak::recorded), READ).takes_cycles(),
        Route::new(routes!(jobs::get), READ),
        Route::new(routes!(jobs::cancel), READ),
        Route::new(routes!(friction::simulate), READ),
        Route::new(routes!(live::events), READ),
        Route::new(routes!(stream::open), OWN),
        Route::new(routes!(stream::overrides), READ_OR_OWN),
        Route::new(routes!(what_if::of_cycle), READ),
        Route::new(routes!(what_if::of_many), READ),
        Route::new(routes!(calibrations::fit), ENGINEER),
        Route::new(routes!(feed_profiles::draft), ENGINEER),
        Route::new(routes!(feed_profiles::list), READ),
        Route::new(routes!(feed_profiles::get), READ_OR_OWN),
        Route::new(routes!(feed_profiles::versions), READ),
        Route::new(routes!(feed_profiles::version), READ_OR_OWN),
        Route::new(routes!(feed_profiles::compare), READ),
        Route::new(routes!(feed_profiles::shadow), ENGINEER),
        Route::new(routes!(feed_profiles::approve), APPROVER),
        Route::new(routes!(feed_profiles::activate), RELEASE),
        Route::new(routes!(feed_profiles::rollback), RELEASE),
        Route::new(routes!(profile_files::export), READ_OR_OWN),
        Route::new(routes!(profile_files::import), ENGINEER),
        Route::new(routes!(profile_files::read), READ),
        Route::new(routes!(profile_evidence::shadow_report), READ),
        Route::new(routes!(profile_evidence::comparison), READ),
        Route::new(routes!(profile_optimise::start), ENGINEER),
        Route::new(routes!(profile_optimise::outcome), READ),
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
