//! Free text in JSON, within bounds.

use feedwright_core::invalid::Violation;

/// Longest name, program, material.
pub const MAX_NAME: usize = 200;
/// Longest reason.
pub const MAX_REASON: usize = 1000;

/// Takes over text of 1 to `most` characters without control characters.
pub fn required(path: &str, text: &str, most: usize, wrong: &mut Vec<Violation>) -> String {
    let length = text.chars().count();
    if text.trim().is_empty() || length > most {
        wrong.push(Violation::new(path, "invalid_length", format!("must have 1 to {most} characters")));
    } else if text.chars().any(char::is_control) {
        wrong.push(Violation::new(path, "control_character", "must not hold control characters"));
    }
    text.to_owned()
}

/// As [`required`], where it may be left out.
pub fn optional(path: &str, text: Option<&str>, most: usize, wrong: &mut Vec<Violation>) -> Option<String> {
    text.map(|text| required(path, text, most, wrong))
}
