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

/// Steady values of a process.
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
}

/// Standard deviation of ψ_w from which a controlled process bursts rather than settles.
///
/// Settled points of the paper's map lie at 0.04 to 0.10, bursting ones at 0.18 and more.
pub(crate) const BURST_SD: f64 = 0.14;

impl Steady {
    /// Whether chips are segmented: the edges leave the work at all.
    #[must_use]
    pub fn segmented(&self) -> bool {
        self.continuity < 1.0
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
#[must_use]
pub fn simulate(process: &Process) -> Steady {
    lanes([*process], |_, _| {})[0]
}

/// Simulates many processes, side by side where they share exponent, steps and periods.
#[must_use]
pub fn simulate_many(processes: &[Process]) -> Vec<Steady> {
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

/// Simulates one process and keeps every `every`-th step.
///
/// # Errors
/// `every` of zero, or so small that more than a million points would be kept.
pub fn trace(process: &Process, every: u32) -> Result<(Steady, Vec<TracePoint>), FieldError> {
    let steps = u64::from(process.0.steps_per_period) * u64::from(process.0.periods);
    if every == 0 {
        return Err(FieldError::new("every", Problem::OutOfRange { value: 0.0, min: 1.0, max: 1e9 }));
    }
    let count = usize::try_from(steps / u64::from(every)).unwrap_or(usize::MAX);
    crate::field_error::count("every", count, 1, 1_000_000)?;
    let mut points = Vec::with_capacity(count);
    let mut until = every;
    let steady = lanes([*process], |_, point| {
        until -= 1;
        if until == 0 {
            until = every;
            points.push(point());
        }
    })[0];
    Ok((steady, points))
}

/// Processes stepped side by side: enough to keep the square-root unit busy without running out of registers.
pub(crate) const LANES: usize = 4;

fn lanes<const L: usize>(
    processes: [Process; L],
    observe: impl FnMut(usize, &mut dyn FnMut() -> TracePoint),
) -> [Steady; L] {
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

/// max(0, x) as the processor has it: `f64::max` also looks for NaN, which no checked process makes.
#[inline(always)]
fn positive(x: f64) -> f64 {
    if x > 0.0 { x } else { 0.0 }
}

struct Lane<const L: usize> {
    q: [f64; L],
    v: [f64; L],
    b: [f64; L],
    in_cut: [f64; L],
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
    steady_windows: u32,
    sum: f64,
    squares: f64,
}

fn run<const L: usize>(
    processes: [Process; L],
    power: impl Fn(&[f64; L]) -> [f64; L],
    mut observe: impl FnMut(usize, &mut dyn FnMut() -> TracePoint),
) -> [Steady; L] {
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
        low: [f64::INFINITY; L],
        high: [f64::NEG_INFINITY; L],
    };
    let mut gathered: [Gathered; L] = std::array::from_fn(|_| Gathered {
        whole: Extremes::NONE,
        steady: Extremes::NONE,
        in_cut: 0.0,
        peak_force: 0.0,
        windows: 0,
        steady_windows: 0,
        sum: 0.0,
        squares: 0.0,
    });
    let mut peak_eta = [0.0_f64; L];
    let mut step = 0_usize;
    for period in 0..course.periods {
        let steady = period >= course.periods - course.steady_periods;
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
        if (period + 1) % WINDOW_PERIODS == 0 {
            let samples = f64::from(WINDOW_PERIODS * course.steps_per_period);
            let peak_force = power(&peak_eta);
            for l in 0..L {
                let share = lane.in_cut[l] / samples;
                let g = &mut gathered[l];
                g.whole.take(lane.low[l], lane.high[l]);
                if period >= course.periods / SETTLING {
                    g.windows += 1;
                    g.sum += share;
                    g.squares += share * share;
                }
                if steady {
                    g.steady.take(lane.low[l], lane.high[l]);
                    g.peak_force = g.peak_force.max(kc[l] * peak_force[l]);
                    g.in_cut += lane.in_cut[l];
                    g.steady_windows += 1;
                }
                if let Some(control) = processes[l].0.control {
                    lane.b[l] += control.adaptation * (share - control.target) * f64::from(WINDOW_PERIODS);
                }
                lane.in_cut[l] = 0.0;
                (lane.low[l], lane.high[l], peak_eta[l]) = (f64::INFINITY, f64::NEG_INFINITY, 0.0);
            }
        }
    }
    std::array::from_fn(|l| {
        let g = &gathered[l];
        let windows = f64::from(g.windows.max(1));
        let mean = g.sum / windows;
        Steady {
            continuity: g.in_cut
                / f64::from(g.steady_windows.max(1) * WINDOW_PERIODS * course.steps_per_period),
            amplitude: g.steady.high - g.steady.low,
            peak_force: g.peak_force,
            window_sd: (g.squares / windows - mean * mean).max(0.0).sqrt(),
            largest_amplitude: g.whole.high - g.whole.low,
            gain: lane.b[l],
        }
    })
}
