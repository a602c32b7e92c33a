//! What is kept of a turning cut, and what an edge's history is read back as.

use super::{library::setup_of, number, optional_float};
use crate::error::StoreResult;
use feedwright_core::cycle::{Cycle, Flag, Flags, ReportedCut};
use feedwright_core::recommend::EdgeCycle;
use feedwright_core::turning::TurningSetup;
use feedwright_core::units::Timestamp;

/// A row of `cycle_cuts`.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct CutRow {
    pub(crate) machine_id: String,
    pub(crate) cycle_id: String,
    pub(crate) cutting_speed_m_min: Option<f64>,
    pub(crate) feed_mm_rev: Option<f64>,
    pub(crate) spindle_power_watts: Option<f64>,
    pub(crate) thrust_newtons: Option<f64>,
    pub(crate) edge_wear_mm: Option<f64>,
}

impl CutRow {
    /// The row of a cycle; none where nothing of a cut was reported.
    pub(crate) fn of(cycle: &Cycle) -> StoreResult<Option<Self>> {
        let cut = &cycle.reported.cut;
        if cut.is_empty() {
            return Ok(None);
        }
        Ok(Some(Self {
            machine_id: cycle.machine.as_str().to_owned(),
            cycle_id: cycle.id.as_str().to_owned(),
            cutting_speed_m_min: optional_float("cutting_speed_m_min", cut.cutting_speed_m_min)?,
            feed_mm_rev: optional_float("feed_mm_rev", cut.feed_mm_rev)?,
            spindle_power_watts: optional_float("spindle_power_watts", cut.spindle_power_watts)?,
            thrust_newtons: optional_float("thrust_newtons", cut.thrust_newtons)?,
            edge_wear_mm: optional_float("edge_wear_mm", cut.edge_wear_mm)?,
        }))
    }
}

/// What was reported of a cut, read back.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct ReportedCutRow {
    cutting_speed_m_min: Option<f64>,
    feed_mm_rev: Option<f64>,
    spindle_power_watts: Option<f64>,
    thrust_newtons: Option<f64>,
    edge_wear_mm: Option<f64>,
}

impl From<ReportedCutRow> for ReportedCut {
    fn from(row: ReportedCutRow) -> Self {
        Self {
            cutting_speed_m_min: row.cutting_speed_m_min,
            feed_mm_rev: row.feed_mm_rev,
            spindle_power_watts: row.spindle_power_watts,
            thrust_newtons: row.thrust_newtons,
            edge_wear_mm: row.edge_wear_mm,
        }
    }
}

/// Depth and diameter that an operation's turning stated from a time on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TurnedAs {
    /// From when on; the first one holds for what came before it as well.
    pub(crate) from: Timestamp,
    pub(crate) depth_mm: f64,
    pub(crate) diameter_mm: Option<f64>,
}

impl TurnedAs {
    pub(crate) const fn of(setup: &TurningSetup, from: Timestamp) -> Self {
        Self { from, depth_mm: setup.depth_mm, diameter_mm: setup.diameter_mm }
    }

    /// Whether both state the same.
    pub(crate) fn is_as(&self, other: &Self) -> bool {
        (self.depth_mm, self.diameter_mm) == (other.depth_mm, other.diameter_mm)
    }
}

/// A setup as it stands now, at the depth and the diameter that held at a time, of what was stated one after the other, or those of now
/// where they are larger: what was declared too small is mended by what is declared now, and an edge is taken for more worn rather than for
/// less. A diameter that nobody had told yet is the one that was told next: it says what was turned all along.
pub(crate) fn as_then(setup: TurningSetup, stated: &[TurnedAs], at: Timestamp) -> TurningSetup {
    let place = stated.iter().rposition(|one| one.from <= at).unwrap_or(0);
    let Some(then) = stated.get(place) else { return setup };
    let diameter_mm = stated[place..].iter().find_map(|one| one.diameter_mm);
    let diameter_mm = match (diameter_mm, setup.diameter_mm) {
        (Some(then), Some(now)) => Some(then.max(now)),
        (then, now) => then.or(now),
    };
    TurningSetup { depth_mm: then.depth_mm.max(setup.depth_mm), diameter_mm, ..setup }
}

/// One cycle of an edge with its operation's setup.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct EdgeCycleRow {
    pub(crate) operation_id: String,
    pub(crate) setup: Option<String>,
    pub(crate) setup_since_us: Option<i64>,
    started_at_us: i64,
    duration_ms: Option<f64>,
    reported_duration_ms: Option<f64>,
    sample_count: i64,
    coverage: f64,
    flags: i64,
    cutting_speed_m_min: Option<f64>,
    spindle_rpm: Option<f64>,
    feed_mm_rev: Option<f64>,
    spindle_power_watts: Option<f64>,
    spindle_joules: Option<f64>,
    force_newtons: Option<f64>,
    edge_wear_mm: Option<f64>,
}

impl EdgeCycleRow {
    /// The cycle, turned as its operation stated when it began.
    pub(crate) fn cycle(&self, stated: &[TurnedAs]) -> StoreResult<EdgeCycle> {
        let setup = setup_of(self.setup.as_deref())?.0;
        let flags = Flags::from_bits(number("flags", self.flags)?);
        Ok(EdgeCycle {
            setup: setup.map(|setup| as_then(setup, stated, Timestamp::from_micros(self.started_at_us))),
            duration_ms: self.duration_ms,
            reported_duration_ms: self.reported_duration_ms,
            sample_count: number("sample_count", self.sample_count)?,
            coverage: self.coverage,
            cut_short: flags.contains(Flag::CutShort),
            speed_m_min: self.cutting_speed_m_min,
            spindle_rpm: self.spindle_rpm.filter(|rpm| *rpm > 0.0),
            feed_mm_rev: self.feed_mm_rev,
            power_watts: self.spindle_power_watts,
            spindle_joules: self.spindle_joules,
            // A dynamometer that hung idle says nothing of the cut.
            force_newtons: self.force_newtons.filter(|force| *force > 0.0),
            wear_mm: self.edge_wear_mm,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use feedwright_core::turning::{Accumulation, JobInput};

    #[test]
    fn a_cycle_is_turned_as_was_stated_when_it_began() {
        let JobInput { interval_min, limits, domain, .. } = JobInput::alaskari_oraby_2017();
        let now = TurningSetup {
            model: "m".try_into().unwrap(),
            depth_mm: 1.0,
            diameter_mm: Some(40.0),
            interval_min,
            limits,
            domain,
            accumulation: Accumulation::State,
            caution_sigmas: 0.0,
        };
        let from = Timestamp::from_micros;
        let stated = [
            TurnedAs { from: from(-100), depth_mm: 2.5, diameter_mm: None },
            TurnedAs { from: from(100), depth_mm: 2.0, diameter_mm: Some(80.0) },
            TurnedAs::of(&now, from(200)),
        ];
        let then = |at: i64| {
            let setup = as_then(now.clone(), &stated, from(at));
            assert_eq!(TurningSetup { depth_mm: 1.0, diameter_mm: Some(40.0), ..setup.clone() }, now);
            (setup.depth_mm, setup.diameter_mm)
        };
        assert_eq!(then(-1000), (2.5, Some(80.0)), "the first holds for what came before");
        assert_eq!(then(99), (2.5, Some(80.0)));
        assert_eq!(then(100), (2.0, Some(80.0)));
        assert_eq!(then(200), (1.0, Some(40.0)));
        assert_eq!(as_then(now.clone(), &[], from(0)), now);
        // Declared too small, and mended.
        let deeper = TurningSetup { depth_mm: 2.2, diameter_mm: Some(90.0), ..now };
        let setup = as_then(deeper, &stated, from(100));
        assert_eq!((setup.depth_mm, setup.diameter_mm), (2.2, Some(90.0)));
    }
}
