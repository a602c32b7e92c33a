//! Reading: samples of a cycle, series and summaries, in every form that clients ask for.

use super::app::{Answer, App, operation, tool};
use feedwright_store::Role;
use http::StatusCode;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use tower::ServiceExt;

crate::engines::on_both!(
    samples_come_chosen_in_a_range_and_few_enough_for_a_screen,
    a_bound_takes_the_sample_whose_time_is_the_same_number_but_for_rounding,
    samples_come_in_the_form_that_is_accepted,
    a_range_without_samples_is_an_empty_table,
    cycles_of_one_moment_stand_in_the_order_of_the_machines_count,
    what_cannot_be_read_says_why,
    buckets_hold_every_cycle_once_and_gaps_are_no_zeros,
    a_range_without_cycles_has_empty_buckets_of_every_measure,
    the_last_cycles_of_a_tool_and_how_worn_it_was_after_each,
    the_level_of_a_series_is_the_one_that_is_judged,
    a_course_has_the_times_and_the_energy_of_its_summary,
    a_bound_that_is_finer_than_what_is_kept_parts_it_all_the_same,
    an_absurd_energy_costs_no_cycle,
    small_answers_do_not_wait_for_large_ones_and_those_are_few_until_they_are_read,
);

const SAMPLES: &str = "/v1/machines/M1/cycles/s1/samples";

async fn shop() -> App {
    let app = App::registered().await;
    assert_eq!(app.put("/v1/operations/O1", operation()).await.status, StatusCode::CREATED);
    app
}

async fn post(app: &App, body: Value) {
    let answer = app.call(Role::Machine, "POST", "/v1/machines/M1/cycles", &[], Some(body)).await;
    assert_eq!(answer.status, StatusCode::CREATED, "{}", String::from_utf8_lossy(&answer.body));
}

async fn get_as(app: &App, path: &str, accept: &str) -> Answer {
    app.call(Role::Viewer, "GET", path, &[("accept", accept)], None).await
}

fn text(answer: Answer) -> String {
    assert_eq!(answer.status, StatusCode::OK, "{answer:?}");
    String::from_utf8(answer.body).unwrap()
}

/// 1,000 samples at 100 Hz, the depth growing by 0.01 mm, one load of 180 % among 20 %.
async fn sampled(app: &App) {
    let depth: Vec<f64> = (0..1000).map(|k| f64::from(k) / 100.0).collect();
    let mut load = vec![20.0; 1000];
    load[617] = 180.0;
    post(
        app,
        json!({
            "cycle_id": "s1", "tool": "T1", "operation": "O1", "started_at": "2026-05-04T05:00:00.5Z",
            "samples": {"period_ms": 10, "depth_mm": depth, "spindle_load_percent": load},
        }),
    )
    .await;
}

async fn samples_come_chosen_in_a_range_and_few_enough_for_a_screen() {
    let app = shop().await;
    sampled(&app).await;
    let all = app.get(SAMPLES).await.json();
    assert_eq!((all["period_ms"].as_f64(), all["depth_mm"].as_array().unwrap().len()), (Some(10.0), 1000));

    let load = app.get(&format!("{SAMPLES}?channels=spindle_load_percent")).await.json();
    assert_eq!((load["period_ms"].as_f64(), load.get("depth_mm")), (Some(10.0), None));

    // The first sample is at the end of the first period, 10 ms.
    let second = app.get(&format!("{SAMPLES}?from_ms=1010&to_ms=1030")).await.json();
    assert_eq!(second["time_ms"], json!([1010.0, 1020.0, 1030.0]));
    assert_eq!(second["depth_mm"], json!([1.0, 1.01, 1.02]));
    let deep = app.get(&format!("{SAMPLES}?from_depth_mm=9.98&channels=depth_mm")).await.json();
    assert_eq!(deep["depth_mm"], json!([9.98, 9.99]));
    let none = app.get(&format!("{SAMPLES}?from_depth_mm=20")).await.json();
    assert_eq!(none["depth_mm"], json!([]));

    let few = app.get(&format!("{SAMPLES}?points=20")).await.json();
    let loads = few["spindle_load_percent"].as_array().unwrap();
    assert!(loads.len() <= 20 && loads.contains(&json!(180.0)), "the peak survives: {few}");
    let shape = app.get(&format!("{SAMPLES}?points=20&method=lttb&channels=depth_mm")).await.json();
    assert_eq!(shape["depth_mm"].as_array().unwrap().len(), 20);

    let rows = app.get(&format!("{SAMPLES}?to_ms=20&layout=rows")).await.json();
    assert_eq!(
        rows["items"][1],
        json!({"time": "2026-05-04T05:00:00.520000Z", "time_ms": 20.0, "depth_mm": 0.01, "spindle_load_percent": 20.0})
    );
}

async fn a_bound_takes_the_sample_whose_time_is_the_same_number_but_for_rounding() {
    let app = shop().await;
    let samples = json!({"period_ms": 1.1, "spindle_load_percent": [20.0, 21.0, 22.0, 23.0]});
    post(
        &app,
        json!({"cycle_id": "s1", "tool": "T1", "operation": "O1",
        "started_at": "2026-05-04T05:00:00.5Z", "samples": samples}),
    )
    .await;
    // Three times 1.1 is 3.3000000000000003.
    for range in ["from_ms=3.3&to_ms=3.3", "from_ms=2.21&to_ms=3.3", "from_ms=3.3&to_ms=4.39"] {
        let one = app.get(&format!("{SAMPLES}?{range}")).await.json();
        assert_eq!(one["spindle_load_percent"], json!([22.0]), "{range}");
    }
    let beside = app.get(&format!("{SAMPLES}?from_ms=3.30000001&to_ms=4.39999999")).await.json();
    assert_eq!(beside["spindle_load_percent"], json!([]), "what is another number is none of it");
}

async fn samples_come_in_the_form_that_is_accepted() {
    let app = shop().await;
    sampled(&app).await;
    let csv = get_as(&app, &format!("{SAMPLES}?to_ms=20"), "text/csv").await;
    assert_eq!(csv.header("content-type"), "text/csv; charset=utf-8; header=present");
    assert_eq!(csv.header("vary"), "accept");
    assert_eq!(
        text(csv),
        "time,time_ms,depth_mm,spindle_load_percent\r\n\
         2026-05-04T05:00:00.510000Z,10,0,20\r\n2026-05-04T05:00:00.520000Z,20,0.01,20\r\n"
    );
    let parquet = get_as(&app, SAMPLES, "application/vnd.apache.parquet, */*;q=0.1").await;
    assert_eq!(parquet.header("content-type"), "application/vnd.apache.parquet");
    assert!(parquet.body.starts_with(b"PAR1") && parquet.body.ends_with(b"PAR1"));
    let arrow = get_as(&app, SAMPLES, "application/vnd.apache.arrow.stream").await;
    // An IPC stream ends with the marker and a length of zero.
    assert!(arrow.body.ends_with(&[0xff, 0xff, 0xff, 0xff, 0, 0, 0, 0]), "{} bytes", arrow.body.len());
    let refused = get_as(&app, SAMPLES, "text/html, application/json;q=0").await;
    assert_eq!((refused.status, refused.code().as_str()), (StatusCode::NOT_ACCEPTABLE, "not_acceptable"));
}

async fn a_range_without_samples_is_an_empty_table() {
    let app = shop().await;
    sampled(&app).await;
    for range in
        ["from_ms=1e9", "to_ms=-1", "from_ms=11&to_ms=12", "from_depth_mm=500", "from_ms=1e9&points=100"]
    {
        let path = format!("{SAMPLES}?{range}");
        let columns = json!({"time_ms": [], "depth_mm": [], "spindle_load_percent": []});
        assert_eq!(app.get(&path).await.json(), columns, "{range}");
        assert_eq!(app.get(&format!("{path}&layout=rows")).await.json()["items"], json!([]), "{range}");
        let csv = text(get_as(&app, &path, "text/csv").await);
        assert_eq!(csv, "time,time_ms,depth_mm,spindle_load_percent\r\n", "{range}");
        let parquet = get_as(&app, &path, "application/vnd.apache.parquet").await;
        assert!(parquet.body.starts_with(b"PAR1") && parquet.body.ends_with(b"PAR1"), "{range}");
        let arrow = get_as(&app, &path, "application/vnd.apache.arrow.stream").await;
        assert!(arrow.body.ends_with(&[0xff, 0xff, 0xff, 0xff, 0, 0, 0, 0]), "{range}");
    }
}

/// As wear counts them: a control may begin several within one tick of its clock.
async fn cycles_of_one_moment_stand_in_the_order_of_the_machines_count() {
    let app = shop().await;
    for number in [10, 8, 11, 9] {
        let mut cycle = reported(number, "2026-05-04T05:00:00Z", f64::from(number));
        cycle["seq"] = number.into();
        post(&app, cycle).await;
    }
    post(&app, reported(12, "2026-05-04T05:00:01Z", 12.0)).await;
    let ordered = json!(["c8", "c9", "c10", "c11", "c12"]);
    let ids = |items: &Value| {
        let items = items.as_array().unwrap_or_else(|| panic!("{items}"));
        items.iter().map(|item| item["cycle_id"].clone()).collect::<Value>()
    };
    for of in ["tool=T1", "machine=M1", "operation=O1", "tool=T1&machine=M1"] {
        for measure in ["duration_ms", "energy_joules"] {
            let path = format!("/v1/series?{of}&last=5&measures={measure}");
            assert_eq!(app.get(&path).await.json()["series"][0]["cycle_id"], ordered, "{path}");
            let newest = app.get(&path.replace("last=5", "last=2")).await.json();
            assert_eq!(newest["series"][0]["cycle_id"], json!(["c11", "c12"]), "{path}");
        }
        let path = format!("/v1/summaries?{of}&last=2");
        assert_eq!(ids(&app.get(&path).await.json()["items"]), json!(["c11", "c12"]), "{path}");
        // Page by page: a cursor is within the moment.
        let (mut found, mut cursor) = (Vec::new(), String::new());
        loop {
            let page = app.get(&format!("/v1/cycles?{of}&limit=2{cursor}")).await.json();
            found.extend(page["items"].as_array().unwrap().iter().map(|cycle| cycle["cycle_id"].clone()));
            let Some(next) = page["next_cursor"].as_str() else { break };
            cursor = format!("&cursor={next}");
        }
        assert_eq!(Value::from(found), ordered, "{of}");
    }
    assert_eq!(ids(&app.get("/v1/summaries").await.json()["items"]), ordered);
    let life = app.get("/v1/tools/T1/life").await.json();
    assert_eq!(life["cycle_id"], ordered, "{life}");
    assert_eq!(app.get("/v1/fleet/M1").await.json()["last_cycle"]["cycle_id"], "c12");
}

async fn what_cannot_be_read_says_why() {
    let app = shop().await;
    sampled(&app).await;
    for (query, path, code) in [
        ("channels=load", "channels", "unknown_channel"),
        ("channels=thrust_newtons", "channels", "channel_not_sampled"),
        ("from_ms=5&to_ms=4", "to_ms", "empty_range"),
        ("from_ms=NaN", "from_ms", "not_finite"),
        ("points=5", "points", "too_few_points"),
        ("points=7&channels=depth_mm&method=best", "method", "unknown_word"),
        ("layout=table", "layout", "unknown_word"),
    ] {
        let answer = app.get(&format!("{SAMPLES}?{query}")).await;
        assert_eq!(answer.status, StatusCode::UNPROCESSABLE_ENTITY, "{query}");
        assert_eq!(answer.errors(), [(path.to_owned(), code.to_owned())], "{query}");
    }
    post(
        &app,
        json!({"cycle_id": "s2", "tool": "T1", "operation": "O1", "started_at": "2026-05-04T05:10:00Z",
                      "samples": {"period_ms": 10, "spindle_load_percent": [4.1, 12.7]}}),
    )
    .await;
    for asked in ["from_depth_mm", "to_depth_mm"] {
        let answer = app.get(&format!("/v1/machines/M1/cycles/s2/samples?{asked}=1")).await;
        assert_eq!(answer.errors(), [(asked.to_owned(), "channel_not_sampled".to_owned())]);
    }
    for query in ["point=5", "points=many", "points=-1", "from_ms=soon"] {
        assert_eq!(app.get(&format!("{SAMPLES}?{query}")).await.code(), "invalid_query", "{query}");
    }
    assert_eq!(app.get("/v1/machines/M1/cycles/none/samples").await.status, StatusCode::NOT_FOUND);
    for (query, path, code) in [
        ("", "bucket", "one_of"),
        ("bucket=1h&last=5", "bucket", "one_of"),
        ("bucket=1h", "from", "missing"),
        ("bucket=soon&from=2026-05-04T00:00:00Z", "bucket", "invalid_duration"),
        ("bucket=1s&from=2020-01-01T00:00:00Z", "bucket", "too_many_buckets"),
        ("bucket=5300w&from=0001-01-01T00:00:00Z", "bucket", "out_of_range"),
        ("bucket=1h&from=2027-01-01T00:00:00Z", "to", "empty_range"),
        ("last=3&from=2026-05-05T00:00:00Z&to=2026-05-04T00:00:00Z", "to", "empty_range"),
        ("last=3&from=2026-05-04T00:00:00Z&to=2026-05-04T00:00:00Z", "to", "empty_range"),
        ("bucket=1h&from=yesterday", "from", "invalid_timestamp"),
        ("last=0", "last", "out_of_range"),
        ("last=10001", "last", "out_of_range"),
        ("last=5&measures=energy", "measures", "unknown_measure"),
        ("last=5&by=shift", "by", "unknown_word"),
        ("last=5&layout=table", "layout", "unknown_word"),
    ] {
        let answer = app.get(&format!("/v1/series?{query}")).await;
        assert_eq!(answer.status, StatusCode::UNPROCESSABLE_ENTITY, "{query}: {answer:?}");
        assert_eq!(answer.errors(), [(path.to_owned(), code.to_owned())], "{query}");
    }
    let fine = "/v1/series?bucket=1ms&from=2026-05-04T00:00:00Z&to=2026-05-05T00:00:00Z";
    let fine = app.get(fine).await.json();
    assert!(fine["errors"][0]["message"].as_str().unwrap().contains("86400000 buckets of 1 ms"), "{fine}");
    // Its first bucket begins before there are years.
    let path = "/v1/series?bucket=1000d&from=0001-01-01T00:00:00Z&to=2026-05-05T00:00:00Z&measures=duration_ms&machine=M1";
    let longest = app.get(path).await.json();
    assert_eq!(longest["series"][0]["points"][0]["time"], "0001-01-01T00:00:00Z", "{longest}");
    for path in [
        "/v1/series?last=5&machine=M9",
        "/v1/series?last=5&tool=T9",
        "/v1/series?last=5&operation=O9",
        "/v1/summaries?machine=M9",
        "/v1/summaries?tool=T9",
        "/v1/summaries?operation=O9&last=2",
    ] {
        assert_eq!(app.get(path).await.status, StatusCode::NOT_FOUND, "{path}");
    }
    for (end, status) in [("04T05:00:00Z", 422), ("04T04:59:59Z", 422), ("04T05:00:00.000001Z", 200)] {
        let range = format!("from=2026-05-04T05:00:00Z&to=2026-05-{end}");
        for path in ["/v1/summaries?", "/v1/summaries?last=3&", "/v1/cycles?", "/v1/series?last=3&"] {
            let answer = app.get(&format!("{path}{range}")).await;
            assert_eq!(answer.status, status, "{path}{range}: {answer:?}");
            if status == 422 {
                assert_eq!(answer.errors(), [("to".to_owned(), "empty_range".to_owned())]);
            }
        }
    }
    let filter = json!({"from": "2026-05-04T05:00:00Z", "to": "2026-05-04T05:00:00Z"});
    let many = app.post("/v1/what-if", json!({"filter": filter, "question": {"control": {}}})).await;
    assert_eq!(many.errors(), [("filter.to".to_owned(), "empty_range".to_owned())]);
    let none = app.get("/v1/summaries?tool=T1&to=2020-01-01T00:00:00Z").await;
    assert_eq!(
        (none.status, &none.json()["items"]),
        (StatusCode::OK, &json!([])),
        "known, and none of that time"
    );
}

/// A cycle that the control only reported.
fn reported(number: u32, at: &str, joules: f64) -> Value {
    json!({
        "cycle_id": format!("c{number}"), "tool": "T1", "operation": "O1", "started_at": at,
        "reported": {"energy_joules": joules, "duration_ms": 4000.0 + f64::from(number)},
    })
}

async fn buckets_hold_every_cycle_once_and_gaps_are_no_zeros() {
    let app = shop().await;
    for (number, at, joules) in
        [(1, "02:10:00", 100.0), (2, "02:20:00", 300.0), (3, "02:30:00", 200.0), (4, "04:00:00", 50.0)]
    {
        post(&app, reported(number, &format!("2026-05-04T{at}Z"), joules)).await;
    }
    // A sampled cycle in the last bucket: its energy rests on the rating, and is never averaged with reported ones.
    sampled(&app).await;
    let path = "/v1/series?tool=T1&bucket=1h&from=2026-05-04T02:00:00Z&to=2026-05-04T06:00:00Z";
    let answer = app.get(&format!("{path}&measures=energy_joules,duration_ms")).await.json();
    assert_eq!(answer["by"], "tool");
    let series = answer["series"].as_array().unwrap();
    let names: Vec<_> =
        series.iter().map(|one| (one["measure"].as_str().unwrap(), one["basis"].as_str())).collect();
    assert_eq!(
        names,
        [("energy_joules", Some("rated_power")), ("energy_joules", Some("reported")), ("duration_ms", None)]
    );
    let reported = &series[1];
    assert_eq!((reported["unit"].as_str(), reported["group"].as_str()), (Some("J"), Some("T1")));
    let points = reported["points"].as_array().unwrap();
    assert_eq!(points.len(), 4);
    assert_eq!(
        points[0],
        json!({"time": "2026-05-04T02:00:00Z", "count": 3, "mean": 200.0, "min": 100.0, "max": 300.0,
               "p50": 200.0, "p95": 290.0})
    );
    assert_eq!((points[1]["count"].as_u64(), points[1]["mean"].is_null()), (Some(0), true));
    assert_eq!(points[3]["count"], 0, "the sampled cycle is of another basis");
    assert_eq!(series[0]["points"][3]["count"], 1);

    let rows = app.get(&format!("{path}&measures=duration_ms&layout=rows")).await.json();
    assert_eq!(rows["items"].as_array().unwrap().len(), 4);
    assert_eq!(rows["items"][0]["p50"], 4002.0);
    assert!(rows["items"][1]["mean"].is_null());
    let csv = text(get_as(&app, &format!("{path}&measures=duration_ms"), "text/csv").await);
    let lines: Vec<_> = csv.split("\r\n").collect();
    assert_eq!(lines[0], "time,tool,measure,unit,basis,idle_power,count,mean,min,max,p50,p95");
    assert_eq!(lines[2], "2026-05-04T03:00:00.000000Z,T1,duration_ms,ms,,,0,,,,,");

    for by in ["fleet", "machine", "operation"] {
        let answer = app.get(&format!("{path}&by={by}&measures=duration_ms")).await.json();
        assert_eq!(answer["series"][0]["points"][0]["count"], 3, "{by}");
    }
}

async fn a_range_without_cycles_has_empty_buckets_of_every_measure() {
    let app = shop().await;
    sampled(&app).await;
    let range = "bucket=1h&from=2026-05-01T00:00:00Z&to=2026-05-01T03:00:00Z";
    let empty = |time: &str| json!({"time": time, "count": 0, "mean": null, "min": null, "max": null, "p50": null, "p95": null});
    let hours = ["2026-05-01T00:00:00Z", "2026-05-01T01:00:00Z", "2026-05-01T02:00:00Z"].map(empty);
    for of in ["tool=T1", "machine=M1", "operation=O1", "by=fleet"] {
        let path = format!("/v1/series?{of}&{range}&measures=energy_joules,duration_ms,wear_level_ratio");
        let answer = app.get(&path).await.json();
        let series = answer["series"].as_array().unwrap();
        let names: Vec<_> = series.iter().map(|one| one["measure"].as_str().unwrap()).collect();
        assert_eq!(names, ["energy_joules", "duration_ms", "wear_level_ratio"], "{of}");
        for one in series {
            assert_eq!(one["points"].as_array().unwrap()[..], hours, "{of}: {one}");
            assert!(one.get("basis").is_none() && one.get("idle_power").is_none(), "{one}");
        }
        let rows = app.get(&format!("/v1/series?{of}&{range}&layout=rows")).await.json();
        assert_eq!(rows["items"].as_array().unwrap().len(), 3, "{of}");
    }
    let csv = text(get_as(&app, &format!("/v1/series?tool=T1&{range}"), "text/csv").await);
    let lines: Vec<_> = csv.split("\r\n").collect();
    assert_eq!(lines[1], "2026-05-01T00:00:00.000000Z,T1,energy_joules,J,,,0,,,,,");
}

async fn the_last_cycles_of_a_tool_and_how_worn_it_was_after_each() {
    let app = shop().await;
    for number in 0..30 {
        let at = format!("2026-05-04T05:{number:02}:00Z");
        post(&app, reported(number, &at, 1000.0 + f64::from(number))).await;
    }
    let answer = app.get("/v1/series?tool=T1&last=5&measures=energy_joules,wear_level_ratio").await.json();
    let series = answer["series"].as_array().unwrap();
    assert_eq!(series[0]["value"], json!([1025.0, 1026.0, 1027.0, 1028.0, 1029.0]));
    assert_eq!(series[0]["cycle_id"][4], "c29");
    assert_eq!(series[0]["time"][0], "2026-05-04T05:25:00Z");
    let level = series[1]["value"].as_array().unwrap().last().unwrap().clone();
    let wear = app.get("/v1/tools/T1/wear").await.json();
    assert_eq!(wear["level"]["value"], level, "{wear}");

    let path = "/v1/series?tool=T1&bucket=10m&from=2026-05-04T05:00:00Z&to=2026-05-04T05:30:00Z";
    let bucketed = app.get(&format!("{path}&measures=wear_level_ratio")).await.json();
    let points = bucketed["series"][0]["points"].as_array().unwrap();
    assert_eq!(points.len(), 3);
    assert_eq!(points[2]["max"], level, "a level that only rises ends highest");
    // The same levels whatever else ran: by operation it is the same one series here.
    let by_operation = app.get(&format!("{path}&measures=wear_level_ratio&by=operation")).await.json();
    assert_eq!(by_operation["series"][0]["points"], bucketed["series"][0]["points"]);

    let summaries = text(get_as(&app, "/v1/summaries?tool=T1&last=2", "text/csv").await);
    let lines: Vec<_> = summaries.trim_end().split("\r\n").collect();
    assert_eq!(lines.len(), 3);
    assert!(
        lines[0].starts_with("started_at,received_at,machine,cycle_id,tool,operation,seq,"),
        "{}",
        lines[0]
    );
    assert!(lines[2].starts_with("2026-05-04T05:29:00.000000Z,2026-05-04T06:00:00.000000Z,M1,c29,T1,O1,,"));
    let all = app.get("/v1/summaries?machine=M1").await.json();
    let items = all["items"].as_array().unwrap();
    assert_eq!((items.len(), &items[0]["cycle_id"]), (30, &json!("c0")));
    assert_eq!(items[0]["energy_reported_joules"], 1000.0);
    assert!(items[0]["energy_rated_power_joules"].is_null());
}

async fn the_level_of_a_series_is_the_one_that_is_judged() {
    let app = shop().await;
    // A program whose feed varies hides wear from the energy as run, until reference cycles tell it.
    for number in 0..40 {
        let mut cycle =
            reported(number, &format!("2026-05-04T05:{number:02}:00Z"), 1000.0 + 2.0 * f64::from(number));
        let is_reference = number < 10 || number % 5 == 0;
        cycle["strategy"] = json!(if is_reference { "f_const" } else { "f_ac" });
        cycle["reference_cycle"] = json!(is_reference);
        post(&app, cycle).await;
    }
    let told = app.get("/v1/series?tool=T1&last=100&measures=wear_level_ratio").await.json();
    let series = &told["series"][0];
    let life = app.get("/v1/tools/T1/life").await.json();
    let texts = |column: &Value| -> Vec<String> {
        column.as_array().unwrap().iter().map(|text| text.as_str().unwrap().to_owned()).collect()
    };
    let judged = texts(&life["cycle_id"]).into_iter().zip(life["level"].as_array().unwrap());
    let judged: BTreeMap<String, &Value> = judged.filter(|(_, level)| !level.is_null()).collect();
    let levels = texts(&series["cycle_id"]).into_iter().zip(series["value"].as_array().unwrap());
    assert!(judged.len() > 20, "{life}");
    assert_eq!(levels.collect::<BTreeMap<_, _>>(), judged);
    assert_eq!(life["decides"].as_array().unwrap().last().unwrap(), "reference_cycles", "{life}");
    assert_ne!(life["wear"]["level"]["as_run"], life["wear"]["level"]["value"], "as run it is another one");

    // What was never known to be new has no level.
    assert_eq!(app.put("/v1/tools/T2", tool()).await.status, StatusCode::CREATED);
    let event = json!({"kind": "mounted_used", "at": "2026-05-04T04:00:00Z"});
    let mounted = app.call(Role::Engineer, "POST", "/v1/tools/T2/events", &[], Some(event)).await;
    assert_eq!(mounted.status, StatusCode::CREATED, "{mounted:?}");
    for number in 40..50 {
        let mut cycle = reported(number, &format!("2026-05-04T05:{number:02}:30Z"), 1000.0);
        cycle["tool"] = json!("T2");
        post(&app, cycle).await;
    }
    let told = app.get("/v1/series?tool=T2&last=100&measures=wear_level_ratio").await.json();
    let has_none = |one: &Value| one["value"].as_array().is_none_or(Vec::is_empty);
    assert!(told["series"].as_array().unwrap().iter().all(has_none), "{told}");
}

async fn a_course_has_the_times_and_the_energy_of_its_summary() {
    let app = App::registered().await;
    let with_speed = json!({"name": "Bushing M8", "process": "friction", "spindle_speed_rpm": 2400.0, "spindle_load_set_percent": 40.0});
    assert_eq!(app.put("/v1/operations/O1", with_speed).await.status, StatusCode::CREATED);
    let load = json!([0, 0, 0, 0, 90, 90, 90, 90, 0, 0, 0, 0, 0]);
    let torque = json!([1, 2, 3, 4, 5, 6, 7, 6, 5, 4, 3, 2, 1]);
    let times: Vec<u32> = (1..=13).map(|at| 100 * at).collect();
    for (id, time) in [("period", ("period_ms", json!(100))), ("stamps", ("time_ms", json!(times)))] {
        let samples = json!({time.0: time.1, "spindle_load_percent": load, "torque_newton_metres": torque});
        post(
            &app,
            json!({"cycle_id": id, "tool": "T1", "operation": "O1", "started_at": "2026-05-04T05:00:00Z", "samples": samples}),
        )
        .await;
    }
    let course = async |id: &str| app.get(&format!("/v1/machines/M1/cycles/{id}/course")).await.json();
    let (by_period, by_stamps) = (course("period").await, course("stamps").await);
    assert_eq!(by_period["overloads"], by_stamps["overloads"]);
    let overload = &by_period["overloads"][0]["from"];
    assert_eq!(overload["time_ms"], json!(100.0 * (overload["index"].as_f64().unwrap() + 1.0)));
    let cycle = app.get("/v1/machines/M1/cycles/period").await.json();
    assert_eq!(by_period["energy_basis"], "dynamometer");
    let whole = by_period["energy_joules"].as_array().unwrap().last().unwrap().as_f64().unwrap();
    let told = cycle["summary"]["energy"][0]["total_joules"].as_f64().unwrap();
    assert!((whole - told).abs() < 1e-9 * told, "{whole} {told}");
}

async fn a_bound_that_is_finer_than_what_is_kept_parts_it_all_the_same() {
    let app = shop().await;
    post(&app, reported(1, "2026-05-04T05:00:00.000001Z", 1000.0)).await;
    for (bounds, found) in [
        ("from=2026-05-04T05:00:00.000001Z", 1),
        ("from=2026-05-04T05:00:00.0000005Z", 1),
        ("from=2026-05-04T05:00:00.0000015Z", 0),
        ("to=2026-05-04T05:00:00.0000015Z", 1),
        ("to=2026-05-04T05:00:00.000001Z", 0),
    ] {
        for list in ["cycles", "summaries"] {
            let told = app.get(&format!("/v1/{list}?machine=M1&{bounds}")).await.json();
            assert_eq!(told["items"].as_array().unwrap().len(), found, "{list} {bounds}");
        }
    }
}

/// An energy that the API takes, and that is no energy of this tool: the cycles after it are stored like those before.
async fn an_absurd_energy_costs_no_cycle() {
    let app = shop().await;
    for (number, joules) in
        (0..).zip([5.5, 5.5, 5.5, 5.5, 5.5, 5.5, 1e12, 5.5, -1e12, 5.5, 1e12, 1e12, 1e12, 1e12, 5.5, 5.5])
    {
        post(&app, reported(number, &format!("2026-05-04T05:{number:02}:00Z"), joules)).await;
        let wear = app.get("/v1/tools/T1/wear").await.json();
        for name in ["as_run", "lowest", "highest", "value", "sd"] {
            assert!(wear["level"][name].as_f64().is_none_or(|level| level.abs() <= 1e6), "{number}: {wear}");
        }
    }
    let all = app.get("/v1/cycles?machine=M1").await.json();
    assert_eq!(all["items"].as_array().unwrap().len(), 16);
}

async fn small_answers_do_not_wait_for_large_ones_and_those_are_few_until_they_are_read() {
    let app = shop().await;
    sampled(&app).await;
    let load: Vec<f64> = (0..100_000).map(|k| f64::from(k % 1000) / 10.0).collect();
    let body = json!({
        "cycle_id": "large", "tool": "T1", "operation": "O1", "started_at": "2026-05-04T05:30:00Z",
        "samples": {"period_ms": 1, "spindle_load_percent": load, "feed_drive_load_percent": load,
                    "thrust_newtons": load},
    });
    post(&app, body).await;
    let large = async |accept| {
        let request = http::Request::get(SAMPLES.replace("s1", "large"))
            .header("authorization", format!("Bearer {}", app.token(Role::Viewer)))
            .header("accept", accept)
            .body(axum::body::Body::empty())
            .unwrap();
        app.router.clone().oneshot(request).await.unwrap()
    };
    let free = || std::iter::from_fn(|| app.state.exports.at_once()).collect::<Vec<_>>();
    let turns = free();
    assert!((2..100).contains(&turns.len()), "{} of a bounded number", turns.len());
    for path in [
        SAMPLES,
        "/v1/series?tool=T1&last=10",
        "/v1/series?tool=T1&bucket=1h&from=2026-05-04T00:00:00Z&to=2026-05-05T00:00:00Z",
        "/v1/summaries?last=10",
    ] {
        for accept in ["application/json", "text/csv"] {
            assert_eq!(get_as(&app, path, accept).await.status, StatusCode::OK, "{path} {accept}");
        }
    }
    let waited = tokio::time::timeout(std::time::Duration::from_millis(200), large("text/csv")).await;
    assert!(waited.is_err(), "it is answered beyond the bound: {:?}", waited.map(|answer| answer.status()));

    // An answer has its turn as long as it is not read.
    let most = turns.len();
    drop(turns);
    for accept in ["application/json", "text/csv"] {
        let answers = [large(accept).await, large(accept).await];
        assert_eq!(free().len(), most - 2, "{accept}");
        for answer in answers {
            assert_eq!(answer.status(), StatusCode::OK);
            assert!(axum::body::to_bytes(answer.into_body(), usize::MAX).await.unwrap().len() > 400_000);
        }
        assert_eq!(free().len(), most, "{accept}");
    }
}
