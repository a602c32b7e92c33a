//! Simulation of the dimensionless process (Gouskov et al. 2015, Eq. 6–13).
//!
//! q'' = w²·(Pc + q0 − q) − 2ζw·q', w = 2πp; η = max(0, Λ(τ−1) + 1 − q); Pc = kc·η^r; Λ(τ) = Λ(τ−1) + 1 − η.
//! Runge–Kutta of order 4 with cubic interpolation of the surface left by the last edge; several processes are
//! stepped side by side, since one alone waits for its own square roots most of the time.

use crate::field_error::{FieldError, Problem, within};

/// Most steps of one simulation: about twenty seconds.
const MAX_STEPS: u64 = 200_000_000;

/// Periods after which the controller corrects its gain (Gouskov et al. 2015, section 4.2).
const WINDOW_PERIODS: u32 = 2;

/// The first 1/5 of a run counts as transient where the spread of ψ_w is taken.
const SETTLING: u32 = 5;

/// Settings of the continuity control (Eq. 12 and 13).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContinuityControl {
    /// Adaptation parameter c.
    pub adaptation: f64,
    /// Target ψ0 of the cutting continuity.
    pub target: f64,
    /// Greatest actuator displacement, in feeds per edge.
    pub actuator_limit: f64,
}

impl ContinuityControl {
    /// Settings of the paper: c = 0.002, ψ0 = 0.9, |q0| ≤ 0.1.
    pub const GOUSKOV_2015: Self = Self { adaptation: 0.002, target: 0.9, actuator_limit: 0.1 };
}

/// Unchecked process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProcessInput {
    /// p: eigenfrequency over edge-passing frequency, f0·60/(z·rpm).
    pub frequency_ratio: f64,
    /// kc: cutting force at one feed per edge over spring force at one feed per edge.
    pub cutting_coefficient: f64,
    /// ζ, share of critical damping.
    pub damping: f64,
    /// r, exponent of the cutting law.
    pub exponent: f64,
    /// Control, or none for the free process.
    pub control: Option<ContinuityControl>,
    /// Steps per period of edge passing, 1/Δτ.
    pub steps_per_period: u32,
    /// Periods simulated.
    pub periods: u32,
    /// Periods at the end that the steady values are taken from.
    pub steady_periods: u32,
}

impl ProcessInput {
    /// The paper's settings at a point: ζ = 0.01, r = 0.75, Δτ = 0.01, 500 periods, steady values of the last 100.
    #[must_use]
    pub const fn gouskov_2015(
        frequency_ratio: f64,
        cutting_coefficient: f64,
        control: Option<ContinuityControl>,
    ) -> Self {
        Self {
            frequency_ratio,
            cutting_coefficient,
            damping: 0.01,
            exponent: 0.75,
            control,
            steps_per_period: 100,
            periods: 500,
            steady_periods: 100,
        }
    }
}

/// Checked process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Process(ProcessInput);

impl Process {
    /// Checks a process.
    ///
    /// # Errors
    /// The first field that is not finite or out of range; steps too coarse for the eigenfrequency are
    /// `inconsistent`, a run of more than 2·10⁸ steps is `too_many`.
    pub fn new(input: ProcessInput) -> Result<Self, FieldError> {
        within("frequency_ratio", input.frequency_ratio, 0.01, 100.0)?;
        within("cutting_coefficient", input.cutting_coefficient, 0.0, 100.0)?;
        within("damping", input.damping, 0.0, 1.0)?;
        within("exponent", input.exponent, 0.1, 2.0)?;
        if let Some(control) = input.control {
            within("control.adaptation", control.adaptation, 0.0, 1.0)?;
            within("control.target", control.target, 0.0, 1.0)?;
            within("control.actuator_limit", control.actuator_limit, 0.0, 100.0)?;
        }
        within("steps_per_period", f64::from(input.steps_per_period), 8.0, 10_000.0)?;
        within("periods", f64::from(input.periods), 2.0, 1e6)?;
        within("steady_periods", f64::from(input.steady_periods), 2.0, f64::from(input.periods))?;
        let steps = u64::from(input.steps_per_period) * u64::from(input.periods);
        if steps > MAX_STEPS {
            let count = usize::try_from(steps).unwrap_or(usize::MAX);
            return Err(FieldError::new("periods", Problem::TooMany { count, max: 200_000_000 }));
        }
        let coarse = std::f64::consts::TAU * input.frequency_ratio > 0.5 * f64::from(input.steps_per_period);
        if coarse {
            let why = "is too coarse: an eigenperiod needs at least 12 steps";
            return Err(FieldError::new("steps_per_period", Problem::Inconsistent(why)));
        }
        Ok(Self(input))
    }

    /// The data of the process.
    #[must_use]
    pub const fn data(&self) -> &ProcessInput {
        &self.0
    }

    /// The same settings at another point.
    pub(crate) fn at(&self, frequency_ratio: f64, cutting_coefficient: f64) -> Result<Self, FieldError> {
        Self::new(ProcessInput { frequency_ratio, cutting_coefficient, ..self.0 })
    }

    fn same_course(&self, other: &Self) -> bool {
        let (a, b) = (&self.0, &other.0);
        a.steps_per_period == b.steps_per_period
            && a.periods == b.periods
            && a.steady_periods == b.steady_periods
            && a.exponent.to_bits() == b.exponent.to_bits()
    }
}

/// Largest displacement that the model can mean, feeds per edge: with a micrometre per edge it is a metre.
///
/// A chip thickness of so many feeds is none that a cutting law was fitted in either. Runs that get there grow without
/// end, be it that the law feeds in more than damping takes out, or that the steps are too coarse for the stiffness of
/// the cut: what is computed from there on says nothing.
const MOST_DISPLACEMENT: f64 = 1e6;

/// A run whose displacement left everything that the model can mean; it has no steady values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Diverged;

impl std::fmt::Display for Diverged {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("the displacement grows beyond everything that the model can mean")
    }
}

impl std::error::Error for Diverged {}

/// What a simulation comes to.
pub type Simulated = Result<Steady, Diverged>;

/// Share of the feed by which the mean chip may be off for roundings and for what dies away.
const REMOVED_TOLERANCE: f64 = 0.01;

/// Steady values of a process; every one is finite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Steady {
    /// ψ, share of time in cut, 0..1 (Eq. 11).
    pub continuity: f64,
    /// A, peak-to-peak displacement, feeds per edge.
    pub amplitude: f64,
    /// Pmax, largest cutting force, spring force per feed.
    pub peak_force: f64,
    /// Standard deviation of ψ over windows of two periods, first fifth of the run left out: large when the control
    /// makes bursts, which may lie further apart than the steady periods are long.
    pub window_sd: f64,
    /// Largest peak-to-peak displacement of the whole run, feeds per edge.
    pub largest_amplitude: f64,
    /// Feedback gain b at the end; zero without control.
    pub gain: f64,
    /// Mean chip thickness over the steady periods, feeds per edge: 1 where the drill removes what it advances by.
    pub removed: f64,
    /// Whether the drill removes what it advances by, so that the steady values are those of a cut.
    ///
    /// Λ(τ) = Λ(τ − 1) + 1 − η (Gouskov et al. 2015, Eq. 6–10) summed over N periods: the mean of η is 1 less the rise of
    /// the mean surface over N. The surface that a vibration leaves lies within its own displacement, so it rises by A
    /// at the most, and |mean η − 1| ≤ A/N. Where it is off by more, the tool still moves in the air above what an
    /// earlier, larger motion has dug, or digs itself into what one has left. So no steady cut is refused; where A is
    /// as large as N, the periods are too few to tell more than whether anything is cut.
    pub cuts: bool,
}

/// Standard deviation of ψ_w from which a controlled process bursts rather than settles.
///
/// Settled points of the paper's map lie at 0.04 to 0.10, bursting ones at 0.18 and more.
pub(crate) const BURST_SD: f64 = 0.14;

impl Steady {
    /// Whether chips are segmented: the edges cut, and leave the work in between.
    #[must_use]
    pub fn segmented(&self) -> bool {
        self.cuts && self.continuity < 1.0
    }

    /// Whether the control alternates between growing and dying vibration, so that mean values mislead.
    #[must_use]
    pub fn bursting(&self) -> bool {
        self.window_sd > BURST_SD
    }
}

/// One step of a recorded run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TracePoint {
    /// τ, periods of edge passing.
    pub time: f64,
    /// q, feeds per edge; positive is retraction.
    pub displacement: f64,
    /// Pc, spring force per feed.
    pub force: f64,
    /// Actuator displacement q0, feeds per edge.
    pub actuator: f64,
    /// Feedback gain b.
    pub gain: f64,
}

/// Simulates one process.
///
/// # Errors
/// [`Diverged`] where the displacement grows beyond 10⁶ feeds per edge.
pub fn simulate(process: &Process) -> Simulated {
    lanes([*process], |_, _| {})[0]
}

/// Simulates many processes, side by side where they share exponent, steps and periods; each as [`simulate`] does.
#[must_use]
pub fn simulate_many(processes: &[Process]) -> Vec<Simulated> {
    let mut done = Vec::with_capacity(processes.len());
    let mut groups = processes.chunks_exact(LANES);
    for group in &mut groups {
        match <[Process; LANES]>::try_from(group) {
            Ok(group) if group.iter().all(|p| p.same_course(&group[0])) => {
                done.extend(lanes(group, |_, _| {}));
            }
            _ => {
                done.extend(group.iter().map(simulate));
            }
        }
    }
    done.extend(groups.remainder().iter().map(simulate));
    done
}

/// Steady values of a run, or that it diverged, and its course up to there.
pub type Traced = (Simulated, Vec<TracePoint>);

/// Simulates one process and keeps every `every`-th step, up to where it diverges.
///
/// # Errors
/// `every` of zero, or so small that more than a million points would be kept.
pub fn trace(process: &Process, every: u32) -> Result<Traced, FieldError> {
    let steps = u64::from(process.0.steps_per_period) * u64::from(process.0.periods);
    if every == 0 {
        return Err(FieldError::new("every", Problem::OutOfRange { value: 0.0, min: 1.0, max: 1e9 }));
    }
    let count = usize::try_from(steps / u64::from(every)).unwrap_or(usize::MAX);
    crate::field_error::count("every", count, 1, 1_000_000)?;
    let mut points = Vec::with_capacity(count);
    let mut until = every;
    let mut is_meant = true;
    let steady = lanes([*process], |_, point| {
        until -= 1;
        if until > 0 {
            return;
        }
        until = every;
        let point = point();
        is_meant = is_meant && within_bound(point.displacement);
        if is_meant {
            points.push(point);
        }
    })[0];
    Ok((steady, points))
}

/// Processes stepped side by side: enough to keep the square-root unit busy without running out of registers.
pub(crate) const LANES: usize = 4;

fn lanes<const L: usize>(
    processes: [Process; L],
    observe: impl FnMut(usize, &mut dyn FnMut() -> TracePoint),
) -> [Simulated; L] {
    // The paper's exponent costs two square roots instead of a general power.
    let exponent = processes[0].0.exponent;
    if (exponent - 0.75).abs() < f64::EPSILON {
        run(processes, |eta| each(|l| (eta[l] * eta[l].sqrt()).sqrt()), observe)
    } else if (exponent - 1.0).abs() < f64::EPSILON {
        run(processes, |eta| *eta, observe)
    } else {
        run(processes, move |eta| each(|l| eta[l].powf(exponent)), observe)
    }
}

/// The same for every lane; spelt out per operation so that lanes share vector instructions.
#[inline(always)]
fn each<const L: usize>(value: impl FnMut(usize) -> f64) -> [f64; L] {
    std::array::from_fn(value)
}

/// Whether a displacement is one that the model can mean; NaN is none.
fn within_bound(displacement: f64) -> bool {
    displacement.abs() <= MOST_DISPLACEMENT
}

/// max(0, x) as the processor has it: `f64::max` also looks for NaN, which only a run that diverged makes.
#[inline(always)]
fn positive(x: f64) -> f64 {
    if x > 0.0 { x } else { 0.0 }
}

struct Lane<const L: usize> {
    q: [f64; L],
    v: [f64; L],
    b: [f64; L],
    /// Steps in cut of the running period.
    in_cut: [f64; L],
    /// Steps in cut of the running window.
    in_window: [f64; L],
    low: [f64; L],
    high: [f64; L],
}

#[derive(Clone, Copy)]
struct Extremes {
    low: f64,
    high: f64,
}

impl Extremes {
    const NONE: Self = Self { low: f64::INFINITY, high: f64::NEG_INFINITY };

    fn take(&mut self, low: f64, high: f64) {
        self.low = self.low.min(low);
        self.high = self.high.max(high);
    }
}

struct Gathered {
    whole: Extremes,
    steady: Extremes,
    in_cut: f64,
    peak_force: f64,
    windows: u32,
    /// Sum of the surface where the steady periods begin.
    surface: f64,
    has_diverged: bool,
    sum: f64,
    squares: f64,
}

fn run<const L: usize>(
    processes: [Process; L],
    power: impl Fn(&[f64; L]) -> [f64; L],
    mut observe: impl FnMut(usize, &mut dyn FnMut() -> TracePoint),
) -> [Simulated; L] {
    let course = &processes[0].0;
    let n = course.steps_per_period as usize;
    let dt = 1.0 / f64::from(course.steps_per_period);
    let w: [f64; L] = processes.map(|p| std::f64::consts::TAU * p.0.frequency_ratio);
    let spring = w.map(|w| w * w);
    let drag: [f64; L] = std::array::from_fn(|l| 2.0 * processes[l].0.damping * w[l]);
    let kc: [f64; L] = processes.map(|p| p.0.cutting_coefficient);
    let limit: [f64; L] = processes.map(|p| p.0.control.map_or(0.0, |control| control.actuator_limit));

    let push = |gap: &[f64; L], q: &[f64; L], v: &[f64; L], b: &[f64; L]| -> [f64; L] {
        let eta: [f64; L] = each(|l| positive(gap[l] - q[l]));
        let cut = power(&eta);
        let wanted: [f64; L] = each(|l| b[l] * v[l]);
        let capped: [f64; L] = each(|l| if wanted[l] < limit[l] { wanted[l] } else { limit[l] });
        let actuator: [f64; L] = each(|l| if capped[l] > -limit[l] { capped[l] } else { -limit[l] });
        each(|l| spring[l] * (kc[l] * cut[l] + actuator[l] - q[l]) - drag[l] * v[l])
    };
    // surface[i + 1] is Λ at step i of the period before; index −1 and n + 1 serve the interpolation.
    let mut surface = vec![[0.0; L]; n + 3];
    for (i, value) in (0_u32..).zip(&mut surface) {
        *value = [(f64::from(i) - 1.0) * dt - 1.0; L];
    }
    let mut next = surface.clone();
    next[1] = [0.0; L];
    let mut lane = Lane {
        q: [0.0; L],
        v: [0.0; L],
        b: [0.0; L],
        in_cut: [0.0; L],
        in_window: [0.0; L],
        low: [f64::INFINITY; L],
        high: [f64::NEG_INFINITY; L],
    };
    let mut gathered: [Gathered; L] = std::array::from_fn(|_| Gathered {
        whole: Extremes::NONE,
        steady: Extremes::NONE,
        in_cut: 0.0,
        peak_force: 0.0,
        windows: 0,
        surface: 0.0,
        has_diverged: false,
        sum: 0.0,
        squares: 0.0,
    });
    let mut peak_eta = [0.0_f64; L];
    let mut step = 0_usize;
    for period in 0..course.periods {
        let steady = period >= course.periods - course.steady_periods;
        if period == course.periods - course.steady_periods {
            let sums = summed(&surface[2..n + 2]);
            for (gathered, sum) in gathered.iter_mut().zip(sums) {
                gathered.surface = sum;
            }
        }
        for j in 0..n {
            let ahead: [[f64; L]; 4] = [surface[j], surface[j + 1], surface[j + 2], surface[j + 3]];
            let half: [f64; L] =
                each(|l| 0.5625 * (ahead[1][l] + ahead[2][l]) - 0.0625 * (ahead[0][l] + ahead[3][l]));
            let (start, end): ([f64; L], [f64; L]) =
                (each(|l| ahead[1][l] + 1.0), each(|l| ahead[2][l] + 1.0));
            let middle: [f64; L] = each(|l| half[l] + 1.0);
            let (q, v) = (lane.q, lane.v);
            let a1 = push(&start, &q, &v, &lane.b);
            let (q2, v2) = (each(|l| q[l] + 0.5 * dt * v[l]), each(|l| v[l] + 0.5 * dt * a1[l]));
            let a2 = push(&middle, &q2, &v2, &lane.b);
            let (q3, v3) = (each(|l| q[l] + 0.5 * dt * v2[l]), each(|l| v[l] + 0.5 * dt * a2[l]));
            let a3 = push(&middle, &q3, &v3, &lane.b);
            let (q4, v4) = (each(|l| q[l] + dt * v3[l]), each(|l| v[l] + dt * a3[l]));
            let a4 = push(&end, &q4, &v4, &lane.b);
            let q = each(|l| q[l] + dt / 6.0 * (v[l] + 2.0 * (v2[l] + v3[l]) + v4[l]));
            lane.q = q;
            lane.v = each(|l| v[l] + dt / 6.0 * (a1[l] + 2.0 * (a2[l] + a3[l]) + a4[l]));
            let eta: [f64; L] = each(|l| positive(end[l] - q[l]));
            next[j + 2] = each(|l| end[l] - eta[l]);
            // Counted in doubles, which step together with the rest.
            lane.in_cut = each(|l| lane.in_cut[l] + if eta[l] > 0.0 { 1.0 } else { 0.0 });
            lane.low = each(|l| if q[l] < lane.low[l] { q[l] } else { lane.low[l] });
            lane.high = each(|l| if q[l] > lane.high[l] { q[l] } else { lane.high[l] });
            peak_eta = each(|l| if eta[l] > peak_eta[l] { eta[l] } else { peak_eta[l] });
            if j == 0 {
                // The first step of this period is the one past the end of the last: the interpolation looks at it.
                surface[n + 2] = next[2];
            }
            step += 1;
            observe(step, &mut || {
                #[expect(clippy::cast_precision_loss, reason = "at most 2·10⁸ steps")]
                let time = step as f64 * dt;
                let eta = (surface[j + 2][0] + 1.0 - lane.q[0]).max(0.0);
                let actuator = (lane.b[0] * lane.v[0]).clamp(-limit[0], limit[0]);
                TracePoint {
                    time,
                    displacement: lane.q[0],
                    force: kc[0] * power(&[eta; L])[0],
                    actuator,
                    gain: lane.b[0],
                }
            });
        }
        next[0] = surface[n];
        std::mem::swap(&mut surface, &mut next);
        next[1] = surface[n + 1];
        let peak_force = power(&peak_eta);
        for l in 0..L {
            let g = &mut gathered[l];
            g.has_diverged |=
                !(within_bound(lane.low[l]) && within_bound(lane.high[l]) && within_bound(lane.q[l]));
            g.whole.take(lane.low[l], lane.high[l]);
            if steady {
                g.steady.take(lane.low[l], lane.high[l]);
                g.peak_force = g.peak_force.max(kc[l] * peak_force[l]);
                g.in_cut += lane.in_cut[l];
            }
            lane.in_window[l] += lane.in_cut[l];
            lane.in_cut[l] = 0.0;
            (lane.low[l], lane.high[l], peak_eta[l]) = (f64::INFINITY, f64::NEG_INFINITY, 0.0);
        }
        if (period + 1) % WINDOW_PERIODS == 0 {
            let samples = f64::from(WINDOW_PERIODS * course.steps_per_period);
            for l in 0..L {
                let share = lane.in_window[l] / samples;
                let g = &mut gathered[l];
                if period >= course.periods / SETTLING {
                    g.windows += 1;
                    g.sum += share;
                    g.squares += share * share;
                }
                if let Some(control) = processes[l].0.control {
                    lane.b[l] += control.adaptation * (share - control.target) * f64::from(WINDOW_PERIODS);
                }
                lane.in_window[l] = 0.0;
            }
        }
    }
    let ends = summed(&surface[2..n + 2]);
    std::array::from_fn(|l| {
        let g = &gathered[l];
        if g.has_diverged {
            return Err(Diverged);
        }
        let windows = f64::from(g.windows.max(1));
        let mean = g.sum / windows;
        let periods = f64::from(course.steady_periods);
        let amplitude = g.steady.high - g.steady.low;
        let removed = 1.0 - (ends[l] - g.surface) * dt / periods;
        let tolerance = amplitude / periods + REMOVED_TOLERANCE;
        Ok(Steady {
            continuity: g.in_cut / f64::from(course.steady_periods * course.steps_per_period),
            amplitude,
            peak_force: g.peak_force,
            window_sd: (g.squares / windows - mean * mean).max(0.0).sqrt(),
            largest_amplitude: g.whole.high - g.whole.low,
            gain: lane.b[l],
            removed,
            cuts: removed > REMOVED_TOLERANCE && (removed - 1.0).abs() <= tolerance,
        })
    })
}

/// Sum over the steps of a period, per lane.
fn summed<const L: usize>(steps: &[[f64; L]]) -> [f64; L] {
    steps.iter().fold([0.0; L], |sum, step| each(|l| sum[l] + step[l]))
}
