//! Registering and changing machines, tools and operations, and what happens to a tool.

use super::app::{App, machine, operation, tool};
use feedwright_store::Role;
use http::StatusCode;
use serde_json::{Value, json};

crate::engines::on_both!(
    what_is_put_comes_back_with_its_version,
    a_change_names_the_version_it_is_based_on,
    a_reset_needs_a_reason_and_goes_into_the_audit,
    fitted_lines_get_versions,
    fitted_lines_may_be_as_large_as_can_be_stored,
    a_cycle_of_more_energy_than_any_is_kept_without_it,
    a_machine_without_overloads_has_nothing_to_acknowledge,
);

async fn what_is_put_comes_back_with_its_version() {
    let app = App::new().await;
    for (path, body, field) in [
        ("/v1/machines/M1", machine(), "control"),
        ("/v1/tools/T1", tool(), "tool_type"),
        ("/v1/operations/O1", operation(), "process"),
    ] {
        let created = app.put(path, body.clone()).await;
        assert_eq!(created.status, StatusCode::CREATED, "{created:?}");
        assert_eq!((created.header("etag"), created.header("location")), ("\"1\"", path));
        let again = app.put(path, body.clone()).await;
        assert_eq!((again.status, again.header("etag")), (StatusCode::OK, "\"1\""), "the same content twice");
        let read = app.get(path).await;
        assert_eq!((read.status, read.header("etag")), (StatusCode::OK, "\"1\""));
        let read = read.json();
        assert_eq!(read, created.json());
        assert_eq!(read[field], body[field]);
        assert_eq!(read["updated_at"], "2026-05-04T06:00:00Z");
        for (name, value) in body.as_object().unwrap() {
            assert_eq!(&read[name], value, "{path} {name}");
        }
    }
}

async fn a_change_names_the_version_it_is_based_on() {
    let app = App::registered().await;
    let change = |name: &str| {
        let mut body = tool();
        body["name"] = json!(name);
        Some(body)
    };
    let put = async |headers: &[(&str, &str)], body: Option<Value>| {
        app.call(Role::Engineer, "PUT", "/v1/tools/T1", headers, body).await
    };
    let answer = put(&[], change("b")).await;
    assert_eq!(
        (answer.status, answer.code().as_str()),
        (StatusCode::PRECONDITION_REQUIRED, "version_required")
    );
    assert_eq!(answer.json()["current_version"], 1);
    let answer = put(&[("if-none-match", "*")], change("b")).await;
    assert_eq!(
        (answer.status, answer.code().as_str()),
        (StatusCode::PRECONDITION_FAILED, "version_mismatch")
    );
    let answer = put(&[("if-match", "\"1\"")], change("b")).await;
    assert_eq!((answer.status, answer.header("etag")), (StatusCode::OK, "\"2\""));
    let answer = put(&[("if-match", "\"1\"")], change("c")).await;
    assert_eq!((answer.status, answer.header("etag")), (StatusCode::PRECONDITION_FAILED, "\"2\""));
    for tags in ["*", "W/\"2\"", "2", "\"0\"", "\"1\", \"2\""] {
        let answer = put(&[("if-match", tags)], change("c")).await;
        assert_eq!(
            (answer.status, answer.code().as_str()),
            (StatusCode::BAD_REQUEST, "invalid_precondition"),
            "{tags}"
        );
    }
    let missing =
        app.call(Role::Engineer, "PUT", "/v1/tools/T9", &[("if-match", "\"1\"")], change("b")).await;
    assert_eq!(missing.status, StatusCode::PRECONDITION_FAILED);
    assert_eq!(app.get("/v1/tools/T9").await.status, StatusCode::NOT_FOUND);

    let known = app.call(Role::Viewer, "GET", "/v1/tools/T1", &[("if-none-match", "\"2\"")], None).await;
    assert_eq!((known.status, known.body.len()), (StatusCode::NOT_MODIFIED, 0));
    let newer = app.call(Role::Viewer, "GET", "/v1/tools/T1", &[("if-none-match", "\"1\"")], None).await;
    assert_eq!((newer.status, newer.json()["name"].as_str()), (StatusCode::OK, Some("b")));
}

async fn a_reset_needs_a_reason_and_goes_into_the_audit() {
    let app = App::registered().await;
    let mounted = json!({"kind": "mounted_new", "at": "2026-05-04T05:00:00Z",
                         "first_cycle": {"machine": "M1", "cycle_id": "c-1"}});
    let answer = app.post("/v1/tools/T1/events", mounted).await;
    assert_eq!(answer.status, StatusCode::CREATED, "{answer:?}");
    assert_eq!(answer.json()["first_cycle"]["cycle_id"], "c-1");

    let answer = app.post("/v1/tools/T1/events", json!({"kind": "reset"})).await;
    assert_eq!(answer.errors(), [("reason".to_owned(), "reason_required".to_owned())]);
    let answer =
        app.post("/v1/tools/T1/events", json!({"kind": "reset", "reason": "sensor was loose"})).await;
    assert_eq!(answer.json()["at"], "2026-05-04T06:00:00Z", "{answer:?}");
    let answer = app.post("/v1/tools/T9/events", json!({"kind": "changed"})).await;
    assert_eq!(answer.status, StatusCode::NOT_FOUND);
    let bad = json!({"kind": "changed", "at": "today", "first_cycle": {"machine": "M 1", "cycle_id": "c"}});
    let errors = app.post("/v1/tools/T1/events", bad).await.errors();
    assert_eq!(errors.len(), 2, "{errors:?}");
    // A typing error of the year would end every life to come.
    let ahead = |at: &str| json!({"kind": "changed", "at": at});
    let errors = app.post("/v1/tools/T1/events", ahead("2062-05-04T06:00:00Z")).await.errors();
    assert_eq!(errors, [("at".to_owned(), "in_future".to_owned())]);
    let nowhere = json!({"kind": "changed", "first_cycle": {"machine": "M9", "cycle_id": "c"}});
    let errors = app.post("/v1/tools/T1/events", nowhere).await.errors();
    assert_eq!(errors, [("first_cycle.machine".to_owned(), "unknown_machine".to_owned())]);

    let events = app.get("/v1/tools/T1/events").await.json();
    let kinds: Vec<_> =
        events["items"].as_array().unwrap().iter().map(|event| event["kind"].clone()).collect();
    assert_eq!(kinds, [json!("mounted_new"), json!("reset")]);
    // Told by mistake: it stays in the list, and holds no more.
    assert_eq!(app.get("/v1/tools/T1/wear").await.json()["life"], 2);
    let reset = events["items"][1]["id"].as_i64().unwrap();
    let revoked = app.post(&format!("/v1/tools/T1/events/{reset}/revoke"), json!({})).await;
    assert_eq!(revoked.status, StatusCode::OK, "{revoked:?}");
    let after = app.get("/v1/tools/T1/events").await.json();
    assert_eq!(after["items"][1], revoked.json());
    assert_eq!(after["items"][0], events["items"][0]);
    assert_eq!(
        (&after["items"][1]["revoked_at"], &after["items"][0]["revoked_at"]),
        (&json!("2026-05-04T06:00:00Z"), &json!(null))
    );
    assert_eq!(after["items"][1]["revoked_by"], after["items"][1]["actor"]);
    assert_eq!(app.get("/v1/tools/T1/wear").await.json()["life"], 1);
    for nothing in ["T1/events/9999", "T9/events/1"] {
        let answer = app.post(&format!("/v1/tools/{nothing}/revoke"), json!({})).await;
        assert_eq!(
            (answer.status, answer.code().as_str()),
            (StatusCode::NOT_FOUND, "not_found"),
            "{nothing}"
        );
    }
    assert_eq!(app.get("/v1/tools/T9/events").await.status, StatusCode::NOT_FOUND);

    let audit = app.get("/v1/audit?limit=1000").await.json().to_string();
    assert!(audit.contains("tool/T1") && audit.contains("sensor was loose"), "{audit}");
    assert!(audit.contains("machine/M1"), "{audit}");
}

async fn fitted_lines_get_versions() {
    let app = App::registered().await;
    let line = json!({"slope": 20.0, "intercept": -50.0, "min_percent": 5.0, "max_percent": 45.0,
                      "r_squared": 0.99, "residual_spread": 5.0});
    let path = "/v1/machines/M1/calibrations";
    assert_eq!(app.post(path, json!({})).await.errors()[0].1, "nothing_fitted");
    let mut wrong = line.clone();
    wrong["max_percent"] = json!(1.0);
    wrong["r_squared"] = json!(1.5);
    let errors = app.post(path, json!({"torque": wrong})).await.errors();
    assert_eq!(
        errors.iter().map(|e| e.0.as_str()).collect::<Vec<_>>(),
        ["torque.r_squared", "torque.max_percent"]
    );
    for version in 1..=2 {
        let answer = app.post(path, json!({"thrust": line})).await;
        assert_eq!((answer.status, answer.json()["version"].as_u64()), (StatusCode::CREATED, Some(version)));
    }
    let listed = app.get(path).await.json();
    assert_eq!(listed["items"].as_array().unwrap().len(), 2);
    assert_eq!(listed["items"][1]["thrust"], line);
    let unknown = app.post("/v1/machines/M9/calibrations", json!({"thrust": line})).await;
    assert_eq!(unknown.status, StatusCode::NOT_FOUND);
}

/// What the API takes of a line the tables take, and what they do not it tells with its path.
async fn fitted_lines_may_be_as_large_as_can_be_stored() {
    let app = App::registered().await;
    let usual = json!({"slope": 20.0, "intercept": -50.0, "min_percent": 5.0, "max_percent": 45.0,
                       "r_squared": 0.99, "residual_spread": 5.0});
    let path = "/v1/machines/M1/calibrations";
    let document = app.get("/openapi.json").await.json();
    let properties = &document["components"]["schemas"]["LineBody"]["properties"];
    for (field, least, most) in [
        ("slope", None, 1e6),
        ("intercept", Some(-1e7), 1e7),
        ("r_squared", Some(0.0), 1.0),
        ("residual_spread", Some(0.0), 1e7),
        ("min_percent", Some(-400.0), 44.0),
        ("max_percent", Some(6.0), 400.0),
    ] {
        for name in ["thrust", "torque"] {
            let with = |value: f64| {
                let mut line = usual.clone();
                line[field] = json!(value);
                json!({name: line})
            };
            for end in least.into_iter().chain([most]) {
                let taken = app.post(path, with(end)).await;
                assert_eq!(taken.status, StatusCode::CREATED, "{name}.{field} {end}: {taken:?}");
            }
            if field.ends_with("_percent") {
                continue;
            }
            for beyond in least.map(|least| least - 0.001).into_iter().chain([most + 0.001]) {
                let refused = app.post(path, with(beyond)).await;
                let errors = refused.errors();
                let told: Vec<_> = errors.iter().map(|error| (error.0.as_str(), error.1.as_str())).collect();
                assert_eq!(told, [(format!("{name}.{field}").as_str(), "out_of_range")], "{beyond}");
            }
        }
        if !field.ends_with("_percent") {
            assert_eq!(properties[field]["maximum"].as_f64(), Some(most), "{field}");
            let floor = if least.is_some() { "minimum" } else { "exclusiveMinimum" };
            assert_eq!(properties[field][floor].as_f64(), Some(least.unwrap_or(0.0)), "{field}");
        }
    }
}

/// Whatever lines a machine was given, what it measured is kept.
async fn a_cycle_of_more_energy_than_any_is_kept_without_it() {
    const CYCLES: &str = "/v1/machines/M1/cycles";
    let app = App::registered().await;
    let line = json!({"slope": 1e6, "intercept": 1e7, "min_percent": -400.0, "max_percent": 400.0,
                      "r_squared": 0.99, "residual_spread": 5.0});
    let added = app.post("/v1/machines/M1/calibrations", json!({"thrust": line, "torque": line})).await;
    assert_eq!(added.status, StatusCode::CREATED);
    let cycle = json!({
        "cycle_id": "a-day", "tool": "T1", "operation": "O1", "started_at": "2026-05-04T06:00:00Z",
        "spindle_speed_rpm": 1e6,
        "samples": {"time_ms": [0, 1, 43_200_000, 86_400_000], "depth_mm": [0, 1, 2, 3],
                    "spindle_load_percent": [399, 399, 399, 399], "feed_drive_load_percent": [399, 399, 399, 399],
                    "spindle_speed_rpm": [1e6, 1e6, 1e6, 1e6]},
    });
    // Half of the samples a gap away: not even then.
    let long = {
        let mut long = cycle.clone();
        long["cycle_id"] = json!("long");
        long["samples"]["time_ms"] = json!([0, 28_800_000, 57_600_000, 86_400_000]);
        long
    };
    for body in [cycle, long.clone()] {
        let stored = app.call(Role::Machine, "POST", CYCLES, &[], Some(body)).await;
        assert_eq!(stored.status, StatusCode::CREATED, "{stored:?}");
    }
    let known = app.call(Role::Machine, "POST", CYCLES, &[], Some(long)).await;
    assert_eq!(known.status, StatusCode::OK, "{known:?}");
    let summary = &known.json()["summary"];
    let flags: Vec<_> =
        summary["flags"].as_array().unwrap().iter().filter_map(|flag| flag.as_str()).collect();
    assert!(flags.contains(&"implausible_energy"), "{summary}");
    let bases: Vec<_> = summary["energy"].as_array().unwrap().iter().map(|energy| &energy["basis"]).collect();
    assert!(!bases.contains(&&json!("calibrated")), "{summary}");
    assert!(app.state.store.check_cycles(None, 10).await.unwrap().faults.is_empty());
}

async fn a_machine_without_overloads_has_nothing_to_acknowledge() {
    let app = App::registered().await;
    let answer = app.call(Role::Engineer, "POST", "/v1/machines/M1/acknowledge", &[], None).await;
    assert_eq!((answer.status, answer.json()), (StatusCode::OK, json!({"acknowledged": []})));
    let answer = app.call(Role::Engineer, "POST", "/v1/machines/M9/acknowledge", &[], None).await;
    assert_eq!(answer.status, StatusCode::NOT_FOUND);
    let answer = app.call(Role::Engineer, "POST", "/v1/alarms/77/acknowledge", &[], None).await;
    assert_eq!((answer.status, answer.code().as_str()), (StatusCode::NOT_FOUND, "not_found"));
    let answer = app.call(Role::Engineer, "POST", "/v1/alarms/x/acknowledge", &[], None).await;
    assert_eq!((answer.status, answer.code().as_str()), (StatusCode::BAD_REQUEST, "invalid_path"));
}
