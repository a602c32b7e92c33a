//! Controls with a linear feed word: a block per knot.
//!
//! SINUMERIK `FLIN` is modal and ends with `FNORM`; TwinCAT NC I `FLIN` ends with `FCONST`; TwinCAT CNC repeats `G193`. All
//! begin from the feed in force where the block begins, so the approach runs at the first knot's feed.

use super::{Dialect, ExportOptions, decimal, law};
use crate::feed::profile::{Fields, KnotInput, Profile, parse_decimal};
use crate::invalid::Violation;

/// Ends a block that is no knot: one that only ends where the law begins, with the feed that the profile has there.
const NO_KNOT: &str = " ; no knot";

/// Writes the blocks.
pub(super) fn write(
    dialect: Dialect,
    profile: &Profile,
    options: &ExportOptions,
    out: &mut String,
) -> Result<(), Violation> {
    let clearance = decimal(options.clearance_mm);
    let (start, linear, modal, end): (&[&str], &str, bool, &[&str]) = match dialect {
        Dialect::TwincatNci => (&["G90 G71", "FCONST"], "FLIN", true, &["FCONST"]),
        Dialect::TwincatCnc => (&["G90 G94 G71", "#SLOPE [TYPE=STEP]"], "G193 ", false, &[]),
        _ => (&["G90 G94 G710 G64"], "FLIN", true, &["FNORM"]),
    };
    let law = match options.law {
        None => None,
        Some(law) => Some(law::Actions::new(profile, law, options)?),
    };
    let mut line = |text: &str| out.extend([text, "\n"]);
    start.iter().for_each(|text| line(text));
    if let Some(law) = &law {
        law.definitions().iter().for_each(|text| line(text));
    }
    line(&format!("G0 Z{clearance}"));
    let mut waiting = law.as_ref();
    let mut before_mm = 0.0;
    for (at, knot) in profile.knots().enumerate() {
        let (z, feed) = (decimal(-knot.depth_mm), decimal(knot.feed_mm_min));
        if at == 0 {
            line(&format!("G1 Z{z} F{feed}"));
            if modal {
                line(linear);
            }
            continue;
        }
        // A synchronised action acts from the block behind it on: it stands before the first one that begins where the law
        // begins, and where no knot lies there, the block is split. The feed is linear, so both parts run as the whole did.
        if let Some(law) = waiting.take_if(|law| law.begins_mm < knot.depth_mm) {
            if law.begins_mm > before_mm {
                let (z, feed) = (decimal(-law.begins_mm), decimal(profile.feed_at(law.begins_mm)));
                line(&format!("G1 Z{z} F{feed}{NO_KNOT}"));
            }
            law.actions().iter().for_each(|text| line(text));
        }
        line(&format!("{}G1 Z{z} F{feed}", if modal { "" } else { linear }));
        before_mm = knot.depth_mm;
    }
    end.iter().for_each(|text| line(text));
    if let Some(law) = &law {
        line(&law.cancel());
    }
    line(&format!("G0 Z{clearance}"));
    line(if dialect == Dialect::TwincatNci { "M30" } else { "M17" });
    Ok(())
}

/// Takes the knots out of the blocks: every `G1` with a Z and an F that is not marked to be none.
pub(super) fn knots<'a>(
    blocks: impl Iterator<Item = (usize, &'a str)>,
    fields: &mut Fields,
) -> Result<(), Violation> {
    for (at, block) in blocks {
        let block = block.strip_prefix("G193 ").unwrap_or(block);
        // Whoever marks a knot so takes it out of the content, and its hash no longer fits.
        let Some(words) = block.strip_prefix("G1 Z").filter(|words| !words.ends_with(NO_KNOT)) else {
            continue;
        };
        let read = words.split_once(" F").and_then(|(z, feed)| {
            let depth_mm = match z.strip_prefix('-') {
                Some(depth) => parse_decimal(depth)?,
                None => parse_decimal(z).filter(|z| *z == 0.0)?,
            };
            Some(KnotInput { depth_mm, feed_mm_min: parse_decimal(feed)? })
        });
        let knot = read.ok_or_else(|| {
            Violation::new(format!("line {at}"), "changed", "is no block of a profile: the file was changed")
        })?;
        if fields.knots.len() >= crate::feed::profile::MOST_KNOTS {
            return Err(Violation::new(format!("line {at}"), "too_many", "has more knots than a profile"));
        }
        fields.knots.push(knot);
    }
    Ok(())
}
