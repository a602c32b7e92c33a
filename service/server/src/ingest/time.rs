//! RFC 3339 times at the edge; inside, a time is microseconds.

use feedwright_core::invalid::Violation;
use feedwright_core::units::Timestamp;

/// Parses an RFC 3339 time with its offset; finer digits than a microsecond are cut off.
pub fn parse(path: &str, text: &str) -> Result<Timestamp, Violation> {
    text.parse::<jiff::Timestamp>().map(|at| Timestamp::from_micros(at.as_microsecond())).map_err(|_| {
        Violation::new(
            path,
            "invalid_timestamp",
            "must be an RFC 3339 time with an offset, as 2026-05-04T06:00:00Z",
        )
    })
}

/// Writes a time as RFC 3339 in UTC, with as many digits as it needs.
pub fn format(at: Timestamp) -> String {
    match jiff::Timestamp::from_microsecond(at.micros()) {
        Ok(at) => at.to_string(),
        // Every time that was parsed is in range; one that was added up may leave it.
        Err(_) if at.micros() > 0 => jiff::Timestamp::MAX.to_string(),
        Err(_) => jiff::Timestamp::MIN.to_string(),
    }
}
