//! The clock, handed in: only the binary's edge knows the system's.
//!
//! Beside the time, which is set now and then and which every computer has otherwise, it tells how much of it goes by.

use feedwright_core::units::Timestamp;
use std::fmt;
use std::sync::{Arc, LazyLock};
use std::time::{Duration, Instant};

/// Moments are counted from here.
static BEGUN: LazyLock<Instant> = LazyLock::new(Instant::now);

/// Tells the time; cheap to clone.
#[derive(Clone)]
pub struct Clock {
    now: Arc<dyn Fn() -> Timestamp + Send + Sync>,
    /// Whether moments go by.
    goes: bool,
}

/// A moment of a clock that nobody sets. It tells how long ago something was, and never the time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Moment(Duration);

impl Moment {
    /// The moment so much later.
    #[must_use]
    pub const fn plus(self, later: Duration) -> Self {
        Self(self.0.saturating_add(later))
    }

    /// How long after `earlier` it is; nothing where it is not after it.
    pub const fn since(self, earlier: Self) -> Duration {
        self.0.saturating_sub(earlier.0)
    }
}

impl Clock {
    /// A clock that asks `now` for the time.
    pub fn new(now: impl Fn() -> Timestamp + Send + Sync + 'static) -> Self {
        Self { now: Arc::new(now), goes: true }
    }

    /// The system's clock.
    pub fn system() -> Self {
        Self::new(|| Timestamp::from_micros(jiff::Timestamp::now().as_microsecond()))
    }

    /// A clock that stands still.
    pub fn fixed(at: Timestamp) -> Self {
        Self { goes: false, ..Self::new(move || at) }
    }

    /// The time now.
    pub fn now(&self) -> Timestamp {
        (self.now)()
    }

    /// The moment now, which is later than any before whatever becomes of the time.
    pub fn moment(&self) -> Moment {
        Moment(if self.goes { BEGUN.elapsed() } else { Duration::ZERO })
    }
}

impl fmt::Debug for Clock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Clock")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicI64, Ordering};

    #[test]
    fn moments_go_on_whatever_becomes_of_the_time() {
        let time = Arc::new(AtomicI64::new(1_000));
        let set = time.clone();
        let clock = Clock::new(move || Timestamp::from_micros(set.load(Ordering::Relaxed)));
        let before = clock.moment();
        time.store(0, Ordering::Relaxed);
        assert_eq!(clock.now(), Timestamp::from_micros(0));
        let after = clock.moment();
        assert!(after >= before);
        assert_eq!(before.since(after), Duration::ZERO);
        assert_eq!(before.plus(Duration::from_secs(1)).since(before), Duration::from_secs(1));
    }
}
