//! Time of the turning searches; prints medians and gates nothing.

use std::hint::black_box;
use std::time::{Duration, Instant};

use feedwright_core::turning::{
    DomainInput, EdgeState, Job, JobInput, Objective, Range, Selector, greedy_plan, whole_life_plan,
};

fn median<T>(rounds: usize, mut work: impl FnMut() -> T) -> Duration {
    let mut times: Vec<Duration> = (0..rounds)
        .map(|_| {
            let start = Instant::now();
            black_box(work());
            start.elapsed()
        })
        .collect();
    times.sort();
    times[rounds / 2]
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let grid = Job::new(JobInput::alaskari_oraby_2017())?;
    let free = Job::new(JobInput {
        domain: DomainInput::Continuous {
            speed_m_min: Range { min: 50.0, max: 200.0 },
            feed_mm_rev: Range { min: 0.06, max: 0.6 },
        },
        ..JobInput::alaskari_oraby_2017()
    })?;
    let state = EdgeState::new(5.0, 0.23)?;
    for (name, job) in [("grid 16x109", &grid), ("continuous", &free)] {
        let fresh = median(2001, || Selector::new(black_box(job)).choose(state));
        let selector = Selector::new(job);
        let prepared = median(2001, || selector.choose(black_box(state)));
        let plan = median(201, || greedy_plan(black_box(job), EdgeState::FRESH));
        println!("{name}: interval {fresh:?}, with a prepared selector {prepared:?}, greedy plan {plan:?}");
        for objective in [Objective::RemovalInGreedyTime, Objective::OverallRemoval, Objective::Cost] {
            let life = median(11, || whole_life_plan(black_box(job), EdgeState::FRESH, objective));
            println!("{name}: whole life {objective:?} {life:?}");
        }
    }
    Ok(())
}
