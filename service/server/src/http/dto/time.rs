//! Times in JSON: RFC 3339, UTC, to the microsecond.

use feedwright_core::invalid::Violation;
use feedwright_core::units::Timestamp;
use std::fmt::Write;

/// Every time that was read is in range; one that was added up may leave it, and is shown as the last there is.
fn in_range(at: Timestamp) -> jiff::Timestamp {
    let end = if at.micros() > 0 { jiff::Timestamp::MAX } else { jiff::Timestamp::MIN };
    jiff::Timestamp::from_microsecond(at.micros()).unwrap_or(end)
}

/// A time as JSON shows it, with as many digits as it needs.
pub fn show(at: Timestamp) -> String {
    shown(at).to_string()
}

/// What shows a time as [`show`] does, without a text of its own.
pub fn shown(at: Timestamp) -> impl std::fmt::Display {
    in_range(at)
}

/// Writes a time as [`show`] shows it. Into memory this cannot fail.
pub fn write(out: &mut impl Write, at: Timestamp) {
    let _ = write!(out, "{}", in_range(at));
}

/// A time as tables show it: always with six digits, so that a reader which guesses the format from the first row
/// guesses right.
pub fn show_even(at: Timestamp) -> String {
    static PRINTER: jiff::fmt::temporal::DateTimePrinter =
        jiff::fmt::temporal::DateTimePrinter::new().precision(Some(6));
    PRINTER.timestamp_to_string(&in_range(at))
}

/// The time so many milliseconds after another, to the microsecond.
#[expect(clippy::cast_possible_truncation, reason = "a cycle lasts at most a day")]
pub fn after_ms(at: Timestamp, millis: f64) -> Timestamp {
    Timestamp::from_micros(at.micros().saturating_add((millis * 1000.0).round() as i64))
}

/// Reads RFC 3339 with any offset; digits finer than a microsecond are cut off.
pub fn read(path: &str, text: &str) -> Result<Timestamp, Violation> {
    text.parse::<jiff::Timestamp>().map(|at| Timestamp::from_micros(at.as_microsecond())).map_err(|_| {
        Violation::new(
            path,
            "invalid_timestamp",
            "must be an RFC 3339 time with an offset, as 2026-05-04T06:00:00Z",
        )
    })
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
        assert_eq!(show(Timestamp::from_micros(0)), "1970-01-01T00:00:00Z");
        for micros in [i64::MIN, i64::MAX] {
            let mut written = String::new();
            write(&mut written, Timestamp::from_micros(micros));
            assert_eq!(written, show(Timestamp::from_micros(micros)));
        }
        for text in ["", "yesterday", "2025-11-21", "2025-11-21T03:20:28", "1763695228"] {
            assert_eq!(read("at", text).unwrap_err().code, "invalid_timestamp", "{text}");
        }
    }
}
