//! What became of a simulated shift.

use serde::Serialize;
use std::collections::BTreeMap;

/// Counts over machines.
#[derive(Debug, Default, Serialize)]
pub(super) struct Report {
    pub(super) machines: u32,
    /// Cycles that were drilled.
    pub(super) cycles: u64,
    /// What the server made of the posts: `stored`, `known`, `quarantined`, or the status.
    pub(super) outcomes: BTreeMap<String, u64>,
    /// Faults that were injected.
    pub(super) faults: BTreeMap<&'static str, u64>,
    /// Tools changed: `worn` and `broken_suspected` because the server said so, `overdue` because it did not.
    pub(super) tool_changes: BTreeMap<&'static str, u64>,
    /// Conditions that the server found changed and an engineer confirmed.
    pub(super) conditions_confirmed: u64,
    /// Wear over the limit's at each change for wear: 1 is +10 % at constant feed.
    #[serde(skip)]
    pub(super) wear_at_change: Vec<f64>,
}

#[derive(Serialize)]
struct Summary<'a> {
    #[serde(flatten)]
    report: &'a Report,
    /// Median of wear over the limit's where the server called it.
    median_wear_at_change: Option<f64>,
    seconds: f64,
    cycles_per_second: f64,
}

impl Report {
    pub(super) fn count(&mut self, outcome: impl Into<String>) {
        *self.outcomes.entry(outcome.into()).or_insert(0) += 1;
    }

    pub(super) fn plus(mut self, other: Self) -> Self {
        self.machines += other.machines;
        self.cycles += other.cycles;
        self.conditions_confirmed += other.conditions_confirmed;
        for (outcome, count) in other.outcomes {
            *self.outcomes.entry(outcome).or_insert(0) += count;
        }
        for (fault, count) in other.faults {
            *self.faults.entry(fault).or_insert(0) += count;
        }
        for (why, count) in other.tool_changes {
            *self.tool_changes.entry(why).or_insert(0) += count;
        }
        self.wear_at_change.extend(other.wear_at_change);
        self
    }

    /// The summary that is printed.
    pub(super) fn json(mut self, seconds: f64) -> serde_json::Result<String> {
        self.wear_at_change.sort_by(f64::total_cmp);
        let median_wear_at_change = self.wear_at_change.get(self.wear_at_change.len() / 2).copied();
        #[expect(clippy::cast_precision_loss, reason = "a count of cycles")]
        let cycles_per_second = self.cycles as f64 / seconds.max(1e-9);
        let summary = Summary { report: &self, median_wear_at_change, seconds, cycles_per_second };
        serde_json::to_string_pretty(&summary)
    }
}
