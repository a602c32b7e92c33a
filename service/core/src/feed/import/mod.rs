//! What a shop has now, as knots: a feed list as CSV, or one hole of a simple program.
//!
//! Read strictly and within bounds: whatever is not understood is refused with its line, because a hole that was read
//! half right is worse than none. What these lists mean is what they say at least: where a stepped feed changes, the ramp
//! lies on the slower side, so that nowhere more than the imported feed is run.

mod gcode;

pub use gcode::{Hole, gcode};

use super::profile::{KnotInput, MOST_KNOTS};
use crate::invalid::Violation;

/// Longest text that is read, bytes.
pub const LONGEST_TEXT: usize = 256 * 1024;
/// Most lines.
pub const MOST_LINES: usize = 5000;
/// Shortest ramp, mm: ten times the resolution.
const SHORTEST_RAMP_MM: f64 = 0.01;

/// A stretch with one feed, from the end of the one before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Held {
    /// Where it ends, mm below first contact.
    pub to_mm: f64,
    /// Its feed, mm/min.
    pub feed_mm_min: f64,
}

/// How a list of depths and feeds is meant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ListKind {
    /// A row's feed holds from its depth to the next row's; the last row is the end.
    Stepped,
    /// The feed runs linearly from row to row.
    Linear,
}

fn at_line(at: usize, code: &'static str, why: impl Into<String>) -> Vec<Violation> {
    vec![Violation::new(format!("text:line {at}"), code, why)]
}

fn bounded(text: &str) -> Result<(), Vec<Violation>> {
    if text.len() > LONGEST_TEXT {
        let why = format!("has {} bytes, at most {LONGEST_TEXT} are read", text.len());
        return Err(vec![Violation::new("text", "too_long", why)]);
    }
    if text.lines().count() > MOST_LINES {
        return Err(vec![Violation::new("text", "too_many", format!("has more than {MOST_LINES} lines"))]);
    }
    Ok(())
}

/// A number with a decimal point, if any; no exponent, no other sign of thousands.
fn number(text: &str) -> Option<f64> {
    let digits = text.strip_prefix(['-', '+']).unwrap_or(text);
    let plain = !digits.is_empty()
        && digits.len() <= 16
        && digits.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.')
        && digits.bytes().filter(|byte| *byte == b'.').count() <= 1
        && digits.bytes().any(|byte| byte.is_ascii_digit());
    plain.then(|| text.parse().ok())?
}

/// The largest number of whole thousandths that is not above `value`: a profile keeps no more digits.
fn thousandths_below(value: f64) -> f64 {
    let nearest = (value * 1000.0).round();
    if nearest / 1000.0 > value { (nearest - 1.0) / 1000.0 } else { nearest / 1000.0 }
}

/// The smallest number of whole thousandths that is not below `value`.
fn thousandths_above(value: f64) -> f64 {
    -thousandths_below(-value)
}

/// Whether a cell of the head says that its column is the depth in mm, or the feed in mm/min: `names` once at most, then
/// nothing or the unit. What else it says could be another unit, in a language that nobody foresaw.
fn says(cell: &str, names: &[&str], units: &[&[&str]]) -> bool {
    let cell = cell.to_lowercase();
    let mut said: Vec<&str> = cell.split(|letter: char| !letter.is_alphanumeric()).collect();
    said.retain(|word| !word.is_empty());
    let name = said.iter().take_while(|word| names.contains(word)).count();
    let mut unit = &said[name..];
    // `depth in mm`; `depth_in` is another unit.
    if let ["in", rest @ ..] = unit
        && name > 0
        && !rest.is_empty()
    {
        unit = rest;
    }
    !said.is_empty() && (unit.is_empty() || units.contains(&unit))
}

/// Refuses a head that names other columns than a list is read as.
fn head_agrees(depth: &str, feed: &str) -> Result<(), String> {
    const DEPTH: [&str; 3] = ["tip", "depth", "tiefe"];
    const FEED: [&str; 5] = ["feed", "rate", "feedrate", "programmed", "vorschub"];
    const MM: [&[&str]; 1] = [&["mm"]];
    const MM_MIN: [&[&str]; 3] = [&["mm", "min"], &["mm", "per", "min"], &["mm", "minute"]];
    if says(depth, &DEPTH, &MM) && says(feed, &FEED, &MM_MIN) {
        return Ok(());
    }
    let begins = |cell: &str, names: &[&str]| names.iter().any(|name| cell.to_lowercase().starts_with(name));
    let why = if begins(depth, &FEED) && begins(feed, &DEPTH) {
        "the head names the feed first"
    } else {
        "the head does not say that these columns are depth in mm and feed in mm/min"
    };
    Err(format!("{why}: it has to be like `depth_mm,feed_mm_min`, or is left out"))
}

/// Knots out of a list: two columns, depth in mm and feed in mm/min, separated by comma, semicolon or tab.
///
/// Lines that begin with `#` and empty ones are passed over, as is a head that names these columns and no other unit.
/// `acceleration_mm_s2` makes the ramps of a stepped list.
///
/// # Errors
/// With the line that is no row, or a list that is too long, too short or out of order.
pub fn list(text: &str, kind: ListKind, acceleration_mm_s2: f64) -> Result<Vec<KnotInput>, Vec<Violation>> {
    bounded(text)?;
    let mut rows: Vec<KnotInput> = Vec::new();
    let mut head = true;
    for (at, line) in text.lines().enumerate().map(|(at, line)| (at + 1, line.trim())) {
        // A byte order mark is how some spreadsheets begin.
        let line = line.trim_start_matches('\u{feff}');
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let separator = if line.contains(';') {
            ';'
        } else if line.contains('\t') {
            '\t'
        } else {
            ','
        };
        let cells: Vec<&str> = line.split(separator).map(str::trim).collect();
        let &[depth, feed] = cells.as_slice() else {
            let why = format!("needs two columns, depth in mm and feed in mm/min, has {}", cells.len());
            return Err(at_line(at, "columns", why));
        };
        let (Some(depth_mm), Some(feed_mm_min)) = (number(depth), number(feed)) else {
            let is_name = |cell: &str| number(cell).is_none() && cell.contains(char::is_alphabetic);
            if head && is_name(depth) && is_name(feed) {
                head_agrees(depth, feed).map_err(|why| at_line(at, "columns", why))?;
                head = false;
                continue;
            }
            let why = if depth.contains(',') || feed.contains(',') {
                "a number has a decimal point, not a comma"
            } else {
                "holds something that is no number"
            };
            return Err(at_line(at, "not_a_number", why));
        };
        head = false;
        if rows.last().is_some_and(|row| depth_mm <= row.depth_mm) {
            return Err(at_line(at, "not_increasing", "must be deeper than the row before"));
        }
        if feed_mm_min <= 0.0 {
            return Err(at_line(at, "out_of_range", "a feed must be above 0"));
        }
        // Wherever it were rounded to, the feed on one of its sides could be above the one that is listed.
        if kind == ListKind::Linear && thousandths_below(depth_mm) < thousandths_above(depth_mm) {
            return Err(at_line(at, "too_many_digits", "a depth has three decimals at the most"));
        }
        rows.push(KnotInput { depth_mm, feed_mm_min: thousandths_below(feed_mm_min) });
    }
    if rows.len() < 2 {
        let why = "needs two rows at least: where it begins and where it ends";
        return Err(vec![Violation::new("text", "too_few", why)]);
    }
    match kind {
        ListKind::Linear => at_most_knots(rows),
        ListKind::Stepped => {
            if rows[0].depth_mm != 0.0 {
                let why = "the first row must be at first contact, depth 0";
                return Err(vec![Violation::new("text", "not_covered", why)]);
            }
            let held = rows
                .windows(2)
                .map(|pair| Held { to_mm: pair[1].depth_mm, feed_mm_min: pair[0].feed_mm_min });
            ramped(&held.collect::<Vec<_>>(), acceleration_mm_s2)
        }
    }
}

fn at_most_knots(knots: Vec<KnotInput>) -> Result<Vec<KnotInput>, Vec<Violation>> {
    if knots.len() > MOST_KNOTS {
        let why = format!("makes {} knots, a profile has at most {MOST_KNOTS}", knots.len());
        return Err(vec![Violation::new("text", "too_many", why)]);
    }
    Ok(knots)
}

/// Knots of held feeds, with ramps that the acceleration allows, each on the slower side of its change.
///
/// A profile keeps thousandths: feeds are rounded down, and borders to where the slower feed is longer.
///
/// # Errors
/// Where a stretch is too short for its ramps.
pub fn ramped(held: &[Held], acceleration_mm_s2: f64) -> Result<Vec<KnotInput>, Vec<Violation>> {
    if !(acceleration_mm_s2.is_finite() && acceleration_mm_s2 > 0.0) {
        let why = "must be above 0: it makes the ramps";
        return Err(vec![Violation::new("limits.acceleration_mm_s2", "out_of_range", why)]);
    }
    let Some(first) = held.first() else {
        return Err(vec![Violation::new("text", "too_few", "holds no feed")]);
    };
    let mut knots = vec![KnotInput { depth_mm: 0.0, feed_mm_min: thousandths_below(first.feed_mm_min) }];
    for pair in held.windows(2) {
        let [from, to] = [pair[0], pair[1]].map(|one| thousandths_below(one.feed_mm_min));
        let border =
            if to > from { thousandths_above(pair[0].to_mm) } else { thousandths_below(pair[0].to_mm) };
        if (to - from).abs() < 0.0005 {
            continue;
        }
        // Linear in depth, the acceleration is largest at the faster end; a hair more, so that rounding stays below.
        let way = from.max(to) * (to - from).abs() / 3600.0 / acceleration_mm_s2;
        let way = ((way * 1000.0).ceil() / 1000.0 + 0.001).max(SHORTEST_RAMP_MM);
        // Faster behind the border, slower before it: nowhere above the feed that was imported.
        let (start, end) = if to > from { (border, border + way) } else { (border - way, border) };
        let before = knots[knots.len() - 1].depth_mm;
        if start <= before {
            if start < before - 1e-9 || knots.len() == 1 {
                let why =
                    format!("the feed changes again before {border} mm, sooner than the acceleration allows");
                return Err(vec![Violation::new("text", "acceleration", why)]);
            }
        } else {
            knots.push(KnotInput { depth_mm: start, feed_mm_min: from });
        }
        knots.push(KnotInput { depth_mm: end, feed_mm_min: to });
    }
    let last = held[held.len() - 1];
    if last.to_mm <= knots[knots.len() - 1].depth_mm {
        let why = "the last feed is changed to closer to the end than the acceleration allows";
        return Err(vec![Violation::new("text", "acceleration", why)]);
    }
    knots.push(KnotInput { depth_mm: last.to_mm, feed_mm_min: thousandths_below(last.feed_mm_min) });
    at_most_knots(knots)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pairs(knots: &[KnotInput]) -> Vec<(f64, f64)> {
        knots.iter().map(|knot| (knot.depth_mm, knot.feed_mm_min)).collect()
    }

    #[test]
    fn a_linear_list_is_its_own_knots() {
        let text = "\u{feff}depth;feed\n# new\n0;105\n3.0;155.5\n\n20.5;345\n";
        let knots = list(text, ListKind::Linear, 300.0).unwrap();
        assert_eq!(pairs(&knots), [(0.0, 105.0), (3.0, 155.5), (20.5, 345.0)]);
    }

    #[test]
    fn a_stepped_list_gets_ramps_that_nowhere_exceed_it() {
        let knots = list("0,160\n4,480\n8,150\n20.5,150\n", ListKind::Stepped, 300.0).unwrap();
        // 480·320/3600/300 = 0.1422 mm up behind 4 mm, 480·330/3600/300 = 0.1467 mm down before 8 mm.
        let meant = [(0.0, 160.0), (4.0, 160.0), (4.144, 480.0), (7.852, 480.0), (8.0, 150.0), (20.5, 150.0)];
        for (is, meant) in pairs(&knots).into_iter().zip(meant) {
            assert!((is.0 - meant.0).abs() < 1e-9 && (is.1 - meant.1).abs() < 1e-9, "{knots:?}");
        }
    }

    #[test]
    fn a_depth_of_a_linear_list_has_three_decimals_at_the_most() {
        let refused = list("0,50\n1.0004,50\n1.2504,500\n5,500", ListKind::Linear, 300.0).unwrap_err();
        assert_eq!((refused[0].code, refused[0].path.ends_with("line 2")), ("too_many_digits", true));
        let kept = list("0,50\n1.0040,50\n1.250,500\n5,500", ListKind::Linear, 300.0).unwrap();
        assert_eq!(pairs(&kept)[1..3], [(1.004, 50.0), (1.25, 500.0)]);
    }

    #[test]
    fn a_feed_of_more_digits_is_rounded_down() {
        let kept = |feed: &str| {
            list(&format!("0,{feed}\n5,{feed}"), ListKind::Stepped, 300.0).unwrap()[0].feed_mm_min
        };
        for (feed, meant) in [
            ("100.0009", 100.0),
            ("100.0009999999", 100.0),
            ("100.001", 100.001),
            ("0.1239", 0.123),
            ("29999.9999", 29_999.999),
            ("545", 545.0),
        ] {
            assert_eq!(kept(feed).to_bits(), f64::to_bits(meant), "{feed}");
        }
        // Every thousandth is itself: a program and its profile are the same to the last digit.
        for thousandth in 1..200_000 {
            let feed = format!("{}.{:03}", thousandth / 1000, thousandth % 1000).parse::<f64>().unwrap();
            assert_eq!(thousandths_below(feed).to_bits(), feed.to_bits());
            assert_eq!(thousandths_above(feed).to_bits(), feed.to_bits());
        }
        let hole = gcode("G1 Z-5.0004 F100.0009\nZ-10.0004 F200.0009\nZ-20 F100.0009", 0.0).unwrap();
        let knots = ramped(&hole.held, 300.0).unwrap();
        assert_eq!(knots[0].feed_mm_min.to_bits(), 100.0_f64.to_bits());
        // Up behind its border, down before it.
        assert_eq!(pairs(&knots)[1], (5.001, 100.0));
        assert_eq!(pairs(&knots)[4], (10.0, 100.0));
        assert_eq!(
            list("0,100.0009\n5,200.0009", ListKind::Linear, 300.0).unwrap(),
            [
                KnotInput { depth_mm: 0.0, feed_mm_min: 100.0 },
                KnotInput { depth_mm: 5.0, feed_mm_min: 200.0 },
            ]
        );
    }

    #[test]
    fn a_head_has_to_name_depth_in_mm_and_feed_in_mm_per_min() {
        let rows = "0;105\n20.5;345\n";
        for head in [
            "depth_mm;feed_mm_min",
            "depth;feed",
            "Depth (mm); Feed [mm/min]",
            "depth in mm;feed rate in mm/min",
            "Tip depth, mm;Feedrate, mm per min",
            "Tiefe;Vorschub mm/min",
            "mm;mm/min",
        ] {
            let knots = list(&format!("{head}\n{rows}"), ListKind::Linear, 300.0).expect(head);
            assert_eq!(pairs(&knots), [(0.0, 105.0), (20.5, 345.0)], "{head}");
        }
        for (head, why) in [
            ("depth_inch;feed_mm_s", "depth in mm and feed in mm/min"),
            ("depth_inch;feed_mm_min", "depth in mm"),
            ("depth_mm;feed_mm_s", "feed in mm/min"),
            ("depth_in;feed", "depth in mm"),
            ("depth in;feed", "depth in mm"),
            ("depth;feed in/min", "feed in mm/min"),
            ("depth;feed ipm", "feed in mm/min"),
            ("depth;feed m/min", "feed in mm/min"),
            ("depth;feed mm/rev", "feed in mm/min"),
            ("depth;feed mm/min/min", "feed in mm/min"),
            ("depth µm;feed", "depth in mm"),
            ("depth;depth", "feed in mm/min"),
            ("depth;speed", "feed in mm/min"),
            ("time;feed", "depth in mm"),
            ("Zoll;Vorschub", "depth in mm"),
            ("feed_mm_min;depth_mm", "names the feed first"),
            ("Feed;Depth", "names the feed first"),
            ("feed_mm_s;depth_inch", "names the feed first"),
        ] {
            let wrong =
                list(&format!("# what we run\n{head}\n{rows}"), ListKind::Linear, 300.0).expect_err(head);
            assert_eq!((wrong[0].path.as_str(), wrong[0].code), ("text:line 2", "columns"), "{head}");
            assert!(wrong[0].message.contains(why), "{head}: {}", wrong[0].message);
        }
        // A row with a letter in it is no head, and nothing stands for one twice.
        for (line, text) in [
            (1, "O;160\n4;480\n8;150"),
            (1, "0;l60\n4;480"),
            (1, "depth;\n0;105\n5;100"),
            (2, "depth;feed\nmm;mm/min\n0;1"),
        ] {
            let wrong = list(text, ListKind::Linear, 300.0).unwrap_err();
            assert_eq!(
                (wrong[0].path.clone(), wrong[0].code),
                (format!("text:line {line}"), "not_a_number"),
                "{text}"
            );
        }
    }

    #[test]
    fn lists_are_refused_with_their_line() {
        let refused = |text: &str| {
            let wrong = list(text, ListKind::Stepped, 300.0).unwrap_err();
            (wrong[0].path.clone(), wrong[0].code)
        };
        assert_eq!(refused("0,100\n5,\n"), ("text:line 2".into(), "not_a_number"));
        assert_eq!(refused("0;100,5\n5;200\n"), ("text:line 1".into(), "not_a_number"));
        assert_eq!(refused("0,100\n0,200\n"), ("text:line 2".into(), "not_increasing"));
        assert_eq!(refused("0,100,7\n"), ("text:line 1".into(), "columns"));
        assert_eq!(refused("0,1e3\n5,100"), ("text:line 1".into(), "not_a_number"));
        assert_eq!(refused("0,NaN\n5,100"), ("text:line 1".into(), "not_a_number"));
        assert_eq!(refused("0,100\n5,-1"), ("text:line 2".into(), "out_of_range"));
        assert_eq!(refused("0,100"), ("text".into(), "too_few"));
        assert_eq!(refused("1,100\n5,100"), ("text".into(), "not_covered"));
        assert_eq!(refused("0,100\n5,30000\n5.02,100\n10,100"), ("text".into(), "acceleration"));
        assert_eq!(refused(&"0,1\n".repeat(6000)), ("text".into(), "too_many"));
        assert_eq!(refused(&"#".repeat(300_000)), ("text".into(), "too_long"));
    }

    proptest! {
        #[test]
        fn whatever_comes_is_answered(text in "[GZFXMRN0-9 .;(%#\\-\n]{0,200}|\\PC{0,100}") {
            let _ = gcode(&text, 0.0);
            let _ = list(&text, ListKind::Stepped, 100.0);
        }

        #[test]
        fn ramps_keep_the_acceleration_and_stay_below_the_steps(
            steps in prop::collection::vec((0.5..5.0_f64, 50.0..900.0_f64), 1..20), acceleration in 200.0..5000.0_f64,
            decimals in 0_i32..7,
        ) {
            let mut to_mm = 0.0;
            let digits = 10.0_f64.powi(decimals);
            let held: Vec<Held> = steps.iter().map(|&(way, feed)| {
                to_mm += (way * digits).ceil() / digits;
                Held { to_mm, feed_mm_min: (feed * digits).round() / digits }
            }).collect();
            let Ok(knots) = ramped(&held, acceleration) else { return Ok(()) };
            // As a profile keeps them.
            let kept = |value: f64| (value * 1000.0).round() / 1000.0;
            let knots: Vec<KnotInput> = knots.iter().map(|knot| {
                KnotInput { depth_mm: kept(knot.depth_mm), feed_mm_min: kept(knot.feed_mm_min) }
            }).collect();
            let feed_of = |depth: f64| held.iter().find(|one| depth <= one.to_mm).map_or(f64::MAX, |one| one.feed_mm_min);
            for knot in &knots {
                // Where two stretches meet, the profile is at the slower one's feed; the end may be rounded deeper.
                let either = [-1e-9, 1e-9].map(|to| feed_of((knot.depth_mm + to).min(held[held.len() - 1].to_mm)));
                prop_assert!(knot.feed_mm_min <= either[0].min(either[1]), "{knot:?} {either:?}");
            }
            for pair in knots.windows(2) {
                prop_assert!(pair[1].depth_mm > pair[0].depth_mm);
                let middle = f64::midpoint(pair[0].depth_mm, pair[1].depth_mm);
                let feed = f64::midpoint(pair[0].feed_mm_min, pair[1].feed_mm_min);
                prop_assert!(feed <= feed_of(middle.min(held[held.len() - 1].to_mm)) + 1e-9);
                let rise = (pair[1].feed_mm_min - pair[0].feed_mm_min).abs();
                let a = pair[0].feed_mm_min.max(pair[1].feed_mm_min) * rise / (pair[1].depth_mm - pair[0].depth_mm) / 3600.0;
                prop_assert!(a <= acceleration);
            }
        }
    }
}
