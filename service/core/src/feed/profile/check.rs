//! From plain values to a profile, or everything that is wrong with them.

use super::{
    Conditions, Knot, LONGEST_TEXT, Limits, MOST_KNOTS, MOST_SECTIONS, Profile, ProfileInput, Section,
    Thousandths, WearBand,
};
use crate::invalid::{Range, Violation};

/// Depths of a profile; the lowest is first contact.
const DEPTH_RANGE: Range = Range::new(0.0, 1_000.0, "mm");
/// Feeds of a profile: as [`crate::friction::program::HIGHEST_FEED_MM_MIN`], and above 0, where time would not end.
const FEED_RANGE: Range = Range::new(0.1, 30_000.0, "mm/min");
/// Accelerations of a feed axis.
const ACCELERATION_RANGE: Range = Range::new(1.0, 100_000.0, "mm/s²");
/// Lowest overrides: 0 is a feed hold, and 100 has to be allowed.
const OVERRIDE_MIN_RANGE: Range = Range::new(1.0, 100.0, "%");
/// Highest overrides, up to what any control takes.
const OVERRIDE_MAX_RANGE: Range = Range::new(100.0, 255.0, "%");
/// Set loads.
const SET_LOAD_RANGE: Range = crate::operation::SET_LOAD_RANGE;
/// Levels of wear; at 1.10 a tool is worn, so nothing is meant for tools far beyond.
const LEVEL_RANGE: Range = Range::new(1.0, 2.0, "times the new tool's energy");
/// Spindle speeds.
const SPEED_RANGE: Range = Range::new(1.0, 1_000_000.0, "rpm");

struct Checker {
    wrong: Vec<Violation>,
}

impl Checker {
    fn say(&mut self, path: impl Into<String>, code: &'static str, message: impl Into<String>) {
        self.wrong.push(Violation::new(path, code, message));
    }

    /// A number of the range, rounded to thousandths; the range holds for what is kept.
    fn number(&mut self, path: &str, range: &Range, value: f64) -> Option<Thousandths> {
        let rounded = if value.is_finite() { (value * 1000.0).round() / 1000.0 } else { value };
        let kept = range.collect(path, rounded, &mut self.wrong)?;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "in a range below 4e6")]
        let thousandths = (kept * 1000.0).round() as Thousandths;
        Some(thousandths)
    }

    fn optional(&mut self, path: &str, range: &Range, value: Option<f64>) -> Option<Thousandths> {
        value.and_then(|value| self.number(path, range, value))
    }

    fn text(&mut self, path: &str, text: &str) {
        if text.is_empty() {
            self.say(path, "empty", "must not be empty");
        } else if text.len() > LONGEST_TEXT {
            self.say(path, "too_long", format!("must have at most {LONGEST_TEXT} bytes, has {}", text.len()));
        }
    }

    fn count(&mut self, path: &str, count: usize, least: usize, most: usize) -> bool {
        if count < least {
            let code = if count == 0 { "empty" } else { "too_few" };
            self.say(path, code, format!("needs at least {least} entries, has {count}"));
        } else if count > most {
            self.say(path, "too_many", format!("takes at most {most} entries, has {count}"));
        }
        (least..=most).contains(&count)
    }
}

pub(super) fn profile(input: ProfileInput) -> Result<Profile, Vec<Violation>> {
    let mut check = Checker { wrong: Vec::new() };
    check.text("tool_type", &input.tool_type);
    let limits = limits(&mut check, &input);
    let wear = wear(&mut check, &input);
    let conditions = conditions(&mut check, input.conditions.clone());
    let knots = knots(&mut check, &input, limits.as_ref());
    let sections = sections(&mut check, &input, knots.last().map(|knot| knot.depth));
    match (limits, wear) {
        (Some(limits), Some(wear)) if check.wrong.is_empty() => Ok(Profile {
            operation: input.operation,
            tool_type: input.tool_type,
            knots,
            sections,
            limits,
            wear,
            conditions,
        }),
        _ => Err(check.wrong),
    }
}

fn limits(check: &mut Checker, input: &ProfileInput) -> Option<Limits> {
    let given = &input.limits;
    let feed_min = check.number("limits.feed_min_mm_min", &FEED_RANGE, given.feed_min_mm_min);
    let feed_max = check.number("limits.feed_max_mm_min", &FEED_RANGE, given.feed_max_mm_min);
    if let (Some(min), Some(max)) = (feed_min, feed_max)
        && min > max
    {
        // Equal ones are a shop that may run one feed only.
        let message = format!("must not be below feed_min_mm_min ({})", given.feed_min_mm_min);
        check.say("limits.feed_max_mm_min", "empty_range", message);
    }
    let acceleration =
        check.number("limits.acceleration_mm_s2", &ACCELERATION_RANGE, given.acceleration_mm_s2);
    let low = check.number("limits.override_min_percent", &OVERRIDE_MIN_RANGE, given.override_min_percent);
    let high = check.number("limits.override_max_percent", &OVERRIDE_MAX_RANGE, given.override_max_percent);
    let set = |check: &mut Checker, path, value| check.optional(path, &SET_LOAD_RANGE, value);
    let spindle_load_set = set(check, "limits.spindle_load_set_percent", given.spindle_load_set_percent);
    let feed_drive_load_set =
        set(check, "limits.feed_drive_load_set_percent", given.feed_drive_load_set_percent);
    Some(Limits {
        feed_min: feed_min?,
        feed_max: feed_max?,
        acceleration: acceleration?,
        override_min: low?,
        override_max: high?,
        spindle_load_set,
        feed_drive_load_set,
    })
}

fn wear(check: &mut Checker, input: &ProfileInput) -> Option<WearBand> {
    let from = check.optional("wear.from_level", &LEVEL_RANGE, input.wear.from_level);
    let to = check.number("wear.to_level", &LEVEL_RANGE, input.wear.to_level)?;
    // From exactly the new tool's level is from new: one name for one thing.
    let from = from.filter(|from| *from > 1000);
    if from.is_some_and(|from| from >= to) {
        check.say("wear.to_level", "empty_range", "must be above from_level");
    }
    Some(WearBand { from, to })
}

fn conditions(check: &mut Checker, given: Conditions<f64>) -> Conditions<Thousandths> {
    for (path, text) in
        [("conditions.program", &given.program), ("conditions.work_material", &given.work_material)]
    {
        if let Some(text) = text {
            check.text(path, text);
        }
    }
    let spindle_speed_rpm =
        check.optional("conditions.spindle_speed_rpm", &SPEED_RANGE, given.spindle_speed_rpm);
    Conditions { program: given.program, work_material: given.work_material, spindle_speed_rpm }
}

fn knots(check: &mut Checker, input: &ProfileInput, limits: Option<&Limits>) -> Vec<Knot> {
    let mut knots: Vec<Knot> = Vec::new();
    if !check.count("knots", input.knots.len(), 2, MOST_KNOTS) {
        return knots;
    }
    let mut whole = true;
    for (at, given) in input.knots.iter().enumerate() {
        let depth = check.number(&format!("knots[{at}].depth_mm"), &DEPTH_RANGE, given.depth_mm);
        let path = format!("knots[{at}].feed_mm_min");
        let feed = check.number(&path, &FEED_RANGE, given.feed_mm_min);
        if let (Some(feed), Some(limits)) = (feed, limits)
            && !(limits.feed_min..=limits.feed_max).contains(&feed)
        {
            let (min, max) = (super::whole(limits.feed_min), super::whole(limits.feed_max));
            let message =
                format!("must be within the limits {min} to {max} mm/min, is {}", given.feed_mm_min);
            check.say(path, "outside_limits", message);
        }
        match (depth, feed) {
            (Some(depth), Some(feed)) => knots.push(Knot { depth, feed }),
            _ => whole = false,
        }
    }
    // Without every knot the pairs would not be neighbours.
    if !whole {
        return Vec::new();
    }
    if knots[0].depth != 0 {
        check.say("knots[0].depth_mm", "not_covered", "the first knot must be at first contact, depth 0");
    }
    for (at, pair) in knots.windows(2).enumerate() {
        let (left, right) = (pair[0], pair[1]);
        let at = at + 1;
        if right.depth <= left.depth {
            let message = "must be deeper than the knot before, by 0.001 mm at least";
            check.say(format!("knots[{at}].depth_mm"), "not_increasing", message);
        } else if let Some(limits) = limits {
            let needed = acceleration_mm_s2(left, right);
            let most = super::whole(limits.acceleration);
            if needed > most {
                let message = format!(
                    "needs {needed:.0} mm/s² from the knot before, the limit is {most} mm/s²: move them apart \
                     or change the feed less"
                );
                check.say(format!("knots[{at}].feed_mm_min"), "acceleration", message);
            }
        }
    }
    knots
}

/// Largest acceleration between two knots at an override of 100 %, mm/s²: a = v·dv/dz with the larger v of the two.
fn acceleration_mm_s2(left: Knot, right: Knot) -> f64 {
    let (from, to) = (super::whole(left.feed), super::whole(right.feed));
    let way_mm = super::whole(right.depth - left.depth);
    from.max(to) * (to - from).abs() / way_mm / 3600.0
}

fn sections(check: &mut Checker, input: &ProfileInput, end: Option<Thousandths>) -> Vec<Section> {
    let mut sections: Vec<Section> = Vec::new();
    if !check.count("sections", input.sections.len(), 1, MOST_SECTIONS) {
        return sections;
    }
    for (at, given) in input.sections.iter().enumerate() {
        let path = format!("sections[{at}].to_mm");
        let Some(to) = check.number(&path, &DEPTH_RANGE, given.to_mm) else { continue };
        if to <= sections.last().map_or(0, |before| before.to) {
            check.say(path, "not_increasing", "must be deeper than where the section begins");
        }
        if sections.last().is_some_and(|before| before.kind > given.kind) {
            let message = "heating, forming, idle travel and flange follow each other in this order";
            check.say(format!("sections[{at}].kind"), "order", message);
        }
        sections.push(Section { kind: given.kind, to });
    }
    if let (Some(end), Some(last)) = (end, sections.last())
        && last.to != end
    {
        let path = format!("sections[{}].to_mm", input.sections.len() - 1);
        let message = format!("the last section must end with the last knot, at {} mm", super::whole(end));
        check.say(path, "not_covered", message);
    }
    sections
}
