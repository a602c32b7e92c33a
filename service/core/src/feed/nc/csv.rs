//! A list of knots, for people and for anything that is no control.

use crate::feed::profile::{Fields, Profile};
use crate::invalid::Violation;

const HEAD: &str = "depth_mm,feed_mm_min";

pub(super) fn write(profile: &Profile, out: &mut String) {
    out.extend([HEAD, "\n"]);
    for (_, value) in profile.knot_lines() {
        out.extend([&value.replace(' ', ","), "\n"]);
    }
}

pub(super) fn knots<'a>(
    lines: impl Iterator<Item = (usize, &'a str)>,
    fields: &mut Fields,
) -> Result<(), Violation> {
    for (at, line) in lines.filter(|(_, line)| *line != HEAD) {
        let knot = fields.knot(&line.replace(',', " "));
        knot.map_err(|why| Violation::new(format!("line {at}"), "changed", why))?;
    }
    Ok(())
}
