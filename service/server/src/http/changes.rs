//! Whoever watches is told that something was changed, so that no page shows advice that rests on what was before.

use super::precondition::NothingChanged;
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
    let mut due = Due { state, what, is_due: true };
    let response = next.run(request).await;
    let changed = response.status().is_success() && response.extensions().get::<NothingChanged>().is_none();
    due.is_due = changed;
    response
}

/// Tells in any case but where it is known that nothing was changed: whoever asked may be gone before the answer, and what they
/// asked for goes on.
struct Due {
    state: AppState,
    what: &'static str,
    is_due: bool,
}

impl Drop for Due {
    fn drop(&mut self) {
        if self.is_due {
            // They follow what is registered, what is told of tools and what is settled. Said first: other servers hear of it with the event.
            self.state.live.alarms_may_have_changed();
            self.state.live.publish(Event::changed(self.what));
        }
    }
}
