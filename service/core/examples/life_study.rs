//! Lives of many tools on the process model: is wear called when constant feed would have reached +10 %?
//!
//! `cargo run --release -p feedwright-core --example life_study -- [SECONDS] [SEED]`: as many lives as fit into the
//! time (360 s unless told), a life of every row in turn, so that all rows have equally many. Prints a table in
//! Markdown. The same seed and number of lives give the same table on every machine.

use feedwright_core::friction::error::Invalid;
use feedwright_core::friction::program::Strategy;
use feedwright_core::friction::study::{LifeOutcome, LifeStudy, LifeStudyParams, summarise};
use feedwright_core::friction::twin::{PaperStrategies, Twin, TwinParams, paper_params, typical_noise};
use feedwright_core::friction::wear::{WearConfig, WearParams};
use std::error::Error;
use std::time::{Duration, Instant};

/// How long it runs unless told.
const USUAL_SECONDS: u64 = 360;

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

fn rows(twin: &Twin) -> Result<Vec<Row>, Invalid> {
    let paper = PaperStrategies::new()?;
    let all: Vec<Strategy> = paper.all().map(Clone::clone).to_vec();
    let names = ["F_Const", "F_Sec", "F_Lin", "F_AC"];
    let mut sets: Vec<(&'static str, Vec<Strategy>)> =
        names.into_iter().zip(all.iter().map(|one| vec![one.clone()])).collect();
    sets.push(("mixed", all));
    let mut rows = Vec::new();
    for references in [true, false] {
        for (name, strategies) in &sets {
            for wears in [true, false] {
                let mut params = LifeStudyParams::paper(strategies.clone(), wears)?;
                if !references {
                    let never = WearParams { reference_every: None, ..*params.wear.params() };
                    params.wear = WearConfig::new(never)?;
                }
                if !wears {
                    params.horizon_cycles = TIRELESS_HORIZON;
                }
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
    let seconds: u64 = arguments.next().map_or(Ok(USUAL_SECONDS), |text| text.parse())?;
    let first_seed: u64 = arguments.next().map_or(Ok(1), |text| text.parse())?;
    let twin = Twin::new(TwinParams { noise: typical_noise(), ..paper_params() })?;
    let mut rows = rows(&twin)?;
    let (begun, limit) = (Instant::now(), Duration::from_secs(seconds));
    let mut seed = first_seed;
    loop {
        for row in &mut rows {
            row.outcomes.push(row.study.life(&twin, seed)?);
        }
        seed = seed.wrapping_add(1);
        if begun.elapsed() >= limit {
            break;
        }
    }
    print(&rows);
    let lives: usize = rows.iter().map(|row| row.outcomes.len()).sum();
    let drilled: u64 =
        rows.iter().flat_map(|row| &row.outcomes).map(|life| u64::from(life.drilled_cycles)).sum();
    println!(
        "\n{lives} lives, {drilled} drilled cycles, seeds from {first_seed}, {:.0} s",
        begun.elapsed().as_secs_f64()
    );
    Ok(())
}
