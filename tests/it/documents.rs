//! What the documents say of numbers that stand in the code.

use feedwright_core::cycle::{Channel, Reported, ReportedCut};
use feedwright_core::invalid::Range;

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
