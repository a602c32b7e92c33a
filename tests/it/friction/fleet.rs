//! `feedwright simulate`: a shop of machines that drive a real server.

use crate::http::commands::binary;
use crate::shop::Shop;
use serde_json::Value;
use std::process::{Output, Stdio};
use tokio::process::Command;

async fn simulate(shop: &Shop, arguments: &[&str]) -> Output {
    let binary = tokio::task::spawn_blocking(binary).await.unwrap();
    Command::new(binary)
        .args(["simulate", "--server", &shop.address, "--until", "2026-05-04T06:30:00Z"])
        .args(arguments)
        .env("FEEDWRIGHT_TOKEN", &shop.admin)
        .output()
        .await
        .unwrap()
}

async fn simulated(shop: &Shop, arguments: &[&str]) -> Value {
    let output = simulate(shop, arguments).await;
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn count(report: &Value, group: &str, name: &str) -> u64 {
    report[group][name].as_u64().unwrap_or(0)
}

#[tokio::test]
async fn a_simulated_shop_wears_its_tools_out_has_faults_and_is_told_what_to_do() {
    let shop = Shop::open().await;
    let faults = "air_cut,nan_body,duplicate,late_replay";
    let report = simulated(
        &shop,
        &[
            "--machines",
            "2",
            "--cycles",
            "90",
            "--life",
            "40",
            "--strategy",
            "f_const",
            "--seed",
            "3",
            "--faults",
            faults,
            "--fault-share",
            "0.12",
        ],
    )
    .await;
    assert_eq!((report["machines"].as_u64(), report["cycles"].as_u64()), (Some(2), Some(180)), "{report}");
    assert!(count(&report, "tool_changes", "worn") >= 2, "each machine wears out a tool: {report}");
    for fault in faults.split(',') {
        assert!(count(&report, "faults", fault) > 0, "{fault}: {report}");
    }
    assert_eq!(count(&report, "faults", "nan_body"), count(&report, "outcomes", "quarantined"), "{report}");
    assert_eq!(count(&report, "faults", "duplicate"), count(&report, "outcomes", "known"), "{report}");
    assert_eq!(
        count(&report, "outcomes", "stored"),
        180 - count(&report, "faults", "nan_body"),
        "nothing is lost: {report}"
    );
    let quarantined = shop.get("/v1/quarantine?limit=1000").await;
    let kept = quarantined.body["items"].as_array().unwrap().len() as u64;
    assert_eq!(kept, count(&report, "faults", "nan_body"));
    let refused = simulate(&shop, &["--machines", "1", "--faults", "gremlins"]).await;
    assert!(!refused.status.success() && String::from_utf8_lossy(&refused.stderr).contains("air_cut"));
}

/// Under the adaptive law wear is masked: the machine is asked for reference cycles, runs them, and is told in time.
#[tokio::test]
async fn tools_under_the_adaptive_law_are_called_and_changed_in_time() {
    let shop = Shop::open().await;
    let report = simulated(
        &shop,
        &[
            "--machines",
            "3",
            "--cycles",
            "260",
            "--life",
            "100",
            "--strategy",
            "f_ac",
            "--seed",
            "5",
            "--tolerance",
            "0.15",
        ],
    )
    .await;
    let wear = &report["wear_at_change"];
    assert!(wear["tools"].as_u64().unwrap() >= 5, "{report}");
    assert_eq!(count(&report, "tool_changes", "overdue"), 0, "{report}");
    assert!(report["reference_cycles"].as_u64().unwrap() > 3 * 30, "{report}");
    let told = shop.get("/v1/tools/sim-tool-1/wear").await.body;
    assert_eq!(told["feed"]["references"]["every_cycles"], 4, "{told}");
    assert!(told["feed"]["references"]["count"].as_u64().unwrap() >= 5, "{told}");
    assert!(told["feed"]["masked_share"].as_f64().unwrap() < 0.5, "{told}");
    // What was judged is what a rebuild finds.
    let strict = simulate(
        &shop,
        &["--machines", "1", "--cycles", "20", "--life", "1000", "--strategy", "f_ac", "--tolerance", "0.1"],
    )
    .await;
    assert!(!strict.status.success(), "no tool was called worn, so nothing was shown");
}

#[tokio::test]
async fn broken_tools_are_noticed_and_thicker_sheets_are_no_wear() {
    let shop = Shop::open().await;
    let report = simulated(
        &shop,
        &[
            "--machines",
            "1",
            "--cycles",
            "70",
            "--life",
            "2000",
            "--strategy",
            "f_const",
            "--seed",
            "2",
            "--faults",
            "broken_tool",
            "--fault-share",
            "0.06",
        ],
    )
    .await;
    let broken = count(&report, "faults", "broken_tool");
    assert!(broken >= 1, "{report}");
    assert_eq!(count(&report, "tool_changes", "broken_suspected"), broken, "{report}");
    assert_eq!(count(&report, "tool_changes", "worn"), 0, "a broken tool is not worn: {report}");
    let shop = Shop::open().await;
    let report = simulated(
        &shop,
        &[
            "--machines",
            "1",
            "--cycles",
            "70",
            "--life",
            "150",
            "--strategy",
            "f_const",
            "--seed",
            "2",
            "--faults",
            "thickness",
            "--fault-share",
            "0.06",
        ],
    )
    .await;
    assert!(count(&report, "faults", "thickness") >= 1, "{report}");
    // A third more sheet needs as much more energy as a worn tool; where it opens tells them apart.
    assert_eq!(count(&report, "outcomes", "stored"), 70, "{report}");
    assert!(report["conditions_confirmed"].as_u64().unwrap() >= 1, "{report}");
    for why in ["broken_suspected", "worn"] {
        assert_eq!(count(&report, "tool_changes", why), 0, "{report}");
    }
}

#[tokio::test]
async fn a_shop_whose_cycles_are_refused_ends_in_an_error() {
    let shop = Shop::open().await;
    simulated(&shop, &["--machines", "2", "--cycles", "10", "--seed", "1"]).await;
    // The same ids with other contents.
    let other = simulate(&shop, &["--machines", "2", "--cycles", "10", "--seed", "2"]).await;
    let told = String::from_utf8_lossy(&other.stderr);
    assert!(!other.status.success(), "{told}");
    assert!(told.contains("20 of 20 cycles were refused") && told.contains("cycle_conflict"), "{told}");
    let report: Value = serde_json::from_slice(&other.stdout).unwrap();
    assert_eq!(count(&report, "outcomes", "quarantined"), 20, "what became of them is printed all the same");
}

/// The tokens that simulated machines were given, by name.
async fn tokens(shop: &Shop) -> Vec<Value> {
    let answer = shop.get("/v1/tokens?limit=1000").await;
    assert_eq!(answer.status, 200, "{}", answer.text);
    let named = |token: &&Value| token["name"].as_str().is_some_and(|name| name.starts_with("simulation of"));
    answer.body["items"].as_array().unwrap().iter().filter(named).cloned().collect()
}

/// Revokes a simulated machine's token as soon as it has one.
async fn revoke(shop: &Shop, name: &str) {
    for _ in 0..10_000 {
        if let Some(token) = tokens(shop).await.iter().find(|token| token["name"] == name) {
            let path = format!("/v1/tokens/{}", token["id"].as_str().unwrap());
            let answer = shop.send(shop.client.delete(shop.url(&path))).await;
            assert_eq!(answer.status, 200, "{}", answer.text);
            return;
        }
    }
    panic!("{name} was never made");
}

#[tokio::test]
async fn where_one_machine_fails_no_token_of_the_others_stays_behind() {
    let shop = Shop::open().await;
    // Without its token the second machine wears its tool out unheard, and cannot ask what to run with the next.
    let arguments = ["--machines", "2", "--cycles", "20000", "--life", "20"];
    let (output, ()) = tokio::join!(simulate(&shop, &arguments), revoke(&shop, "simulation of sim-2"));
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && told.contains("sim-2 stops"), "{told}");
    let tokens = tokens(&shop).await;
    assert_eq!(tokens.len(), 2, "{tokens:?}");
    assert!(tokens.iter().all(|token| token["revoked_at"].is_string()), "{tokens:?}");
}

#[tokio::test]
async fn a_shop_that_is_told_to_stop_leaves_no_token_behind() {
    let shop = Shop::open().await;
    let binary = tokio::task::spawn_blocking(binary).await.unwrap();
    let mut running = Command::new(binary)
        .args(["simulate", "--server", &shop.address, "--until", "2026-05-04T06:30:00Z"])
        .args(["--machines", "2", "--cycles", "20000", "--rate", "5"])
        .env("FEEDWRIGHT_TOKEN", &shop.admin)
        .spawn()
        .unwrap();
    while tokens(&shop).await.len() < 2 {
        assert!(running.try_wait().unwrap().is_none(), "it ended by itself");
    }
    let process = running.id().unwrap().to_string();
    assert!(Command::new("kill").args(["-INT", &process]).status().await.unwrap().success());
    assert!(!running.wait().await.unwrap().success(), "half a shift is none");
    let tokens = tokens(&shop).await;
    assert!(tokens.iter().all(|token| token["revoked_at"].is_string()), "{tokens:?}");
}

/// A terminal that was closed, or `head`: what is posted is posted, and no token stays behind.
#[tokio::test]
async fn a_replay_that_nobody_reads_goes_on_to_its_end() {
    let shop = Shop::open().await;
    let binary = tokio::task::spawn_blocking(binary).await.unwrap();
    let mut running = Command::new(binary)
        .args(["replay", "michigan-smart", "--url", &shop.address, "--report"])
        .env("FEEDWRIGHT_TOKEN", &shop.admin)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop((running.stdout.take(), running.stderr.take()));
    let ended = running.wait().await.unwrap();
    assert!(ended.success(), "{ended}");
    let made = shop.get("/v1/tokens?limit=1000").await;
    let replays = |token: &&Value| token["name"] == "replay of michigan-smart";
    let replays = made.body["items"].as_array().unwrap().iter().filter(replays);
    let revoked: Vec<bool> = replays.map(|token| token["revoked_at"].is_string()).collect();
    assert_eq!(revoked, [true], "{}", made.text);
}

#[tokio::test]
async fn a_rate_is_kept() {
    let shop = Shop::open().await;
    let began = std::time::Instant::now();
    let report = simulated(&shop, &["--machines", "2", "--cycles", "10", "--rate", "20"]).await;
    // Twenty cycles at twenty a second: the first two at once, so nine tenths of a second at the least.
    assert!(began.elapsed().as_secs_f64() >= 0.85, "{report}");
    assert!(report["cycles_per_second"].as_f64().unwrap() <= 23.0, "{report}");
    for rate in ["0", "-1", "NaN", "inf", "1e-300"] {
        let refused = simulate(&shop, &["--machines", "1", &format!("--rate={rate}")]).await;
        assert!(!refused.status.success(), "{rate}");
    }
}
