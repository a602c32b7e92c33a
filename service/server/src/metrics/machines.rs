//! Metrics that carry a machine's label: only registered machines, and at most `limits.metric_machines` of them. What somebody
//! has to be told of the others is told of all of them together.

use super::registrar::Registrar;
use super::{CycleOutcome, seconds};
use feedwright_core::ids::{MachineId, ToolId};
use feedwright_core::recommend::{NEUTRAL_OVERRIDE_PERCENT, Recommendation};
use feedwright_core::units::Timestamp;
use feedwright_core::wear::Verdict;
use feedwright_store::{AlarmKind, FleetRow, Round};
use prometheus::{Gauge, GaugeVec, IntCounter, IntCounterVec, IntGauge, IntGaugeVec};
use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Reasons of a recommendation that leaves the feed as it is, the one that someone can do something about first; what
/// is none of these is "other".
const NEUTRAL_REASONS: [&str; 9] = [
    "registered_data_damaged",
    "data_stale",
    "tool_unregistered",
    "operation_unregistered",
    "profile_wear_unknown",
    "profile_outside_machine",
    "profile_other_material",
    "no_programmed_feed",
    "no_profile",
];
/// Reasons that name what to run: the feed profile, the pair of speed and feed, the plunge feed. With one of them a recommendation is not
/// neutral although its override is.
const ADVISED: [&str; 3] = ["profile_active", "turning_advised", "plunge_advised"];

/// What is remembered of a machine that has a label. What each of its cycles changes is kept at hand: to look a series up
/// by its labels takes longer than to count.
struct Known {
    /// Since when its recommendations leave the feed as it is.
    neutral_since: Option<Timestamp>,
    /// Why the last of them does, as it is shown, and until when that is good: another replica may have made a better one, or nobody
    /// asks any more.
    neutral_shown: Option<(&'static str, Timestamp)>,
    /// Its cycles, by [`CycleOutcome`].
    cycles: [IntCounter; CycleOutcome::ALL.len()],
    /// Tool and beginning of the newest of them: that tool's wear is shown.
    newest: Option<(ToolId, Timestamp)>,
    /// Life and cycles of the verdict that is shown.
    judged: (u32, u64),
    wear_level: Option<Gauge>,
    remaining_cycles: Option<Gauge>,
}

pub(super) struct MachineMetrics {
    known: Mutex<HashMap<MachineId, Known>>,
    most: usize,
    cycles: IntCounterVec,
    wear_level: GaugeVec,
    remaining_cycles: GaugeVec,
    last_cycle: GaugeVec,
    silence_limit: GaugeVec,
    silent: IntGaugeVec,
    alarms_open: IntGaugeVec,
    neutral_since: GaugeVec,
    /// Of what has no label of its own.
    others_silent: IntGauge,
    others_alarms_open: IntGaugeVec,
}

impl MachineMetrics {
    pub(super) fn new(new: &Registrar, most: usize) -> Result<Self, prometheus::Error> {
        let machine = &["machine"];
        Ok(Self {
            known: Mutex::default(),
            most,
            cycles: new.counters(
                "feedwright_machine_cycles_total",
                "Cycles taken in of a machine, by outcome",
                &["machine", "outcome"],
            )?,
            wear_level: new.gauges(
                "feedwright_tool_wear_level_ratio",
                "Energy of the tool that ran last on the machine over its energy when new; worn at 1.10",
                machine,
            )?,
            remaining_cycles: new.gauges(
                "feedwright_tool_remaining_cycles",
                "Cycles that the tool that ran last on the machine is expected to last; absent where unknown",
                machine,
            )?,
            last_cycle: new.gauges(
                "feedwright_machine_last_cycle_timestamp_seconds",
                "When a cycle of the machine last arrived, by the clock that all servers go by",
                machine,
            )?,
            silence_limit: new.gauges(
                "feedwright_machine_silence_limit_seconds",
                "After so long without a cycle the machine is silent; absent where it never is",
                machine,
            )?,
            silent: new.int_gauges(
                "feedwright_machine_silent",
                "1 where the machine posted before and has been silent for longer than its limit",
                machine,
            )?,
            alarms_open: new.int_gauges(
                "feedwright_machine_alarms_open",
                "Open alarms that concern the machine, or a tool that last ran on it",
                &["machine", "kind"],
            )?,
            neutral_since: new.gauges(
                "feedwright_machine_recommendation_neutral_since_timestamp_seconds",
                "Since when every recommendation that this process made for the machine leaves the feed as it is; \
                 absent where the last one is not valid any more",
                &["machine", "reason"],
            )?,
            others_silent: new.int_gauge(
                "feedwright_other_machines_silent",
                "Machines beyond limits.metric_machines that are silent",
            )?,
            others_alarms_open: new.int_gauges(
                "feedwright_other_machines_alarms_open",
                "Open alarms that concern none of the machines with series of their own",
                &["kind"],
            )?,
        })
    }

    /// What is known of a machine, where it has a label or there is room for one more.
    fn labelled<T>(&self, machine: &MachineId, run: impl FnOnce(&mut Known) -> T) -> Option<T> {
        let mut known: MutexGuard<'_, HashMap<MachineId, Known>> =
            self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if !known.contains_key(machine) {
            if known.len() >= self.most {
                return None;
            }
            let cycles = CycleOutcome::ALL
                .map(|outcome| self.cycles.with_label_values(&[machine.as_str(), outcome.as_str()]));
            let new = Known {
                neutral_since: None,
                neutral_shown: None,
                cycles,
                newest: None,
                judged: (0, 0),
                wear_level: None,
                remaining_cycles: None,
            };
            known.insert(machine.clone(), new);
        }
        known.get_mut(machine).map(run)
    }

    pub(super) fn cycle(&self, machine: &MachineId, outcome: CycleOutcome) {
        self.labelled(machine, |known| known.cycles[outcome as usize].inc());
    }

    pub(super) fn verdict(&self, machine: &MachineId, cycle: (&ToolId, Timestamp), verdict: &Verdict) {
        let (tool, started_at) = cycle;
        self.labelled(machine, |known| {
            if let Some((ran, newest)) = &known.newest {
                // A cycle that comes late may be of another tool than the one that ran last; and two that were counted one after the other
                // may be told of in any order.
                let is_behind = ran != tool || (verdict.life, verdict.cycles) < known.judged;
                if started_at <= *newest && is_behind {
                    return;
                }
            }
            self.judged(machine, known, cycle, verdict);
        });
    }

    fn judged(
        &self,
        machine: &MachineId,
        known: &mut Known,
        (tool, started_at): (&ToolId, Timestamp),
        verdict: &Verdict,
    ) {
        if known.newest.as_ref().is_none_or(|(_, newest)| started_at >= *newest) {
            known.newest = Some((tool.clone(), started_at));
        }
        known.judged = (verdict.life, verdict.cycles);
        // A tool that is being learnt has no level: that of the one before it must not stay.
        let level = verdict.level.map(|level| level.value);
        set_kept(&self.wear_level, &mut known.wear_level, machine, level);
        #[expect(clippy::cast_precision_loss, reason = "a count of cycles")]
        let remaining = verdict.remaining.map(|left| left.cycles as f64);
        set_kept(&self.remaining_cycles, &mut known.remaining_cycles, machine, remaining);
    }

    /// What the database says of the wear of some machines: after a restart, where another replica takes their cycles,
    /// and where somebody changed a tool, no cycle tells it here.
    pub(super) fn fleet(&self, rows: &[FleetRow]) {
        for row in rows {
            if let (Some(newest), Some(verdict)) = (row.recent.first(), &row.verdict) {
                let machine = &row.machine.value.id;
                self.labelled(machine, |known| {
                    let started_at = newest.facts.order.started_at;
                    // A cycle that came while the rows were read told more.
                    if known.newest.as_ref().is_none_or(|(_, shown)| started_at >= *shown) {
                        self.judged(machine, known, (&newest.tool, started_at), verdict);
                    }
                });
            }
        }
    }

    pub(super) fn recommendation(&self, recommendation: &Recommendation) {
        let is_neutral = recommendation.override_percent == NEUTRAL_OVERRIDE_PERCENT
            && !ADVISED.iter().any(|code| has(recommendation, code));
        let machine = &recommendation.machine;
        self.labelled(machine, |known| {
            let before = known.neutral_shown.map(|(reason, _)| reason);
            let now = is_neutral.then(|| reason(recommendation));
            known.neutral_since = now.map(|_| known.neutral_since.unwrap_or(recommendation.issued_at));
            known.neutral_shown = now.map(|reason| (reason, recommendation.valid_until));
            if before == now {
                return;
            }
            if let Some(before) = before {
                self.no_longer_neutral(machine, before);
            }
            if let Some((since, reason)) = known.neutral_since.zip(now) {
                self.neutral_since.with_label_values(&[machine.as_str(), reason]).set(seconds(since));
            }
        });
    }

    fn no_longer_neutral(&self, machine: &MachineId, reason: &str) {
        // It is there: it was set when it became known.
        let _ = self.neutral_since.remove_label_values(&[machine.as_str(), reason]);
    }

    /// Shows of no machine any more that its recommendations are neutral where the last one has run out. Since when they are stays
    /// known: one that is asked now and then is neutral all the time.
    pub(super) fn run_out(&self, now: Timestamp) {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        for (machine, known) in known.iter_mut() {
            if let Some((reason, _)) = known.neutral_shown.take_if(|(_, until)| *until < now) {
                self.no_longer_neutral(machine, reason);
            }
        }
    }

    pub(super) fn round(&self, found: &Round) {
        let mut others_silent = 0;
        for contact in &found.machines {
            let machine = &contact.machine;
            let labelled = self.labelled(machine, |_| {
                set(&self.last_cycle, machine, contact.last_cycle_at.map(seconds));
                #[expect(clippy::cast_precision_loss, reason = "a limit of at most a year")]
                set(&self.silence_limit, machine, contact.silent_after_ms.map(|ms| ms as f64 / 1e3));
                self.silent.with_label_values(&[machine.as_str()]).set(i64::from(contact.is_silent));
            });
            if labelled.is_none() {
                others_silent += i64::from(contact.is_silent);
                continue;
            }
            let of_machine = || found.alarms.iter().filter(|alarms| alarms.machine.as_ref() == Some(machine));
            for kind in AlarmKind::ALL {
                let open = of_machine().find(|alarms| alarms.kind == kind).map_or(0, |alarms| alarms.open);
                let gauge = self.alarms_open.with_label_values(&[machine.as_str(), kind.as_str()]);
                gauge.set(super::whole(open));
            }
        }
        self.others_silent.set(others_silent);
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        for kind in AlarmKind::ALL {
            let of_others = found.alarms.iter().filter(|alarms| {
                alarms.kind == kind
                    && alarms.machine.as_ref().is_none_or(|machine| !known.contains_key(machine))
            });
            let open = super::whole(of_others.map(|alarms| alarms.open).sum());
            self.others_alarms_open.with_label_values(&[kind.as_str()]).set(open);
        }
    }
}

/// As [`set`], of a gauge that is kept at hand while it is shown.
fn set_kept(gauges: &GaugeVec, kept: &mut Option<Gauge>, machine: &MachineId, value: Option<f64>) {
    match value {
        Some(value) => kept.get_or_insert_with(|| gauges.with_label_values(&[machine.as_str()])).set(value),
        None if kept.take().is_some() => drop(gauges.remove_label_values(&[machine.as_str()])),
        None => {}
    }
}

/// Sets a gauge, or takes it away where there is nothing to say.
fn set(gauges: &GaugeVec, machine: &MachineId, value: Option<f64>) {
    match value {
        Some(value) => gauges.with_label_values(&[machine.as_str()]).set(value),
        // Nothing is to be removed where it was never set.
        None => drop(gauges.remove_label_values(&[machine.as_str()])),
    }
}

fn has(recommendation: &Recommendation, code: &str) -> bool {
    recommendation.reasons.iter().any(|(reason, _)| reason == code)
}

fn reason(recommendation: &Recommendation) -> &'static str {
    NEUTRAL_REASONS.into_iter().find(|code| has(recommendation, code)).unwrap_or("other")
}
