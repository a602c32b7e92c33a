//! What became of a simulated shift.

use crate::replay::refusals::Refusals;
use anyhow::{Context, ensure};
use feedwright_core::summary::median;
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
    /// Cycles that were drilled at one constant feed because the server asked for a reference.
    pub(super) reference_cycles: u64,
    /// Conditions that the server found changed and an engineer confirmed.
    pub(super) conditions_confirmed: u64,
    /// Wear over the limit's at each change for wear: 1 is +10 % at constant feed.
    #[serde(skip)]
    pub(super) wear_at_change: Vec<f64>,
    /// Cycles that were to be taken and were not.
    #[serde(skip)]
    pub(super) refusals: Refusals,
}

/// Wear over the limit's at the tool changes that the server called: 1 is +10 % at constant feed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct WearAtChange {
    tools: usize,
    lowest: f64,
    pub(super) median: f64,
    highest: f64,
    /// Share of the tools within ±15 %.
    within_15_percent: f64,
}

#[derive(Serialize)]
struct Summary<'a> {
    #[serde(flatten)]
    report: &'a Report,
    /// Wear over the limit's where the server called it.
    wear_at_change: Option<WearAtChange>,
    seconds: f64,
    cycles_per_second: f64,
}

impl Report {
    pub(super) fn count(&mut self, outcome: impl Into<String>) {
        *self.outcomes.entry(outcome.into()).or_insert(0) += 1;
    }

    /// Counts a cycle that was to be taken and was not.
    pub(super) fn refuse(&mut self, outcome: &str, said: &str) {
        self.count(outcome);
        self.refusals.count(said);
    }

    /// Posts that were answered, also of bodies that were broken on purpose.
    pub(super) fn posts(&self) -> u64 {
        self.outcomes.values().sum()
    }

    pub(super) fn plus(mut self, other: Self) -> Self {
        self.machines += other.machines;
        self.cycles += other.cycles;
        self.conditions_confirmed += other.conditions_confirmed;
        self.reference_cycles += other.reference_cycles;
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
        self.refusals = self.refusals.plus(&other.refusals);
        self
    }

    /// What the tool changes that the server called amount to; `None` where it called none.
    pub(super) fn wear_at_change(&self) -> Option<WearAtChange> {
        let wear = &self.wear_at_change;
        let within = wear.iter().filter(|wear| (**wear - 1.0).abs() <= 0.15).count();
        #[expect(clippy::cast_precision_loss, reason = "a count of tools")]
        let within_15_percent = within as f64 / wear.len().max(1) as f64;
        Some(WearAtChange {
            tools: wear.len(),
            lowest: wear.iter().copied().reduce(f64::min)?,
            median: median(wear),
            highest: wear.iter().copied().reduce(f64::max)?,
            within_15_percent,
        })
    }

    /// Whether tools were changed when they were worn: by the median, no farther off than `tolerance`, and none only
    /// because it was overdue.
    ///
    /// # Errors
    /// In a sentence, what is not so.
    pub(super) fn check(&self, tolerance: f64) -> anyhow::Result<()> {
        let overdue = self.tool_changes.get("overdue").copied().unwrap_or(0);
        ensure!(overdue == 0, "{overdue} tools were overdue before anybody called them worn");
        let wear = self.wear_at_change().context("no tool was called worn: drill more cycles")?;
        let off = (wear.median - 1.0).abs();
        ensure!(
            off <= tolerance,
            "tools are changed at {:.2} times the limit's wear by the median",
            wear.median
        );
        Ok(())
    }

    /// The summary that is printed.
    pub(super) fn json(&self, seconds: f64) -> serde_json::Result<String> {
        #[expect(clippy::cast_precision_loss, reason = "a count of cycles")]
        let cycles_per_second = self.cycles as f64 / seconds.max(1e-9);
        let wear_at_change = self.wear_at_change();
        let summary = Summary { report: self, wear_at_change, seconds, cycles_per_second };
        serde_json::to_string_pretty(&summary)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_of_two_changes_lies_between_them() {
        let report = Report { wear_at_change: vec![1.2, 0.9], ..Report::default() };
        let wear = report.wear_at_change().unwrap();
        assert_eq!((wear.lowest, wear.median, wear.highest), (0.9, f64::midpoint(0.9, 1.2), 1.2));
        assert!(report.check(0.06).is_ok() && report.check(0.04).is_err());
        assert_eq!(Report::default().wear_at_change(), None);
    }
}
