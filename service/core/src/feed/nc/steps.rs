//! Controls without a linear feed word: short blocks, each with the feed that takes the profile's own time.
//!
//! In a block that covers the feeds F₀ to F₁ the feed is the mean over time, way by ∫dz/F, so that the whole file takes as
//! long as the profile. It differs from the profile most at the block's ends; blocks are made so short that it stays
//! within the feed error there.

use super::{Dialect, ExportOptions, decimal};
use crate::feed::profile::Profile;
use crate::invalid::Violation;

/// Most blocks of a file.
pub const MOST_STEPS: usize = 4000;
/// Depth in thousandths of a millimetre: the resolution of a block's end.
const RESOLUTION: f64 = 1000.0;

/// A block: where it ends and its feed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeedStep {
    /// Depth at its end, mm.
    pub to_mm: f64,
    /// Its feed, mm/min.
    pub feed_mm_min: f64,
}

/// A profile as stepped feeds that keep within `feed_error` (a part of the profile's feed) at every depth.
///
/// `places` are the decimals of a feed, at most 3.
///
/// # Errors
/// `too_steep` where the feed changes faster than blocks of 0.001 mm can follow; `feed_decimals` where they could, but not
/// with a feed of so few decimals; `too_many_steps` above [`MOST_STEPS`].
pub fn steps(profile: &Profile, feed_error: f64, places: u32) -> Result<Vec<FeedStep>, Violation> {
    let knots: Vec<_> = profile.knots().collect();
    let mut steps = Vec::new();
    for pair in knots.windows(2) {
        let ends = [(pair[0].depth_mm, pair[0].feed_mm_min), (pair[1].depth_mm, pair[1].feed_mm_min)];
        let least = (ends[1].1 / ends[0].1).ln().abs() / (2.0 * feed_error).ln_1p();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most 1e5, not negative"
        )]
        let mut count = (least.ceil() as usize).max(1);
        let most = 64 + 4 * count;
        let mut only_decimals = false;
        let piece = loop {
            if steps.len() + count > MOST_STEPS {
                let why = format!("would make more than {MOST_STEPS} blocks: allow a larger error");
                return Err(Violation::new("feed_error", "too_many_steps", why));
            }
            match piece(profile, ends, count, feed_error, places) {
                Piece::Follows(piece) => break piece,
                Piece::Decimals => only_decimals = true,
                Piece::Steep => {}
            }
            // A little shorter blocks make up for rounding; much shorter ones mean that nothing will.
            count += 1 + count / 8;
            if count > most {
                let [(from_mm, from), (to_mm, to)] = ends;
                let stretch = format!("cannot be kept between {from_mm} and {to_mm} mm");
                let (code, why) = if only_decimals {
                    let places =
                        if places == 1 { "one decimal".to_owned() } else { format!("{places} decimals") };
                    let why = format!("F has {places} here, too few for feeds of {from} to {to} mm/min");
                    ("feed_decimals", why)
                } else {
                    ("too_steep", "the feed changes too fast there".to_owned())
                };
                return Err(Violation::new("feed_error", code, format!("{stretch}: {why}")));
            }
        };
        steps.extend(piece);
    }
    Ok(steps)
}

/// A linear piece in so many blocks.
enum Piece {
    /// Its blocks keep within the feed error.
    Follows(Vec<FeedStep>),
    /// They would, were it not for the decimals of a feed.
    Decimals,
    /// They do not, whatever the decimals.
    Steep,
}

/// Relative slack for a feed before it is rounded: that of a constant feed is computed, and may miss its limit by a bit.
const SLACK: f64 = 1e-9;

/// One linear piece in `count` blocks of equal ratio of feeds.
fn piece(
    profile: &Profile,
    [(from_mm, from), (to_mm, to)]: [(f64, f64); 2],
    count: usize,
    feed_error: f64,
    places: u32,
) -> Piece {
    let limits = profile.limits();
    let unit = f64::from(10_u32.pow(places));
    let mut steps = Vec::with_capacity(count);
    let mut before_mm = from_mm;
    let mut only_decimals = false;
    for k in 1..=count {
        #[expect(clippy::cast_precision_loss, reason = "at most 4000 blocks")]
        let part = k as f64 / count as f64;
        let depth = if k == count {
            to_mm
        } else if (to - from).abs() < f64::EPSILON {
            from_mm + part * (to_mm - from_mm)
        } else {
            let feed = from * libm::pow(to / from, part);
            from_mm + (feed - from) / (to - from) * (to_mm - from_mm)
        };
        let depth = (depth * RESOLUTION).round() / RESOLUTION;
        if depth <= before_mm {
            return Piece::Steep;
        }
        let time_s = profile.time_between_s(before_mm, depth);
        let exact = (depth - before_mm) / time_s * 60.0;
        let feed = (exact * unit).round() / unit;
        let fits = |feed: f64, slack: f64| {
            let within = |is: f64| (feed - is).abs() <= (feed_error + slack) * is;
            feed > 0.0
                && within(profile.feed_at(before_mm))
                && within(profile.feed_at(depth))
                && feed >= limits.feed_min_mm_min * (1.0 - slack)
                && feed <= limits.feed_max_mm_min * (1.0 + slack)
        };
        if !fits(feed, 0.0) {
            if !fits(exact, SLACK) {
                return Piece::Steep;
            }
            only_decimals = true;
        }
        steps.push(FeedStep { to_mm: depth, feed_mm_min: feed });
        before_mm = depth;
    }
    if only_decimals { Piece::Decimals } else { Piece::Follows(steps) }
}

/// How a FANUC file begins: inch or metric has to be chosen in a block of its own.
const FANUC_START: &str = "G21\nG90 G94 G64";
/// How its files began before; those that are in use still read back.
const FANUC_START_IN_ONE: &str = "G21 G90 G94 G64";

/// A FANUC file as it would begin in the way that `text` does.
pub(super) fn with_its_start(written: String, text: &str) -> String {
    if text.lines().any(|line| line == FANUC_START_IN_ONE) {
        written.replacen(FANUC_START, FANUC_START_IN_ONE, 1)
    } else {
        written
    }
}

/// Writes the blocks.
pub(super) fn write(
    dialect: Dialect,
    profile: &Profile,
    options: &ExportOptions,
    out: &mut String,
) -> Result<(), Violation> {
    // FANUC reads one decimal of a feed per minute on every model; LinuxCNC reads any.
    let (start, places, end) = match dialect {
        Dialect::Fanuc => (FANUC_START, 1, "M99"),
        _ => ("G21 G90 G94 G64 P0.001", 3, "M2"),
    };
    let feed = |value: f64| if places == 1 { format!("{value:.1}") } else { decimal(value) };
    let steps = steps(profile, options.feed_error, places)?;
    let clearance = decimal(options.clearance_mm);
    let first = steps.first().map_or_else(|| profile.feed_at(0.0), |step| step.feed_mm_min);
    let mut line = |text: &str| out.extend([text, "\n"]);
    line(start);
    line(&format!("G0 Z{clearance}"));
    line(&format!("G1 Z0.000 F{}", feed(first)));
    for step in &steps {
        line(&format!("G1 Z{} F{}", decimal(-step.to_mm), feed(step.feed_mm_min)));
    }
    line(&format!("G0 Z{clearance}"));
    line(end);
    Ok(())
}
