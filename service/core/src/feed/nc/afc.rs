//! A row of Heidenhain's AFC.TAB: how far adaptive feed control may move the feed. It knows no depth.

use super::{ExportOptions, Stamp, override_range};
use crate::feed::profile::Profile;

/// Width of the name's column.
const NAME: usize = 10;

/// Writes the columns' names and the row.
///
/// `FMIN`, `FMAX` are the override limits of profile and machine, the narrower ones, rounded inwards; `FIDL` and `FENT` leave the programmed feed as it is
/// outside the material and at entry, where the tool maker's feed has to hold; `OVLD` F stops once the tool is retracted,
/// because a tool that stops in hot material sticks there; `SENS` is the middle.
pub(super) fn write(profile: &Profile, stamp: &Stamp, options: &ExportOptions, out: &mut String) {
    let (low, high) = override_range(profile, options.machine.as_ref());
    let (low, high) = (low.ceil(), high.floor());
    let mut name = format!("FW{}", stamp.hash).to_ascii_uppercase();
    name.truncate(NAME);
    let row = |cells: [&str; 10]| {
        let [nr, afc, rest @ ..] = cells;
        let rest: Vec<String> = rest.iter().map(|cell| format!("{cell:<5}")).collect();
        format!("{nr:<5}{afc:<11}{}", rest.concat()).trim_end().to_owned()
    };
    let (low, high) = (format!("{low:.0}"), format!("{high:.0}"));
    let head = ["NR", "AFC", "FMIN", "FMAX", "FIDL", "FENT", "OVLD", "POUT", "SENS", "PLC"];
    let cells = ["0", &name, &low, &high, "100", "100", "F", "0", "100", "0"];
    out.extend([row(head).as_str(), "\n", row(cells).as_str(), "\n"]);
}
