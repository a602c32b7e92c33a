//! The server dies without a word, in mid-cycle and right after a commit: the machine sends again, nothing doubles.

use super::client::Machine;
use crate::http::commands::{Served, first_token};
use serde_json::{Value, json};
use std::net::SocketAddr;
use tempfile::TempDir;

/// Starts the binary and reads its log to the line that holds `until`; where it listens.
fn started(dir: &TempDir, until: &str) -> (Served, SocketAddr) {
    let served = Served::start(dir, until);
    let address = served.address();
    (served, address)
}

struct Shop {
    client: reqwest::Client,
    token: String,
}

impl Shop {
    async fn send(&self, address: SocketAddr, method: &str, path: &str, body: Option<Value>) -> Value {
        let method = reqwest::Method::from_bytes(method.as_bytes()).unwrap();
        let mut request =
            self.client.request(method, format!("http://{address}{path}")).bearer_auth(&self.token);
        if let Some(body) = body {
            request = request.json(&body);
        }
        let answer = request.send().await.unwrap();
        assert!(answer.status().is_success(), "{path}: {}", answer.status());
        answer.json().await.unwrap()
    }
}

async fn connect(address: SocketAddr, token: &str) -> Machine {
    Machine::open_at(address, "M1", token, "feedwright.v1", &[]).await.expect("the stream opens")
}

#[tokio::test]
async fn after_kill_9_the_machine_sends_again_and_nothing_doubles() {
    let dir = TempDir::new().unwrap();
    let (server, address) = started(&dir, "make others");
    // No server of this process has chosen it.
    feedwright_server::tls::use_ring();
    let client = reqwest::Client::builder().no_proxy().build().unwrap();
    let shop = Shop { client, token: first_token(&server.log) };
    let limits = json!({"feed_min_mm_min": 1.0, "feed_max_mm_min": 3000.0,
                        "override_min_percent": 20.0, "override_max_percent": 150.0});
    let machine = json!({"name": "M1", "control": "linuxcnc", "ipo_period_ms": 10.0, "limits": limits,
                         "spindle": {"reference": "rated_power", "rated_power_watts": 7000.0},
                         "feed_drive": {"reference": "rated_torque", "rated_thrust_newtons": 8000.0}});
    shop.send(address, "PUT", "/v1/machines/M1", Some(machine)).await;
    shop.send(
        address,
        "PUT",
        "/v1/tools/T1",
        Some(json!({"name": "FD M8", "tool_type": "friction-drill-7.3"})),
    )
    .await;
    let operation = json!({"name": "Bushing", "process": "friction", "programmed_feed_mm_min": 150.0,
                           "feed_drive_load_set_percent": 30.0, "spindle_load_set_percent": 40.0});
    shop.send(address, "PUT", "/v1/operations/O1", Some(operation)).await;
    let named = json!({"name": "M1", "role": "machine", "machine": "M1"});
    let made = shop.send(address, "POST", "/v1/tokens", Some(named)).await;
    let token = made["token"].as_str().unwrap();

    // One cycle is committed, the next one is half way.
    let mut machine = connect(address, token).await;
    machine.start("c1", json!({})).await;
    machine.samples(0, 20).await;
    let first = machine.end(20).await;
    assert_eq!(first["status"], 201, "{first}");
    machine.start("c2", json!({"seq": 8})).await;
    machine.samples(0, 12).await;
    server.kill();

    let (server, address) = started(&dir, "listening");
    let mut machine = connect(address, token).await;
    // The answer to the committed one was lost on its way, for all that the machine knows.
    let resend = |seq: u32| json!({"resend": true, "seq": seq, "in_force_percent": 90.0});
    let asked = machine.ask(json!({"type": "resume", "cycle_id": "c1"})).await;
    assert_eq!(asked["restart_from"], 0, "{asked}");
    let begun = machine.start("c1", resend(7)).await;
    assert!(super::client::codes(&begun["reasons"]).contains(&"restarted"), "{begun}");
    let old = machine.samples(0, 20).await;
    assert!(old["override_percent"].as_f64().unwrap() <= 100.0, "{old}");
    let known = machine.end(20).await;
    assert_eq!((&known["status"], &known["answer"]["status"]), (&json!(200), &json!("known")), "{known}");
    assert_eq!(known["answer"]["summary"], first["answer"]["summary"]);

    let asked = machine.ask(json!({"type": "resume", "cycle_id": "c2"})).await;
    assert_eq!(asked["restart_from"], 0, "{asked}");
    machine.start("c2", resend(8)).await;
    machine.samples(0, 30).await;
    assert_eq!(machine.end(30).await["status"], 201);
    server.kill();

    let (server, address) = started(&dir, "listening");
    let cycles = shop.send(address, "GET", "/v1/cycles?machine=M1", None).await;
    let mut told: Vec<_> = cycles["items"]
        .as_array()
        .unwrap()
        .iter()
        .map(|cycle| {
            (cycle["cycle_id"].as_str().unwrap(), cycle["summary"]["sample_count"].as_u64().unwrap())
        })
        .collect();
    told.sort_unstable();
    assert_eq!(told, [("c1", 20), ("c2", 30)]);
    let tool = shop.send(address, "GET", "/v1/tools/T1/wear", None).await;
    assert_eq!(tool["cycles"], 2, "each counts once: {tool}");
    server.kill();
}
