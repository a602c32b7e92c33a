//! What was acknowledged is there after a restart, and goes on.

use super::{Shop, reported};
use serde_json::json;

use std::time::Duration;

crate::engines::on_both!(
    a_restart_loses_nothing_and_goes_on_to_the_bit,
    metrics_say_how_worn_a_tool_is_before_a_cycle_comes,
    folds_of_earlier_rules_are_made_anew_while_the_server_runs,
);

async fn a_restart_loses_nothing_and_goes_on_to_the_bit() {
    let shop = Shop::open().await;
    for number in 1..=7 {
        assert_eq!(shop.cycle("M1", &reported(number, 1000.0 + number as f64)).await.status, 201);
    }
    let before = shop.get("/v1/tools/T1/wear").await.text;
    let shop = shop.restart().await;
    assert_eq!(shop.get("/v1/tools/T1/wear").await.text, before);
    assert_eq!(shop.cycle("M1", &reported(7, 1007.0)).await.status, 200);
    assert_eq!(shop.cycle("M1", &reported(8, 1008.0)).await.body["wear"]["counted"], json!(8));
}

async fn metrics_say_how_worn_a_tool_is_before_a_cycle_comes() {
    let shop = Shop::open().await;
    for number in 1..=6 {
        assert_eq!(shop.cycle("M1", &reported(number, 1000.0)).await.status, 201);
    }
    let level = "feedwright_tool_wear_level_ratio{machine=\"M1\"} 1\n";
    let shop = shop.restart().await;
    // The watch makes its first round when the server starts.
    assert!(becomes(&shop, |text| text.contains(level)).await, "no cycle has come since");
}

/// Whether the metrics come to hold.
async fn becomes(shop: &Shop, holds: impl Fn(&str) -> bool) -> bool {
    for _ in 0..200 {
        if holds(&shop.get("/metrics").await.text) {
            return true;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    false
}

async fn folds_of_earlier_rules_are_made_anew_while_the_server_runs() {
    let mut shop = Shop::open().await;
    for number in 1..=7 {
        assert_eq!(shop.cycle("M1", &reported(number, 1000.0 + number as f64)).await.status, 201);
    }
    let before = shop.get("/v1/tools/T1/wear").await.text;
    let outdated = format!("fold_version < {}", feedwright_core::wear::FOLD_VERSION);
    assert_eq!(shop.count("tool_wear", &outdated).await, 0);
    // By two servers' time: the version before stops, this one starts.
    shop.stop().await;
    shop.tables("UPDATE tool_wear SET fold_version = fold_version - 1").await;
    assert_eq!(shop.count("tool_wear", &outdated).await, 1);
    let shop = shop.restart().await;
    let mut left = 1;
    for _ in 0..200 {
        left = shop.count("tool_wear", &outdated).await;
        if left == 0 {
            break;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    assert_eq!(left, 0, "nobody has asked for the tool, nor run it");
    assert_eq!(shop.get("/v1/tools/T1/wear").await.text, before);
    assert_eq!(shop.cycle("M1", &reported(8, 1008.0)).await.body["wear"]["counted"], json!(8));
}
