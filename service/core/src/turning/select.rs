//! Choice of one interval: the pair, what it leads to and what keeps it from being faster.

use super::domain::Domain;
use super::grid::PairTable;
use super::{Cut, EdgeState, Job, Outcome, Outside, continuous};

/// Utilisation from which a limit counts as reached by a continuous optimum.
const REACHED: f64 = 1.0 - 1e-6;

/// One of the three limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Limit {
    /// Spindle power.
    Power,
    /// Thrust force.
    Force,
    /// Average edge wear.
    Wear,
}

impl Limit {
    /// The word used in the API and in storage.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Power => "power",
            Self::Force => "force",
            Self::Wear => "wear",
        }
    }

    /// The limit of that word.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        [Self::Power, Self::Force, Self::Wear].into_iter().find(|limit| limit.as_str() == text)
    }
}

/// What keeps an interval from a higher removal rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Binding {
    /// The next step up in feed or speed would break this limit.
    Limit(Limit),
    /// The upper end of the speeds and feeds allowed.
    Range,
    /// No limit: a faster pair was possible and is left for the sake of the rest of the life.
    Life,
    /// The pair was given, not chosen.
    Given,
}

impl Binding {
    /// The word used in the API and in storage.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Limit(limit) => limit.as_str(),
            Self::Range => "range",
            Self::Life => "life",
            Self::Given => "given",
        }
    }

    /// The binding of that word.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        match text {
            "range" => Some(Self::Range),
            "life" => Some(Self::Life),
            "given" => Some(Self::Given),
            limit => Limit::parse(limit).map(Self::Limit),
        }
    }
}

/// Predicted value over its limit, 0..1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Utilisation {
    /// Of the power limit.
    pub power: f64,
    /// Of the force limit.
    pub force: f64,
    /// Of the wear limit.
    pub wear: f64,
}

impl Utilisation {
    pub(super) fn of(job: &Job, outcome: &Outcome) -> Self {
        let limits = job.limits();
        Self {
            power: outcome.power_kw / limits.power_kw,
            force: outcome.force_n / limits.force_n,
            wear: outcome.wear_mm / limits.wear_mm,
        }
    }

    fn ranked(self) -> [(Limit, f64); 3] {
        let mut all = [(Limit::Power, self.power), (Limit::Force, self.force), (Limit::Wear, self.wear)];
        all.sort_by(|a, b| b.1.total_cmp(&a.1));
        all
    }

    /// The limit most used.
    #[must_use]
    pub fn highest(self) -> Limit {
        self.ranked()[0].0
    }

    /// The most used of the limits exceeded, or none.
    pub(super) fn exceeded(self) -> Option<Limit> {
        let (limit, share) = self.ranked()[0];
        // Also a share that is no number, from an entry so extreme that its powers overflow, counts as exceeded.
        if share <= 1.0 { None } else { Some(limit) }
    }
}

/// An interval of a plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Chosen {
    /// Start, min since the first cut of the edge.
    pub start_min: f64,
    /// End, min since the first cut of the edge.
    pub end_min: f64,
    /// Speed and feed.
    pub cut: Cut,
    /// Prediction at the end of the interval.
    pub outcome: Outcome,
    /// What keeps it from being faster.
    pub binding: Binding,
    /// How far each limit is used.
    pub utilisation: Utilisation,
    /// Whether the prediction extrapolates the library entry.
    pub outside: Outside,
}

impl Chosen {
    pub(super) fn new(job: &Job, state: EdgeState, cut: Cut, binding: Binding) -> Self {
        let outcome = job.predict(state, cut);
        Self {
            start_min: state.elapsed_min(),
            end_min: state.elapsed_min() + job.interval_min(),
            cut,
            outcome,
            binding,
            utilisation: Utilisation::of(job, &outcome),
            outside: job.outside(cut),
        }
    }

    /// State of the edge after the interval.
    #[must_use]
    pub const fn after(&self) -> EdgeState {
        EdgeState::unchecked(self.end_min, self.outcome.wear_mm)
    }
}

/// Chooses pairs for one job; building it precomputes what no state of the edge changes.
#[derive(Debug, Clone)]
pub struct Selector<'a> {
    job: &'a Job,
    table: Option<PairTable>,
}

impl<'a> Selector<'a> {
    /// Prepares the choice of pairs for `job`.
    #[must_use]
    pub fn new(job: &'a Job) -> Self {
        let table = match job.domain() {
            Domain::Grid { speeds_m_min, feeds_mm_rev } => {
                Some(PairTable::new(job, speeds_m_min, feeds_mm_rev))
            }
            Domain::Continuous { .. } => None,
        };
        Self { job, table }
    }

    pub(super) const fn table(&self) -> Option<&PairTable> {
        self.table.as_ref()
    }

    /// The feasible pair of largest removal rate for the interval that starts at `state`.
    ///
    /// # Errors
    /// The limit that leaves no pair: the end of the edge's life.
    pub fn choose(&self, state: EdgeState) -> Result<Chosen, Limit> {
        let chosen = match (self.job.domain(), &self.table) {
            (Domain::Continuous { speed_m_min, feed_mm_rev }, _) => {
                continuous::best(self.job, state, *speed_m_min, *feed_mm_rev, true, true)
                    .map(|cut| self.with_reached_limit(state, cut))
            }
            (Domain::Grid { .. }, Some(table)) => {
                table.best(self.job, state).map(|pair| self.with_broken_limit(table, state, pair))
            }
            (Domain::Grid { .. }, None) => None,
        };
        chosen.ok_or_else(|| self.exhausted_by(state))
    }

    /// The best pair at each speed of the grid, as the paper's tables list them; empty without a grid.
    #[must_use]
    pub fn per_speed(&self, state: EdgeState) -> Vec<Option<Chosen>> {
        let Some(table) = &self.table else { return Vec::new() };
        (0..table.speeds().len())
            .map(|speed| {
                let pair = table.best_at_speed(self.job, state, speed)?;
                Some(self.with_broken_limit(table, state, pair))
            })
            .collect()
    }

    fn with_reached_limit(&self, state: EdgeState, cut: Cut) -> Chosen {
        let mut chosen = Chosen::new(self.job, state, cut, Binding::Range);
        let (limit, share) = chosen.utilisation.ranked()[0];
        if share >= REACHED {
            chosen.binding = Binding::Limit(limit);
        }
        chosen
    }

    /// Between grid points no limit is met exactly: the binding one is what the next step up would break.
    pub(super) fn with_broken_limit(&self, table: &PairTable, state: EdgeState, pair: usize) -> Chosen {
        let mut chosen = Chosen::new(self.job, state, table.cut(pair), Binding::Range);
        let steps = table
            .steps_up(pair)
            .map(|cut| cut.map(|cut| Utilisation::of(self.job, &self.job.predict(state, cut))));
        let breaks = |limit: Limit| {
            steps.iter().flatten().any(|step| match limit {
                Limit::Power => step.power > 1.0,
                Limit::Force => step.force > 1.0,
                Limit::Wear => step.wear > 1.0,
            })
        };
        if let Some((limit, _)) = chosen.utilisation.ranked().into_iter().find(|(limit, _)| breaks(*limit)) {
            chosen.binding = Binding::Limit(limit);
        }
        chosen
    }

    /// Which limit alone leaves no pair; when none does alone, wear counts before force before power.
    fn exhausted_by(&self, state: EdgeState) -> Limit {
        let feasible = |power: bool, force: bool| match self.job.domain() {
            Domain::Continuous { speed_m_min, feed_mm_rev } => {
                continuous::best(self.job, state, *speed_m_min, *feed_mm_rev, power, force).is_some()
            }
            Domain::Grid { .. } => self.table.as_ref().is_some_and(|table| {
                (0..table.len()).any(|pair| {
                    let used = Utilisation::of(self.job, &self.job.predict(state, table.cut(pair)));
                    used.wear <= 1.0 && (!power || used.power <= 1.0) && (!force || used.force <= 1.0)
                })
            }),
        };
        if !feasible(false, false) {
            Limit::Wear
        } else if !feasible(false, true) {
            Limit::Force
        } else {
            Limit::Power
        }
    }
}
