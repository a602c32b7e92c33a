//! `feedwright simulate`: a shop of machines that drive a real server.

use crate::http::commands::binary;
use crate::shop::Shop;
use serde_json::Value;
use tokio::process::Command;

#[tokio::test]
async fn a_simulated_shop_wears_its_tools_out_has_faults_and_is_told_what_to_do() {
    let binary = tokio::task::spawn_blocking(binary).await.unwrap();
    let shop = Shop::open().await;
    let faults = "air_cut,nan_body,duplicate,late_replay";
    let output = Command::new(binary)
        .args(["simulate", "--server", &shop.address, "--machines", "2", "--cycles", "90", "--life", "40"])
        .args(["--strategy", "f_const", "--seed", "3", "--faults", faults, "--fault-share", "0.12"])
        .args(["--until", "2026-05-04T06:30:00Z"])
        .env("FEEDWRIGHT_TOKEN", &shop.admin)
        .output()
        .await
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let count = |group: &str, name: &str| report[group][name].as_u64().unwrap_or(0);
    assert_eq!((report["machines"].as_u64(), report["cycles"].as_u64()), (Some(2), Some(180)), "{report}");
    assert!(count("tool_changes", "worn") >= 2, "each machine wears out a tool: {report}");
    assert_eq!(count("faults", "nan_body"), count("outcomes", "quarantined"), "{report}");
    assert_eq!(count("faults", "duplicate"), count("outcomes", "known"), "{report}");
    assert_eq!(count("outcomes", "stored"), 180 - count("faults", "nan_body"), "nothing is lost: {report}");
    let quarantined = shop.get("/v1/quarantine?limit=1000").await;
    let kept = quarantined.body["items"].as_array().unwrap().len() as u64;
    assert_eq!(kept, count("faults", "nan_body"));
    let refused = Command::new(binary)
        .args(["simulate", "--server", &shop.address, "--machines", "1", "--faults", "gremlins"])
        .env("FEEDWRIGHT_TOKEN", &shop.admin)
        .output()
        .await
        .unwrap();
    assert!(!refused.status.success() && String::from_utf8_lossy(&refused.stderr).contains("air_cut"));
}
