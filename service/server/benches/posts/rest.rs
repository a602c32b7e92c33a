//! When a server is at rest: what it has acknowledged may be written after it was, and costs what it costs.

use std::time::{Duration, Instant};

/// A server is at rest that has done next to nothing for so long: longer than any of them puts off what it acknowledged.
const CALM: Duration = Duration::from_secs(2);
/// What timers and the like may take of that, s of processor time.
const NEXT_TO_NOTHING: f64 = 0.03;
/// Longest time that it may take to come to rest.
const PATIENCE: Duration = Duration::from_secs(30);

/// Waits until a server is at rest, by its processor time, s, and the bytes that it keeps. The processor time up to then, without
/// what it does when it has nothing to do.
pub(crate) async fn rest(server: &str, look: impl Fn() -> (f64, u64)) -> f64 {
    let begun = Instant::now();
    let (mut before, mut since) = (look(), Instant::now());
    while since.elapsed() < CALM {
        assert!(begun.elapsed() < PATIENCE, "{server} does not come to rest");
        tokio::time::sleep(CALM / 20).await;
        let now = look();
        if now.0 - before.0 > NEXT_TO_NOTHING || now.1 != before.1 {
            (before, since) = (now, Instant::now());
        }
    }
    before.0
}
