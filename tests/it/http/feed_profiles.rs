//! A feed profile's life over HTTP: drafted, shadowed, approved by a second person, active, exported, rolled back.

use super::app::{Answer, App, operation};
use feedwright_store::Role;
use http::StatusCode;
use serde_json::{Value, json};

const HERE: &str = "/v1/feed-profiles/bushing-m8";

fn content(end_feed: f64) -> Value {
    json!({
        "operation": "O1", "tool_type": "friction-drill-7.3",
        "knots": [{"depth_mm": 0.0, "feed_mm_min": 105.0}, {"depth_mm": 3.0, "feed_mm_min": 155.0},
                  {"depth_mm": 7.0, "feed_mm_min": 535.0}, {"depth_mm": 12.0, "feed_mm_min": end_feed}],
        "sections": [{"kind": "heating", "to_mm": 3.0}, {"kind": "forming", "to_mm": 12.0}],
        "limits": {"feed_min_mm_min": 50.0, "feed_max_mm_min": 1000.0, "acceleration_mm_s2": 300.0,
                   "override_min_percent": 20.0, "override_max_percent": 150.0,
                   "spindle_load_set_percent": 40.0, "feed_drive_load_set_percent": 30.0},
        "wear": {"to_level": 1.07}
    })
}

fn draft(end_feed: f64) -> Value {
    json!({"profile": "bushing-m8", "content": content(end_feed), "reason": "heating ends earlier"})
}

/// A shop with machine, tool and an operation that says what the profile depends on.
async fn shop() -> App {
    let app = App::registered().await;
    let mut body = operation();
    body["program"] = json!("O1234 (left)");
    body["work_material"] = json!("S235JRH");
    body["depth_mm"] = json!(12.0);
    body["spindle_speed_rpm"] = json!(2800.0);
    assert_eq!(app.put("/v1/operations/O1", body).await.status, StatusCode::CREATED);
    app
}

impl App {
    /// Takes a step with the ETag of the moment.
    async fn step(&self, role: Role, step: &str, version: u32) -> Answer {
        let tag = self.get(HERE).await.header("etag").to_owned();
        let body = (step != "rollback").then(|| json!({"version": version}));
        self.call(role, "POST", &format!("{HERE}/{step}"), &[("if-match", &tag)], body).await
    }

    /// Drafts and brings into force.
    async fn bring_into_force(&self, end_feed: f64) -> u32 {
        let drafted = self.post("/v1/feed-profiles", draft(end_feed)).await;
        assert_eq!(drafted.status, StatusCode::CREATED, "{drafted:?}");
        let version = u32::try_from(drafted.json()["version"].as_u64().unwrap()).unwrap();
        for (role, step) in
            [(Role::Engineer, "shadow"), (Role::Approver, "approve"), (Role::Engineer, "activate")]
        {
            let answer = self.step(role, step, version).await;
            assert_eq!(answer.status, StatusCode::OK, "{step}: {answer:?}");
        }
        version
    }
}

#[tokio::test]
async fn a_profile_goes_from_draft_to_active_and_back() {
    let app = shop().await;
    let drafted = app.post("/v1/feed-profiles", draft(205.0)).await;
    assert_eq!(drafted.status, StatusCode::CREATED);
    assert_eq!(drafted.header("location"), "/v1/feed-profiles/bushing-m8/versions/1");
    let view = drafted.json();
    assert_eq!(
        (&view["state"], &view["version"], &view["source"]),
        (&json!("draft"), &json!(1), &json!("drawn"))
    );
    // What the operation says is what it depends on, unless it says something else itself.
    assert_eq!(view["content"]["conditions"]["program"], "O1234 (left)");
    assert_eq!(
        app.post("/v1/feed-profiles", draft(205.0)).await.status,
        StatusCode::OK,
        "the same content once"
    );

    // A step needs the ETag, and the one of the moment.
    let path = format!("{HERE}/shadow");
    let bare = app.post(&path, json!({"version": 1})).await;
    assert_eq!((bare.status, bare.code().as_str()), (StatusCode::PRECONDITION_REQUIRED, "version_required"));
    let stale =
        app.call(Role::Engineer, "POST", &path, &[("if-match", "\"7\"")], Some(json!({"version": 1}))).await;
    assert_eq!((stale.status, stale.code().as_str()), (StatusCode::PRECONDITION_FAILED, "version_mismatch"));
    assert_eq!(stale.header("etag"), "\"1\"");
    let early = app.step(Role::Approver, "approve", 1).await;
    assert_eq!((early.status, early.code().as_str()), (StatusCode::CONFLICT, "wrong_state"));
    assert_eq!(app.step(Role::Engineer, "shadow", 1).await.status, StatusCode::OK);
    assert_eq!(
        app.step(Role::Engineer, "approve", 1).await.status,
        StatusCode::FORBIDDEN,
        "not an engineer's to give"
    );
    assert_eq!(app.step(Role::Approver, "approve", 1).await.status, StatusCode::OK);
    let active = app.step(Role::Engineer, "activate", 1).await.json();
    assert_eq!((&active["active_version"], &active["revision"]), (&json!(1), &json!(4)));

    let advice = app.get("/v1/recommendations?machine=M1&operation=O1&tool=T1").await.json();
    // The tool was never mounted: its wear is not known, and unknown never raises the feed.
    assert_eq!(advice["reasons"][0]["code"], "profile_wear_unknown");
    assert_eq!(advice["feed"]["source"], "programmed");
    let mounted = json!({"kind": "mounted_new", "at": "2026-05-04T05:00:00Z"});
    assert_eq!(app.post("/v1/tools/T1/events", mounted).await.status, StatusCode::CREATED);
    let advice = app.get("/v1/recommendations?machine=M1&operation=O1&tool=T1").await.json();
    assert_eq!(advice["reasons"][0]["code"], "profile_active", "{advice}");
    assert_eq!(
        (&advice["feed"]["source"], &advice["feed"]["feed_mm_min"]),
        (&json!("profile"), &Value::Null)
    );
    assert_eq!(advice["feed"]["profile"]["hash"], view["hash"]);
    let kept = app.get(&format!("/v1/recommendations/{}", advice["id"].as_str().unwrap())).await.json();
    assert_eq!(kept["feed"], advice["feed"], "what was handed out can be told later");
    let place = advice["feed"]["profile"]["content"].as_str().unwrap();
    let machine = app.call(Role::Machine, "GET", place, &[], None).await;
    assert_eq!(machine.json()["content"]["knots"][2]["feed_mm_min"], 535.0);

    assert_eq!(app.bring_into_force(215.0).await, 2);
    let diff = app.get(&format!("{HERE}/diff?from=1&to=2")).await.json();
    assert_eq!(
        diff["knots"],
        json!([{"depth_mm": 12.0, "change": "changed", "before_mm_min": 205.0, "after_mm_min": 215.0}])
    );
    assert!(diff["change_s"].as_f64().unwrap() < 0.0 && diff["sections"].as_array().unwrap().len() == 2);
    let back = app.step(Role::Approver, "rollback", 0).await;
    assert_eq!((back.status, &back.json()["active_version"]), (StatusCode::OK, &json!(1)));
    let versions = app.get(&format!("{HERE}/versions")).await.json();
    let states: Vec<_> =
        versions["items"].as_array().unwrap().iter().map(|one| one["state"].clone()).collect();
    assert_eq!(states, ["active", "superseded"]);
    assert_eq!(versions["items"][1]["rolled_back"], true);
    let nameless = app.get("/v1/feed-profiles?tool_type=%00").await;
    assert_eq!(
        (nameless.status.as_u16(), &nameless.json()["code"]),
        (400, &serde_json::json!("invalid_query"))
    );
    let lines = app.get("/v1/feed-profiles?operation=O1&tool_type=friction-drill-7.3").await.json();
    assert_eq!(lines["items"][0]["active_version"], 1);
    let audit = app.get("/v1/audit?limit=100").await.json();
    let rolled =
        audit["items"].as_array().unwrap().iter().any(|line| line["action"] == "feed_profile.rollback");
    assert!(rolled, "{audit}");
}

#[tokio::test]
async fn what_was_made_for_another_hole_is_neither_activated_nor_written_for_a_control() {
    let app = shop().await;
    app.bring_into_force(205.0).await;
    let shallower = async |depth: f64, version: u64| {
        let mut body = app.get("/v1/operations/O1").await.json();
        for told in ["id", "version", "updated_at"] {
            body.as_object_mut().unwrap().remove(told);
        }
        body["depth_mm"] = json!(depth);
        let tag = format!("\"{version}\"");
        let put =
            app.call(Role::Engineer, "PUT", "/v1/operations/O1", &[("if-match", &tag)], Some(body)).await;
        assert_eq!(put.status, StatusCode::OK, "{put:?}");
    };
    let file = format!("{HERE}/export?dialect=linuxcnc");
    assert_eq!(app.get(&file).await.status, StatusCode::OK);
    shallower(10.0, 1).await;
    let refused = app.get(&file).await;
    assert_eq!((refused.status, refused.code().as_str()), (StatusCode::CONFLICT, "profile_other_depth"));
    assert_eq!(
        app.get(&format!("{HERE}/export?dialect=json")).await.status,
        StatusCode::OK,
        "what it says can be told"
    );
    assert_eq!(app.step(Role::Approver, "rollback", 0).await.status, StatusCode::OK);
    let refused = app.step(Role::Engineer, "activate", 1).await;
    assert_eq!((refused.status, refused.code().as_str()), (StatusCode::CONFLICT, "profile_other_depth"));
    shallower(12.0, 2).await;
    assert_eq!(app.step(Role::Engineer, "activate", 1).await.status, StatusCode::OK);
    let unknown = app.step(Role::Engineer, "activate", 9).await;
    assert_eq!(unknown.status, StatusCode::NOT_FOUND);
    assert!(unknown.json()["detail"].as_str().unwrap().contains("`9`"), "{unknown:?}");
    let unknown = app.step(Role::Engineer, "shadow", 9).await;
    assert_eq!(unknown.status, StatusCode::NOT_FOUND);
    assert!(unknown.json()["detail"].as_str().unwrap().contains("`9`"), "{unknown:?}");
}

#[tokio::test]
async fn a_draft_that_is_no_profile_is_refused_with_its_fields() {
    let app = shop().await;
    let mut bad = draft(205.0);
    bad["content"]["knots"][1]["feed_mm_min"] = json!(5000.0);
    bad["content"]["knots"][3]["depth_mm"] = json!(6.0);
    bad["content"]["wear"]["to_level"] = json!(0.5);
    let answer = app.post("/v1/feed-profiles", bad).await;
    assert_eq!(answer.status, StatusCode::UNPROCESSABLE_ENTITY);
    let errors = answer.errors();
    for (path, code) in [
        ("content.knots[1].feed_mm_min", "outside_limits"),
        ("content.knots[3].depth_mm", "not_increasing"),
        ("content.wear.to_level", "out_of_range"),
    ] {
        assert!(errors.contains(&(path.to_owned(), code.to_owned())), "{errors:?}");
    }
    let change = async |path: &str, value: Value| {
        let mut body = draft(205.0);
        *body.pointer_mut(path).unwrap() = value;
        app.post("/v1/feed-profiles", body).await.errors()[0].clone()
    };
    assert_eq!(
        change("/content/operation", json!("O9")).await,
        ("content.operation".into(), "operation_unregistered".into())
    );
    assert_eq!(change("/profile", json!("optimize")).await, ("profile".into(), "reserved".into()));
    assert_eq!(change("/profile", json!("a b")).await, ("profile".into(), "invalid_id".into()));
    assert_eq!(change("/reason", json!(" ")).await, ("reason".into(), "invalid_length".into()));
    assert_eq!(change("/content/knots/3/depth_mm", json!(11.0)).await.1, "not_covered");
    let both = json!({"profile": "p", "reason": "r"});
    assert_eq!(app.post("/v1/feed-profiles", both).await.errors()[0], ("content".into(), "one_of".into()));
    for path in
        ["/v1/feed-profiles/none", "/v1/feed-profiles/none/versions", "/v1/feed-profiles/none/versions/1"]
    {
        assert_eq!(app.get(path).await.status, StatusCode::NOT_FOUND, "{path}");
    }
    assert_eq!(app.get(&format!("{HERE}/versions/0")).await.status, StatusCode::BAD_REQUEST);
}
