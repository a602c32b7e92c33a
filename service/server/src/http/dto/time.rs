//! Times in JSON: RFC 3339, UTC, microseconds.

use feedwright_core::invalid::Violation;
use feedwright_core::units::Timestamp;

/// A time as JSON shows it.
pub fn show(at: Timestamp) -> String {
    // Every time that was read from JSON or from the clock lies within jiff's years −9999 to 9999.
    jiff::Timestamp::from_microsecond(at.micros())
        .map_or_else(|_| at.micros().to_string(), |at| format!("{at:.6}"))
}

/// Reads RFC 3339 with any offset.
pub fn read(path: &str, text: &str) -> Result<Timestamp, Violation> {
    text.parse::<jiff::Timestamp>()
        .map(|at| Timestamp::from_micros(at.as_microsecond()))
        .map_err(|_| Violation::new(path, "invalid_time", "must be a time as in 2026-01-31T08:15:00.250Z"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_come_back_to_the_microsecond() {
        let at = Timestamp::from_micros(1_763_695_228_123_456);
        assert_eq!(show(at), "2025-11-21T03:20:28.123456Z");
        assert_eq!(read("at", &show(at)), Ok(at));
        assert_eq!(read("at", "2025-11-21T04:20:28.123456+01:00"), Ok(at));
        assert_eq!(show(Timestamp::from_micros(0)), "1970-01-01T00:00:00.000000Z");
        for text in ["", "yesterday", "2025-11-21", "2025-11-21T03:20:28", "1763695228"] {
            assert_eq!(read("at", text).unwrap_err().code, "invalid_time", "{text}");
        }
    }
}
