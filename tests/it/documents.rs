//! What the documents say of numbers that stand in the code.

use feedwright_core::cycle::{Channel, DURATION_RANGE, Reported, ReportedCut};
use feedwright_core::invalid::Range;
use feedwright_core::machine::IPO_RANGE;
use feedwright_server::http::openapi::json;
use serde_json::Value;

/// The limits of a row that begins with these fields.
fn row(named: &str, range: Range) -> String {
    format!("| {named} | {} | {} | {} |", range.min, range.max, range.unit)
}

#[test]
fn the_ranges_of_fields_are_those_that_are_held() {
    let document = include_str!("../../docs/cycle-format.md");
    for &channel in Channel::ALL {
        let named = format!("`{}`", channel.as_str());
        let found = document
            .lines()
            .find(|line| line.starts_with('|') && line.contains(&named) && line.split('|').count() == 6);
        let line = found.unwrap_or_else(|| panic!("{named} is not told"));
        let fields = line.split('|').nth(1).unwrap().trim();
        assert_eq!(line, row(fields, channel.range()));
    }
    let (reported, cut) = (Reported::default().fields(), ReportedCut::default().fields());
    for (name, range, _) in reported.into_iter().chain(cut) {
        let expected = row(&format!("`{name}`"), range);
        assert!(document.lines().any(|line| line == expected), "{expected}");
    }
}

#[test]
fn the_ranges_of_what_is_posted_of_a_cycle_are_described() {
    let document: Value = serde_json::from_str(&json().unwrap()).unwrap();
    let schemas = &document["components"]["schemas"];
    let bounds = |of: &Value| (of["minimum"].as_f64(), of["maximum"].as_f64());
    let held = |range: Range| (Some(range.min), Some(range.max));
    let samples = &schemas["SamplesPost"]["properties"];
    for &channel in Channel::ALL {
        let name = channel.as_str();
        assert_eq!(bounds(&samples[name]["items"]), held(channel.range()), "{name}");
    }
    assert_eq!(bounds(&samples["time_ms"]["items"]), held(DURATION_RANGE));
    assert_eq!(bounds(&samples["period_ms"]), held(IPO_RANGE));
    let (reported, cut) = (Reported::default().fields(), ReportedCut::default().fields());
    for (name, range, _) in reported.into_iter().chain(cut) {
        assert_eq!(bounds(&schemas["ReportedPost"]["properties"][name]), held(range), "{name}");
    }
}
