//! How each drive's load depends on depth, feed, heat put in before and wear, with uncertainty.
//!
//! At every depth, with x = ln feed, h the heat put in so far and w the wear:
//!
//! ln(load − idle) = a + s·(x − x₀) + c·q(x − x₀) − m·(φ − φ₀) + k·(w − w₀),   φ = ln(1 + h/h₀),   q(d) ≈ d²/2.
//!
//! Nothing of it is a process model: it is the expansion of any load that grows with the feed, falls with heat and
//! changes with wear, about the profile that was tried last. Level a belongs to the depth; slope s and wear k to
//! its neighbourhood, drawn towards the drive's own; memory m and bend c to the drive. Cycles far from the expansion point
//! in feed or heat count less. What only a law's feeds show never teaches the slope.
//!
//! The bend is there because a load of which a part knows no feed and a part grows with it is convex in x: s rises by
//! s·(1 − s) per unit of x. A pure power is not bent; half of it is expected, and what cycles at three feeds show counts.

use super::course::Course;
use super::grid::Grid;
use super::ridge::solve;
use crate::friction::relation::FeedSource;

/// How long heat put in is remembered, s: of the order of one hole.
pub(super) const MEMORY_S: f64 = 6.0;

/// What is expected before any cycle was seen, per drive.
const PRIOR_SLOPE: f64 = 0.7;
const PRIOR_SLOPE_SD: f64 = 0.3;
/// Share of s·(1 − s) that the bend is expected to be, and how unsure that is.
const PRIOR_BEND: f64 = 0.5;
const PRIOR_BEND_SD: f64 = 0.2;
const PRIOR_MEMORY: f64 = 0.35;
const PRIOR_MEMORY_SD: f64 = 0.35;
/// ln load per unit of energy ratio: a worn tool (1.1) drags up to half as much again somewhere.
const PRIOR_WEAR: f64 = 2.0;
const PRIOR_WEAR_SD: f64 = 2.0;

/// How much the slope differs from depth to depth, and the wear's effect.
const LOCAL_SLOPE_SD: f64 = 0.3;
const LOCAL_WEAR_SD: f64 = 2.0;

/// How wrong the expansion in ln feed may be beside its bend, per unit of ln feed away from where it was measured.
const CURVATURE_SD: f64 = 0.08;

/// Distance in ln feed beyond which the slope changes no further, and the largest share of the slope that the bend may
/// take away or add until there: a load never falls with the feed.
const BENT_REACH: f64 = 0.7;
const MOST_BENT: f64 = 0.7;

/// Half width of the neighbourhood that shares a slope, mm.
const NEIGHBOURHOOD_MM: f64 = 1.0;

/// Length over which the unevenness within a cycle is one and the same, mm.
const UNEVEN_MM: f64 = 0.6;

/// Expected unevenness within a cycle and from cycle to cycle, relative, and the weight of that expectation in cycles.
const PRIOR_UNEVEN: f64 = 0.02;
const PRIOR_COMMON: f64 = 0.015;
const PRIOR_NOISE_WEIGHT: f64 = 2.0;

/// Unevenness beyond which a depth is a case of its own; how far around a depth its unevenness is told from; and the
/// weight of what is usual, in degrees of freedom.
const MOST_USUAL_UNEVEN: f64 = 0.06;
const UNEVEN_REACH_MM: f64 = 1.5;
const LOCAL_NOISE_WEIGHT: f64 = 2.0;

/// Terms that all depths have in common: slope, memory, wear, bend.
const COMMON_TERMS: usize = 4;

/// Largest square of a residual that counts in how far the relation misses.
const MOST_MISSED: f64 = 0.04;

/// Slopes outside this are not believed: a load that falls with the feed is heat or noise.
const SLOPES: std::ops::RangeInclusive<f64> = 0.1..=2.0;

/// Level of wear of a new tool.
const NEW_TOOL: f64 = 1.0;

/// Spread of wear over the cycles from which its effect is told.
const TOLD_WEAR: f64 = 0.02;

/// Share of the slope that uncertainty may take away, at three standard deviations, when the feed is lowered: lowering it
/// always lowers the load, but a load of which much knows no feed hardly.
const LOWERING_DOUBT: f64 = 0.9;

/// One drive at one depth.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct DriveNode {
    pub(super) level: f64,
    pub(super) level_var: f64,
    pub(super) slope: f64,
    pub(super) slope_var: f64,
    /// Change of the slope per unit of ln feed.
    pub(super) bend: f64,
    pub(super) bend_var: f64,
    pub(super) wear: f64,
    pub(super) wear_var: f64,
    /// Standard deviation of the noise of reading in ln load, of one filtered sample.
    pub(super) reading: f64,
    /// Unevenness within a cycle around here, relative.
    pub(super) uneven: f64,
}

/// Both drives at one depth, and the point about which they are expanded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Node {
    pub(super) x: f64,
    pub(super) phi: f64,
    pub(super) drives: [DriveNode; 2],
}

/// Unevenness that no profile can avoid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Noise {
    /// Within a cycle, relative.
    pub(super) uneven: f64,
    /// From cycle to cycle, relative.
    pub(super) common: f64,
}

/// What is known of the operation.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Relation {
    pub(super) grid: Grid,
    pub(super) idle: [f64; 2],
    pub(super) nodes: Vec<Option<Node>>,
    pub(super) memory: [f64; 2],
    pub(super) memory_var: [f64; 2],
    pub(super) noise: [Noise; 2],
    pub(super) heat_scale: f64,
    pub(super) wear_ratio: Option<f64>,
    /// Whether cycles at different wear taught what wear does.
    pub(super) wear_known: bool,
    /// How far the relation misses the cycles' loads, those that matter most.
    pub(super) missed: f64,
    /// Offset of each cycle from what all have in common, ln load: that of the drive where it is larger.
    pub(super) offsets: Vec<f64>,
    pub(super) spread_scale: f64,
    /// Period of the samples, s: what the load filter's lag is counted in.
    pub(super) period_s: f64,
    /// Whether feeds varied enough to tell a slope, per drive: standard deviation of the common slope.
    pub(super) slope: [(f64, f64); 2],
}

/// A predicted load: ln over idle with standard deviations of what is expected and of one cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LnLoad {
    pub(super) mean: f64,
    pub(super) known_sd: f64,
    pub(super) cycle_sd: f64,
}

/// Slope and wear of one neighbourhood with their variances.
struct Local {
    slope: f64,
    slope_var: f64,
    wear: f64,
    wear_var: f64,
}

struct Fit {
    slope: f64,
    slope_var: f64,
    bend: f64,
    bend_var: f64,
    memory: f64,
    memory_var: f64,
    wear: f64,
    wear_var: f64,
    offsets: Vec<f64>,
    noise: Noise,
    /// Unevenness at each node.
    uneven: Vec<f64>,
    /// Squares that the relation misses, loads that matter most.
    missed: f64,
}

impl Relation {
    /// Learns from courses that are in their final order. `about` is the ln feed of the expansion at each node.
    pub(super) fn learn(
        grid: Grid,
        courses: &[Course],
        about: &[f64],
        idle: [f64; 2],
        wear_ratio: Option<f64>,
        spread_scale: f64,
    ) -> Self {
        let heat_scale = heat_scale(courses);
        let known = || courses.iter().filter_map(|course| course.wear_ratio);
        let planned_at = wear_ratio;
        let wear_ratio = wear_ratio.or_else(|| known().next_back());
        // A cycle whose wear nobody knows counts as one of the least worn tool, of a new one where none is known: what it
        // shows is then never laid to wear that the plan already counts on.
        let least = known().reduce(f64::min).unwrap_or(if planned_at.is_some() { NEW_TOOL } else { 0.0 });
        let wears: Vec<f64> = courses
            .iter()
            .map(|course| wear_ratio.map_or(0.0, |planned| course.wear_ratio.unwrap_or(least) - planned))
            .collect();
        let table = Table::new(&grid, courses, about, heat_scale, &wears);
        let fits = [0, 1].map(|drive| table.fit(drive));
        let mut nodes = vec![None; grid.count()];
        for (at, node) in nodes.iter_mut().enumerate() {
            *node = table.node(at, about[at], &fits);
        }
        let spread = known().fold(f64::NEG_INFINITY, f64::max) - known().fold(f64::INFINITY, f64::min);
        let offsets = (fits[0].offsets.iter().zip(&fits[1].offsets))
            .map(|(feed, spindle)| if feed.abs() > spindle.abs() { *feed } else { *spindle })
            .collect();
        Self {
            grid,
            idle,
            nodes,
            memory: [fits[0].memory, fits[1].memory],
            memory_var: [fits[0].memory_var, fits[1].memory_var],
            noise: [fits[0].noise, fits[1].noise],
            heat_scale,
            wear_ratio,
            wear_known: spread >= TOLD_WEAR,
            missed: fits[0].missed + fits[1].missed,
            offsets,
            spread_scale,
            period_s: courses
                .iter()
                .map(|course| course.period_s)
                .fold(f64::INFINITY, f64::min)
                .clamp(1e-4, 0.1),
            slope: [(fits[0].slope, fits[0].slope_var.sqrt()), (fits[1].slope, fits[1].slope_var.sqrt())],
        }
    }

    /// φ of a heat in √percent·s.
    pub(super) fn phi(&self, heat: f64) -> f64 {
        (heat / self.heat_scale).ln_1p()
    }

    /// The load of a drive at a node for a ln feed, heat and `more_wear` beyond that of the plan.
    pub(super) fn load(&self, node: &Node, drive: usize, x: f64, phi: f64, more_wear: f64) -> LnLoad {
        let one = &node.drives[drive];
        let (dx, dphi) = (x - node.x, phi - node.phi);
        let bent = bent(dx);
        let mean =
            one.level + one.slope * dx + one.bend * bent - self.memory[drive] * dphi + one.wear * more_wear;
        let mut slope_var =
            (one.slope_var + CURVATURE_SD * CURVATURE_SD) * dx * dx + one.bend_var * bent * bent;
        if dx < 0.0 {
            let most = LOWERING_DOUBT / 3.0 * one.slope * dx;
            slope_var = slope_var.min(most * most);
        }
        let wear_var = one.wear_var * more_wear * more_wear;
        let known = one.level_var + slope_var + self.memory_var[drive] * dphi * dphi + wear_var;
        let noise = self.noise[drive];
        let all = known + noise.common * noise.common + one.uneven * one.uneven + one.reading * one.reading;
        LnLoad { mean, known_sd: known.sqrt() * self.spread_scale, cycle_sd: all.sqrt() * self.spread_scale }
    }
}

/// Heat per second that a spindle load over idle, percent, puts in, √percent.
///
/// Some loads soften with the work put in and some with the time in contact alone. At half the feed the work of a hole grows
/// little and the time doubles; a heat between the two is wrong by half at most.
pub(super) fn heat_rate(load: f64) -> f64 {
    load.max(0.0).sqrt()
}

/// What a bend of 1 adds to ln load: half the square of the distance, a straight line beyond the reach.
fn bent(dx: f64) -> f64 {
    let far = dx.abs();
    if far <= BENT_REACH { far * far / 2.0 } else { BENT_REACH * (far - BENT_REACH / 2.0) }
}

/// Half the largest heat that any cycle put in: where memory begins to matter.
fn heat_scale(courses: &[Course]) -> f64 {
    let largest =
        courses.iter().flat_map(|c| c.readings.iter().flatten()).map(|r| r.heat).fold(0.0, f64::max);
    (largest / 2.0).max(1.0)
}

#[derive(Debug, Clone, Copy)]
struct Row {
    cycle: usize,
    x: f64,
    /// What a bend of 1 adds here.
    bent: f64,
    phi: f64,
    wear: f64,
    y: [f64; 2],
    var: [f64; 2],
    programmed: bool,
}

/// Every reading by node.
struct Table<'a> {
    grid: &'a Grid,
    rows: Vec<Vec<Row>>,
    cycles: usize,
    /// Whether wear differs between cycles.
    worn: bool,
}

impl<'a> Table<'a> {
    fn new(grid: &'a Grid, courses: &[Course], about: &[f64], heat_scale: f64, wears: &[f64]) -> Self {
        let row = |node: usize, cycle: usize| {
            let reading = courses[cycle].readings[node]?;
            Some(Row {
                cycle,
                x: reading.x,
                bent: bent(reading.x - about[node]),
                phi: (reading.heat / heat_scale).ln_1p(),
                wear: wears[cycle],
                y: reading.y,
                var: reading.var,
                programmed: courses[cycle].source == FeedSource::Programmed,
            })
        };
        let rows = (0..grid.count())
            .map(|node| (0..courses.len()).filter_map(|cycle| row(node, cycle)).collect())
            .collect();
        Self { grid, rows, cycles: courses.len(), worn: wears.iter().any(|wear| wear.abs() > 1e-9) }
    }

    /// Weight of one node: neighbours within the unevenness's length tell the same.
    fn share(&self) -> f64 {
        (self.grid.step_mm() / UNEVEN_MM).min(1.0)
    }

    /// What a drive has in common at all depths: slope, memory, wear and each cycle's offset; twice, because the
    /// weights need the noise that the residuals tell.
    fn fit(&self, drive: usize) -> Fit {
        let mut fit = self.fit_once(drive, Noise { uneven: PRIOR_UNEVEN, common: PRIOR_COMMON }, PRIOR_SLOPE);
        self.noise(drive, &mut fit);
        let (uneven, missed) = (std::mem::take(&mut fit.uneven), fit.missed);
        Fit { uneven, missed, ..self.fit_once(drive, fit.noise, fit.slope) }
    }

    /// `slope` is what the expected bend follows from.
    fn fit_once(&self, drive: usize, noise: Noise, slope: f64) -> Fit {
        let size = COMMON_TERMS + self.cycles;
        let mut left = vec![0.0; size * size];
        let mut right = vec![0.0; size];
        let priors = [
            (PRIOR_SLOPE, PRIOR_SLOPE_SD),
            (PRIOR_MEMORY, PRIOR_MEMORY_SD),
            (PRIOR_WEAR, PRIOR_WEAR_SD),
            (PRIOR_BEND * (slope * (1.0 - slope)).max(0.0), PRIOR_BEND_SD),
        ];
        for (at, (value, sd)) in priors.into_iter().enumerate() {
            left[at * size + at] = 1.0 / (sd * sd);
            right[at] = value / (sd * sd);
        }
        for at in COMMON_TERMS..size {
            left[at * size + at] = 1.0 / (noise.common * noise.common);
        }
        for rows in &self.rows {
            let usable: Vec<&Row> = rows.iter().filter(|row| row.programmed).collect();
            if usable.len() < 2 {
                continue;
            }
            let mean_x = usable.iter().map(|row| row.x).sum::<f64>() / usable.len() as f64;
            let weights: Vec<f64> = usable
                .iter()
                .map(|row| {
                    // Local slopes scatter about the common one, so feeds far apart tell it less surely.
                    let scatter = LOCAL_SLOPE_SD * (row.x - mean_x);
                    self.share() / (noise.uneven.powi(2) + row.var[drive] + scatter * scatter)
                })
                .collect();
            let total: f64 = weights.iter().sum();
            let mean = |of: &dyn Fn(&Row) -> f64| {
                usable.iter().zip(&weights).map(|(row, weight)| weight * of(row)).sum::<f64>() / total
            };
            let (x, phi, wear, y) =
                (mean(&|row| row.x), mean(&|row| row.phi), mean(&|row| row.wear), mean(&|row| row.y[drive]));
            let bent = mean(&|row| row.bent);
            for (row, weight) in usable.iter().zip(&weights) {
                let mut line: Vec<(usize, f64)> =
                    vec![(0, row.x - x), (1, -(row.phi - phi)), (2, row.wear - wear), (3, row.bent - bent)];
                for (other, other_weight) in usable.iter().zip(&weights) {
                    let own = if other.cycle == row.cycle { 1.0 } else { 0.0 };
                    line.push((COMMON_TERMS + other.cycle, own - other_weight / total));
                }
                for (i, a) in &line {
                    right[*i] += weight * a * (row.y[drive] - y);
                    for (k, b) in &line {
                        left[i * size + k] += weight * a * b;
                    }
                }
            }
        }
        let (values, variances) = solve(left, right, COMMON_TERMS);
        Fit {
            slope: values[0].clamp(*SLOPES.start(), *SLOPES.end()),
            slope_var: variances[0],
            memory: values[1].clamp(0.0, 2.0),
            memory_var: variances[1],
            wear: values[2],
            wear_var: variances[2],
            bend: values[3],
            bend_var: variances[3],
            offsets: values[COMMON_TERMS..].to_vec(),
            noise,
            uneven: Vec::new(),
            missed: 0.0,
        }
    }

    /// Unevenness that the residuals about the local slopes show, drawn towards what is expected; and how far the
    /// relation misses the loads that matter.
    fn noise(&self, drive: usize, fit: &mut Fit) {
        let stride = super::grid::whole(UNEVEN_MM / 2.0 / self.grid.step_mm()).max(1);
        let largest = self.rows.iter().flatten().map(|row| row.y[drive]).fold(f64::NEG_INFINITY, f64::max);
        let mut found: Vec<(usize, f64, f64)> = Vec::new();
        let mut missed = 0.0;
        for (at, rows) in self.rows.iter().enumerate().step_by(stride) {
            // Loads that are barely read tell of the reading and not of the process.
            let rows: Vec<&Row> = rows.iter().filter(|row| row.var[drive] < 0.01).collect();
            if rows.len() < 2 {
                continue;
            }
            let local = self.local(at, drive, fit);
            let mean_x = rows.iter().map(|row| row.x).sum::<f64>() / rows.len() as f64;
            let of = |row: &Row| {
                self.residual(row, drive, fit)
                    - (local.slope - fit.slope) * (row.x - mean_x)
                    - (local.wear - fit.wear) * row.wear
            };
            let residuals: Vec<f64> = rows.iter().map(|row| of(row)).collect();
            let mean = residuals.iter().sum::<f64>() / residuals.len() as f64;
            let spread = rows.iter().map(|row| (row.x - mean_x).powi(2)).sum::<f64>();
            let share = (stride as f64 * self.share()).min(1.0);
            let mut squares = 0.0;
            for (row, residual) in rows.iter().zip(&residuals) {
                let square = (residual - mean).powi(2);
                squares += share * (square - row.var[drive]).max(0.0);
                missed += share * square.min(MOST_MISSED) * (2.0 * (row.y[drive] - largest)).exp();
            }
            // A local slope that the feeds of these very rows told takes part of a degree of freedom.
            let slope_taken = spread / (spread + (fit.noise.uneven / LOCAL_SLOPE_SD).powi(2));
            found.push((at, squares, share * ((rows.len() - 1) as f64 - 0.3 * slope_taken).max(0.3)));
        }
        let weight = PRIOR_NOISE_WEIGHT * self.grid.end_mm() / UNEVEN_MM / 4.0;
        let (mut squares, mut freedom) = (weight * PRIOR_UNEVEN.powi(2), weight);
        for (_, square, free) in &found {
            // What is very uneven at a few depths is told there and not everywhere.
            squares += square.min(free * MOST_USUAL_UNEVEN * MOST_USUAL_UNEVEN);
            freedom += free;
        }
        let uneven = (squares / freedom).sqrt().clamp(0.004, 0.3);
        let reach = UNEVEN_REACH_MM / self.grid.step_mm();
        fit.uneven = (0..self.rows.len())
            .map(|node| {
                let near = |at: usize| (1.0 - (at.abs_diff(node) as f64 / reach).powi(2)).max(0.0);
                let (mut squares, mut freedom) = (LOCAL_NOISE_WEIGHT * uneven * uneven, LOCAL_NOISE_WEIGHT);
                for (at, square, free) in &found {
                    squares += near(*at) * square;
                    freedom += near(*at) * free;
                }
                (squares / freedom).sqrt().clamp(0.004, 0.3)
            })
            .collect();
        let offsets: f64 = fit.offsets.iter().map(|offset| offset * offset).sum();
        let seen = (self.cycles.saturating_sub(1)) as f64;
        let common =
            ((PRIOR_NOISE_WEIGHT * PRIOR_COMMON.powi(2) + offsets) / (PRIOR_NOISE_WEIGHT + seen)).sqrt();
        fit.noise = Noise { uneven, common: common.clamp(0.003, 0.3) };
        fit.missed = missed;
    }

    fn residual(&self, row: &Row, drive: usize, fit: &Fit) -> f64 {
        row.y[drive] - fit.slope * row.x - fit.bend * row.bent + fit.memory * row.phi
            - fit.wear * row.wear
            - fit.offsets.get(row.cycle).copied().unwrap_or(0.0)
    }

    /// Both drives at a node, expanded about a ln feed.
    fn node(&self, at: usize, about: f64, fits: &[Fit; 2]) -> Option<Node> {
        let rows = &self.rows[at];
        if rows.is_empty() {
            return None;
        }
        let closeness = |row: &Row| 1.0 / (0.02 + (row.x - about).powi(2));
        let total: f64 = rows.iter().map(closeness).sum();
        let phi = rows.iter().map(|row| closeness(row) * row.phi).sum::<f64>() / total;
        let drives = [0, 1].map(|drive| self.drive_node(at, about, phi, drive, &fits[drive]));
        Some(Node { x: about, phi, drives })
    }

    fn drive_node(&self, at: usize, about: f64, phi: f64, drive: usize, fit: &Fit) -> DriveNode {
        let Local { slope, slope_var, wear, wear_var } = self.local(at, drive, fit);
        let curvature = slope_var + CURVATURE_SD * CURVATURE_SD;
        let (bend, bend_var) = (fit.bend.clamp(-MOST_BENT * slope, MOST_BENT * slope), fit.bend_var);
        let noise = Noise { uneven: fit.uneven[at], ..fit.noise };
        let (mut total, mut level, mut off_x, mut off_bent, mut off_phi, mut off_wear, mut common) =
            (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        let mut reading = 0.0;
        for row in &self.rows[at] {
            let (dx, dphi) = (row.x - about, row.phi - phi);
            let var = noise.uneven.powi(2)
                + noise.common.powi(2)
                + row.var[drive]
                + curvature * dx * dx
                + bend_var * row.bent * row.bent
                + fit.memory_var * dphi * dphi
                + wear_var * row.wear * row.wear;
            let weight = 1.0 / var;
            total += weight;
            level +=
                weight * (row.y[drive] - slope * dx - bend * row.bent + fit.memory * dphi - wear * row.wear);
            off_x += weight * dx;
            off_bent += weight * row.bent;
            off_phi += weight * dphi;
            off_wear += weight * row.wear;
            common += weight * weight * (noise.common.powi(2) + noise.uneven.powi(2) + row.var[drive]);
            reading += weight * row.var[drive];
        }
        let (dx, dphi, dwear) = (off_x / total, off_phi / total, off_wear / total);
        let bent = off_bent / total;
        let level_var = common / (total * total)
            + curvature * dx * dx
            + bend_var * bent * bent
            + fit.memory_var * dphi * dphi
            + wear_var * dwear * dwear;
        DriveNode {
            level: level / total,
            level_var,
            slope,
            slope_var,
            bend,
            bend_var,
            wear,
            wear_var,
            reading: (reading / total).sqrt(),
            uneven: noise.uneven,
        }
    }

    /// Slope and wear of a neighbourhood, drawn towards the drive's own.
    fn local(&self, at: usize, drive: usize, fit: &Fit) -> Local {
        let reach = NEIGHBOURHOOD_MM / self.grid.step_mm();
        let half = super::grid::whole(reach).max(1);
        let (from, to) = (at.saturating_sub(half), (at + half).min(self.rows.len() - 1));
        // Precisions of the two deviations from the drive's own, and their cross term.
        let (mut xx, mut xr, mut ww, mut wr) = (0.0, 0.0, 0.0, 0.0);
        for (node, rows) in self.rows.iter().enumerate().take(to + 1).skip(from) {
            let usable: Vec<&Row> = rows.iter().filter(|row| row.programmed).collect();
            if usable.len() < 2 {
                continue;
            }
            let distance = node.abs_diff(at) as f64 / (half as f64 + 1.0);
            let near = (1.0 - distance * distance) * self.share();
            let precise =
                |row: &Row| near / (fit.noise.uneven.powi(2) + fit.noise.common.powi(2) + row.var[drive]);
            let total: f64 = usable.iter().map(|row| precise(row)).sum();
            let mean = |of: &dyn Fn(&Row) -> f64| {
                usable.iter().map(|row| precise(row) * of(row)).sum::<f64>() / total
            };
            let (x, wear, residual) =
                (mean(&|row| row.x), mean(&|row| row.wear), mean(&|row| self.residual(row, drive, fit)));
            for row in &usable {
                let (weight, dx, dw) = (precise(row), row.x - x, row.wear - wear);
                let r = self.residual(row, drive, fit) - residual;
                xx += weight * dx * dx;
                xr += weight * dx * r;
                ww += weight * dw * dw;
                wr += weight * dw * r;
            }
        }
        let drawn = |precision: f64, cross: f64, sd: f64, var: f64| {
            let prior = 1.0 / (sd * sd);
            let posterior = 1.0 / (precision + prior);
            let left = prior * posterior;
            (cross * posterior, posterior + left * left * var)
        };
        let (slope_off, slope_var) = drawn(xx, xr, LOCAL_SLOPE_SD, fit.slope_var);
        let (wear_off, wear_var) = if self.worn {
            drawn(ww, wr, LOCAL_WEAR_SD, fit.wear_var)
        } else {
            (0.0, LOCAL_WEAR_SD.powi(2) + fit.wear_var)
        };
        let slope = (fit.slope + slope_off).clamp(*SLOPES.start(), *SLOPES.end());
        Local { slope, slope_var, wear: fit.wear + wear_off, wear_var }
    }
}
