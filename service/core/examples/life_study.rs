//! Lives of many tools on the process model: is wear called when constant feed would have reached +10 %?
//!
//! `cargo run --release -p feedwright-core --example life_study -- [LIVES] [SECONDS] [with|without] [THIN]`: so many
//! lives of every row, a life of every row in turn, so that all rows have equally many when the time is up before
//! (360 s unless told); rows with reference cycles, without, or both. Prints a table in Markdown. The same number of
//! lives gives the same table on every machine.

use feedwright_core::friction::error::Invalid;
use feedwright_core::friction::program::Strategy;
use feedwright_core::friction::study::{LifeOutcome, LifeStudy, LifeStudyParams, summarise};
use feedwright_core::friction::twin::{
    NoiseLevels, PaperStrategies, Twin, TwinParams, paper_params, typical_noise,
};
use feedwright_core::units;
use std::error::Error;
use std::time::{Duration, Instant};

/// How many lives of a row unless told.
const USUAL_LIVES: usize = 1000;

/// How long it runs unless told.
const USUAL_SECONDS: u64 = 360;

/// Seed of the first life.
const FIRST_SEED: u64 = 1;

/// Cycles after which a tool that does not wear counts as never called: four tenths more than the true life.
const TIRELESS_HORIZON: u32 = 14_000;

/// One row of the table: strategies, with or without reference cycles, on a tool that wears or not.
struct Row {
    name: &'static str,
    references: bool,
    wears: bool,
    study: LifeStudy,
    outcomes: Vec<LifeOutcome>,
}

fn rows(twin: &Twin, with_references: &[bool], thin: Option<u32>) -> Result<Vec<Row>, Invalid> {
    let paper = PaperStrategies::new()?;
    let all: Vec<(units::Strategy, Strategy)> =
        units::Strategy::ALL.into_iter().zip(paper.all().map(Clone::clone)).collect();
    let names = ["F_Const", "F_Sec", "F_Lin", "F_AC"];
    let mut sets: Vec<(&'static str, Vec<(units::Strategy, Strategy)>)> =
        names.into_iter().zip(all.iter().map(|one| vec![one.clone()])).collect();
    sets.push(("mixed", all));
    let mut rows = Vec::new();
    for &references in with_references {
        for (name, strategies) in &sets {
            for wears in [true, false] {
                let mut params = LifeStudyParams::paper(strategies.clone(), wears, references)?;
                if !wears {
                    params.horizon_cycles = TIRELESS_HORIZON;
                }
                params.thin = thin.unwrap_or(params.thin);
                let study = LifeStudy::new(twin, params)?;
                rows.push(Row { name, references, wears, study, outcomes: Vec::new() });
            }
        }
    }
    Ok(rows)
}

fn print(rows: &[Row]) {
    println!(
        "| strategy | reference cycles | wears | lives | called | within ±15 % | called / true life: 1 %, median, 99 % | masked |"
    );
    println!("|---|---|---|---:|---:|---:|---|---:|");
    for row in rows {
        let sum = summarise(&row.outcomes);
        let yes = |is: bool| if is { "yes" } else { "no" };
        let (within, ratio) = if row.wears {
            let (low, high) = sum.ratio_p01_p99;
            let ratio = format!("{low:.3}, {:.3}, {high:.3}", sum.ratio_min_median_max.1);
            (sum.within_15_percent.to_string(), if sum.called > 0 { ratio } else { "–".to_owned() })
        } else {
            ("–".to_owned(), "–".to_owned())
        };
        println!(
            "| {} | {} | {} | {} | {} | {within} | {ratio} | {:.0} % |",
            row.name,
            yes(row.references),
            yes(row.wears),
            sum.lives,
            sum.called,
            100.0 * sum.masked_share
        );
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let lives: usize = arguments.next().map_or(Ok(USUAL_LIVES), |text| text.parse())?;
    let seconds: u64 = arguments.next().map_or(Ok(USUAL_SECONDS), |text| text.parse())?;
    let with_references: &[bool] = match arguments.next().as_deref() {
        Some("with") => &[true],
        Some("without") => &[false],
        None => &[true, false],
        Some(other) => return Err(format!("with or without reference cycles, not {other}").into()),
    };
    let thin = arguments.next().map(|text| text.parse()).transpose()?;
    // Thrust and torque are no part of the study: their noise is not drawn.
    let noise = NoiseLevels { thrust_n: 0.0, torque_nm: 0.0, ..typical_noise() };
    let twin = Twin::new(TwinParams { noise, ..paper_params() })?;
    let mut rows = rows(&twin, with_references, thin)?;
    let (begun, limit) = (Instant::now(), Duration::from_secs(seconds));
    for seed in (FIRST_SEED..).take(lives) {
        if begun.elapsed() >= limit {
            break;
        }
        for row in &mut rows {
            row.outcomes.push(row.study.life(seed)?);
        }
    }
    print(&rows);
    let lives: usize = rows.iter().map(|row| row.outcomes.len()).sum();
    let drilled: u64 =
        rows.iter().flat_map(|row| &row.outcomes).map(|life| u64::from(life.drilled_cycles)).sum();
    println!(
        "\n{lives} lives, {drilled} drilled cycles, seeds from {FIRST_SEED}, {:.0} s",
        begun.elapsed().as_secs_f64()
    );
    Ok(())
}
