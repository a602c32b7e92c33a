//! Times in JSON: RFC 3339, UTC, to the microsecond.

use feedwright_core::invalid::Violation;
use feedwright_core::units::Timestamp;
use std::borrow::Cow;
use std::cell::RefCell;
use std::fmt::Write;

/// 0001-01-01T00:00:00Z: before it neither RFC 3339 nor most readers have a year.
const FIRST_US: i64 = -62_135_596_800_000_000;

/// Every time that was read is in range; one that was added up may leave it, and is shown as the last there is.
fn in_range(at: Timestamp) -> jiff::Timestamp {
    jiff::Timestamp::from_microsecond(at.micros().max(FIRST_US)).unwrap_or(jiff::Timestamp::MAX)
}

/// The time that is shown for one: that itself, but for what was before the year 1, as the edge of a wide bucket may be.
pub fn as_shown(at: Timestamp) -> Timestamp {
    Timestamp::from_micros(in_range(at).as_microsecond())
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

/// Digits of a second that the library reads.
const FRACTION_DIGITS: usize = 9;

/// Reads where a range begins or ends. What is kept is of whole microseconds: of a finer time, what lies before it lies before
/// the next whole one.
pub fn read_bound(path: &str, text: &str) -> Result<Timestamp, Violation> {
    let whole = read(path, text)?;
    Ok(if is_finer(text) { Timestamp::from_micros(whole.micros().saturating_add(1)) } else { whole })
}

/// Refuses a range that ends before anything can begin in it; `to` is the path of its end. Answered as one in which nothing was
/// run it would hide that its ends were mixed up.
pub fn check_range(to: &str, range: (Option<Timestamp>, Option<Timestamp>)) -> Result<(), Violation> {
    match range {
        (Some(begin), Some(end)) if begin >= end => Err(empty_range(to)),
        _ => Ok(()),
    }
}

/// What is wrong with such a range.
pub fn empty_range(to: &str) -> Violation {
    Violation::new(to, "empty_range", "must be later than the beginning of the range")
}

/// Reads RFC 3339 with any offset, from the year 1 on; a time finer than a microsecond is the last whole one before it.
pub fn read(path: &str, text: &str) -> Result<Timestamp, Violation> {
    let invalid = |message| Violation::new(path, "invalid_timestamp", message);
    if !is_rfc3339(text) {
        return Err(invalid(
            "must be an RFC 3339 time with an offset, as 2026-05-04T06:00:00Z (a leap second as 23:59:60Z alone)",
        ));
    }
    let nanos = within_digits(text).parse::<jiff::Timestamp>().ok().map(jiff::Timestamp::as_nanosecond);
    let at = nanos.and_then(|nanos| i64::try_from(nanos.div_euclid(1000)).ok());
    at.filter(|micros| *micros >= FIRST_US).map(Timestamp::from_micros).ok_or_else(|| {
        invalid("must be a time that there is, from 0001-01-01T00:00:00Z to 9999-12-30T22:00:00Z")
    })
}

/// Whether a text of RFC 3339 has digits other than 0 behind the microseconds.
fn is_finer(text: &str) -> bool {
    let fraction = text.split_once('.').map_or("", |(_, fraction)| fraction);
    let digits = fraction.bytes().take_while(u8::is_ascii_digit);
    digits.skip(6).any(|digit| digit != b'0')
}

/// The same without digits of the second that are finer than [`FRACTION_DIGITS`]: RFC 3339 allows any number of them.
fn within_digits(text: &str) -> Cow<'_, str> {
    let Some((seconds, fraction)) = text.split_once('.') else { return Cow::Borrowed(text) };
    let offset = fraction.trim_start_matches(|digit: char| digit.is_ascii_digit());
    match fraction[..fraction.len() - offset.len()].get(..FRACTION_DIGITS) {
        Some(digits) => Cow::Owned(format!("{seconds}.{digits}{offset}")),
        None => Cow::Borrowed(text),
    }
}

/// Whether a text has the form of RFC 3339: the library reads more (years of six digits, shorter offsets, offsets of more
/// than a day, names of time zones). Whether there is such a time it does not say.
fn is_rfc3339(text: &str) -> bool {
    const DATE_AND_TIME: &[u8; 19] = b"0000-00-00T00:00:00";
    let has_form = |bytes: &[u8], form: &[u8]| {
        bytes.iter().zip(form).all(|(byte, form)| match form {
            b'0' => byte.is_ascii_digit(),
            b'T' => matches!(byte, b'T' | b't' | b' '),
            _ => byte == form,
        })
    };
    let Some((date_and_time, mut rest)) = text.as_bytes().split_first_chunk::<19>() else { return false };
    if !has_form(date_and_time, DATE_AND_TIME) {
        return false;
    }
    // A leap second ends a day of UTC, and is read as the second before it. Any other sixtieth second is one that a control
    // has rounded up, and would come out a second early.
    if date_and_time.ends_with(b":60") && (!date_and_time.ends_with(b"23:59:60") || !rest.ends_with(b"Z")) {
        return false;
    }
    if let Some(fraction) = rest.strip_prefix(b".") {
        let digits = fraction.iter().take_while(|byte| byte.is_ascii_digit()).count();
        if digits == 0 {
            return false;
        }
        rest = &fraction[digits..];
    }
    match rest {
        [b'Z' | b'z'] => true,
        [b'+' | b'-', offset @ ..] => {
            offset.len() == 5 && has_form(offset, b"00:00") && &offset[..2] < b"24".as_slice()
        }
        _ => false,
    }
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

    #[test]
    fn what_lies_before_a_bound_lies_before_the_microsecond_it_is_rounded_to() {
        for (text, micros) in [
            ("1970-01-01T00:00:00.000001Z", 1),
            ("1970-01-01T00:00:00.0000010000Z", 1),
            ("1970-01-01T00:00:00.0000010001Z", 2),
            ("1970-01-01T00:00:00.0000015Z", 2),
            ("1970-01-01T01:00:00.0000010000000000001+01:00", 2),
            ("1969-12-31T23:59:59.9999995Z", 0),
            ("1969-12-31T23:59:59.9999985Z", -1),
        ] {
            assert_eq!(read_bound("from", text), Ok(Timestamp::from_micros(micros)), "{text}");
        }
    }

    #[test]
    fn what_is_read_is_rfc_3339_and_so_is_what_is_shown() {
        for text in [
            "2026-05-05T06:00:00+24:00",
            "2026-05-05T06:00:00+25:59",
            "2026-05-05T06:00:00+02",
            "2026-05-05T06:00:00+0200",
            "2026-05-05T06:00:00+02:00[Europe/Berlin]",
            "2026-05-05T06:00:00.Z",
            "2026-05-05T06:00:00,5Z",
            "2026-05-05T06:00Z",
            "2026-05-05T06:00:00+02:60",
            "2026-05-05T12:30:60Z",
            "2026-05-05T23:59:60+02:00",
            "2026-05-05T23:59:61Z",
            "2026-02-30T06:00:00Z",
            "+002026-05-05T06:00:00Z",
            "-009999-06-01T00:00:00Z",
            "0000-12-31T23:59:59Z",
            "0001-01-01T00:00:00+00:01",
            "9999-12-31T23:59:59Z",
        ] {
            assert_eq!(read("at", text).unwrap_err().code, "invalid_timestamp", "{text}");
        }
        for (text, shown) in [
            ("0001-01-01T00:00:00Z", "0001-01-01T00:00:00Z"),
            ("2026-05-05t06:00:00.5z", "2026-05-05T06:00:00.5Z"),
            ("2016-12-31T23:59:60Z", "2016-12-31T23:59:59Z"),
            ("2026-05-05 06:00:00-23:59", "2026-05-06T05:59:00Z"),
            ("9999-12-30T22:00:00Z", "9999-12-30T22:00:00Z"),
            ("2026-05-05T06:00:00.1234569Z", "2026-05-05T06:00:00.123456Z"),
            ("2026-05-05T06:00:00.12345678999999999+02:00", "2026-05-05T04:00:00.123456Z"),
            ("1969-12-31T23:59:59.9999999Z", "1969-12-31T23:59:59.999999Z"),
            ("1969-12-31T23:59:59.9999990Z", "1969-12-31T23:59:59.999999Z"),
        ] {
            assert_eq!(read("at", text).map(show).as_deref(), Ok(shown), "{text}");
        }
        assert_eq!(show(Timestamp::from_micros(i64::MIN)), "0001-01-01T00:00:00Z");
        assert_eq!(show_even(Timestamp::from_micros(FIRST_US - 1)), "0001-01-01T00:00:00.000000Z");
        assert_eq!(as_shown(Timestamp::from_micros(FIRST_US - 1)).micros(), FIRST_US);
        assert_eq!(as_shown(Timestamp::from_micros(-1)).micros(), -1);
    }
}
