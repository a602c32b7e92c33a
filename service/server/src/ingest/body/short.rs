//! Numbers as a control writes them: up to five digits before the point and four behind it, without sign or exponent.
//!
//! One test for each digit, at a place that is known where the test stands: a loop over digits counts them, asks at each
//! whether the body ends, and looks up what to divide by.

/// As many bytes as are looked at: five digits, the point, four more and what may follow them.
const REACH: usize = 11;

/// The bytes that stand there, where the body goes on for so long.
pub(super) fn reached(json: &[u8]) -> Option<&[u8; REACH]> {
    json.first_chunk()
}

/// A number, its length in bytes, the byte that follows it, and 1 shifted by its places behind the point.
type Short = (f64, usize, u8, u32);

/// Appends the numbers that stand there, one behind the other, each with a comma right behind it and, where they are
/// `SPACED`, a blank behind that; returns what follows them, and a bit for each count of places that they have. A function of
/// its own, so that all it goes by is in registers.
#[inline(never)]
pub(super) fn run<'j, const SPACED: bool>(mut json: &'j [u8], values: &mut Vec<f64>) -> (&'j [u8], u32) {
    let mut all_places = 0;
    // Not by `and_then`: a number of its own function would be handed over by memory.
    while let Some(text) = reached(json)
        && let Some((value, length, b',', places)) = number(text)
    {
        values.push(value);
        all_places |= places;
        json = &json[length + 1..];
        if SPACED && let [b' ', rest @ ..] = json {
            json = rest;
        }
    }
    (json, all_places)
}

/// The number that begins there. `None` says nothing: it may be a longer number, or none.
///
/// Its digits make an integer below 2^32, and its quotient by a power of ten is rounded once, so that it has the bits that
/// a correct reader gives.
#[inline(always)]
pub(super) fn number(text: &[u8; REACH]) -> Option<Short> {
    let first = digit(text, 0)?;
    let Some(second) = digit(text, 1) else { return behind::<1>(text, first) };
    if first == 0 {
        return None;
    }
    let whole = first * 10 + second;
    let Some(third) = digit(text, 2) else { return behind::<2>(text, whole) };
    let whole = whole * 10 + third;
    let Some(fourth) = digit(text, 3) else { return behind::<3>(text, whole) };
    let whole = whole * 10 + fourth;
    let Some(fifth) = digit(text, 4) else { return behind::<4>(text, whole) };
    let whole = whole * 10 + fifth;
    if digit(text, 5).is_some() { None } else { behind::<5>(text, whole) }
}

/// With what stands behind `WHOLE` digits.
#[inline(always)]
fn behind<const WHOLE: usize>(text: &[u8; REACH], whole: u32) -> Option<Short> {
    if text[WHOLE] != b'.' {
        return Some((f64::from(whole), WHOLE, text[WHOLE], 1));
    }
    let tenths = whole * 10 + digit(text, WHOLE + 1)?;
    let Some(second) = digit(text, WHOLE + 2) else {
        return Some((f64::from(tenths) / 10.0, WHOLE + 2, text[WHOLE + 2], 1 << 1));
    };
    let hundredths = tenths * 10 + second;
    let Some(third) = digit(text, WHOLE + 3) else {
        return Some((f64::from(hundredths) / 100.0, WHOLE + 3, text[WHOLE + 3], 1 << 2));
    };
    let thousandths = hundredths * 10 + third;
    let Some(fourth) = digit(text, WHOLE + 4) else {
        return Some((f64::from(thousandths) / 1_000.0, WHOLE + 4, text[WHOLE + 4], 1 << 3));
    };
    let value = thousandths * 10 + fourth;
    if digit(text, WHOLE + 5).is_some() {
        None
    } else {
        Some((f64::from(value) / 10_000.0, WHOLE + 5, text[WHOLE + 5], 1 << 4))
    }
}

#[inline(always)]
fn digit(text: &[u8; REACH], at: usize) -> Option<u32> {
    let digit = text[at].wrapping_sub(b'0');
    (digit < 10).then_some(u32::from(digit))
}
