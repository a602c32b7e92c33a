//! Plunges and vibrations over the same stream.

use super::client::{Came, Machine, codes};
use crate::live::Served;
use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::Message;

#[tokio::test]
async fn a_plunge_is_told_its_feeds_by_what_the_load_says() {
    let served = Served::start(&[]).await;
    served.with_a_shop().await;
    served
        .put(
            "/v1/models/plunge/steel",
            json!({"name": "steel", "thrust": {"coefficient": 680.0, "diameter_exponent": 1.0, "feed_exponent": 0.7, "correction": 1.0},
                   "torque": {"coefficient": 345.0, "diameter_exponent": 2.0, "feed_exponent": 0.8, "correction": 1.0}}),
        )
        .await;
    served
        .put(
            "/v1/operations/P1",
            json!({"name": "Plunge", "process": "plunge", "programmed_feed_mm_min": 120.0, "plunge": {
                "material": "steel",
                "drill": {"diameter_mm": 8.0, "length_mm": 80.0, "spindle_rpm": 1200.0},
                "latency": {"allowed_bite_mm": 0.5, "detector_samples": 4, "sample_period_s": 0.01, "answer_age_s": 0.02}}}),
        )
        .await;
    let token = served.machine_token("M1").await;
    let mut machine = Machine::connect(&served, &token).await;
    let channels = json!({"operation": "P1", "program": null, "strategy": null,
                          "channels": ["depth_mm", "feed_actual_mm_min", "feed_drive_load_percent"]});
    machine.start("c1", channels).await;
    let mut next = 0_u64;
    let mut at = async |machine: &mut Machine, depth: f64, load: f64, count: usize| -> Value {
        let deeper: Vec<f64> = (0..count).map(|k| depth + 0.01 * k as f64).collect();
        let message = json!({"type": "samples", "first": next, "depth_mm": deeper,
                             "feed_actual_mm_min": vec![500.0; count], "feed_drive_load_percent": vec![load; count]});
        next += count as u64;
        machine.ask(message).await
    };
    let learning = at(&mut machine, -10.0, 3.0, 1).await;
    assert_eq!(
        (&learning["plunge"]["phase"], &learning["plunge"]["feed_mm_min"]),
        (&json!("work"), &json!(120.0))
    );
    assert!(codes(&learning["reasons"]).contains(&"idle_unknown"));
    let approach = at(&mut machine, -8.0, 3.0, 25).await;
    assert_eq!(approach["plunge"]["phase"], "approach", "{approach}");
    let feed = approach["plunge"]["feed_mm_min"].as_f64().unwrap();
    assert!(feed > 120.0 && feed <= 500.0 + 1e-9, "0.5 mm within 60 ms, the machine and the drill: {feed}");
    assert!(approach["plunge"]["bite_mm"].as_f64().unwrap() <= 0.5 + 1e-9);
    let work = at(&mut machine, 0.2, 30.0, 6).await;
    assert_eq!((&work["plunge"]["phase"], &work["plunge"]["feed_mm_min"]), (&json!("work"), &json!(120.0)));
    assert_eq!(work["plunge"]["contact_offset_mm"], 0.2);
    let through = at(&mut machine, 9.0, 3.0, 6).await;
    assert_eq!(
        (&through["plunge"]["phase"], &through["plunge"]["feed_mm_min"]),
        (&json!("retract"), &json!(120.0))
    );
    let back = at(&mut machine, 8.0, 3.0, 1).await;
    assert_eq!(
        (&back["plunge"]["phase"], &back["plunge"]["feed_mm_min"]),
        (&json!("retract"), &json!(3000.0))
    );
    assert_eq!(through["override_percent"], 100.0);
    assert_eq!(machine.end(39).await["status"], 201);
    served.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn blocks_of_vibration_are_answered_with_gain_amplitude_and_frequency() {
    let served = Served::start(&[]).await;
    served.with_a_shop().await;
    let token = served.machine_token("M1").await;
    let mut machine = Machine::connect(&served, &token).await;
    let wave = |n: u32| {
        let phase = std::f64::consts::TAU * 70.0 * f64::from(n) * 300e-6;
        (20.0 * phase.cos(), -20.0 * std::f64::consts::TAU * 70.0 * phase.sin())
    };
    let block = |from: u32, count: u32| {
        let (v, a): (Vec<_>, Vec<_>) = (from..from + count).map(wave).unzip();
        json!({"type": "vibration", "first": from, "velocity_mm_s": v, "acceleration_mm_s2": a})
    };
    assert_eq!(machine.ask(block(0, 10)).await["code"], "no_monitor");
    assert_eq!(machine.ask(json!({"type": "monitor"})).await["type"], "monitoring");
    let first = machine.ask(block(0, 1000)).await;
    assert_eq!((&first["type"], &first["next"]), (&json!("gain"), &json!(1000)));
    assert!((first["frequency_hz"].as_f64().unwrap() - 70.0).abs() < 0.5, "{first}");
    // Peak to peak 2·v/ω.
    let expected = 2.0 * 20.0 / (std::f64::consts::TAU * 70.0);
    assert!((first["amplitude_mm"].as_f64().unwrap() / expected - 1.0).abs() < 0.02, "{first}");
    assert!((-1.0..=1.0).contains(&first["gain"].as_f64().unwrap()));
    let gap = machine.ask(block(2000, 10)).await;
    assert!(codes(&gap["reasons"]).contains(&"missing_samples"));

    let mut bytes = vec![0x02, 0, 2, 0, 9, 0, 0, 0];
    bytes.extend(2010_u32.to_le_bytes());
    for value in [1.0_f32, 2.0, 3.0, 4.0] {
        bytes.extend(value.to_le_bytes());
    }
    machine.send(Message::Binary(bytes.into())).await;
    let Came::Binary(answer) = machine.came().await else { panic!("a binary answer") };
    assert_eq!((answer[0], answer.len(), &answer[8..12]), (0x82, 64, &9_u32.to_le_bytes()[..]));
    let refused = machine.ask(json!({"type": "monitor", "settings": {
        "eigenfrequency_hz": 70.86, "period_s": 1.0, "target_mm": 0.06, "deviation_gain": 1.0, "rate_gain": 1.0,
        "time_constant_s": 0.07, "low_share": 0.2, "high_share": 0.2, "frequency_share": 0.3}})).await;
    assert_eq!(refused["errors"][0]["path"], "settings.period_s", "{refused}");
    served.server.shutdown().await.unwrap();
}
