//! Which version is handed out for the next cycle, or why none is.
//!
//! Only an active version is ever considered. Whatever does not match or is not known ends in the neutral answer:
//! unknown never raises the feed.

use super::profile::{Profile, ProfileHash};
use crate::cycle::ProfileVersion;
use crate::machine::FeedLimits;
use crate::operation::Operation;
use crate::wear::{ToolState, Verdict};

/// Commanded speeds that differ by no more are the same speed, as in the wear's baselines.
const SAME_SPEED: f64 = 0.02;
/// Depths that differ by no more are the same depth, mm.
const SAME_DEPTH_MM: f64 = 0.0005;

/// An active version.
#[derive(Debug, Clone, PartialEq)]
pub struct ActiveProfile {
    /// Which.
    pub version: ProfileVersion,
    /// Hash of its content.
    pub hash: ProfileHash,
    /// Its content.
    pub profile: Profile,
}

/// What a recommendation says of the version that it hands out.
#[derive(Debug, Clone, PartialEq)]
pub struct ProfileAdvice {
    /// Which.
    pub version: ProfileVersion,
    /// Hash of its content, as the exported file names it.
    pub hash: ProfileHash,
    /// Time from first contact to the end at an override of 100 %, s.
    pub time_s: f64,
    /// Level of wear up to which it holds.
    pub wear_to_level: f64,
}

/// Why no version is handed out: a stable code and a sentence.
pub type Withheld = (&'static str, String);

/// The version for the next cycle among the active ones of the operation and the tool's type.
///
/// `in_order` tells whether the tool may simply run on, `stale` whether its data is too old to judge its wear by.
///
/// # Errors
/// With the reason why the program is to be run as it is.
pub fn choose(
    active: &[ActiveProfile],
    operation: &Operation,
    limits: &FeedLimits,
    verdict: &Verdict,
    (in_order, stale): (bool, bool),
) -> Result<ProfileAdvice, Withheld> {
    let withheld = |code, why: String| Err((code, why));
    if active.is_empty() {
        return withheld("no_profile", "no feed profile is active: 100 % of the programmed feed".to_owned());
    }
    if !in_order {
        return withheld(
            "profile_withheld",
            "the tool is to be looked at first: no feed profile is handed out".to_owned(),
        );
    }
    let level = wear_level(verdict, stale)?;
    // The band that begins last is the one that was made for this wear.
    let for_wear = active
        .iter()
        .filter(|one| {
            let band = one.profile.wear();
            band.from_level.is_none_or(|from| level >= from) && level <= band.to_level
        })
        .max_by(|a, b| {
            let from = |one: &ActiveProfile| one.profile.wear().from_level.unwrap_or(0.0);
            from(a).total_cmp(&from(b))
        });
    let Some(chosen) = for_wear else {
        let highest = active.iter().map(|one| one.profile.wear().to_level).fold(0.0, f64::max);
        return withheld(
            "profile_beyond_wear",
            format!(
                "the tool's wear is {level:.2}, no active feed profile holds there (the furthest to {highest:.2})"
            ),
        );
    };
    let name = format!("version {} of feed profile {}", chosen.version.version, chosen.version.profile);
    let profile = &chosen.profile;
    let conditions = profile.conditions();
    let differs = |stated: &Option<String>, is: &Option<String>| stated.is_some() && stated != is;
    if differs(&conditions.program, &operation.program) {
        return withheld(
            "profile_other_program",
            format!("{name} was made for another program than the operation's"),
        );
    }
    if differs(&conditions.work_material, &operation.work_material) {
        return withheld("profile_other_material", format!("{name} was made for another work material"));
    }
    if let Some(stated) = conditions.spindle_speed_rpm
        && operation.spindle_speed_rpm.is_none_or(|is| (is - stated).abs() > SAME_SPEED * stated)
    {
        return withheld(
            "profile_other_speed",
            format!("{name} was made for a spindle speed of {stated} rpm"),
        );
    }
    if let Some(depth) = operation.depth_mm
        && (depth - profile.end_depth_mm()).abs() > SAME_DEPTH_MM
    {
        let end = profile.end_depth_mm();
        return withheld(
            "profile_other_depth",
            format!("{name} ends at {end} mm, the operation at {depth} mm"),
        );
    }
    if profile.fastest_mm_min() > limits.max_mm_min() || profile.slowest_mm_min() < limits.min_mm_min() {
        return withheld("profile_outside_machine", format!("{name} leaves the feeds of this machine"));
    }
    Ok(ProfileAdvice {
        version: chosen.version.clone(),
        hash: chosen.hash,
        time_s: profile.time_s(),
        wear_to_level: profile.wear().to_level,
    })
}

/// The level of wear to choose by, on the careful side.
fn wear_level(verdict: &Verdict, stale: bool) -> Result<f64, Withheld> {
    let unknown = |why: &str| Err(("profile_wear_unknown", format!("{why}: no feed profile is handed out")));
    let mounted_new = verdict.life > 0 && verdict.started_unworn;
    match (verdict.state, verdict.level) {
        // Mounted new and not judged yet: it is what a profile for new tools is made for.
        (ToolState::Learning, None) if mounted_new => Ok(1.0),
        (ToolState::Unknown, None) if mounted_new && verdict.cycles == 0 => Ok(1.0),
        (_, None) => unknown("the tool's wear is not known"),
        (_, Some(_)) if stale => unknown("the tool's wear is older than data stays good"),
        (_, Some(level)) if verdict.indicators.masked_by_control => {
            // Under a law that slows the feed the energy hides the wear and the time shows it: in the process model,
            // +9.1 % at constant feed are +2.3 % energy and +6.3 % time (Stryczek & Błaszczak 2020, F_AC). Their
            // product is close, and never less than either.
            match verdict.indicators.cycle_time_ratio {
                Some(time) => Ok(level.as_run.max(1.0) * time.max(1.0)),
                None => unknown("a control law hides the tool's wear and its cycle time is not known"),
            }
        }
        (_, Some(level)) => Ok(level.as_run),
    }
}
