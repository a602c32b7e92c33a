//! A feed profile on the process model: put into shadow, compared with its successor, optimised, exported, imported.

use super::{drilled, model_machine, number};
use crate::shop::Shop;
use feedwright_core::friction::program::{Between, FeedProgram, Strategy};
use feedwright_core::friction::twin::{PAPER_END_DEPTH_MM, PaperStrategies};
use serde_json::{Value, json};

crate::engines::on_both!(where_retention_has_left_nothing_to_learn_from_the_refusal_says_so);

const HERE: &str = "/v1/feed-profiles/bushing";

/// F_Lin of the paper's set-up, times a factor, to the end of the path.
fn knots(factor: f64) -> Vec<(f64, f64)> {
    let linear = PaperStrategies::new().unwrap().linear;
    let mut knots: Vec<_> =
        linear.program.knots().iter().map(|knot| (knot.depth_mm, knot.feed_mm_min * factor)).collect();
    knots.push((PAPER_END_DEPTH_MM, 345.0 * factor));
    knots
}

fn strategy(factor: f64) -> Strategy {
    let program = FeedProgram::from_pairs(Between::Linear, &knots(factor)).unwrap();
    Strategy::new("F_Lin", program, PAPER_END_DEPTH_MM, None).unwrap()
}

fn limits() -> Value {
    json!({"feed_min_mm_min": 50.0, "feed_max_mm_min": 1000.0, "acceleration_mm_s2": 300.0,
           "override_min_percent": 20.0, "override_max_percent": 150.0,
           "spindle_load_set_percent": 50.0, "feed_drive_load_set_percent": 40.0})
}

fn draft(factor: f64) -> Value {
    let knots: Vec<_> = knots(factor)
        .into_iter()
        .map(|(depth, feed)| json!({"depth_mm": depth, "feed_mm_min": feed}))
        .collect();
    let content = json!({
        "operation": "O1", "tool_type": "fd-7.3", "knots": knots,
        "sections": [{"kind": "heating", "to_mm": 3.0}, {"kind": "forming", "to_mm": 13.0},
                     {"kind": "idle_travel", "to_mm": 18.0}, {"kind": "flange", "to_mm": PAPER_END_DEPTH_MM}],
        "limits": limits(), "wear": {"to_level": 1.07},
    });
    json!({"profile": "bushing", "content": content, "reason": "as the story goes"})
}

struct Story {
    shop: Shop,
    approver: String,
    next: i64,
}

impl Story {
    /// The process model's machine, and an operation that says how deep it is.
    async fn begin() -> Self {
        let shop = Shop::open().await;
        model_machine(&shop).await;
        let operation = json!({
            "name": "Bush M8", "process": "friction", "program": "O0815", "spindle_speed_rpm": 2800,
            "depth_mm": PAPER_END_DEPTH_MM, "programmed_feed_mm_min": 110,
        });
        let put = shop.client.put(shop.url("/v1/operations/O1")).header("if-match", "\"1\"").json(&operation);
        assert_eq!(shop.send(put).await.status, 200);
        let approver = shop.token("approver", None).await;
        Self { shop, approver, next: 1 }
    }

    /// Drills holes and posts them, saying which version ran.
    async fn drill(&mut self, count: usize, factor: f64, version: Option<u64>) {
        for _ in 0..count {
            let mut cycle = drilled(self.next, &strategy(factor), "f_lin", false);
            if let Some(version) = version {
                cycle["profile"] = json!({"id": "bushing", "version": version});
            }
            let answer = self.shop.cycle("F1", &cycle).await;
            assert_eq!(answer.status, 201, "{}", answer.text);
            self.next += 1;
        }
    }

    async fn step(&self, step: &str, version: u64) {
        let tag = self.shop.get(HERE).await.headers["etag"].clone();
        let body = json!({"version": version});
        let request = self.shop.client.post(self.shop.url(&format!("{HERE}/{step}")));
        let request = request.header("if-match", tag).json(&body);
        let token = if step == "approve" { &self.approver } else { &self.shop.admin };
        let answer = self.shop.send_as(request, token).await;
        assert_eq!(answer.status, 200, "{step}: {}", answer.text);
    }

    /// Brings a drafted version into force.
    async fn bring(&self, version: u64) {
        for step in ["shadow", "approve", "activate"] {
            self.step(step, version).await;
        }
    }

    async fn drafted(&self, body: &Value) -> u64 {
        let answer = self.shop.post("/v1/feed-profiles", body).await;
        assert_eq!(answer.status, 201, "{}", answer.text);
        answer.body["version"].as_u64().unwrap()
    }
}

#[tokio::test]
async fn a_shadow_is_computed_against_what_really_ran() {
    let mut story = Story::begin().await;
    for factor in [0.85, 1.0, 1.15, 0.95, 1.05, 1.0] {
        story.drill(1, factor, None).await;
    }
    let version = story.drafted(&draft(1.2)).await;
    let early = story.shop.get(&format!("{HERE}/shadow")).await;
    assert_eq!((early.status, &early.body["code"]), (409, &json!("not_in_shadow")), "{}", early.text);
    story.step("shadow", version).await;
    let report = story.shop.get(&format!("{HERE}/shadow?version={version}&cycles=6")).await;
    assert_eq!(report.status, 200, "{}", report.text);
    let cycles = &report.body["cycles"];
    assert_eq!(
        (&cycles["considered"], &cycles["predicted_cycles"]),
        (&json!(6), &json!(6)),
        "{}",
        report.text
    );
    let shorter =
        number(&cycles["predicted"]["mean_duration_s"]) / number(&cycles["happened"]["mean_duration_s"]);
    assert!((shorter - 1.0 / 1.2).abs() < 0.06, "a fifth faster: {shorter}");
    // Its own time is that of its curve; the model brakes at the end of the path besides.
    let own = number(&report.body["time_s"]) / number(&cycles["predicted"]["mean_duration_s"]);
    assert!((0.9..1.02).contains(&own), "{own}");
    assert!(
        number(&cycles["predicted"]["peak_spindle_percent"])
            > number(&cycles["happened"]["peak_spindle_percent"]) * 0.95
    );
    assert_eq!(story.shop.get(&format!("{HERE}/shadow?cycles=0")).await.status, 422);
}

#[tokio::test]
async fn two_versions_are_compared_over_the_cycles_that_ran_them() {
    let mut story = Story::begin().await;
    let first = story.drafted(&draft(1.0)).await;
    story.bring(first).await;
    story.drill(12, 1.0, Some(first)).await;
    let second = story.drafted(&draft(1.15)).await;
    story.bring(second).await;
    story.drill(12, 1.15, Some(second)).await;
    let found = story.shop.get(&format!("{HERE}/comparison?before={first}")).await;
    assert_eq!(found.status, 200, "{}", found.text);
    let change = &found.body["duration_s"]["change"];
    assert!((number(&change["value"]) + 0.13).abs() < 0.03, "{change}");
    assert!(
        number(&change["low"]) <= number(&change["value"])
            && number(&change["high"]) >= number(&change["value"])
    );
    assert_eq!(found.body["duration_s"]["is_clear"], true);
    assert_eq!(found.body["energy_basis"], "rated_power");
    assert_eq!(found.body["energy_joules"]["before"]["cycles"], 12);
    assert!(number(&found.body["peak_spindle_load_percent"]["change"]["value"]) > 0.0, "faster loads more");
    assert!(found.body["versions"][0]["wear_rate_per_thousand"]["low"].is_number());
    // Their wear is said beside, and what it did is taken out where it is known.
    let level = &found.body["wear_level"];
    assert!(number(&level["before"]["cycles"]) >= 5.0 && number(&level["after"]["cycles"]) >= 5.0, "{level}");
    let balanced = &found.body["duration_s"]["at_same_wear"];
    assert!((number(&balanced["change"]["value"]) + 0.13).abs() < 0.05, "{balanced}");
    assert_eq!(balanced["is_clear"], true, "{balanced}");
    let again = story.shop.get(&format!("{HERE}/comparison?before={first}")).await;
    assert_eq!(again.text, found.text, "the same cycles give the same intervals");
    let same = story.shop.get(&format!("{HERE}/comparison?before={first}&after={first}")).await;
    assert_eq!(same.body["duration_s"]["is_clear"], false);
    // What ran is not what is active: whoever reads the answer to the cycle sees it.
    let cycle = {
        let mut cycle = drilled(90, &strategy(1.0), "f_lin", false);
        cycle["profile"] = json!({"id": "bushing", "version": first});
        story.shop.cycle("F1", &cycle).await
    };
    assert!(cycle.text.contains("profile_mismatch"), "{}", cycle.text);
}

#[tokio::test]
async fn files_are_written_for_controls_and_read_back_to_the_letter() {
    let story = Story::begin().await;
    let shop = &story.shop;
    let version = story.drafted(&draft(1.0)).await;
    let export = |query: &str| format!("{HERE}/export?{query}");
    let early = shop.get(&export("dialect=sinumerik&version=1")).await;
    assert_eq!((early.status, &early.body["code"]), (409, &json!("not_released")), "a draft is no program");
    let none = shop.get(&export("dialect=sinumerik")).await;
    assert_eq!((none.status, &none.body["code"]), (409, &json!("nothing_active")));
    story.bring(version).await;
    for dialect in ["sinumerik", "twincat_nci", "twincat_cnc", "linuxcnc", "fanuc", "heidenhain_afc", "csv"] {
        let file = shop.get(&export(&format!("dialect={dialect}&machine=F1"))).await;
        assert_eq!(file.status, 200, "{dialect}: {}", file.text);
        assert_eq!(file.headers["content-type"], "text/plain; charset=us-ascii");
        assert!(file.headers["content-disposition"].to_str().unwrap().contains("bushing.v1."));
        let back = shop.post("/v1/feed-profiles/read", &json!({"text": file.text})).await;
        assert_eq!(back.status, 200, "{dialect}: {}", back.text);
        assert_eq!((&back.body["dialect"], &back.body["version"]), (&json!(dialect), &json!(1)));
        assert_eq!((&back.body["known"], &back.body["state"]), (&json!(true), &json!("active")));
        let changed = file.text.replacen("3.000", "3.001", 1);
        let refused = shop.post("/v1/feed-profiles/read", &json!({"text": changed})).await;
        assert_eq!(refused.status, 422, "{dialect}: {}", refused.text);
    }
    let law = shop.get(&export("dialect=sinumerik&law_intensity=2")).await;
    assert!(law.text.contains("FCTDEF(1,20.000,100.000,"), "{}", law.text);
    let file = shop.get(&export("dialect=json")).await;
    assert_eq!(file.headers["content-type"], "application/json");
    let version = shop.get(&format!("{HERE}/versions/1")).await.body;
    for name in ["profile", "version", "hash", "content"] {
        assert_eq!(file.body[name], version[name], "{name}");
    }
    let back = shop.post("/v1/feed-profiles/read", &json!({"text": file.text})).await;
    assert_eq!((back.status, &back.body["dialect"]), (200, &json!("json")), "{}", back.text);
    assert_eq!((&back.body["known"], &back.body["content"]), (&json!(true), &version["content"]));
    let changed = file.text.replacen("535.0", "635.0", 1);
    let refused = shop.post("/v1/feed-profiles/read", &json!({"text": changed})).await;
    assert_eq!((refused.status, &refused.body["code"]), (422, &json!("hash_mismatch")), "{}", refused.text);
    let unknown = shop.get(&export("dialect=basic")).await;
    assert_eq!((unknown.status, &unknown.body["code"]), (422, &json!("unknown_dialect")));
    let coarse = shop.get(&export("dialect=fanuc&feed_error=0.9")).await;
    assert_eq!((coarse.status, &coarse.body["errors"][0]["path"]), (422, &json!("feed_error")));
    for (query, path, code) in [
        ("dialect=sinumerik&law_override_max_percent=120", "law_override_max_percent", "without_law"),
        ("dialect=sinumerik&law_intensity=0", "law_intensity", "out_of_range"),
        ("dialect=fanuc&law_intensity=2", "law_intensity", "not_in_this_dialect"),
        (
            "dialect=sinumerik&law_intensity=2&law_override_max_percent=500",
            "law_override_max_percent",
            "out_of_range",
        ),
    ] {
        let refused = shop.get(&export(query)).await;
        assert_eq!((refused.status, &refused.body["errors"][0]["path"]), (422, &json!(path)), "{query}");
        assert_eq!(refused.body["errors"][0]["code"], code, "{query}");
    }
    // The profile runs 545 mm/min, and this machine only 500.
    let slow = json!({
        "name": "Slow", "control": "x", "ipo_period_ms": 10, "spindle": {"reference": "unknown"},
        "feed_drive": {"reference": "unknown"},
        "limits": {"feed_min_mm_min": 1, "feed_max_mm_min": 500, "override_min_percent": 5, "override_max_percent": 200},
    });
    assert_eq!(shop.put("/v1/machines/F2", &slow).await.status, 201);
    let fast = shop.get(&export("dialect=linuxcnc&machine=F2")).await;
    assert_eq!((fast.status, &fast.body["code"]), (422, &json!("outside_machine")));
}

#[tokio::test]
async fn what_a_shop_has_now_is_imported_as_a_draft() {
    let story = Story::begin().await;
    let shop = &story.shop;
    let import = |format: &str, text: &str| {
        json!({"profile": "bushing", "reason": "as it runs today", "format": format, "text": text,
               "operation": "O1", "tool_type": "fd-7.3", "limits": limits(), "wear": {"to_level": 1.05}})
    };
    let program = "%\nO0815 (BUSH M8)\nG21 G90 G94\nS2800 M3\nG0 X10. Y5. Z5.\nG1 Z0.5 F1000.\nG1 Z-4. F160.\n\
                   G1 Z-8. F480.\nG1 Z-20.5 F150.\nG0 Z50.\nM30\n%\n";
    let drafted = shop.post("/v1/feed-profiles/import", &import("gcode", program)).await;
    assert_eq!(drafted.status, 201, "{}", drafted.text);
    assert_eq!((&drafted.body["source"], &drafted.body["state"]), (&json!("imported"), &json!("draft")));
    assert_eq!(drafted.body["report"]["passed_over"], json!(["O815", "S2800", "M3", "M30"]));
    assert_eq!(drafted.body["report"].get("without_point"), None, "every depth has its point");
    let feeds: Vec<_> = drafted.body["content"]["knots"]
        .as_array()
        .unwrap()
        .iter()
        .map(|knot| number(&knot["feed_mm_min"]))
        .collect();
    assert_eq!(feeds, [160.0, 160.0, 480.0, 480.0, 150.0, 150.0], "ramps instead of steps");
    let pointless =
        shop.post("/v1/feed-profiles/import", &import("gcode", &program.replace("Z-8.", "Z-9"))).await;
    assert_eq!(pointless.status, 201, "{}", pointless.text);
    assert_eq!(pointless.body["report"]["without_point"], json!(["Z-9"]));
    let list = shop
        .post("/v1/feed-profiles/import", &import("csv_linear", "depth;feed\n0;105\n3;155\n20.5;345\n"))
        .await;
    assert_eq!((list.status, &list.body["version"]), (201, &json!(3)), "{}", list.text);
    let bad = shop.post("/v1/feed-profiles/import", &import("gcode", "G0 Z5\nG83 Z-20.5 R1 Q2 F100\n")).await;
    assert_eq!((bad.status, &bad.body["errors"][0]["path"]), (422, &json!("text:line 2")), "{}", bad.text);
    let short = shop.post("/v1/feed-profiles/import", &import("csv_linear", "0,100\n19,100\n")).await;
    assert_eq!((short.status, &short.body["code"]), (422, &json!("not_covered")), "{}", short.text);
}

async fn ended(shop: &Shop, path: &str) -> Value {
    for _ in 0..2400 {
        let job = shop.get(path).await;
        assert_eq!(job.status, 200, "{}", job.text);
        if !["waiting", "running"].contains(&job.body["state"].as_str().unwrap()) {
            return job.body;
        }
        tokio::time::sleep(std::time::Duration::from_millis(25)).await;
    }
    panic!("{path} does not end");
}

#[tokio::test]
async fn a_profile_is_learnt_from_cycles_and_its_prediction_held_against_the_next_ones() {
    let mut story = Story::begin().await;
    let question = json!({
        "operation": "O1", "tool_type": "fd-7.3", "limits": limits(),
        "heating": {"feed_mm_min": 160.0, "until_mm": 3.0},
    });
    let none = story.shop.post("/v1/feed-profiles/optimize", &question).await;
    assert_eq!(none.status, 202, "{}", none.text);
    let ended_without = ended(&story.shop, none.headers["location"].to_str().unwrap()).await;
    assert_eq!(ended_without["result"]["refused"][0]["path"], "cycles", "{ended_without}");
    let empty = json!({"profile": "bushing", "job": ended_without["id"], "reason": "r"});
    assert_eq!(story.shop.post("/v1/feed-profiles", &empty).await.body["errors"][0]["code"], "no_proposal");

    for factor in [0.85, 1.0, 1.15] {
        story.drill(1, factor, None).await;
    }
    let asked = story.shop.post("/v1/feed-profiles/optimize", &question).await;
    let done = ended(&story.shop, asked.headers["location"].to_str().unwrap()).await;
    assert_eq!(done["state"], "done", "{done}");
    let report = &done["result"]["report"];
    assert_eq!(report["learned_from"], 3, "{done}");
    assert!(number(&report["prediction"]["time_s"]["low"]) < number(&report["prediction"]["time_s"]["high"]));
    let explained = report["sections"].as_array().unwrap();
    assert!(explained.iter().all(|section| !section["text"].as_str().unwrap().is_empty()), "{report}");
    assert!(number(&done["result"]["content"]["wear"]["to_level"]) >= 1.0);

    let draft = json!({"profile": "bushing", "job": done["id"], "reason": "learnt from three holes"});
    let drafted = story.shop.post("/v1/feed-profiles", &draft).await;
    assert_eq!(drafted.status, 201, "{}", drafted.text);
    assert_eq!(
        (&drafted.body["source"], &drafted.body["report"]["learned_from"]),
        (&json!("optimised"), &json!(3))
    );
    let version = drafted.body["version"].as_u64().unwrap();
    story.bring(version).await;

    let learnt: Vec<(f64, f64)> = drafted.body["content"]["knots"]
        .as_array()
        .unwrap()
        .iter()
        .map(|knot| (number(&knot["depth_mm"]), number(&knot["feed_mm_min"])))
        .collect();
    assert!(learnt.iter().filter(|(depth, _)| *depth < 3.0).all(|(_, feed)| *feed <= 160.0), "{learnt:?}");
    let program = FeedProgram::from_pairs(Between::Linear, &learnt).unwrap();
    let strategy = Strategy::new("learnt", program, PAPER_END_DEPTH_MM, None).unwrap();
    for number in 50..56 {
        let mut cycle = drilled(number, &strategy, "f_lin", false);
        cycle["profile"] = json!({"id": "bushing", "version": version});
        assert_eq!(story.shop.cycle("F1", &cycle).await.status, 201);
    }
    let outcome = story.shop.get(&format!("{HERE}/outcome")).await;
    assert_eq!(outcome.status, 200, "{}", outcome.text);
    assert_eq!(outcome.body["cycles"].as_array().unwrap().len(), 6);
    for cycle in outcome.body["cycles"].as_array().unwrap() {
        assert!(number(&cycle["time_s"]["relative"]).abs() < 0.1, "{}", outcome.text);
    }
    assert!(number(&outcome.body["within_share"]) >= 0.5, "{}", outcome.text);
    // How the prediction turned out is what the next one is trusted by.
    let scale = number(&outcome.body["spread_scale"]);
    assert_eq!(outcome.body["skipped_cycles"], json!([]));
    // Of half a hole nothing is held against the prediction of one, whoever stopped it.
    for number in [56, 57] {
        let mut cycle = drilled(number, &strategy, "f_lin", false);
        cycle["profile"] = json!({"id": "bushing", "version": version});
        if number == 56 {
            cycle["outcome"] = json!("aborted");
        }
        for (_, column) in cycle["samples"].as_object_mut().unwrap() {
            if let Some(column) = column.as_array_mut() {
                column.truncate(column.len() / 2);
            }
        }
        assert_eq!(story.shop.cycle("F1", &cycle).await.status, 201);
        if number == 57 {
            story.shop.cut_short(cycle["cycle_id"].as_str().unwrap()).await;
        }
    }
    let again = story.shop.get(&format!("{HERE}/outcome")).await;
    assert_eq!(again.body["cycles"], outcome.body["cycles"], "{}", again.text);
    assert_eq!(again.body["spread_scale"], outcome.body["spread_scale"]);
    let left_out = again.body["skipped_cycles"].as_array().unwrap();
    let reasons: Vec<_> = left_out.iter().map(|one| one["reason"].as_str().unwrap()).collect();
    assert_eq!(
        (&again.body["skipped"], reasons),
        (&json!(2), vec!["aborted", "cut_short"]),
        "{}",
        again.text
    );
    let compared = story.shop.get(&format!("{HERE}/comparison?before={version}&after={version}")).await;
    assert_eq!(compared.body["duration_s"]["before"]["cycles"], 6, "{}", compared.text);
    assert_eq!((&compared.body["aborted"], &compared.body["cut_short"]), (&json!([1, 1]), &json!([1, 1])));
    assert!((0.7..=4.0).contains(&scale) && (scale - 1.0).abs() > 1e-9, "{scale}");
    let mut next = question.clone();
    next["profile"] = json!("bushing");
    let asked = story.shop.post("/v1/feed-profiles/optimize", &next).await;
    let done = ended(&story.shop, asked.headers["location"].to_str().unwrap()).await;
    let report = &done["result"]["report"];
    assert!((number(&report["spread_scale"]) - scale).abs() < 1e-12, "{done}");
    // The machine says what a percent of its spindle is, so the energy of a hole is told in joules.
    assert!(number(&report["prediction"]["energy_joules"]["expected"]) > 100.0, "{done}");
    let mut faster = next.clone();
    faster["override_percent"] = json!(150.0);
    let asked = story.shop.post("/v1/feed-profiles/optimize", &faster).await;
    let raised = ended(&story.shop, asked.headers["location"].to_str().unwrap()).await;
    // What runs at 150 % is programmed slower.
    let seconds = |done: &Value| {
        let knots = done["result"]["content"]["knots"].as_array().unwrap().clone();
        let knots: Vec<(f64, f64)> =
            knots.iter().map(|knot| (number(&knot["depth_mm"]), number(&knot["feed_mm_min"]))).collect();
        knots.windows(2).map(|pair| 120.0 * (pair[1].0 - pair[0].0) / (pair[0].1 + pair[1].1)).sum::<f64>()
    };
    assert!(seconds(&raised) > seconds(&done) * 1.1, "{} {}", seconds(&raised), seconds(&done));
    let bad = json!({"operation": "O1", "tool_type": "fd-7.3", "limits": limits(), "confidence": 2.0});
    let refused = story.shop.post("/v1/feed-profiles/optimize", &bad).await;
    assert_eq!((refused.status, &refused.body["errors"][0]["path"]), (422, &json!("confidence")));
    let unknown = json!({"profile": "bushing", "job": "none", "reason": "r"});
    assert_eq!(story.shop.post("/v1/feed-profiles", &unknown).await.body["errors"][0]["code"], "unknown_job");
}

async fn where_retention_has_left_nothing_to_learn_from_the_refusal_says_so() {
    let mut story = Story::begin().await;
    let mut question = json!({"operation": "O1", "tool_type": "fd-7.3", "limits": limits()});
    let mut refused = async |story: &Story, change: Option<Value>| {
        if let Some(edges) = change {
            question["wear_edges"] = edges;
        }
        let asked = story.shop.post("/v1/feed-profiles/optimize", &question).await;
        let done = ended(&story.shop, asked.headers["location"].to_str().unwrap()).await;
        let result = done["result"].clone();
        assert_eq!(
            (&result["report"], &result["refused"][0]["path"]),
            (&Value::Null, &json!("cycles")),
            "{done}"
        );
        result
    };
    let none = refused(&story, None).await;
    assert!(none["refused"][0]["message"].as_str().unwrap().starts_with("no cycle was given"), "{none}");
    assert_eq!(none["skipped"], json!([]));
    for factor in [0.85, 1.0] {
        story.drill(1, factor, None).await;
    }
    assert_eq!(story.shop.get("/v1/cycles?tool=T1").await.body["items"].as_array().unwrap().len(), 2);
    assert_eq!(story.shop.tables("DELETE FROM cycle_samples").await, 2);
    // The same question by the cycles that there are to learn from, and another answer.
    for change in [None, Some(json!([1.0, 1.04]))] {
        let gone = refused(&story, change).await;
        let message = gone["refused"][0]["message"].as_str().unwrap();
        assert!(message.contains("the samples of 2 were dropped by retention, or are missing"), "{message}");
        let skipped = gone["skipped"].as_array().unwrap();
        assert_eq!(skipped.len(), 2, "{gone}");
        assert!(skipped.iter().all(|one| one["reason"] == "samples_dropped"), "{gone}");
    }
}

#[tokio::test]
async fn a_stored_profile_is_asked_about_by_its_id_and_version() {
    let mut story = Story::begin().await;
    for factor in [0.85, 1.0, 1.15, 0.95, 1.05, 1.0] {
        story.drill(1, factor, None).await;
    }
    let version = story.drafted(&draft(1.2)).await;
    let of_c2 = "/v1/machines/F1/cycles/c2/what-if";
    let asked = |profile: Value| json!({"control": {"profile": profile}});
    let question = asked(json!({"id": "bushing", "version": version}));
    let answer = story.shop.post(of_c2, &question).await;
    assert_eq!(answer.status, 200, "{}", answer.text);
    assert_eq!(answer.body["assumed"]["profile"], format!("bushing@{version}"));
    let shorter =
        number(&answer.body["predicted"]["duration_s"]) / number(&answer.body["happened"]["duration_s"]);
    assert!((shorter - 1.0 / 1.2).abs() < 0.06, "a fifth faster: {shorter}");
    // The same as the same knots given inline.
    let inline = asked(json!({"between": "linear", "knots": draft(1.2)["content"]["knots"]}));
    let by_knots = story.shop.post(of_c2, &inline).await;
    assert_eq!(by_knots.body["predicted"], answer.body["predicted"], "{}", by_knots.text);
    // The law over a profile keeps to the profile's set loads and override limits.
    let mut lawful = question.clone();
    lawful["control"]["law"] = json!({});
    let under_law = story.shop.post(of_c2, &lawful).await;
    assert_eq!(under_law.status, 200, "{}", under_law.text);
    lawful["control"]["law"] = json!({"override_max_percent": 120, "set_spindle_percent": 50,
                                      "set_feed_drive_percent": 40});
    assert_ne!(story.shop.post(of_c2, &lawful).await.body["predicted"], under_law.body["predicted"]);
    let many = json!({"filter": {"machine": "F1"}, "question": question});
    let sum = story.shop.post("/v1/what-if", &many).await;
    assert_eq!(sum.status, 200, "{}", sum.text);
    assert_eq!(sum.body["predicted_cycles"], 6, "{}", sum.text);

    // The active version is asked about where none is named, once there is one.
    let active = asked(json!({"id": "bushing"}));
    let none = story.shop.post(of_c2, &active).await;
    assert_eq!((none.status, &none.body["errors"][0]["code"]), (422, &json!("no_active_version")));
    story.bring(version).await;
    let found = story.shop.post(of_c2, &active).await;
    assert_eq!(found.body["assumed"]["profile"], format!("bushing@{version}"), "{}", found.text);

    for (profile, path, code) in [
        (json!({"id": "nobody", "version": 1}), "profile.id", "unknown_profile"),
        (json!({"id": "bushing", "version": 99}), "profile.version", "unknown_version"),
        (json!({"id": "bushing", "version": 0}), "profile.version", "out_of_range"),
        (json!({"version": 1}), "profile.id", "missing_field"),
        (json!({}), "profile", "missing_field"),
        (json!({"id": "bushing", "between": "held"}), "profile", "contradictory"),
        (json!({"between": "held", "knots": []}), "profile.knots", "empty"),
    ] {
        for (path, answer) in [
            (format!("control.{path}"), story.shop.post(of_c2, &asked(profile.clone())).await),
            (
                format!("question.control.{path}"),
                story.shop.post("/v1/what-if", &json!({"question": asked(profile.clone())})).await,
            ),
        ] {
            assert_eq!(answer.status, 422, "{profile}: {}", answer.text);
            let wrong = &answer.body["errors"][0];
            assert_eq!((&wrong["path"], &wrong["code"]), (&json!(path), &json!(code)), "{profile}");
        }
    }
    let mut both = question.clone();
    both["control"]["program"] = json!({"between": "held", "knots": [{"depth_mm": 0, "feed_mm_min": 100}]});
    assert_eq!(story.shop.post(of_c2, &both).await.status, 422);
}

#[tokio::test]
async fn a_profile_is_not_asked_about_what_it_was_not_made_for() {
    let mut story = Story::begin().await;
    story.drill(4, 1.0, None).await;
    let unbounded = json!({"name": "Another", "process": "friction", "spindle_speed_rpm": 2800});
    assert_eq!(story.shop.put("/v1/operations/O2", &unbounded).await.status, 201);
    let mut other = drilled(5, &strategy(1.0), "f_lin", false);
    other["operation"] = json!("O2");
    assert_eq!(story.shop.cycle("F1", &other).await.status, 201);
    let version = story.drafted(&draft(1.1)).await;
    let control = json!({"profile": {"id": "bushing", "version": version}});
    let answer =
        story.shop.post("/v1/machines/F1/cycles/c5/what-if", &json!({"control": control.clone()})).await;
    assert_eq!((answer.status, &answer.body["reason"]), (422, &json!("other_operation")), "{}", answer.text);
    let sum = story
        .shop
        .post("/v1/what-if", &json!({"filter": {}, "question": {"control": control.clone()}}))
        .await;
    assert_eq!(sum.body["predicted_cycles"], 4, "{}", sum.text);
    assert_eq!(sum.body["skipped"], json!({"other_operation": 1}), "{}", sum.text);
    let wrong = json!({"filter": {"operation": "O2"}, "question": {"control": control}});
    let answer = story.shop.post("/v1/what-if", &wrong).await;
    assert_eq!((answer.status, &answer.body["errors"][0]["code"]), (422, &json!("other_operation")));

    // A profile that ends where half of the hole is still to come.
    let mut short = draft(1.0);
    let knots: Vec<Value> = short["content"]["knots"].as_array().unwrap()[..4].to_vec();
    let end = number(&knots[3]["depth_mm"]);
    short["profile"] = json!("short");
    short["content"]["operation"] = json!("O2");
    short["content"]["knots"] = json!(knots);
    short["content"]["sections"] =
        json!([{"kind": "heating", "to_mm": 3.0}, {"kind": "forming", "to_mm": end}]);
    let drafted = story.shop.post("/v1/feed-profiles", &short).await;
    assert_eq!(drafted.status, 201, "{}", drafted.text);
    let question = json!({"control": {"profile": {"id": "short", "version": 1}}});
    let answer = story.shop.post("/v1/machines/F1/cycles/c5/what-if", &question).await;
    assert_eq!(
        (answer.status, &answer.body["reason"]),
        (422, &json!("profile_too_short")),
        "{}",
        answer.text
    );
    let detail = answer.body["detail"].as_str().unwrap();
    assert!(detail.contains("12 mm"), "{detail}");
}

#[tokio::test]
async fn a_profile_per_wear_band_is_drafted_and_each_is_handed_out_within_its_band() {
    let mut story = Story::begin().await;
    for factor in [0.85, 1.0, 1.15] {
        story.drill(1, factor, None).await;
    }
    let question = json!({
        "operation": "O1", "tool_type": "fd-7.3", "limits": limits(), "wear_edges": [1.0, 1.04, 1.08],
    });
    let refused = |body: Value, change: Value| {
        let mut body = body;
        body.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
        body
    };
    let both = refused(question.clone(), json!({"wear_level": 1.02}));
    let answer = story.shop.post("/v1/feed-profiles/optimize", &both).await;
    assert_eq!(
        (answer.status, &answer.body["errors"][0]["path"]),
        (422, &json!("wear_edges")),
        "{}",
        answer.text
    );
    for (edges, path) in [
        (json!([1.0]), "wear_edges"),
        (json!([1.0, 9.0]), "wear_edges[1]"),
        (json!([1.0, 1.0]), "wear_edges[1]"),
    ] {
        let wrong = refused(question.clone(), json!({"wear_edges": edges}));
        let answer = story.shop.post("/v1/feed-profiles/optimize", &wrong).await;
        assert_eq!(
            (answer.status, &answer.body["errors"][0]["path"]),
            (422, &json!(path)),
            "{}",
            answer.text
        );
    }
    // Three cycles do not tell their wear: no band is made up.
    let asked = story.shop.post("/v1/feed-profiles/optimize", &question).await;
    let done = ended(&story.shop, asked.headers["location"].to_str().unwrap()).await;
    assert_eq!(done["result"]["bands"], json!([]), "{done}");
    assert_eq!(done["result"]["refused"][0]["path"], "cycles", "{done}");

    // A tool that was mounted new tells it after its baseline.
    let mounted = json!({"kind": "mounted_new", "at": "2026-01-01T00:00:00Z"});
    assert_eq!(story.shop.post("/v1/tools/T1/events", &mounted).await.status, 201);
    story.drill(30, 1.0, None).await;
    let asked = story.shop.post("/v1/feed-profiles/optimize", &question).await;
    let done = ended(&story.shop, asked.headers["location"].to_str().unwrap()).await;
    let bands = done["result"]["bands"].as_array().unwrap().clone();
    assert!(!bands.is_empty(), "{done}");
    assert_eq!((&done["result"]["content"], &bands[0]["from_level"]), (&Value::Null, &json!(1.0)));
    assert_eq!(bands[bands.len() - 1]["to_level"], json!(1.08));
    let draft = |name: String, band: Value| json!({"profile": name, "job": done["id"], "band": band, "reason": "for its wear"});
    let unnamed = story.shop.post("/v1/feed-profiles", &draft("bushing".to_owned(), Value::Null)).await;
    assert_eq!(unnamed.body["errors"][0]["path"], "band", "{}", unnamed.text);
    let beyond = story.shop.post("/v1/feed-profiles", &draft("bushing".to_owned(), json!(9))).await;
    assert_eq!(beyond.body["errors"][0]["code"], "out_of_range", "{}", beyond.text);
    for (at, band) in bands.iter().enumerate() {
        let drafted = story.shop.post("/v1/feed-profiles", &draft(format!("band-{at}"), json!(at))).await;
        assert_eq!(drafted.status, 201, "{}", drafted.text);
        let wear = &drafted.body["content"]["wear"];
        assert!(number(&wear["to_level"]) >= number(&band["to_level"]) - 1e-9, "{}", drafted.text);
        let from = if at == 0 { Value::Null } else { band["from_level"].clone() };
        assert_eq!(wear["from_level"], from, "{}", drafted.text);
    }
}
