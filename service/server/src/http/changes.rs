//! Whoever watches is told that something was changed, so that no page shows advice that rests on what was before.

use crate::live::Event;
use crate::state::AppState;
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::Response;

/// Tells of a change that was made; `what` is the part of the API that it stands under.
pub(super) async fn tell(
    State((state, what)): State<(AppState, &'static str)>,
    request: Request,
    next: Next,
) -> Response {
    let response = next.run(request).await;
    if response.status().is_success() {
        state.live.publish(Event::changed(what));
    }
    response
}
