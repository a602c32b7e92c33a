//! Which version is handed out for the next cycle, or why none is.
//!
//! Only an active version is ever considered. Whatever does not match or is not known ends in the neutral answer:
//! unknown never raises the feed.

use super::profile::{Profile, ProfileHash};
use crate::cycle::ProfileVersion;
use crate::machine::FeedLimits;
use crate::operation::Operation;
use crate::wear::{Exclusion, ToolState, Verdict};

/// Commanded speeds that differ by no more are the same speed, as in the wear's baselines.
const SAME_SPEED: f64 = 0.02;
/// Depths that differ by no more are the same depth, mm.
pub const SAME_DEPTH_MM: f64 = 0.0005;

/// After so many cycles of a life of which none says how worn the tool is, it is no new one any more: as many as outdate a level,
/// before there is one to tell its window.
const NEW_FOR_CYCLES: u64 = 20;

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

impl ProfileAdvice {
    /// Of a version that is handed out.
    pub fn of(one: &ActiveProfile) -> Self {
        Self {
            version: one.version.clone(),
            hash: one.hash,
            time_s: one.profile.time_s(),
            wear_to_level: one.profile.wear().to_level,
        }
    }
}

/// The lower of two preferred loads: both are limits that somebody has set.
pub fn lower(one: Option<f64>, other: Option<f64>) -> Option<f64> {
    match (one, other) {
        (Some(one), Some(other)) => Some(one.min(other)),
        (one, other) => one.or(other),
    }
}

/// Why no version is handed out: a stable code and a sentence.
pub type Withheld = (&'static str, String);

/// The version for the next cycle among the active ones of the operation and the tool's type.
///
/// `in_order` tells whether the tool may simply run on, `stale` whether its data is too old to judge its wear by.
///
/// # Errors
/// With the reason why the program is to be run as it is.
pub fn choose<'a>(
    active: &'a [ActiveProfile],
    operation: &Operation,
    limits: &FeedLimits,
    verdict: &Verdict,
    (in_order, stale): (bool, bool),
) -> Result<&'a ActiveProfile, Withheld> {
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
    matches(chosen, operation, limits)?;
    Ok(chosen)
}

/// Whether a version was made for this operation as it is now, and for this machine's feeds.
///
/// # Errors
/// With what differs.
pub fn matches(one: &ActiveProfile, operation: &Operation, limits: &FeedLimits) -> Result<(), Withheld> {
    let (profile, version) = (&one.profile, &one.version);
    fits(version, profile, operation)?;
    if profile.fastest_mm_min() > limits.max_mm_min() || profile.slowest_mm_min() < limits.min_mm_min() {
        let why = format!("{} leaves the feeds of this machine", named(version));
        return Err(("profile_outside_machine", why));
    }
    Ok(())
}

fn named(version: &ProfileVersion) -> String {
    format!("version {} of feed profile {}", version.version, version.profile)
}

/// Whether a version was made for this operation as it is now.
///
/// # Errors
/// With what differs.
pub fn fits(version: &ProfileVersion, profile: &Profile, operation: &Operation) -> Result<(), Withheld> {
    let withheld = |code, why: String| Err((code, why));
    let name = named(version);
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
    Ok(())
}

/// Whether a version holds at the tool's wear.
///
/// # Errors
/// When the wear is beyond it, or not known.
pub fn holds(one: &ActiveProfile, verdict: &Verdict, stale: bool) -> Result<(), Withheld> {
    let (level, to) = (wear_level(verdict, stale)?, one.profile.wear().to_level);
    if level <= to {
        return Ok(());
    }
    Err(("profile_beyond_wear", format!("the tool's wear is {level:.2}, the feed profile holds to {to:.2}")))
}

/// The level of wear to choose by, on the careful side.
fn wear_level(verdict: &Verdict, stale: bool) -> Result<f64, Withheld> {
    let unknown = |why: &str| Err(("profile_wear_unknown", format!("{why}: no feed profile is handed out")));
    let mounted_new = verdict.life > 0 && verdict.started_unworn;
    match (verdict.state, verdict.level) {
        // Mounted new and not judged yet: it is what a profile for new tools is made for. What data is of before, old or not, is another
        // tool's; one whose cycles may have come without a clock is not known to be new.
        (ToolState::Unknown, None) if mounted_new && verdict.cycles == 0 => Ok(1.0),
        // Before anything else that is said of a new tool: of its newest cycles none may have come.
        (_, _) if stale => unknown("the tool's wear is older than data stays good"),
        // Also where a level is told: it is of before what cannot be counted, or too uncertain to go by.
        (ToolState::Unknown, _) => unknown("the tool's wear is not known"),
        (ToolState::Learning, None) if mounted_new => match unknown_cycles(verdict) {
            0..=NEW_FOR_CYCLES => Ok(1.0),
            cycles => unknown(&format!("none of {cycles} cycles since the tool was new says how worn it is")),
        },
        (_, None) => unknown("the tool's wear is not known"),
        (_, Some(level)) if verdict.indicators.masked_by_control => {
            // Under a law that slows the feed the energy hides the wear and the time shows it: in the process model,
            // +9.1 % at constant feed are +2.3 % energy and +6.3 % time (Stryczek & Błaszczak 2020, F_AC). Their
            // product is close, and never less than either.
            match verdict.indicators.cycle_time_ratio {
                Some(time) => Ok(level.as_run.max(1.0) * time.max(1.0)),
                None => unknown("a control law hides the tool's wear and its cycle time is not known"),
            }
        }
        // The level that decides, and never a lower one than the energy as run already shows.
        (_, Some(level)) => Ok(level.value.max(level.as_run)),
    }
}

/// Cycles of the life that may have worn the tool and say nothing of it: all that cut, without those that one baseline is learnt
/// from. Of cycles that are spread over many conditions no baseline comes to its end, however long the tool works.
fn unknown_cycles(verdict: &Verdict) -> u64 {
    let idle = [Exclusion::Aborted, Exclusion::Incomplete, Exclusion::AirCut, Exclusion::BrokenSuspected];
    let idle: u64 = idle.iter().map(|why| verdict.excluded[*why as usize]).sum();
    let learnt = verdict.baselines.iter().map(|baseline| u64::from(baseline.learnt_from)).max();
    verdict.cycles.saturating_sub(idle).saturating_sub(learnt.unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feed::profile::tests::given;
    use crate::feed::profile::{Conditions, WearBandInput};
    use crate::ids::{OperationId, ProfileId};
    use crate::operation::WearSettings;
    use crate::units::Process;
    use crate::wear::{Level, SecondIndicators};
    use proptest::prelude::*;

    fn active(name: &str, from_level: Option<f64>, to_level: f64) -> ActiveProfile {
        let input = given::input();
        let wear = WearBandInput { from_level, to_level };
        let profile = Profile::new(crate::feed::profile::ProfileInput { wear, ..input }).unwrap();
        let version = ProfileVersion { profile: ProfileId::try_from(name).unwrap(), version: 1 };
        ActiveProfile { version, hash: ProfileHash::from_bytes([0; 32]), profile }
    }

    fn operation() -> Operation {
        let Conditions { program, work_material, spindle_speed_rpm } = given::input().conditions;
        Operation {
            id: OperationId::try_from("bushing-m8").unwrap(),
            name: "Bushing".to_owned(),
            process: Process::Friction,
            program,
            feature: None,
            work_material,
            thickness_mm: None,
            depth_mm: Some(20.5),
            spindle_speed_rpm,
            programmed_feed_mm_min: Some(110.0),
            spindle_load_set_percent: None,
            feed_drive_load_set_percent: None,
            wear: WearSettings::default(),
            turning: None,
            plunge: None,
        }
    }

    fn worn(level: Option<f64>) -> Verdict {
        let unknown = Verdict::unknown("x", "x");
        let state = if level.is_some() { ToolState::Good } else { ToolState::Learning };
        let level = level.map(|as_run| Level::as_run(as_run, (as_run, as_run), 5, 5));
        Verdict { state, level, life: 1, cycles: 9, ..unknown }
    }

    fn limits() -> FeedLimits {
        FeedLimits::new(10.0, 2000.0, 5.0, 200.0).unwrap()
    }

    fn chosen(bands: &[ActiveProfile], verdict: &Verdict) -> Result<String, &'static str> {
        choose(bands, &operation(), &limits(), verdict, (true, false))
            .map(|one| one.version.profile.to_string())
            .map_err(|(code, _)| code)
    }

    #[test]
    fn the_band_that_was_made_for_the_wear_is_chosen_and_beyond_none() {
        let bands = [active("new", None, 1.05), active("mid", Some(1.03), 1.08)];
        assert_eq!(chosen(&bands, &worn(None)), Ok("new".into()), "mounted new and learning");
        assert_eq!(chosen(&bands, &worn(Some(0.99))), Ok("new".into()));
        assert_eq!(chosen(&bands, &worn(Some(1.04))), Ok("mid".into()));
        assert_eq!(chosen(&bands, &worn(Some(1.08))), Ok("mid".into()));
        assert_eq!(chosen(&bands, &worn(Some(1.081))), Err("profile_beyond_wear"));
        assert_eq!(chosen(&bands[1..], &worn(Some(1.0))), Err("profile_beyond_wear"));
        assert_eq!(chosen(&[], &worn(None)), Err("no_profile"));
    }

    #[test]
    fn wear_that_is_not_known_hands_nothing_out() {
        let band = [active("new", None, 1.10)];
        let used = Verdict { started_unworn: false, ..worn(None) };
        assert_eq!(chosen(&band, &used), Err("profile_wear_unknown"));
        assert_eq!(chosen(&band, &Verdict { life: 0, ..worn(None) }), Err("profile_wear_unknown"));
        let lost = Verdict { state: ToolState::Unknown, ..worn(None) };
        assert_eq!(chosen(&band, &lost), Err("profile_wear_unknown"));
        assert_eq!(chosen(&band, &Verdict { cycles: 0, ..lost }), Ok("new".into()), "mounted a moment ago");
        for verdict in [worn(Some(1.0)), worn(None)] {
            let stale = choose(&band, &operation(), &limits(), &verdict, (true, true));
            assert_eq!(stale.unwrap_err().0, "profile_wear_unknown", "{:?}", verdict.state);
        }
        // The last cycle that is known is of the life before.
        let mounted = Verdict { cycles: 0, state: ToolState::Unknown, ..worn(None) };
        let stale = |verdict: &Verdict| {
            let chosen = choose(&band, &operation(), &limits(), verdict, (true, true));
            chosen.map(|one| one.version.profile.to_string()).map_err(|(code, _)| code)
        };
        assert_eq!(stale(&mounted), Ok("new".to_owned()), "a tool that waits for its first cycle is new");
        // Cycles of this life may have come without a clock.
        let unplaced = Verdict { started_unworn: false, ..mounted };
        assert_eq!(stale(&unplaced), Err("profile_wear_unknown"));
        let outdated = Verdict { state: ToolState::Unknown, ..worn(Some(1.0)) };
        assert_eq!(chosen(&band, &outdated), Err("profile_wear_unknown"), "a level of before");
        let held = choose(&band, &operation(), &limits(), &worn(Some(1.0)), (false, false));
        assert_eq!(held.unwrap_err().0, "profile_withheld");
        let narrow = FeedLimits::new(10.0, 500.0, 5.0, 200.0).unwrap();
        let outside = choose(&band, &operation(), &narrow, &worn(Some(1.0)), (true, false));
        assert_eq!(outside.unwrap_err().0, "profile_outside_machine");
    }

    #[test]
    fn a_tool_whose_baselines_never_stand_is_new_only_for_so_long() {
        let band = [active("new", None, 1.10)];
        let learning = |cycles, learnt: &[u32], idle| {
            let key = crate::wear::BaselineKey {
                machine: "M1".try_into().unwrap(),
                operation: "bushing-m8".try_into().unwrap(),
                spindle_speed_rpm: None,
                basis: crate::summary::EnergyBasis::MeasuredPower,
                idle_subtracted: false,
                in_contact: true,
                energy_scale: 0,
                strategy: None,
                law_version: None,
                profile: None,
            };
            let baseline = |learnt_from: &u32| crate::wear::BaselineEvidence {
                key: key.clone(),
                learnt_from: *learnt_from,
                needed: 100,
                baseline_joules: None,
                level_at_entry: 1.0,
                operator_override_percent: None,
                earlier: Vec::new(),
            };
            let mut verdict =
                Verdict { cycles, baselines: learnt.iter().map(baseline).collect(), ..worn(None) };
            verdict.excluded[Exclusion::AirCut as usize] = idle;
            verdict
        };
        let of = |cycles, learnt: &[u32], idle| chosen(&band, &learning(cycles, learnt, idle));
        assert_eq!(of(90, &[90], 0), Ok("new".into()), "a long baseline that is being learnt");
        assert_eq!(of(150, &[2; 75], 0), Err("profile_wear_unknown"), "spread over 75 speeds");
        assert_eq!(of(22, &[2; 11], 0), Ok("new".into()));
        assert_eq!(of(23, &[2; 12], 0), Err("profile_wear_unknown"));
        assert_eq!(of(23, &[2; 12], 1), Ok("new".into()), "one cut only air");
        let holds_still =
            |cycles| holds(&band[0], &learning(cycles, &[2], 0), false).map_err(|(code, _)| code);
        assert_eq!((holds_still(22), holds_still(23)), (Ok(()), Err("profile_wear_unknown")));
    }

    #[test]
    fn where_a_law_hides_the_wear_the_time_tells_it() {
        let band = [active("new", None, 1.07)];
        let hidden = |time: Option<f64>| {
            let indicators =
                SecondIndicators { fall_depth: None, cycle_time_ratio: time, masked_by_control: true };
            Verdict { indicators, ..worn(Some(1.023)) }
        };
        assert_eq!(chosen(&band, &hidden(Some(1.02))), Ok("new".into()));
        assert_eq!(chosen(&band, &hidden(Some(1.063))), Err("profile_beyond_wear"));
        assert_eq!(chosen(&band, &hidden(None)), Err("profile_wear_unknown"));
    }

    proptest! {
        #[test]
        fn what_is_handed_out_holds_at_the_tools_wear(
            level in 0.8..1.6_f64, edges in prop::collection::vec((1.0..1.4_f64, 0.001..0.3_f64), 1..5),
        ) {
            let bands: Vec<_> = edges
                .iter()
                .enumerate()
                .map(|(at, &(from, more))| active(&format!("p{at}"), (from > 1.1).then_some(from), from + more))
                .collect();
            if let Ok(name) = chosen(&bands, &worn(Some(level))) {
                let wear = bands.iter().find(|one| one.version.profile.as_str() == name).unwrap().profile.wear();
                prop_assert!(level <= wear.to_level && wear.from_level.is_none_or(|from| level >= from));
            }
        }
    }
}
