//! Friction drilling over HTTP and on the command line: simulated, asked "what if", fitted, driven in step.

mod fit;
mod fleet;
mod history;
mod profiles;
mod simulate;
mod twin;
mod wear;

use crate::shop::{Shop, at};
use feedwright_core::friction::noise::Noise;
use feedwright_core::friction::program::Strategy;
use feedwright_core::friction::twin::{
    CycleSample, CycleSetup, PAPER_SPINDLE_RPM, Twin, TwinParams, paper_params, typical_noise,
};
use serde_json::{Value, json};

/// Registers the machine of the process model as `F1`.
async fn model_machine(shop: &Shop) {
    let body = json!({
        "name": "Friction drill", "control": "twin", "ipo_period_ms": 10,
        "spindle": {"reference": "rated_torque", "rated_power_watts": 7000, "base_speed_rpm": 6970},
        "feed_drive": {"reference": "rated_torque", "rated_thrust_newtons": 9000},
        "limits": {"feed_min_mm_min": 1, "feed_max_mm_min": 5000,
                   "override_min_percent": 5, "override_max_percent": 200},
    });
    assert_eq!(shop.put("/v1/machines/F1", &body).await.status, 201);
}

/// A hole of the process model as a machine would post it; with a dynamometer where `measured`.
fn drilled(number: i64, strategy: &Strategy, word: &str, measured: bool) -> Value {
    worn(number, strategy, word, measured, 0.0)
}

/// The same with a worn tool; 1.1 is the limit.
fn worn(number: i64, strategy: &Strategy, word: &str, measured: bool, wear: f64) -> Value {
    let twin = Twin::new(TwinParams { noise: typical_noise(), ..paper_params() }).unwrap();
    let setup = CycleSetup::new(PAPER_SPINDLE_RPM, wear);
    let mut noise = Noise::seeded(number.unsigned_abs());
    let (samples, _) = twin.record(strategy, &setup, Some(&mut noise)).unwrap();
    let column = |of: fn(&CycleSample) -> f64| samples.iter().map(of).collect::<Vec<f64>>();
    let mut columns = json!({
        "period_ms": 10,
        "depth_mm": column(|s| s.depth_mm),
        "feed_actual_mm_min": column(|s| s.feed_mm_min),
        "override_percent": column(|s| s.override_percent),
        "feed_drive_load_percent": column(|s| s.process.feed_drive_percent),
        "spindle_load_percent": column(|s| s.process.spindle_percent),
    });
    if measured {
        columns["thrust_newtons"] = json!(column(|s| s.process.thrust_n));
        columns["torque_newton_metres"] = json!(column(|s| s.process.torque_nm));
    }
    json!({
        "cycle_id": format!("c{number}"), "tool": "T1", "operation": "O1", "started_at": at(number),
        "strategy": word, "spindle_speed_rpm": PAPER_SPINDLE_RPM, "samples": columns,
    })
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}
