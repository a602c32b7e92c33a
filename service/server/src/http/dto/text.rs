//! Free text in JSON, within bounds.

use feedwright_core::cycle::Cycle;
use feedwright_core::invalid::Violation;

/// Longest name, program, material.
pub const MAX_NAME: usize = 200;
/// Longest reason.
pub const MAX_REASON: usize = 1000;

/// Takes over text of 1 to `most` characters without control characters.
pub fn required(path: &str, text: &str, most: usize, wrong: &mut Vec<Violation>) -> String {
    let length = text.chars().count();
    if !text.chars().any(is_seen) || length > most {
        wrong.push(Violation::new(path, "invalid_length", format!("must have 1 to {most} characters")));
    } else if text.chars().any(char::is_control) {
        wrong.push(Violation::new(path, "control_character", "must not hold control characters"));
    }
    text.to_owned()
}

/// Whether anything of a character is seen: a reason of none is no reason, and a name of none no name.
fn is_seen(character: char) -> bool {
    let is_hidden = matches!(
        character,
        '\u{ad}' | '\u{34f}' | '\u{61c}' | '\u{115f}' | '\u{1160}' | '\u{17b4}' | '\u{17b5}' | '\u{180b}'..='\u{180f}'
            | '\u{200b}'..='\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{2800}' | '\u{3164}'
            | '\u{fe00}'..='\u{fe0f}' | '\u{feff}' | '\u{ffa0}' | '\u{fff0}'..='\u{fffb}' | '\u{e0000}'..='\u{e0fff}'
    );
    !is_hidden && !character.is_whitespace()
}

/// As [`required`], where it may be left out.
pub fn optional(path: &str, text: Option<&str>, most: usize, wrong: &mut Vec<Violation>) -> Option<String> {
    text.map(|text| required(path, text, most, wrong))
}

/// Most bytes of a law's version: the binary form of a cycle tells the length of a text in one.
const MAX_LAW_VERSION_BYTES: usize = 255;

/// The version of a control law, where one is told.
pub fn law_version(text: Option<&str>, wrong: &mut Vec<Violation>) -> Option<String> {
    let path = "law_version";
    let told = optional(path, text, Cycle::MAX_LAW_VERSION, wrong)?;
    if told.chars().count() <= Cycle::MAX_LAW_VERSION && told.len() > MAX_LAW_VERSION_BYTES {
        let message = format!("must have {MAX_LAW_VERSION_BYTES} bytes at the most, has {}", told.len());
        wrong.push(Violation::new(path, "invalid_length", message));
    }
    Some(told)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_nobody_sees_is_no_text() {
        let refused = |text: &str| {
            let mut wrong = Vec::new();
            required("reason", text, MAX_REASON, &mut wrong);
            !wrong.is_empty()
        };
        for text in ["", "  ", "\u{200b}", "\u{2800}\u{feff} ", "\u{e0041}", "a\nb"] {
            assert!(refused(text), "{text:?}");
        }
        for text in ["a", "\u{200b}a", "ä", "刃", "🔧\u{fe0f}"] {
            assert!(!refused(text), "{text:?}");
        }
    }

    #[test]
    fn a_laws_version_fits_the_binary_form() {
        let refused = |text: &str| {
            let mut wrong = Vec::new();
            law_version(Some(text), &mut wrong);
            wrong.len()
        };
        assert_eq!(refused(&"🔧".repeat(63)), 0);
        assert_eq!(refused(&"刃".repeat(64)), 0);
        assert_eq!(refused(&"🔧".repeat(64)), 1, "256 bytes");
        assert_eq!(refused(&"🔧".repeat(65)), 1, "too long in either way is told once");
    }
}
