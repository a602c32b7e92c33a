//! Draws the figures of `docs/` from the papers' own settings, and prints the numbers they are quoted with.
//!
//! `cargo run --release -p feedwright-core --example figures -- docs/figures`; the maps take about a minute on two cores.

use std::error::Error;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use feedwright_core::plunge::relative_saving;
use feedwright_core::turning::{
    Accumulation, EdgeState, Job, JobInput, Objective, best_fixed_run, compare, greedy_plan, whole_life_plan,
};
use feedwright_core::vibratory::continuity::{
    ContinuityControl, Map, MapAxis, MapInput, MapQuestion, ProcessInput, border_at, run_map,
};
use feedwright_core::vibratory::loop_model::{
    CuttingForce, LoopInput, LoopRun, LoopSteady, PoincareColumn, poincare_map,
};
use feedwright_core::vibratory::peak_to_peak::{ControllerInput, ControllerSettings};

type Outcome = Result<(), Box<dyn Error>>;

fn main() -> Outcome {
    let folder = PathBuf::from(std::env::args().nth(1).ok_or("name the folder to draw into")?);
    std::fs::create_dir_all(&folder)?;
    turning(&folder)?;
    plunge(&folder)?;
    peak_to_peak(&folder)?;
    continuity(&folder)
}

/// A plot area within a drawing.
struct Panel {
    left: f64,
    top: f64,
    width: f64,
    height: f64,
    x: (f64, f64),
    y: (f64, f64),
}

impl Panel {
    fn x(&self, value: f64) -> f64 {
        self.left + (value - self.x.0) / (self.x.1 - self.x.0) * self.width
    }

    fn y(&self, value: f64) -> f64 {
        self.top + self.height - (value - self.y.0) / (self.y.1 - self.y.0) * self.height
    }

    fn frame(&self, title: &str, x_label: &str, y_label: &str) -> Result<String, std::fmt::Error> {
        let mut out = String::new();
        let (right, bottom) = (self.left + self.width, self.top + self.height);
        writeln!(
            out,
            r##"<rect x="{}" y="{}" width="{}" height="{}" fill="none" stroke="#444"/>"##,
            self.left, self.top, self.width, self.height
        )?;
        writeln!(out, r#"<text x="{}" y="{}">{title}</text>"#, self.left, self.top - 8.0)?;
        for step in 0..=4 {
            let share = f64::from(step) / 4.0;
            let (x, y) = (self.x.0 + share * (self.x.1 - self.x.0), self.y.0 + share * (self.y.1 - self.y.0));
            writeln!(
                out,
                r#"<text x="{:.1}" y="{:.1}" text-anchor="middle">{}</text>"#,
                self.x(x),
                bottom + 16.0,
                tick(x)
            )?;
            writeln!(
                out,
                r#"<text x="{:.1}" y="{:.1}" text-anchor="end">{}</text>"#,
                self.left - 5.0,
                self.y(y) + 4.0,
                tick(y)
            )?;
        }
        writeln!(out, r#"<text x="{right}" y="{}" text-anchor="end">{x_label}</text>"#, bottom + 32.0)?;
        writeln!(
            out,
            r#"<text x="{}" y="{}" transform="rotate(-90 {} {})">{y_label}</text>"#,
            self.left - 42.0,
            bottom,
            self.left - 42.0,
            bottom
        )?;
        Ok(out)
    }

    fn line(
        &self,
        points: impl Iterator<Item = (f64, f64)>,
        colour: &str,
    ) -> Result<String, std::fmt::Error> {
        let mut path = String::new();
        for (x, y) in points {
            write!(path, "{:.1},{:.1} ", self.x(x), self.y(y))?;
        }
        Ok(format!(
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/>\n",
            path.trim()
        ))
    }
}

fn tick(value: f64) -> String {
    let text = format!("{value:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn save(folder: &Path, name: &str, (width, height): (u32, u32), body: &str) -> Outcome {
    let svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" \
         font-size=\"12\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n{body}</svg>\n"
    );
    std::fs::write(folder.join(name), svg)?;
    Ok(())
}

fn turning(folder: &Path) -> Outcome {
    let job = Job::new(JobInput::alaskari_oraby_2017())?;
    let plan = greedy_plan(&job, EdgeState::FRESH);
    let mut body = String::new();
    let panel = |index: u32, y: (f64, f64)| Panel {
        left: 70.0 + 330.0 * f64::from(index % 2),
        top: 30.0 + 210.0 * f64::from(index / 2),
        width: 240.0,
        height: 140.0,
        x: (0.0, 15.0),
        y,
    };
    /// Title, range of the axis, what is drawn, and its limit.
    type Shown = (&'static str, (f64, f64), fn(&feedwright_core::turning::Chosen) -> f64, Option<f64>);
    let shown: [Shown; 4] = [
        ("cutting speed, m/min", (40.0, 200.0), |c| c.cut.speed_m_min(), None),
        ("feed, mm/rev", (0.0, 0.6), |c| c.cut.feed_mm_rev(), None),
        ("power, kW (limit 7)", (0.0, 8.0), |c| c.outcome.power_kw, Some(7.0)),
        ("wear, mm (limit 0.3)", (0.0, 0.32), |c| c.outcome.wear_mm, Some(0.3)),
    ];
    for (index, (title, y, value, limit)) in (0..).zip(shown) {
        let panel = panel(index, y);
        body += &panel.frame(title, "min", "")?;
        let steps = plan.intervals.iter().flat_map(|c| [(c.start_min, value(c)), (c.end_min, value(c))]);
        body += &panel.line(steps, "#1560a8")?;
        if let Some(limit) = limit {
            body += &panel.line([(0.0, limit), (15.0, limit)].into_iter(), "#c03020")?;
        }
    }
    save(folder, "turning.svg", (660, 440), &body)?;
    for accumulation in [Accumulation::ElapsedTime, Accumulation::State] {
        let job = Job::new(JobInput { accumulation, ..JobInput::alaskari_oraby_2017() })?;
        let plan = greedy_plan(&job, EdgeState::FRESH);
        if let Some(fixed) = best_fixed_run(&job, EdgeState::FRESH) {
            println!(
                "{accumulation:?}: {} intervals, over the best fixed pair {:?}",
                plan.intervals.len(),
                compare(&plan, &fixed)
            );
        }
        for objective in [Objective::RemovalInGreedyTime, Objective::OverallRemoval, Objective::Cost] {
            let life = whole_life_plan(&job, EdgeState::FRESH, objective);
            let first = life.plan.intervals.first().map(|c| c.cut);
            println!(
                "  {objective:?}: gain {:.4}, by state {:.4}, first cut {first:?}",
                life.gain, life.gain_by_state
            );
        }
    }
    Ok(())
}

fn plunge(folder: &Path) -> Outcome {
    let panel = Panel { left: 70.0, top: 30.0, width: 420.0, height: 240.0, x: (0.0, 4.0), y: (-0.4, 0.4) };
    let mut body = panel.frame("relative saving k1·(2 − k2)", "k2 = working feed over plunge feed", "")?;
    for (k1, colour) in [(0.05, "#7aa6d6"), (0.1, "#1560a8"), (0.2, "#0b3050")] {
        let points: Result<Vec<_>, _> =
            (0..=40).map(|i| f64::from(i) * 0.1).map(|k2| relative_saving(k1, k2).map(|y| (k2, y))).collect();
        body += &panel.line(points?.into_iter(), colour)?;
        writeln!(
            body,
            r#"<text x="500" y="{:.1}">k1 = {k1}</text>"#,
            panel.y(relative_saving(k1, 4.0)?) + 4.0
        )?;
    }
    body += &panel.line([(0.0, 0.0), (4.0, 0.0)].into_iter(), "#c03020")?;
    save(folder, "plunge.svg", (580, 320), &body)
}

fn peak_to_peak(folder: &Path) -> Outcome {
    let settings = ControllerSettings::new(ControllerInput::IVANOV_2024)?;
    let table: Vec<f64> = (0..7).map(|i| 2000.0 + 500.0 * f64::from(i)).collect();
    let fine: Vec<f64> = (0..=120).map(|i| 2000.0 + 25.0 * f64::from(i)).collect();
    let mut body = String::new();
    for (index, name, force) in [
        (0_u32, "pilot hole (Fig. 11)", CuttingForce::PILOT_HOLE),
        (1, "full hole (Fig. 14)", CuttingForce::FULL_HOLE),
    ] {
        let run = LoopRun::new(LoopInput::ivanov_2024(3000.0, force))?;
        println!("{name}: rpm, free µm, controlled µm, actuator N");
        for column in poincare_map(&run, &table, &settings)? {
            println!(
                "  {} {:.0} {:.1} {:.1}",
                column.spindle_rpm,
                column.free.mean_displacement_mm * 1e3,
                column.controlled.displacement_mm * 1e3,
                column.controlled.actuator_n
            );
        }
        let columns = poincare_map(&run, &fine, &settings)?;
        let panel = Panel {
            left: 70.0 + 400.0 * f64::from(index),
            top: 30.0,
            width: 310.0,
            height: 260.0,
            x: (2000.0, 5000.0),
            y: (0.0, 0.4),
        };
        body += &panel.frame(
            &format!("{name}: free grey, controlled blue"),
            "1/min",
            "peaks of displacement, mm",
        )?;
        type Side = fn(&PoincareColumn) -> &LoopSteady;
        let sides: [(Side, &str); 2] = [(|c| &c.free, "#999"), (|c| &c.controlled, "#1560a8")];
        for (side, colour) in sides {
            for column in &columns {
                let peaks = &side(column).peaks_mm;
                for peak in peaks.iter().step_by(peaks.len().div_ceil(12).max(1)).filter(|p| **p <= panel.y.1)
                {
                    writeln!(
                        body,
                        r#"<circle cx="{:.1}" cy="{:.1}" r="1" fill="{colour}"/>"#,
                        panel.x(column.spindle_rpm),
                        panel.y(*peak)
                    )?;
                }
            }
        }
    }
    save(folder, "peak-to-peak.svg", (860, 340), &body)
}

fn continuity(folder: &Path) -> Outcome {
    let mut body = String::new();
    for (index, title, control) in
        [(0_u32, "ψ without control", None), (1, "ψ with control", Some(ContinuityControl::GOUSKOV_2015))]
    {
        let question = MapQuestion::new(MapInput {
            frequency_ratio: MapAxis { min: 1.0, max: 2.0, count: 101 },
            cutting_coefficient: MapAxis { min: 0.02, max: 0.6, count: 101 },
            process: ProcessInput::gouskov_2015(1.0, 0.1, control),
        })?;
        let begun = Instant::now();
        let workers = std::thread::available_parallelism()?;
        let map = run_map(&question, workers, &|_, _| {}, &AtomicBool::new(false))?;
        println!(
            "{title}: {} points on {workers} threads in {:.1} s",
            map.points.len(),
            begun.elapsed().as_secs_f64()
        );
        let panel = Panel {
            left: 70.0 + 400.0 * f64::from(index),
            top: 30.0,
            width: 303.0,
            height: 303.0,
            x: (1.0, 2.0),
            y: (0.02, 0.6),
        };
        body += &cells(&panel, &map)?;
        body += &panel.frame(title, "p", "kc")?;
        let border = (1..100).map(|i| 1.0 + 0.01 * f64::from(i)).filter_map(|p| {
            let point = border_at(p, 0.01, 0.75).ok()?;
            (point.cutting_coefficient <= 0.6).then_some((p, point.cutting_coefficient))
        });
        body += &panel.line(border, "#c03020")?;
    }
    body += "<text x=\"70\" y=\"385\">white 1 (no segmentation) to dark blue 0.3; red: border of linear stability</text>\n";
    save(folder, "continuity.svg", (800, 400), &body)
}

/// The points of a map in ten shades, equal neighbours of a row in one rectangle.
fn cells(panel: &Panel, map: &Map) -> Result<String, std::fmt::Error> {
    let mut out = String::from("<g shape-rendering=\"crispEdges\">\n");
    let shade = |row: usize, column: usize| {
        let continuity =
            map.at(row, column).and_then(|point| point.ok()).map_or(1.0, |point| point.continuity);
        ((1.0 - continuity) / 0.07).ceil().clamp(0.0, 10.0)
    };
    for row in 0..map.coefficients.len() {
        let mut column = 0;
        while column < map.ratios.len() {
            let level = shade(row, column);
            let from = column;
            while column < map.ratios.len() && (shade(row, column) - level).abs() < 0.5 {
                column += 1;
            }
            let (x, y) = (panel.x(map.ratios[from]), panel.y(map.coefficients[row]));
            let width = panel.x(map.ratios[column - 1]) - x + 3.0;
            let light = 255.0 - 21.0 * level;
            writeln!(
                out,
                r#"<rect x="{x:.1}" y="{:.1}" width="{width:.1}" height="3.1" fill="rgb({light:.0},{light:.0},{:.0})"/>"#,
                y - 1.5,
                255.0 - 8.0 * level
            )?;
        }
    }
    out += "</g>\n";
    Ok(out)
}
