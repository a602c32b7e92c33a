//! Plans of small recordings.

use super::*;
use crate::replay::mapping::tests::SMALL;

fn files(rows: &[&str]) -> Vec<(String, Vec<u8>)> {
    let names = ["b.csv", "a.csv", "notes.txt"];
    names.iter().zip(rows).map(|(name, rows)| ((*name).to_owned(), rows.as_bytes().to_vec())).collect()
}

const TWO: &[&str] = &["p\n1\n2\n3\n", "p\n4\n5\n"];

#[test]
fn ids_and_times_come_from_file_and_index_and_are_the_same_every_time() {
    let plan = Plan::read(SMALL, &files(TWO)).unwrap();
    let ids: Vec<&str> = plan.cycles.iter().map(|cycle| cycle.id.as_str()).collect();
    assert_eq!(ids, ["a-000", "b-000", "b-001"]);
    let starts: Vec<i64> = plan.cycles.iter().map(|cycle| cycle.started_us - 1_577_836_800_000_000).collect();
    assert_eq!(starts, [0, 200_000, 400_000]);
    let mut turned = files(TWO);
    turned.reverse();
    let again = Plan::read(SMALL, &turned).unwrap();
    assert_eq!(again.cycles, plan.cycles);
    assert_eq!(again.fingerprint, plan.fingerprint);
}

#[test]
fn other_content_is_another_plan() {
    let plan = Plan::read(SMALL, &files(TWO)).unwrap();
    let other = Plan::read(SMALL, &files(&["p\n1\n2\n3\n", "p\n4\n6\n"])).unwrap();
    assert_ne!(other.fingerprint, plan.fingerprint);
    let renamed = Plan::read(&SMALL.replace("small", "large"), &files(TWO)).unwrap();
    assert_ne!(renamed.fingerprint, plan.fingerprint);
}

#[test]
fn a_body_carries_the_unit_of_the_api_and_the_moved_time() {
    let plan = Plan::read(SMALL, &files(TWO)).unwrap();
    let body = plan.cycles[0].body(1_500_000).unwrap();
    assert_eq!(
        body,
        json!({
            "cycle_id": "a-000", "tool": "t", "operation": "o", "started_at": "2020-01-01T00:00:01.5Z",
            "samples": { "period_ms": 100.0, "spindle_power_watts": [4000.0, 5000.0] },
        })
    );
}

#[test]
fn a_bad_cell_and_a_doubled_id_are_refused() {
    let bad = Plan::read(SMALL, &files(&["p\n1\nx\n"])).unwrap_err().to_string();
    assert!(bad.contains("b.csv") && bad.contains("line 3"), "{bad}");
    let doubled = Plan::read(&SMALL.replace("{file}-{index:03}", "c"), &files(TWO)).unwrap_err().to_string();
    assert!(doubled.contains("comes twice"), "{doubled}");
    assert!(Plan::read(&SMALL.replace("{file}-{index:03}", "{file} {index}"), &files(TWO)).is_err());
}

#[test]
fn times_that_no_calendar_has_are_refused_with_their_line() {
    let column = |unit: &str, start: &str| {
        SMALL
            .replace("period = \"100 ms\"", &format!("column = \"t\"\nunit = \"{unit}\""))
            .replace("start = \"2020-01-01T00:00:00Z\"", start)
    };
    let counted = column("h", "start = \"2020-01-01T00:00:00Z\"");
    for (text, rows, line) in [
        (column("unix_s", ""), "t,p\n1e300,1\n2e300,2\n", "line 2,"),
        (column("unix_s", ""), "t,p\n1,1\n2,1\n3,1\n1e300,2\n", "line 4,"),
        (column("unix_ms", ""), "t,p\n9e15,1\n", "line 2,"),
        (counted.clone(), "t,p\n0,1\n1e300,2\n", "line 2,"),
        (counted, "t,p\n0,1\n1,2\n1e9,1\n1e9,1\n", "line 4,"),
        (SMALL.replace("2020-01-01T00:00:00Z", "9999-12-30T22:00:00.9Z"), "p\n1\n2\n", "time: "),
    ] {
        let said = Plan::read(&text, &files(&[rows])).unwrap_err().to_string();
        assert!(said.contains(line) && said.contains("calendar"), "{said}");
    }
}

#[test]
fn a_name_may_end_in_capitals() {
    let rows = b"p\n1\n2\n".to_vec();
    let both = [("A.CSV".to_owned(), rows.clone()), ("b.csv".to_owned(), rows.clone())];
    let plan = Plan::read(SMALL, &both).unwrap();
    let ids: Vec<&str> = plan.cycles.iter().map(|cycle| cycle.id.as_str()).collect();
    assert_eq!(ids, ["A-000", "b-000"]);
    let doubled = [("a.CSV".to_owned(), rows.clone()), ("a.csv".to_owned(), rows)];
    assert!(Plan::read(SMALL, &doubled).unwrap_err().to_string().contains("comes twice"));
}

#[test]
fn a_counter_column_gives_stamps_from_the_start_of_the_cycle() {
    let text =
        SMALL.replace("period = \"100 ms\"", "column = \"t\"\nunit = \"s\"\nbetween_files = \"1 min\"");
    let plan = Plan::read(&text, &files(&["t,p\n7,1\n7.5,2\n9,3\n", "t,p\n5,1\n6,2\n"])).unwrap();
    assert_eq!(plan.cycles[1].time, SampleTime::Stamps(vec![0.0, 500.0]));
    let starts: Vec<i64> = plan.cycles.iter().map(|cycle| cycle.started_us - 1_577_836_800_000_000).collect();
    assert_eq!(starts, [0, 61_000_000, 63_000_000]);
}

#[test]
fn times_of_day_in_the_rows_are_kept() {
    let column = |unit: &str| {
        SMALL
            .replace("period = \"100 ms\"", &format!("column = \"t\"\nunit = \"{unit}\""))
            .replace("start = \"2020-01-01T00:00:00Z\"", "")
    };
    let zoned = Plan::read(
        &column("rfc3339"),
        &files(&["t,p\n2024-05-06T07:08:09+02:00,1\n2024-05-06T05:08:10Z,2\n"]),
    );
    let unix = Plan::read(&column("unix_s"), &files(&["t,p\n1714972089,1\n1714972090,2\n"])).unwrap();
    let zoned = zoned.unwrap();
    assert_eq!(zoned.cycles, unix.cycles);
    assert_eq!(zoned.cycles[0].time, SampleTime::Stamps(vec![0.0, 1000.0]));
}

#[test]
fn values_can_be_the_most_frequent_that_counts_and_register_what_they_name() {
    let text = SMALL.replace("operation = \"o\"", "operation = \"f{feed}\"")
        + "[values]\nfeed = { column = \"f\", take = \"most_frequent\", ignore = [\"50\"] }\n\
           [[operation]]\nid = \"f{feed}\"\nname = \"at {feed}\"\nprocess = \"milling\"\n\
           programmed_feed = \"{feed} mm/s\"\n\
           [[tool]]\nid = \"t\"\nname = \"T\"\ntool_type = \"x\"\nmounted = \"used\"\n";
    let text = text.replace("rows = 2", "rows = 4");
    let plan = Plan::read(&text, &files(&["f,p\n50.0,1\n50.0,1\n6.0,1\n50.0,1\n"])).unwrap();
    assert_eq!(plan.cycles[0].operation.as_str(), "f6");
    assert_eq!(
        plan.registrations.operations["f6"],
        json!({ "name": "at 6", "process": "milling", "programmed_feed_mm_min": 360.0 })
    );
    assert_eq!(plan.registrations.mounts[0].kind, "mounted_used");
    assert_eq!(plan.registrations.mounts[0].at_us, plan.cycles[0].started_us);
}
