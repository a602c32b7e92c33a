//! Prints the table of docs/feed-profiles.md: our override law and its polynomial in the control, in closed loop.

use feedwright_core::feed::nc::{Mover, Run, closed_loop};
use feedwright_core::feed::profile::{
    Conditions, LimitsInput, Profile, ProfileInput, SectionInput, SectionKind, WearBandInput,
};
use feedwright_core::friction::twin::{
    CycleSetup, PAPER_SPINDLE_RPM, PaperStrategies, Twin, paper_params, typical_noise,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let strategy = PaperStrategies::new()?.adaptive;
    let end = strategy.end_depth_mm();
    let mut knots: Vec<_> =
        strategy.program.knots().iter().map(|knot| (knot.depth_mm, knot.feed_mm_min).into()).collect();
    knots.push((end, strategy.program.feed_at(end)).into());
    let profile = Profile::new(ProfileInput {
        operation: "bushing-m8".try_into()?,
        tool_type: "paper".to_owned(),
        knots,
        sections: vec![
            SectionInput { kind: SectionKind::Heating, to_mm: 2.0 },
            SectionInput { kind: SectionKind::Forming, to_mm: end },
        ],
        limits: LimitsInput {
            feed_min_mm_min: 50.0,
            feed_max_mm_min: 1000.0,
            acceleration_mm_s2: 300.0,
            override_min_percent: 5.0,
            override_max_percent: 200.0,
            spindle_load_set_percent: Some(40.0),
            feed_drive_load_set_percent: Some(30.0),
        },
        wear: WearBandInput { from_level: None, to_level: 1.1 },
        conditions: Conditions::default(),
    })
    .map_err(|wrong| format!("{wrong:?}"))?;
    let twin =
        Twin::new(feedwright_core::friction::twin::TwinParams { noise: typical_noise(), ..paper_params() })?;
    println!(
        "| b | tool | feed moved by | time s | peak feed drive % | peak spindle % | s above L_set | s above 1.05·L_set |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for intensity in [2.0, 8.47] {
        for (tool, wear) in [("new", 0.0), ("worn (10 000 cycles)", 1.0)] {
            let setup = CycleSetup::new(PAPER_SPINDLE_RPM, wear);
            let holes: Vec<[Run; 4]> = (0..50)
                .map(|seed| closed_loop(&twin, &profile, intensity, &setup, Some(seed)))
                .collect::<Result<_, _>>()?;
            for way in 0..4 {
                let median = |of: fn(&Run) -> f64| {
                    let mut values: Vec<f64> = holes.iter().map(|runs| of(&runs[way])).collect();
                    values.sort_by(f64::total_cmp);
                    values[values.len() / 2]
                };
                let name = match holes[0][way].mover {
                    Mover::Profile => "nothing",
                    Mover::Law => "our law",
                    Mover::Polynomial => "the polynomial, to 200 %",
                    Mover::PolynomialLowering => "the polynomial, to 100 %",
                };
                println!(
                    "| {intensity} | {tool} | {name} | {:.2} | {:.1} | {:.1} | {:.2} | {:.2} |",
                    median(|run| run.duration_s),
                    median(|run| run.peak_feed_drive_percent),
                    median(|run| run.peak_spindle_percent),
                    median(|run| run.above_set_s),
                    median(|run| run.far_above_set_s),
                );
            }
        }
    }
    Ok(())
}
