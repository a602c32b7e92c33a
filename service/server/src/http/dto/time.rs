//! Times in JSON: RFC 3339, UTC, to the microsecond.

use feedwright_core::invalid::Violation;
use feedwright_core::units::Timestamp;
use std::cell::RefCell;
use std::fmt::Write;

/// Every time that was read is in range; one that was added up may leave it, and is shown as the last there is.
fn in_range(at: Timestamp) -> jiff::Timestamp {
    let end = if at.micros() > 0 { jiff::Timestamp::MAX } else { jiff::Timestamp::MIN };
    jiff::Timestamp::from_microsecond(at.micros()).unwrap_or(end)
}

thread_local! {
    // Nearly all times that are shown are of today.
    static SHOWER: RefCell<Shower> = RefCell::default();
}

/// A time as JSON shows it, with as many digits as it needs.
pub fn show(at: Timestamp) -> String {
    SHOWER.with_borrow_mut(|shower| shower.show(at).to_owned())
}

/// Microseconds of a day.
const DAY_US: i64 = 86_400_000_000;
/// Times of these microseconds, until the year 9987, are shown with four digits for the year.
const FOUR_DIGITS: std::ops::Range<i64> = 0..253_000_000_000_000_000;
/// `2026-05-04T`, and the whole with six digits of a second.
const DATE_BYTES: usize = 11;
const LONGEST: usize = DATE_BYTES + 16;

/// Shows times one after the other as the library does each: those of one day share its date.
#[derive(Debug, Default)]
pub struct Shower {
    day: Option<i64>,
    text: String,
}

impl Shower {
    /// The next time.
    pub fn show(&mut self, at: Timestamp) -> &str {
        let micros = at.micros();
        if !FOUR_DIGITS.contains(&micros) {
            self.day = None;
            self.text = in_range(at).to_string();
            return &self.text;
        }
        let (day, within) = (micros / DAY_US, micros % DAY_US);
        if self.day == Some(day) {
            self.text.truncate(DATE_BYTES);
        } else {
            self.text = in_range(Timestamp::from_micros(day * DAY_US)).to_string();
            self.text.truncate(DATE_BYTES);
            self.text.reserve_exact(LONGEST - DATE_BYTES);
            self.day = Some(day);
        }
        let (seconds, fraction) = (within / 1_000_000, within % 1_000_000);
        self.pair(seconds / 3600);
        self.text.push(':');
        self.pair(seconds / 60 % 60);
        self.text.push(':');
        self.pair(seconds % 60);
        if fraction > 0 {
            self.text.push('.');
            self.pair(fraction / 10_000);
            self.pair(fraction / 100 % 100);
            self.pair(fraction % 100);
            self.text.truncate(self.text.trim_end_matches('0').len());
        }
        self.text.push('Z');
        &self.text
    }

    /// Appends a number below a hundred with two digits.
    fn pair(&mut self, number: i64) {
        let at = 2 * usize::try_from(number % 100).unwrap_or(0);
        self.text.push_str(&PAIRS[at..at + 2]);
    }
}

/// The numbers below a hundred, each with two digits.
const PAIRS: &str = "0001020304050607080910111213141516171819202122232425262728293031323334353637383940414243444546474849\
                     5051525354555657585960616263646566676869707172737475767778798081828384858687888990919293949596979899";

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
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn times_shown_one_after_the_other_are_shown_as_each(
            times in prop::collection::vec(
                prop_oneof![
                    any::<i64>(),
                    FOUR_DIGITS,
                    1_700_000_000_000_000_i64..1_700_200_000_000_000,
                    (1_700_000_000_i64..1_700_200_000).prop_map(|second| second * 1_000_000),
                    (1_700_000_000_000_i64..1_700_200_000_000).prop_map(|milli| milli * 1_000),
                    (-2_i64..=2).prop_map(|off| FOUR_DIGITS.end + off),
                    (-2_i64..=2).prop_map(|off| off),
                    (19_000_i64..19_003, -1_i64..=1).prop_map(|(day, off)| day * DAY_US + off),
                ],
                1..20,
            ),
        ) {
            let mut shower = Shower::default();
            for micros in times {
                let at = Timestamp::from_micros(micros);
                let by_the_library = in_range(at).to_string();
                prop_assert_eq!(shower.show(at), &by_the_library);
                prop_assert_eq!(show(at), by_the_library);
            }
        }
    }

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
