//! Whole cycles: answered sample by sample, stored as a post would have been.

use super::client::{Came, Machine, PATIENCE, codes, frame, posted};
use crate::live::{Served, reader::Reader};
use serde_json::{Value, json};
use sqlx::{ConnectOptions, Connection};
use tokio_tungstenite::tungstenite::Message;

/// The law acts from the first sample, so that a story is short.
const NO_HEATING: (&str, &str) = ("stream.heating_ms", "0");

async fn shop(settings: &[(&str, &str)]) -> (Served, String) {
    let settings = [&[NO_HEATING], settings].concat();
    let served = Served::start(&settings).await;
    served.with_a_shop().await;
    let token = served.machine_token("M1").await;
    (served, token)
}

#[tokio::test]
async fn a_streamed_cycle_is_answered_sample_by_sample_and_stored_as_the_posted_one() {
    let (served, token) = shop(&[]).await;
    let mut machine = Machine::connect(&served, &token).await;
    let started = machine.start("c1", json!({})).await;
    assert_eq!((&started["type"], &started["override_percent"]), (&json!("started"), &json!(100.0)));
    assert_eq!(started["override_range_percent"], json!([20.0, 150.0]));
    assert_eq!((&started["mode"], &started["law_version"]), (&json!("advise"), &json!("fac-2")));
    assert_eq!(started["program_hash"].as_str().unwrap().len(), 64);

    let mut before = 100.0;
    let mut highest = 100.0_f64;
    for from in (0..40).step_by(4) {
        let answer = machine.samples(from, from + 4).await;
        let each = answer["each"].as_array().unwrap();
        assert_eq!((each.len(), &answer["next"]), (4, &json!(from + 4)));
        for advice in each {
            let percent = advice["override_percent"].as_f64().unwrap();
            assert!((20.0..=150.0).contains(&percent) && percent <= before + 5.0, "{before} to {percent}");
            assert!(!codes(&advice["reasons"]).is_empty());
            before = percent;
        }
        assert_eq!(answer["override_percent"], each[3]["override_percent"]);
        assert_eq!((&answer["quality"], &answer["valid_for_ms"]), (&json!("good"), &json!(500)));
        assert!(answer["age_ms"].as_f64().unwrap() < 500.0 && answer["valid_until"].is_string());
        highest = highest.max(before);
    }
    assert!(highest > 110.0 && before < highest, "it rose to {highest} and fell to {before}");

    let stored = machine.end(40).await;
    assert_eq!((&stored["type"], &stored["status"]), (&json!("stored"), &json!(201)), "{stored}");
    // A post of the same cycle is known, and answered with the same summary, wear and advice.
    let (status, known) = served.send("POST", "/v1/machines/M1/cycles", Some(posted("c1", 40))).await;
    assert_eq!((status, &known["status"]), (200, &json!("known")));
    for part in ["summary", "wear", "machine", "cycle_id", "received_at", "registered"] {
        assert_eq!(stored["answer"][part], known[part], "{part}");
    }
    for field in ["action", "override_percent", "tool_state"] {
        assert_eq!(stored["answer"]["recommendation"][field], known["recommendation"][field], "{field}");
    }
    // What was answered is kept beside the cycle; asking for the end again is asking for its answer.
    let kept = served.get("/v1/machines/M1/cycles/c1/overrides").await;
    assert_eq!((kept["override_percent"].as_array().unwrap().len(), &kept["mode"]), (40, &json!("advise")));
    assert_eq!(kept["override_percent"][39], json!(before));
    let again = machine.ask(json!({"type": "end", "cycle_id": "c1"})).await;
    assert_eq!((&again["status"], &again["answer"]), (&stored["status"], &stored["answer"]));
    served.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn text_and_binary_end_in_the_same_cycle_and_the_same_overrides() {
    let mut ends = Vec::new();
    for binary in [false, true] {
        let (served, token) = shop(&[]).await;
        let mut machine = Machine::connect(&served, &token).await;
        machine.start("c1", json!({"decimals": [3, 1, 1]})).await;
        let mut last = Value::Null;
        for from in (0..40).step_by(5) {
            if binary {
                machine.send(Message::Binary(frame(99, from, from + 5).into())).await;
                let Came::Binary(answer) = machine.came().await else { panic!("a binary answer") };
                assert_eq!((answer[0], answer[1] & 1, answer.len()), (0x81, 1, 48 + 5 * 16));
                assert_eq!(answer[8..12], 99_u32.to_le_bytes());
                last = f64::from_le_bytes(answer[40..48].try_into().unwrap()).into();
            } else {
                last = machine.samples(from, from + 5).await["override_percent"].clone();
            }
        }
        assert_eq!(machine.end(40).await["status"], 201);
        let cycle = served.get("/v1/machines/M1/cycles/c1").await;
        let kept = served.get("/v1/machines/M1/cycles/c1/overrides").await;
        ends.push((
            cycle["content_hash"].clone(),
            kept["override_percent"].clone(),
            kept["reasons"].clone(),
            last,
        ));
        served.server.shutdown().await.unwrap();
    }
    assert_eq!(ends[0], ends[1]);
}

#[tokio::test]
async fn in_shadow_the_override_is_computed_and_stored_but_not_told() {
    let (served, token) = shop(&[("stream.advise", "false")]).await;
    let mut machine = Machine::connect(&served, &token).await;
    let started = machine.start("c1", json!({"mode": "advise"})).await;
    assert_eq!(started["mode"], "shadow", "a server that only watches never advises");
    let answer = machine.samples(0, 10).await;
    assert!(answer.get("override_percent").is_none() && answer["each"][9].get("override_percent").is_none());
    assert!(codes(&answer["reasons"]).contains(&"load_below_set"));
    machine.send(Message::Binary(frame(5, 10, 12).into())).await;
    let Came::Binary(bytes) = machine.came().await else { panic!("a binary answer") };
    assert!(bytes[1] & 1 == 0 && f64::from_le_bytes(bytes[40..48].try_into().unwrap()).is_nan());
    machine.end(12).await;
    let kept = served.get("/v1/machines/M1/cycles/c1/overrides").await;
    assert_eq!(kept["mode"], "shadow");
    assert!(kept["override_percent"][11].as_f64().unwrap() > 110.0);
    served.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn every_break_of_the_sequence_is_answered_with_its_reason_and_never_raises() {
    let (served, token) = shop(&[]).await;
    let mut machine = Machine::connect(&served, &token).await;
    machine.start("c1", json!({})).await;
    let first = machine.samples(0, 5).await;
    let raised = first["override_percent"].as_f64().unwrap();
    assert!(raised > 110.0);
    let again = machine.samples(0, 5).await;
    assert_eq!(again["each"][4]["override_percent"], first["each"][4]["override_percent"]);
    assert!(codes(&again["each"][0]["reasons"]).contains(&"repeated"));
    assert_eq!(again["valid_until"], first["valid_until"], "a repeat does not live longer");
    let gap = machine.samples(8, 9).await;
    assert!(codes(&gap["reasons"]).contains(&"missing_samples"));
    assert_eq!(gap["override_percent"], 100.0);
    let late = machine.samples(5, 8).await;
    assert!(codes(&late["each"][0]["reasons"]).contains(&"out_of_order"));
    let mut other = super::client::samples(2, 3);
    other["depth_mm"] = json!([9.9]);
    let differs = machine.ask(other).await;
    assert!(codes(&differs["reasons"]).contains(&"repeat_differs"));
    let mut missing = super::client::samples(9, 10);
    missing["spindle_load_percent"] = json!([null]);
    let missing = machine.ask(missing).await;
    assert!(codes(&missing["reasons"]).contains(&"not_finite_load"), "{missing}");
    assert_eq!(missing["quality"], "missing");
    for (text, code) in [
        ("{", "malformed_json"),
        (r#"{"type":"samples","n":70,"first":10,"depth_mm":[NaN]}"#, "not_finite"),
        (
            r#"{"type":"samples","n":71,"first":10,"depth_mm":[1,2],"spindle_load_percent":[1]}"#,
            "length_mismatch",
        ),
        (r#"{"type":"samples","n":72,"first":10,"thrust_newtons":[1]}"#, "unknown_channel"),
        (r#"{"type":"samples","n":73,"first":10}"#, "empty"),
        (r#"{"type":"samples","n":74,"first":10,"time_ms":1,"depth_mm":1}"#, "contradictory"),
    ] {
        let answer = machine.ask_text(text).await;
        assert_eq!((&answer["type"], &answer["code"]), (&json!("error"), &json!(code)), "{answer}");
        assert_eq!(answer["standing"]["override_percent"], 100.0, "{answer}");
        assert!(codes(&answer["standing"]["reasons"]).contains(&"malformed"));
    }
    // The end finds everything but the sample that had no load; a hole that is left would be named.
    let far = machine.samples(12, 13).await;
    assert!(codes(&far["reasons"]).contains(&"missing_samples"));
    let holes = machine.end(13).await;
    assert_eq!((&holes["code"], &holes["status"]), (&json!("samples_missing"), &json!(409)));
    assert!(holes["detail"].as_str().unwrap().contains("sample 10 "), "{holes}");
    machine.samples(10, 12).await;
    let stored = machine.end(13).await;
    assert_eq!(stored["answer"]["summary"]["sample_count"], 12, "{stored}");
    served.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn old_samples_get_no_override_and_neither_do_those_ahead_of_time() {
    let (served, token) = shop(&[]).await;
    let mut machine = Machine::connect(&served, &token).await;
    // Sent again ten seconds after its start: nothing of the first nine is of now.
    let late = json!({"resend": true, "sent_at": "2026-05-04T06:00:10Z", "in_force_percent": 70.0});
    let started = machine.start("c1", late).await;
    assert_eq!(started["override_percent"], 70.0);
    assert!(codes(&started["reasons"]).contains(&"restarted"));
    let old = machine.samples(0, 20).await;
    assert!(codes(&old["reasons"]).contains(&"too_old") && old["quality"] == "stale");
    assert_eq!(old["override_percent"], 70.0, "below 100 it stays");
    let mut message = super::client::samples(20, 21);
    message["first"] = 2000.into();
    let ahead = machine.ask(message).await;
    assert!(codes(&ahead["reasons"]).contains(&"from_future"), "{ahead}");
    served.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn what_a_start_must_not_say_is_named_and_what_is_not_known_keeps_neutral() {
    let (served, token) = shop(&[]).await;
    let mut machine = Machine::connect(&served, &token).await;
    let refused = machine
        .start(
            "c 1",
            json!({"channels": ["depth_mm", "depth"], "period_ms": 0.0, "in_force_percent": 70.0, "law_version": "a\u{0}"}),
        )
        .await;
    assert_eq!((&refused["type"], &refused["code"]), (&json!("error"), &json!("invalid_content")));
    let paths: Vec<_> =
        refused["errors"].as_array().unwrap().iter().map(|e| e["path"].as_str().unwrap()).collect();
    for path in ["cycle_id", "channels[1]", "period_ms", "in_force_percent", "law_version"] {
        assert!(paths.contains(&path), "{path}: {refused}");
    }
    let knots = json!({"program": {"between": "linear", "knots": [{"depth_mm": 0.0, "feed_mm_min": -1.0}]}});
    let refused = machine.start("c1", knots).await;
    assert_eq!(refused["errors"][0]["path"], "program.knots[0].feed_mm_min", "{refused}");
    assert_eq!(machine.ask(json!({"type": "samples", "first": 0, "depth_mm": 1})).await["code"], "no_cycle");
    assert_eq!(machine.end(0).await["code"], "no_cycle");

    for (id, change, reason) in [
        ("a", json!({"program": null}), "no_program"),
        ("b", json!({"program": null, "profile": {"id": "P1", "version": 1}}), "profile_not_active"),
        ("c", json!({"tool": "T9"}), "tool_unregistered"),
        ("d", json!({"operation": "O9"}), "operation_unregistered"),
    ] {
        let started = machine.start(id, change).await;
        assert!(codes(&started["reasons"]).contains(&reason), "{started}");
        let answer = machine.samples(0, 10).await;
        assert_eq!(answer["override_percent"], 100.0);
        assert!(codes(&answer["reasons"]).contains(&reason), "{answer}");
        assert_eq!(machine.end(10).await["status"], 201, "it is stored all the same");
    }
    served.server.shutdown().await.unwrap();
}

fn load(from: u64, count: usize, load: f64) -> Value {
    json!({"type": "samples", "first": from, "depth_mm": vec![1.0; count],
           "spindle_load_percent": vec![load; count], "feed_drive_load_percent": vec![5.0; count]})
}

/// Samples are judged however long the story takes, and however fast it sends what a machine would take half a second for.
const OVERLOADS: [(&str, &str); 2] =
    [("stream.overload_relative_load", "1.5"), ("stream.sample_age_limit_ms", "60000")];

/// The machine's open alarms, once there are so many: an overload is raised in a task of its own, and the list has it as
/// soon as it is committed.
async fn open_alarms(served: &Served, count: usize) -> Vec<Value> {
    let raised = async {
        loop {
            let mut open = served.get("/v1/alarms?open=true&machine=M1").await;
            if let Value::Array(alarms) = open["items"].take()
                && alarms.len() == count
            {
                return alarms;
            }
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(PATIENCE, raised).await.expect("it is raised")
}

#[tokio::test]
async fn an_overload_raises_an_alarm_and_holds_until_it_is_acknowledged() {
    let (served, token) = shop(&OVERLOADS).await;
    let mut machine = Machine::connect(&served, &token).await;
    machine.start("c1", json!({})).await;
    let overload = machine.ask(load(0, 10, 90.0)).await;
    assert_eq!(overload["overload"], true);
    assert!(codes(&overload["reasons"]).contains(&"overload"));
    let held = machine.ask(load(10, 30, 5.0)).await;
    let percent = held["override_percent"].as_f64().unwrap();
    assert!(codes(&held["reasons"]).contains(&"overload_held") && percent < 100.0, "{held}");
    assert_eq!(open_alarms(&served, 1).await[0]["kind"], "overload");
    let (status, _) = served.send("POST", "/v1/machines/M1/acknowledge", None).await;
    assert_eq!(status, 200);
    let freed = machine.ask(load(40, 5, 5.0)).await;
    assert_eq!(freed["overload"], false);
    assert!(freed["override_percent"].as_f64().unwrap() > percent, "{freed}");
    // An overload that nobody acknowledges outlasts its cycle.
    let again = machine.ask(load(45, 10, 90.0)).await;
    assert_eq!(again["overload"], true, "{again}");
    assert_eq!(machine.end(55).await["status"], 201);
    let started = machine.start("c2", json!({})).await;
    assert!(codes(&started["reasons"]).contains(&"overload_unacknowledged"), "{started}");
    let neutral = machine.ask(load(0, 10, 5.0)).await;
    assert_eq!(neutral["override_percent"], 100.0, "{neutral}");
    let (status, _) = served.send("POST", "/v1/machines/M1/acknowledge", None).await;
    assert_eq!(status, 200);
    let freed = machine.ask(load(10, 5, 5.0)).await;
    assert!(freed["override_percent"].as_f64().unwrap() > 100.0, "{freed}");
    served.server.shutdown().await.unwrap();
}

/// Tools that were thrown away as they were worn are worn for ever.
#[tokio::test]
async fn an_overload_holds_however_many_older_alarms_of_its_machine_are_open() {
    const WORN: &str = "WITH RECURSIVE series (n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM series WHERE n < 1200)
        INSERT INTO alarms (kind, machine_id, tool_id, message, raised_at_us) SELECT 'worn', 'M1', 'W' || n, 'worn', n FROM series";
    const OTHER: &str = "INSERT INTO alarms (kind, machine_id, tool_id, message, raised_at_us) VALUES ('overload', 'M1', 'T7', 'another', 1)";
    let dir = tempfile::TempDir::new().unwrap();
    let settings = [&[NO_HEATING], &OVERLOADS[..]].concat();
    let served = Served::start_in(dir.path(), None, &settings).await;
    served.with_a_shop().await;
    let token = served.machine_token("M1").await;
    let mut machine = Machine::connect(&served, &token).await;
    machine.start("c1", json!({})).await;
    let file = dir.path().join("data/feedwright.sqlite3");
    let mut tables = sqlx::sqlite::SqliteConnectOptions::new().filename(file).connect().await.unwrap();
    for alarms in [OTHER, WORN] {
        sqlx::query(alarms).execute(&mut tables).await.unwrap();
    }
    tables.close().await.unwrap();

    assert_eq!(machine.ask(load(0, 10, 90.0)).await["overload"], true);
    // The other tool's overload is acknowledged, and this one is not: the cycle that runs stays held, as does the next.
    let (status, other) = served.send("POST", "/v1/alarms/1/acknowledge", None).await;
    assert_eq!((status, &other["tool"]), (200, &json!("T7")), "{other}");
    let held = machine.ask(load(10, 30, 5.0)).await;
    assert!(codes(&held["reasons"]).contains(&"overload_held"), "{held}");
    assert_eq!(held["overload"], true, "{held}");
    assert_eq!(machine.end(40).await["status"], 201);
    let started = machine.start("c2", json!({})).await;
    assert!(codes(&started["reasons"]).contains(&"overload_unacknowledged"), "{started}");
    let neutral = machine.ask(load(0, 10, 5.0)).await;
    assert_eq!(neutral["override_percent"], 100.0, "{neutral}");
    let (status, answer) = served.send("POST", "/v1/machines/M1/acknowledge", None).await;
    assert_eq!((status, answer["acknowledged"].as_array().unwrap().len()), (200, 1), "{answer}");
    let freed = machine.ask(load(10, 5, 5.0)).await;
    assert!(freed["override_percent"].as_f64().unwrap() > 100.0, "{freed}");
    served.server.shutdown().await.unwrap();
}

/// The alarms take nothing as long as that trigger is there, whoever writes them.
const NO_ALARMS: &str =
    "CREATE TRIGGER no_alarms BEFORE INSERT ON alarms BEGIN SELECT RAISE(ABORT, 'not now'); END";

#[tokio::test]
async fn an_overload_is_raised_when_the_database_is_there_again_and_no_cycle_starts_before() {
    let dir = tempfile::TempDir::new().unwrap();
    let settings = [&[NO_HEATING, ("stream.resume_ms", "1000")], &OVERLOADS[..]].concat();
    let served = Served::start_in(dir.path(), None, &settings).await;
    served.with_a_shop().await;
    let token = served.machine_token("M1").await;
    let file = dir.path().join("data/feedwright.sqlite3");
    let mut tables = sqlx::sqlite::SqliteConnectOptions::new().filename(file).connect().await.unwrap();
    sqlx::query(NO_ALARMS).execute(&mut tables).await.unwrap();

    let mut machine = Machine::connect(&served, &token).await;
    machine.start("c1", json!({})).await;
    assert_eq!(machine.ask(load(0, 10, 90.0)).await["overload"], true);
    machine.break_off();
    // Nobody comes back to it: it is stored as incomplete, and forgotten here.
    let begun = std::time::Instant::now();
    while served.get("/v1/cycles?machine=M1").await["items"].as_array().unwrap().is_empty() {
        assert!(begun.elapsed() < PATIENCE, "it is stored");
        tokio::task::yield_now().await;
    }
    let mut machine = Machine::connect(&served, &token).await;
    let refused = machine.start("c2", json!({})).await;
    assert_eq!(refused["type"], "error", "{refused}");
    assert_eq!(open_alarms(&served, 0).await, Vec::<Value>::new());

    sqlx::query("DROP TRIGGER no_alarms").execute(&mut tables).await.unwrap();
    tables.close().await.unwrap();
    // By itself.
    assert_eq!(open_alarms(&served, 1).await[0]["kind"], "overload");
    let started = machine.start("c2", json!({})).await;
    assert!(codes(&started["reasons"]).contains(&"overload_unacknowledged"), "{started}");
    let held = machine.ask(load(0, 20, 5.0)).await;
    assert!(held["override_percent"].as_f64().unwrap() <= 100.0, "{held}");
    served.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn what_a_stored_cycle_was_answered_stands_whatever_comes_under_its_id() {
    let (served, token) = shop(&[]).await;
    let mut machine = Machine::connect(&served, &token).await;
    machine.start("c1", json!({})).await;
    machine.samples(0, 30).await;
    assert_eq!(machine.end(30).await["status"], 201);
    let kept = served.get("/v1/machines/M1/cycles/c1/overrides").await;
    assert_eq!(kept["override_percent"].as_array().unwrap().len(), 30, "{kept}");
    // A counter that has restarted: another content under the same id.
    machine.start("c1", json!({})).await;
    machine.samples(0, 12).await;
    let refused = machine.end(12).await;
    assert_eq!(
        (&refused["type"], &refused["code"]),
        (&json!("error"), &json!("cycle_conflict")),
        "{refused}"
    );
    assert_eq!(served.get("/v1/machines/M1/cycles/c1/overrides").await, kept);
    // And the same content once more, of which every sample is too old to be answered.
    machine.start("c1", json!({"resend": true, "sent_at": "2026-05-04T06:00:05Z"})).await;
    machine.samples(0, 30).await;
    assert_eq!(machine.end(30).await["status"], 200);
    assert_eq!(served.get("/v1/machines/M1/cycles/c1/overrides").await, kept);
    served.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn cycles_that_are_refused_hold_nothing() {
    let (served, token) =
        shop(&[("stream.buffered_bytes", "1048576"), ("stream.samples_per_message", "4096")]).await;
    let mut machine = Machine::connect(&served, &token).await;
    machine.start("c1", json!({})).await;
    machine.samples(0, 10).await;
    assert_eq!(machine.end(10).await["status"], 201);
    machine.break_off();
    // Each holds some 100 kB until it ends.
    for round in 0..16 {
        let mut machine = Machine::connect(&served, &token).await;
        let started = machine.start("c1", json!({})).await;
        assert_eq!(started["type"], "started", "{round}: {started}");
        machine.samples(0, 1200 + round).await;
        let refused = machine.end(1200 + round).await;
        assert_eq!(refused["code"], "cycle_conflict", "{round}: {refused}");
        machine.break_off();
    }
    served.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn an_overload_that_is_told_too_late_is_raised_all_the_same() {
    let (served, token) = shop(&OVERLOADS).await;
    let mut machine = Machine::connect(&served, &token).await;
    // The connection stood still for two minutes: what comes then is too old for the law.
    machine.start("c1", json!({"sent_at": "2026-05-04T06:02:00Z"})).await;
    let late = machine.ask(load(0, 10, 90.0)).await;
    for code in ["too_old", "overload"] {
        assert!(codes(&late["reasons"]).contains(&code), "{late}");
    }
    assert_eq!((&late["overload"], &late["quality"]), (&json!(true), &json!("stale")), "{late}");
    assert_eq!(machine.end(10).await["status"], 201);
    let next = machine.start("c2", json!({})).await;
    assert!(codes(&next["reasons"]).contains(&"overload_unacknowledged"), "{next}");
    assert_eq!(machine.ask(load(0, 10, 5.0)).await["override_percent"], 100.0);
    served.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn an_overload_of_a_cycle_that_another_one_holds_is_acknowledged_for_itself() {
    let (served, token) = shop(&OVERLOADS).await;
    served.put("/v1/tools/T2", json!({"name": "FD M8", "tool_type": "friction-drill-7.3"})).await;
    let mut machine = Machine::connect(&served, &token).await;
    machine.start("c1", json!({})).await;
    assert_eq!(machine.ask(load(0, 10, 90.0)).await["overload"], true);
    let held = machine.start("c2", json!({"tool": "T2"})).await;
    assert!(codes(&held["reasons"]).contains(&"overload_unacknowledged"), "{held}");
    // Its own loads are low, and nobody has looked at the tool that was overloaded: the machine must not go up.
    assert_eq!(machine.ask(load(0, 5, 5.0)).await["overload"], true);
    assert_eq!(machine.ask(load(5, 10, 90.0)).await["overload"], true);
    let open = open_alarms(&served, 2).await;
    assert_eq!((&open[0]["tool"], &open[1]["tool"]), (&json!("T1"), &json!("T2")));
    for (alarm, from, overload) in [(&open[0], 15, true), (&open[1], 20, false)] {
        let (status, _) = served.send("POST", &format!("/v1/alarms/{}/acknowledge", alarm["id"]), None).await;
        let answer = machine.ask(load(from, 5, 5.0)).await;
        assert_eq!((status, &answer["overload"]), (200, &json!(overload)), "{answer}");
    }
    served.server.shutdown().await.unwrap();
}

#[tokio::test]
async fn an_overload_is_waited_for_and_freed_by_no_other_ones_acknowledgement() {
    let (served, token) = shop(&OVERLOADS).await;
    let mut reader = Reader::open(&served, "", None).await;
    let mut machine = Machine::connect(&served, &token).await;
    // However soon the next cycle starts, after the end, in place of the running cycle or as that cycle itself.
    for round in 0..24 {
        let id = format!("r{round}");
        assert_eq!(machine.start(&id, json!({})).await["type"], "started");
        assert_eq!(machine.ask(load(0, 10, 90.0)).await["overload"], true, "{round}");
        let next = match round % 3 {
            0 => {
                // Aborted, so that none of them counts: the tool's conditions would be taken for changed.
                let end = json!({"type": "end", "samples": 10, "outcome": "aborted"});
                assert_eq!(machine.ask(end).await["status"], 201);
                machine.start("next", json!({})).await
            }
            1 => machine.start("next", json!({})).await,
            _ => machine.start(&id, json!({"resend": true, "in_force_percent": 100.0})).await,
        };
        assert!(codes(&next["reasons"]).contains(&"overload_unacknowledged"), "{round}: {next}");
        let (status, freed) = served.send("POST", "/v1/machines/M1/acknowledge", None).await;
        assert_eq!((status, freed["acknowledged"].as_array().unwrap().len()), (200, 1), "{freed}");
        // The alarms are looked at now and then: what is told of this one comes when there may be another one.
        assert_eq!(machine.start(&format!("{id}-again"), json!({})).await["type"], "started");
        assert_eq!(machine.ask(load(0, 10, 90.0)).await["overload"], true, "{round}");
        let id = &freed["acknowledged"][0]["id"];
        loop {
            let told = reader.next_of("alarm").await.data;
            if told["change"] == "cleared" && &told["alarm"]["id"] == id {
                break;
            }
        }
        let held = machine.ask(load(10, 5, 5.0)).await;
        assert_eq!(held["overload"], true, "{round}: {held}");
        assert!(codes(&held["reasons"]).contains(&"overload_held"), "{round}: {held}");
        // Nobody can acknowledge what is not in the list yet.
        open_alarms(&served, 1).await;
        let (status, freed) = served.send("POST", "/v1/machines/M1/acknowledge", None).await;
        let answer = machine.ask(load(15, 5, 5.0)).await;
        assert_eq!((status, &answer["overload"]), (200, &json!(false)), "{round}: {freed} {answer}");
    }
    served.server.shutdown().await.unwrap();
}
