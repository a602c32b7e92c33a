//! A cycle that names a feed profile: whether it is the one that may be run, and what it asks of the loop.

use super::control::Program;
use super::reason::{LoopReason, LoopReasons};
use crate::cycle::ProfileVersion;
use crate::feed::choose::{ActiveProfile, holds, matches};
use crate::feed::profile::ProfileHash;
use crate::friction::feed_override::HIGHEST_OVERRIDE_PERCENT;
use crate::friction::program::FeedProgram;
use crate::machine::FeedLimits;
use crate::operation::Operation;
use crate::wear::Verdict;

/// Distance at which two programs are compared, mm.
const COMPARED_EVERY_MM: f64 = 0.1;

/// The active version of a feed profile, as the loop needs it.
#[derive(Debug, Clone, PartialEq)]
pub struct RunProfile {
    /// Hash of its content.
    pub hash: ProfileHash,
    /// Its feed over depth.
    pub program: FeedProgram,
    /// The overrides under which it may run, percent.
    pub range: (f64, f64),
    /// The slowest and the fastest feed that it permits, mm/min.
    pub feeds_mm_min: (f64, f64),
    /// Set load of the feed drive that it was made for, percent.
    pub set_feed_drive_percent: Option<f64>,
    /// Set load of the spindle that it was made for, percent.
    pub set_spindle_percent: Option<f64>,
    /// Why the override may not rise above 100 %: the tool is worn beyond it, or nobody knows.
    pub capped: LoopReasons,
}

/// What a cycle runs that names a feed profile, among the active versions of its operation and its tool's type.
///
/// `told` is the program that the machine says it runs, with its overrides: where both are given they have to agree.
/// `stale` tells whether the tool's data is too old to judge its wear by.
#[must_use]
pub fn named(
    version: &ProfileVersion,
    active: &[ActiveProfile],
    (operation, limits): (&Operation, &FeedLimits),
    (verdict, stale): (&Verdict, bool),
    told: Option<(&FeedProgram, Option<(f64, f64)>)>,
) -> Program {
    let Some(one) = active.iter().find(|one| one.version == *version) else {
        return Program::Refused(LoopReason::ProfileNotActive);
    };
    let profile = &one.profile;
    let Ok(program) = profile.program() else {
        return Program::Refused(LoopReason::ProfileMismatch);
    };
    if matches(one, operation, limits).is_err() {
        return Program::Refused(LoopReason::ProfileMismatch);
    }
    let stated = profile.limits();
    let mut range = (stated.override_min_percent, stated.override_max_percent.min(HIGHEST_OVERRIDE_PERCENT));
    if let Some((told, told_range)) = told {
        if differ(&program, told, profile.end_depth_mm()) {
            return Program::Refused(LoopReason::ProgramMismatch);
        }
        if let Some((low, high)) = told_range {
            range = (range.0.max(low), range.1.min(high));
        }
    }
    let capped = match holds(one, verdict, stale) {
        Ok(()) => LoopReasons::NONE,
        Err(("profile_beyond_wear", _)) => LoopReasons::of(LoopReason::ProfileBeyondWear),
        Err(_) => LoopReasons::of(LoopReason::ProfileWearUnknown),
    };
    Program::Profile(Box::new(RunProfile {
        hash: one.hash,
        program,
        range,
        feeds_mm_min: (stated.feed_min_mm_min, stated.feed_max_mm_min),
        set_feed_drive_percent: stated.feed_drive_load_set_percent,
        set_spindle_percent: stated.spindle_load_set_percent,
        capped,
    }))
}

/// Whether two programs are not the same up to what controls round and step.
fn differ(profile: &FeedProgram, told: &FeedProgram, end_mm: f64) -> bool {
    let depths =
        (0_u32..).map(|step| f64::from(step) * COMPARED_EVERY_MM).take_while(|depth| *depth < end_mm);
    depths
        .chain([end_mm])
        .any(|depth| profile.strays(depth, told.feed_at(depth)) || told.strays(depth, profile.feed_at(depth)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feed::profile::Profile;
    use crate::feed::profile::tests::given;
    use crate::friction::program::Between;
    use crate::units::Process;
    use crate::wear::{Level, ToolState};

    fn active() -> ActiveProfile {
        let version = ProfileVersion { profile: "P1".try_into().unwrap(), version: 3 };
        ActiveProfile { version, hash: ProfileHash::from_bytes([7; 32]), profile: given::profile() }
    }

    fn operation() -> Operation {
        let mut operation = crate::closed_loop::tests::operation(Process::Friction);
        let conditions = given::input().conditions;
        operation.program = conditions.program;
        operation.work_material = conditions.work_material;
        operation.spindle_speed_rpm = conditions.spindle_speed_rpm;
        operation
    }

    fn limits() -> FeedLimits {
        FeedLimits::new(1.0, 3000.0, 20.0, 150.0).unwrap()
    }

    fn worn(level: Option<f64>) -> Verdict {
        let level = level.map(|as_run| Level::as_run(as_run, (as_run, as_run), 5, 5));
        Verdict { state: ToolState::Good, level, life: 1, cycles: 9, ..Verdict::unknown("x", "x") }
    }

    fn ran(
        version: u32,
        operation: &Operation,
        verdict: &Verdict,
        told: Option<(&FeedProgram, Option<(f64, f64)>)>,
    ) -> Program {
        let version = ProfileVersion { profile: "P1".try_into().unwrap(), version };
        named(&version, &[active()], (operation, &limits()), (verdict, false), told)
    }

    fn accepted(program: Program) -> RunProfile {
        match program {
            Program::Profile(profile) => *profile,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn the_active_version_is_run_with_its_own_limits_and_loads() {
        let run = accepted(ran(3, &operation(), &worn(Some(1.02)), None));
        assert_eq!((run.range, run.capped), ((5.0, 200.0), LoopReasons::NONE));
        assert_eq!((run.set_feed_drive_percent, run.set_spindle_percent), (Some(30.0), Some(40.0)));
        assert_eq!(run.program, given::profile().program().unwrap());
        assert_eq!(
            ran(2, &operation(), &worn(Some(1.0)), None),
            Program::Refused(LoopReason::ProfileNotActive)
        );
    }

    #[test]
    fn what_it_was_not_made_for_is_refused() {
        let changes: [fn(&mut Operation); 4] = [
            |operation| operation.program = Some("O9".to_owned()),
            |operation| operation.work_material = None,
            |operation| operation.spindle_speed_rpm = Some(3000.0),
            |operation| operation.depth_mm = Some(25.0),
        ];
        for change in changes {
            let mut other = operation();
            change(&mut other);
            let refused = ran(3, &other, &worn(Some(1.0)), None);
            assert_eq!(refused, Program::Refused(LoopReason::ProfileMismatch), "{other:?}");
        }
    }

    #[test]
    fn beyond_its_wear_the_override_may_only_fall() {
        let beyond = accepted(ran(3, &operation(), &worn(Some(1.08)), None));
        assert_eq!(beyond.capped, LoopReasons::of(LoopReason::ProfileBeyondWear));
        let unknown = accepted(ran(3, &operation(), &worn(None), None));
        assert_eq!(unknown.capped, LoopReasons::of(LoopReason::ProfileWearUnknown));
    }

    #[test]
    fn a_program_told_beside_it_has_to_be_the_same_one() {
        let profile: Profile = given::profile();
        let linear = profile.program().unwrap();
        let with = |told: &FeedProgram, range| ran(3, &operation(), &worn(Some(1.0)), Some((told, range)));
        assert_eq!(accepted(with(&linear, Some((50.0, 120.0)))).range, (50.0, 120.0));
        assert_eq!(
            accepted(with(&linear, Some((1.0, 255.0)))).range,
            (5.0, 200.0),
            "never wider than its own"
        );
        // As a control without a linear feed word runs it: blocks of 0.1 mm at the feed in their middle.
        let blocks = (0..205).map(|at| {
            let depth = f64::from(at) * 0.1;
            (depth, linear.feed_at(depth + 0.05))
        });
        let stepped = FeedProgram::from_pairs(Between::Held, &blocks.collect::<Vec<_>>()).unwrap();
        assert_eq!(accepted(with(&stepped, None)).hash, active().hash);
        for other in [linear.scaled(1.2).unwrap(), linear.scaled(0.8).unwrap()] {
            assert_eq!(with(&other, None), Program::Refused(LoopReason::ProgramMismatch));
        }
        let missing = FeedProgram::from_pairs(Between::Linear, &[(0.0, 105.0), (3.0, 155.0)]).unwrap();
        assert_eq!(with(&missing, None), Program::Refused(LoopReason::ProgramMismatch));
    }
}
