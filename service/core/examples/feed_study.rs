//! How close the feed optimiser comes to a planner that knows the process: random cases on three process models, and the
//! strategies of the paper.
//!
//! `cargo run --release -p feedwright-core --example feed_study -- [CASES] [SEED] [twin|other|coarse|paper|all]`: 200 cases
//! of each model from seed 2001 unless told. Prints tables in Markdown. The same seed gives the same table on every
//! machine. Each case is told on the error output as it ends.

use feedwright_core::feed::study::{
    CaseOutcome, Model, OVERLOAD_S, REFERENCE_TRIALS, TRIALS, draw, paper_rows, run_case, summarise,
};
use std::error::Error;
use std::time::Instant;

/// Cases of each model unless told.
const USUAL_CASES: u64 = 200;

/// First seed unless told: no case from there on was looked at while the optimiser was made.
const USUAL_SEED: u64 = 2001;

/// Worst cases that are listed.
const WORST: usize = 8;

/// One case in a line: it takes a while, and every case counts.
fn figures(one: &CaseOutcome) -> String {
    let gaps: Vec<String> = (0..TRIALS).map(|trial| format!("{:+.2}", 100.0 * one.gap(trial))).collect();
    let over = one.trials.iter().filter(|trial| trial.overload_s > OVERLOAD_S + 1e-9).count();
    let knots = one.trials.iter().map(|trial| trial.knots).max().unwrap_or(0);
    format!("{} %, {over} overloaded, {knots} knots", gaps.join(" "))
}

fn print(name: &str, outcomes: &mut [CaseOutcome], refused: usize, seconds: f64) {
    let sum = summarise(outcomes);
    let percent = |value: f64| format!("{:+.1} %", 100.0 * value);
    println!("\n### {name}: {} cases, {refused} without any feasible profile, {seconds:.0} s\n", sum.cases);
    println!("| trial | median | 95th percentile |\n|---:|---:|---:|");
    for trial in 0..TRIALS {
        println!(
            "| {} | {} | {} |",
            trial + 1,
            percent(sum.gap_by_trial[trial]),
            percent(sum.p95_by_trial[trial])
        );
    }
    println!(
        "\noverloaded: {} of {} tried cycles ({:.2} %); most knots {}; loads in their 90 % bands: {:.0} %",
        sum.overloaded,
        sum.tried,
        100.0 * sum.overloaded as f64 / sum.tried.max(1) as f64,
        sum.most_knots,
        100.0 * sum.coverage
    );
    for (at, name) in ["1", "2", "3", "4", "5"].iter().enumerate() {
        let count = outcomes.iter().filter(|one| one.trials[at].overload_s > OVERLOAD_S + 1e-9).count();
        print!("{}trial {name}: {count}", if at == 0 { "by " } else { ", " });
    }
    println!(
        "\n\n| worst | start | noise | wear | sampling | first | reference | after 5 | gap by trial | loads | overload s |"
    );
    println!("|---:|---|---:|---:|---:|---:|---:|---:|---|---|---|");
    outcomes.sort_by(|a, b| b.gap(TRIALS - 1).total_cmp(&a.gap(TRIALS - 1)));
    let overloaded =
        outcomes.iter().filter(|one| one.trials.iter().any(|trial| trial.overload_s > OVERLOAD_S + 1e-9));
    for one in outcomes.iter().take(WORST).chain(overloaded.take(WORST)) {
        let gaps: Vec<String> = (0..TRIALS).map(|trial| format!("{:+.1}", 100.0 * one.gap(trial))).collect();
        let loads: Vec<String> = one.trials.iter().map(|trial| format!("{:.2}", trial.worst_ratio)).collect();
        let over: Vec<String> = one.trials.iter().map(|trial| format!("{:.2}", trial.overload_s)).collect();
        println!(
            "| {} | {} | {:.2} | {:.2} | {:.0} ms | {:.2} s | {:.2} s | {:.2} s | {} | {} | {} |",
            one.seed,
            one.start.as_str(),
            one.noise_factor,
            one.wear,
            1e3 * one.period_s,
            one.first_s,
            one.reference_s,
            one.trials[TRIALS - 1].duration_s,
            gaps.join(" "),
            loads.join(" "),
            over.join(" ")
        );
    }
}

fn paper(seed: u64) -> Result<(), Box<dyn Error>> {
    println!(
        "| strategy | wear | keeps L_set of (feed drive, spindle) % | its time s | learnt, by trial s | overload s |"
    );
    println!("|---|---:|---|---:|---|---|");
    for row in paper_rows(seed)? {
        let times: Vec<String> =
            row.outcome.trials.iter().map(|trial| format!("{:.2}", trial.duration_s)).collect();
        let over: Vec<String> =
            row.outcome.trials.iter().map(|trial| format!("{:.2}", trial.overload_s)).collect();
        println!(
            "| {} | {:.0} | {:.1}, {:.1} | {:.2} | {} | {} |",
            row.name,
            row.wear,
            row.set_percent[0],
            row.set_percent[1],
            row.strategy_s,
            times.join(" "),
            over.join(" ")
        );
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let cases: u64 = arguments.next().map_or(Ok(USUAL_CASES), |text| text.parse())?;
    let first_seed: u64 = arguments.next().map_or(Ok(USUAL_SEED), |text| text.parse())?;
    let which = arguments.next().unwrap_or_else(|| "all".to_owned());
    if which == "all" || which == "paper" {
        paper(first_seed)?;
    }
    for (model, name) in [(Model::Twin, "twin"), (Model::Other, "other"), (Model::Coarse, "coarse")] {
        if which != "all" && which != name {
            continue;
        }
        let begun = Instant::now();
        let (mut outcomes, mut refused) = (Vec::new(), 0);
        let mut seed = first_seed;
        while outcomes.len() < usize::try_from(cases)? {
            match run_case(&draw(model, seed)?, REFERENCE_TRIALS) {
                Ok(outcome) => {
                    let figures = figures(&outcome);
                    eprintln!("{name} {seed}: {figures}");
                    outcomes.push(outcome);
                }
                // Where even full knowledge finds nothing there is nothing to compare with.
                Err(error) if error.field() == "limits" => refused += 1,
                Err(error) => return Err(format!("case {seed}: {error}").into()),
            }
            seed += 1;
        }
        print(name, &mut outcomes, refused, begun.elapsed().as_secs_f64());
    }
    Ok(())
}
