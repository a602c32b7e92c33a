//! How close the feed optimiser comes to a planner that knows the process: random cases on two process models.
//!
//! `cargo run --release -p feedwright-core --example feed_study -- [CASES] [SEED] [twin|other|both]`: 200 cases of each
//! model from seed 1 unless told. Prints tables in Markdown. The same seed gives the same table on every machine.

use feedwright_core::feed::study::{
    CaseOutcome, Model, OVERLOAD_S, REFERENCE_TRIALS, TRIALS, draw, run_case, summarise,
};
use std::error::Error;
use std::time::Instant;

/// Cases of each model unless told.
const USUAL_CASES: u64 = 200;

/// Worst cases that are listed.
const WORST: usize = 8;

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

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let cases: u64 = arguments.next().map_or(Ok(USUAL_CASES), |text| text.parse())?;
    let first_seed: u64 = arguments.next().map_or(Ok(1), |text| text.parse())?;
    let which = arguments.next().unwrap_or_else(|| "both".to_owned());
    for (model, name) in [(Model::Twin, "twin"), (Model::Other, "other")] {
        if which != "both" && which != name {
            continue;
        }
        let begun = Instant::now();
        let (mut outcomes, mut refused) = (Vec::new(), 0);
        let mut seed = first_seed;
        while outcomes.len() < usize::try_from(cases)? {
            match run_case(&draw(model, seed)?, REFERENCE_TRIALS) {
                Ok(outcome) => outcomes.push(outcome),
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
