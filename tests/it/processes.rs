//! The other processes over HTTP: turning, plunging and vibratory drilling, their library and their jobs.

mod jobs;
mod library;
mod plunging;
mod recommended;
mod turning;
mod vibratory;

use crate::shop::{Answer, Shop};
use serde_json::{Value, json};

/// The paper's job (Alaskari & Oraby 2017).
fn papers_job() -> Value {
    json!({
        "model": {"id": "alaskari-oraby-2017"}, "depth_mm": 2.5,
        "limits": {"power_kw": 7.0, "force_n": 1500.0, "wear_mm": 0.3}, "domain": papers_grid(),
        "economics": {"tool_change_min": 1.0, "machine_cost_per_min": 1.0},
    })
}

fn papers_grid() -> Value {
    json!({"grid": {"speed_m_min": {"min": 50, "max": 200, "step": 10},
                    "feed_mm_rev": {"min": 0.06, "max": 0.6, "step": 0.005}}})
}

fn pair(interval: &Value) -> (f64, f64) {
    (interval["speed_m_min"].as_f64().unwrap(), interval["feed_mm_rev"].as_f64().unwrap())
}

/// The first violation of a refusal: its code and path.
fn refusal(answer: &Answer) -> (String, String) {
    assert_eq!(answer.status, 422, "{}", answer.text);
    assert_eq!(answer.headers["content-type"], "application/problem+json");
    let text = |name: &str| answer.body["errors"][0][name].as_str().unwrap_or_default().to_owned();
    (text("code"), text("path"))
}

/// Posts a body as it stands and expects that refusal.
async fn refuses(shop: &Shop, path: &str, body: &str, code: &str, field: &str) {
    let answer = shop.post_raw(path, "application/json", body.to_owned()).await;
    assert_eq!(refusal(&answer), (code.to_owned(), field.to_owned()), "{body}: {}", answer.text);
}
