//! Lines fitted to the dynamometer cycles of a machine.

use crate::http::dto::fit::{
    FitAnswer, FitRequest, FittedLineBody, LineFit, MOST_FIT_CYCLES, USUAL_FIT_CYCLES,
};
use crate::http::problem::Problem;
use feedwright_core::cycle::{Channel, Samples};
use feedwright_core::friction::calibration::{DynamometerCycle, LoadLine, Quantity};
use feedwright_core::friction::error::Invalid;
use feedwright_core::ids::MachineId;
use feedwright_core::invalid::Violation;
use feedwright_core::machine::{Calibration, FittedLine};
use feedwright_store::{CycleFilter, Page, Store, StoreResult, StoredCalibration, StoredCycle};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Least share of the variance that a line has to explain: below it the load says little about the quantity.
const LEAST_R_SQUARED: f64 = 0.5;

/// Rows of calibrations that are read at a time while looking for the newest.
const PAGE: u32 = 500;

/// Cycles that are read at a time: some that were not measured, or whose samples are gone, are passed over.
const CYCLES: u32 = 200;

/// Most cycles that are looked at for ones that can be fitted: a machine's whole history is not walked through by one question.
const MOST_CONSIDERED: u32 = 20_000;

/// Most samples that are unpacked for it: that takes far longer than looking at a cycle.
const MOST_UNPACKED: u32 = 1_000;

/// Points of a cycle that enter a fit, beyond which it is thinned: a long cycle must not outweigh the others.
const MOST_POINTS_PER_CYCLE: usize = 2000;

impl FitRequest {
    /// Which cycles, and how many.
    pub(super) fn checked(&self, machine: &MachineId) -> Result<(CycleFilter, u32), Violation> {
        let mut filter = self.filter.to_filter("filter")?;
        if filter.machine.as_ref().is_some_and(|named| named != machine) {
            let text = "names another machine than the path";
            return Err(Violation::new("filter.machine", "other_machine", text));
        }
        filter.machine = Some(machine.clone());
        let most = self.most_cycles.unwrap_or(USUAL_FIT_CYCLES);
        if !(1..=MOST_FIT_CYCLES).contains(&most) {
            let text = format!("must be within 1 to {MOST_FIT_CYCLES}, is {most}");
            return Err(Violation::new("most_cycles", "out_of_range", text));
        }
        Ok((filter, most))
    }
}

/// Columns of dynamometer cycles: load and measured, cycle by cycle.
#[derive(Default)]
pub(super) struct Measured {
    thrust: Vec<(Vec<f64>, Vec<f64>)>,
    torque: Vec<(Vec<f64>, Vec<f64>)>,
    /// Cycles that gave something.
    taken: u32,
    unpacked: u32,
    considered: u32,
    skipped: BTreeMap<&'static str, u32>,
}

impl Measured {
    /// Reads the contact of the oldest `most` cycles that a dynamometer measured.
    pub(super) async fn read(store: &dyn Store, filter: &CycleFilter, most: u32) -> Result<Self, Problem> {
        let mut measured = Self::default();
        let mut after = None;
        while measured.considered < MOST_CONSIDERED {
            let page = store.cycles(filter, Page { after: after.take(), limit: CYCLES }).await?;
            for row in &page {
                if measured.taken == most || measured.unpacked == MOST_UNPACKED {
                    return Ok(measured);
                }
                measured.consider(store, row).await?;
            }
            match page.last() {
                Some(StoredCycle { cycle, .. }) if page.len() == CYCLES as usize => {
                    after = Some((cycle.started_at, cycle.machine.clone(), cycle.id.clone()));
                }
                _ => break,
            }
        }
        Ok(measured)
    }

    async fn consider(&mut self, store: &dyn Store, row: &StoredCycle) -> Result<(), Problem> {
        self.considered += 1;
        let (machine, cycle) = (&row.cycle.machine, &row.cycle.id);
        let reason = if row.samples_are_gone() {
            Some("samples_dropped")
        } else if !row.has_samples {
            Some("no_samples")
        } else {
            self.unpacked += 1;
            let samples = store.cycle_samples(machine, cycle).await;
            match samples.map_err(|error| Problem::of_samples(error, machine, cycle))? {
                // Retention may have come between the two questions.
                None => Some("samples_dropped"),
                Some(samples) => (!self.take(&samples)).then_some("no_dynamometer"),
            }
        };
        match reason {
            Some(reason) => *self.skipped.entry(reason).or_insert(0) += 1,
            None => self.taken += 1,
        }
        Ok(())
    }

    fn take(&mut self, samples: &Samples) -> bool {
        let pairs = [
            (Channel::FeedDriveLoadPercent, Channel::ThrustNewtons, &mut self.thrust),
            (Channel::SpindleLoadPercent, Channel::TorqueNewtonMetres, &mut self.torque),
        ];
        let depth = samples.column(Channel::DepthMm);
        let mut any = false;
        for (load, quantity, into) in pairs {
            let (Some(load), Some(values)) = (samples.column(load), samples.column(quantity)) else {
                continue;
            };
            // Before contact a drive accelerates what no dynamometer feels.
            let inside: Vec<usize> =
                (0..load.len()).filter(|&at| depth.is_none_or(|depth| depth[at] >= 0.0)).collect();
            let every = inside.len().div_ceil(MOST_POINTS_PER_CYCLE).max(1);
            let column = |of: &[f64]| inside.iter().step_by(every).map(|&at| of[at]).collect::<Vec<f64>>();
            into.push((column(load), column(values)));
            any = true;
        }
        any
    }

    /// Fits both lines; one that cannot be fitted is carried over from `before`.
    pub(super) fn fit(self, before: Option<&Calibration>) -> Result<Fitted, Problem> {
        let (thrust, thrust_line) =
            line(Quantity::ThrustNewton, &self.thrust, before.and_then(|calibration| calibration.thrust));
        let (torque, torque_line) = line(
            Quantity::TorqueNewtonMetre,
            &self.torque,
            before.and_then(|calibration| calibration.torque),
        );
        if thrust.line.is_none() && torque.line.is_none() {
            let reason = |fit: LineFit| fit.reason.unwrap_or_default();
            let problem = Problem::from(vec![
                Violation::new("thrust", "not_identifiable", reason(thrust)),
                Violation::new("torque", "not_identifiable", reason(torque)),
            ]);
            return Err(self.told(problem));
        }
        let calibration = Calibration { version: 0, thrust: thrust_line, torque: torque_line };
        let (considered, skipped) = (self.considered, self.skipped);
        let answer = FitAnswer { dry_run: true, calibration: None, thrust, torque, considered, skipped };
        Ok(Fitted { calibration, answer })
    }

    /// A refusal with what was looked at, as the answer has it: what is missing may be what retention dropped.
    fn told(self, mut problem: Problem) -> Problem {
        let mut detail = format!("{}; {} cycles were looked at", problem.detail, self.considered);
        for (reason, count) in &self.skipped {
            let _ = write!(detail, ", {count} skipped: {reason}");
        }
        if self.considered >= MOST_CONSIDERED || self.unpacked >= MOST_UNPACKED {
            detail.push_str("; one question looks at no more of them: name a later filter.from");
        }
        problem.detail = detail.into();
        let skipped: serde_json::Map<_, _> =
            self.skipped.into_iter().map(|(reason, count)| (reason.to_owned(), count.into())).collect();
        problem.member("considered", self.considered).member("skipped", skipped)
    }
}

/// What would be stored, and the answer that says so.
pub(super) struct Fitted {
    pub(super) calibration: Calibration,
    pub(super) answer: FitAnswer,
}

fn line(
    quantity: Quantity,
    columns: &[(Vec<f64>, Vec<f64>)],
    before: Option<FittedLine>,
) -> (LineFit, Option<FittedLine>) {
    let cycles: Vec<DynamometerCycle<'_>> = columns
        .iter()
        .map(|(load, values)| DynamometerCycle { load_percent: load, measured: values })
        .collect();
    let fitted = LoadLine::fit(quantity, &cycles).map_err(|error: Invalid| error.message().to_owned());
    let fitted = fitted.and_then(|line| {
        let explains = line.r_squared >= LEAST_R_SQUARED;
        let text = || format!("R² is {:.2}, at least {LEAST_R_SQUARED} is needed", line.r_squared);
        if explains { Ok(line) } else { Err(text()) }
    });
    let fitted = fitted.and_then(|line| {
        let body = FittedLineBody::from(&line);
        let line = FittedLine::from(&body);
        // Loads that hardly differ make lines that no machine has.
        let mut wrong = Vec::new();
        line.collect("line", &mut wrong);
        wrong.first().map_or(Ok((body, line)), |wrong| Err(format!("{}: {}", wrong.path, wrong.message)))
    });
    match fitted {
        Ok((body, line)) => (LineFit { outcome: "fitted", line: Some(body), reason: None }, Some(line)),
        Err(reason) => {
            let outcome = if before.is_some() { "carried_over" } else { "none" };
            (LineFit { outcome, line: None, reason: Some(reason) }, before)
        }
    }
}

/// The newest fitted lines of a machine; none where they are damaged, as nothing of them is carried over.
pub(super) async fn newest(store: &dyn Store, machine: &MachineId) -> StoreResult<Option<Calibration>> {
    let mut newest: Option<StoredCalibration> = None;
    loop {
        let after = newest.as_ref().map(|fitted| fitted.calibration.version);
        let page = store.calibrations(machine, Page { after, limit: PAGE }).await?;
        match page.into_iter().next_back() {
            Some(fitted) => newest = Some(fitted),
            None => return Ok(newest.filter(|fitted| !fitted.is_damaged).map(|fitted| fitted.calibration)),
        }
    }
}
