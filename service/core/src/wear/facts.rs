//! What the fold needs of one cycle.

use crate::cycle::{Cycle, Flag, Flags, ProfileVersion};
use crate::ids::{CycleId, MachineId, OperationId, RecommendationId};
use crate::summary::{CycleSummary, DepthDigest, EnergyBasis, IdlePower, LEAST_TURNING};
use crate::units::{Strategy, Timestamp};

/// The place of a cycle in its tool's history: device time first, then what tells equal times apart.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct OrderKey {
    /// When it began, by the machine's clock.
    pub started_at: Timestamp,
    /// The machine that ran it.
    pub machine: MachineId,
    /// The machine's own count; cycles without come first.
    pub seq: Option<u64>,
    /// Its id.
    pub cycle: CycleId,
}

/// What wear needs to know of one stored cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleFacts {
    /// Its place in the history.
    pub order: OrderKey,
    /// What was machined.
    pub operation: OperationId,
    /// When it came in, by the server's clock.
    pub received_at: Timestamp,
    /// Spindle speed commanded with the cycle, rpm; `None` where it names none.
    pub spindle_speed_rpm: Option<f64>,
    /// Median of the speed that was sampled, rpm.
    pub sampled_speed_rpm: Option<f64>,
    /// How the feed was chosen.
    pub strategy: Option<Strategy>,
    /// Which version of the law ran.
    pub law_version: Option<String>,
    /// Which profile ran.
    pub profile: Option<ProfileVersion>,
    /// Basis and joules of the best energy that is known, and whether idle power was subtracted.
    pub energy: Option<(EnergyBasis, bool, f64)>,
    /// Fingerprint of the ratings and fitted lines that the energy rests on.
    pub energy_scale: i64,
    /// Cycle time, ms.
    pub duration_ms: Option<f64>,
    /// Largest depth, mm.
    pub max_depth_mm: Option<f64>,
    /// Depth of the spindle load's falling edge, mm.
    pub fall_depth_mm: Option<f64>,
    /// Operator's override, mean, %.
    pub operator_override_percent: Option<f64>,
    /// Way, time and energy over depth, of a friction cycle that sampled them.
    pub digest: Option<DepthDigest>,
    /// Whether it followed a recommendation that asked for a reference cycle.
    pub asked_as_reference: bool,
    /// Share of the cycle's time that samples cover, 0 to 1.
    pub coverage: f64,
    /// Quality flags.
    pub flags: Flags,
}

impl CycleFacts {
    /// Takes the facts out of a cycle that came in then, and its summary.
    pub fn of(cycle: &Cycle, summary: &CycleSummary, received_at: Timestamp) -> Self {
        let energy = summary.best_energy().map(|energy| {
            let net = matches!(energy.idle, IdlePower::Subtracted { .. });
            (energy.basis, net, energy.total_joules)
        });
        Self {
            order: OrderKey {
                started_at: cycle.started_at,
                machine: cycle.machine.clone(),
                seq: cycle.seq,
                cycle: cycle.id.clone(),
            },
            operation: cycle.operation.clone(),
            received_at,
            spindle_speed_rpm: cycle.spindle_speed_rpm,
            sampled_speed_rpm: summary.median_spindle_speed_rpm,
            strategy: cycle.strategy,
            law_version: cycle.law_version.clone(),
            profile: cycle.profile.clone(),
            energy,
            energy_scale: summary.energy_scale,
            duration_ms: summary.duration_ms,
            max_depth_mm: summary.max_depth_mm,
            fall_depth_mm: summary.spindle_load_fall_depth_mm,
            operator_override_percent: summary.operator_override_percent,
            digest: summary.digest.clone(),
            asked_as_reference: cycle
                .recommendation
                .as_ref()
                .is_some_and(RecommendationId::asks_for_reference),
            coverage: summary.coverage,
            flags: summary.flags,
        }
    }

    /// What wear compares of it: whether that is the part in contact alone, the joules of it, and how long it took, ms.
    ///
    /// Of friction drilling it is the way from contact to full depth, where depth was sampled: how much of the
    /// approach, of spinning up and of the retreat was recorded says nothing of the tool. Of every other cycle it is
    /// all there is.
    pub fn compared(&self, is_friction: bool) -> Option<(bool, f64, Option<f64>)> {
        let (basis, _, joules) = self.energy?;
        let contact = self.digest.as_ref().filter(|_| is_friction && basis != EnergyBasis::Reported);
        Some(match contact {
            Some(digest) => (true, digest.joules(), Some(digest.duration_ms())),
            None => (false, joules, self.duration_ms),
        })
    }

    /// The speed that it is compared under, rpm: the one that it names; else the sampled one, which also tells an operator's spindle
    /// override; else `asked`, that of its operation.
    ///
    /// A sampled speed of 0 or below, or below [`LEAST_TURNING`] of what is asked for, is none that cut: summaries of before version 7 have
    /// the standstill before the cut in their median.
    pub fn speed_rpm(&self, asked: Option<f64>) -> Option<f64> {
        let least = asked.map_or(0.0, |asked| LEAST_TURNING * asked);
        let sampled = self.sampled_speed_rpm.filter(|rpm| *rpm > 0.0 && *rpm >= least);
        self.spindle_speed_rpm.filter(|rpm| *rpm > 0.0).or(sampled).or(asked)
    }

    /// Whether it is a reference cycle: one feed from end to end.
    ///
    /// The strategy says so; or the machine says so, and no sample contradicts it; or it was asked for as one, and its
    /// samples show that it was run as one: a machine may name the advice that it did not follow. A machine that says
    /// that it is none is believed before the advice, and after the strategy.
    pub fn is_reference(&self) -> bool {
        let shown = self.digest.as_ref().map(DepthDigest::is_constant_feed);
        match self.strategy {
            Some(Strategy::FConst) => true,
            _ if self.flags.contains(Flag::NoReferenceCycle) => false,
            None if self.flags.contains(Flag::ReferenceCycle) => shown.unwrap_or(true),
            _ => self.asked_as_reference && shown == Some(true),
        }
    }

    /// The strategy that its energy is compared under. Friction drilling alone has reference cycles, and of a cycle whose operation
    /// was not registered yet nobody knew what it was.
    pub fn compared_as(&self, is_friction: bool) -> Option<Strategy> {
        if is_friction && self.is_reference() { Some(Strategy::FConst) } else { self.strategy }
    }
}
