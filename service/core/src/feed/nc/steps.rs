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
/// `too_steep` where the feed changes faster than blocks of 0.001 mm can follow, or where its decimals are too coarse;
/// `too_many_steps` above [`MOST_STEPS`].
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
        let piece = loop {
            if steps.len() + count > MOST_STEPS {
                let why = format!("would make more than {MOST_STEPS} blocks: allow a larger error");
                return Err(Violation::new("feed_error", "too_many_steps", why));
            }
            if let Some(piece) = piece(profile, ends, count, feed_error, places) {
                break piece;
            }
            // A little shorter blocks make up for rounding; much shorter ones mean that nothing will.
            count += 1 + count / 8;
            if count > most {
                let why = format!(
                    "cannot be kept between {} and {} mm: the feed changes too fast there",
                    ends[0].0, ends[1].0
                );
                return Err(Violation::new("feed_error", "too_steep", why));
            }
        };
        steps.extend(piece);
    }
    Ok(steps)
}

/// One linear piece in `count` blocks of equal ratio of feeds; `None` where a block leaves the feed error.
fn piece(
    profile: &Profile,
    [(from_mm, from), (to_mm, to)]: [(f64, f64); 2],
    count: usize,
    feed_error: f64,
    places: u32,
) -> Option<Vec<FeedStep>> {
    let unit = f64::from(10_u32.pow(places));
    let mut steps = Vec::with_capacity(count);
    let mut before_mm = from_mm;
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
            return None;
        }
        let time_s = profile.time_between_s(before_mm, depth);
        let feed = ((depth - before_mm) / time_s * 60.0 * unit).round() / unit;
        let within = |is: f64| (feed - is).abs() <= feed_error * is;
        if feed <= 0.0 || !within(profile.feed_at(before_mm)) || !within(profile.feed_at(depth)) {
            return None;
        }
        let limits = profile.limits();
        if !(limits.feed_min_mm_min..=limits.feed_max_mm_min).contains(&feed) {
            return None;
        }
        steps.push(FeedStep { to_mm: depth, feed_mm_min: feed });
        before_mm = depth;
    }
    Some(steps)
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
        Dialect::Fanuc => ("G21 G90 G94 G64", 1, "M99"),
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
