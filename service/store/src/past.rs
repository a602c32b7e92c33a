//! Which clock is not believed.

use feedwright_core::units::Timestamp;
use std::sync::Once;

/// Past beyond doubt, 2026-01-01T00:00:00Z: this source was written later. What a database or a file tells of the past was
/// noted by a clock that may have been ahead.
///
/// With a release it may be moved on by hand, up to the day of the release before; the clocks of the stories, which stand
/// still, must not be before it.
pub const PAST: Timestamp = Timestamp::from_micros(1_767_225_600_000_000);

/// Whether a clock may be right that tells this time. A computer without a clock of its own starts years ago, and everything
/// that was noted before would seem to be of a clock that was ahead. Warns once.
pub(crate) fn may_be_right(now: Timestamp) -> bool {
    static TOLD: Once = Once::new();
    let may = now >= PAST;
    if !may {
        TOLD.call_once(|| {
            tracing::warn!(
                now_us = now.micros(),
                "the clock tells a time before this program was written: nothing is taken back by it"
            );
        });
    }
    may
}
