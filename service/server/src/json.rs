//! Reading JSON strictly: an object is an object, and whatever is wrong is told by its path.
//!
//! Every body, every message of a stream and every line of a batch that is not read column by column comes through
//! [`read`]. What [`strict`] refuses is what Serde would take beyond that.

mod strict;

use crate::ingest::scan::first_non_finite;
use feedwright_core::invalid::Violation;
use serde::Deserialize;
use serde::de::IgnoredAny;
use strict::Strict;

/// Why JSON was not read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Wrong {
    /// It is no JSON, or there is more behind it.
    Malformed(String),
    /// It is JSON, but not what is expected: where, and how.
    Field(Violation),
}

/// Reads one document of JSON and nothing behind it.
///
/// # Errors
/// [`Wrong::Field`] where it is JSON but not what `T` expects: `unknown_field`, `missing_field`, `duplicate_field`,
/// `number_out_of_range`, `wrong_type`, `invalid_value`, and `not_finite` for a word like NaN in place of a number.
pub fn read<'de, T: Deserialize<'de>>(json: &'de [u8]) -> Result<T, Wrong> {
    let mut deserializer = serde_json::Deserializer::from_slice(json);
    match T::deserialize(Strict(&mut deserializer)).and_then(|read| deserializer.end().map(|()| read)) {
        Ok(read) => Ok(read),
        // Paths cost time, so they are looked for only now.
        Err(error) => Err(located::<T>(json, &error)),
    }
}

/// What some editors and libraries put before UTF-8.
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// Reads again to tell where the first fault is; `error` is what reading it the first time ended with.
fn located<'de, T: Deserialize<'de>>(json: &'de [u8], error: &serde_json::Error) -> Wrong {
    let malformed = || Wrong::Malformed(error.to_string());
    // A torn text may break a rule of ours before its tear: whether it is JSON at all comes first.
    if let Err(torn) = serde_json::from_slice::<IgnoredAny>(json) {
        // Meant as JSON but for a word like NaN: named like every other bad field.
        let torn = || {
            let marked = json.starts_with(BYTE_ORDER_MARK).then(|| {
                "it begins with a byte order mark (EF BB BF), which JSON must not have: write UTF-8 without it".to_owned()
            });
            Wrong::Malformed(marked.unwrap_or_else(|| torn.to_string()))
        };
        return first_non_finite(json).map_or_else(torn, |(path, literal)| {
            Wrong::Field(Violation::new(path, "not_finite", format!("must be a finite number, is {literal}")))
        });
    }
    let mut deserializer = serde_json::Deserializer::from_slice(json);
    match serde_path_to_error::deserialize::<_, T>(Strict(&mut deserializer)) {
        Err(error) => {
            explained(&error.path().to_string(), error.inner()).map_or_else(malformed, Wrong::Field)
        }
        Ok(_) => malformed(),
    }
}

/// The field that Serde names where it is unknown, missing or given twice, with the code for it.
pub(crate) fn named_field(sentence: &str) -> Option<(&str, &'static str)> {
    [
        ("unknown field `", "unknown_field"),
        ("missing field `", "missing_field"),
        ("duplicate field `", "duplicate_field"),
    ]
    .into_iter()
    .find_map(|(prefix, code)| Some((sentence.strip_prefix(prefix)?.split_once('`')?.0, code)))
}

/// What is wrong and where; `None` where it is no JSON after all, as a lone surrogate in a text.
fn explained(path: &str, error: &serde_json::Error) -> Option<Violation> {
    let message = error.to_string();
    let sentence = message.rsplit_once(" at line ").map_or(message.as_str(), |(sentence, _)| sentence);
    let path = if path == "." { "" } else { path };
    if let Some((name, code)) = named_field(sentence) {
        // The path ends in the field itself where Serde was already inside it.
        let at = match path {
            "" => name.to_owned(),
            path if path == name || path.ends_with(&format!(".{name}")) => path.to_owned(),
            path => format!("{path}.{name}"),
        };
        return Some(Violation::new(at, code, sentence));
    }
    let code = if sentence.starts_with("number out of range") {
        "number_out_of_range"
    } else if !error.is_data() {
        return None;
    } else if sentence.starts_with("invalid type") {
        "wrong_type"
    } else {
        "invalid_value"
    };
    Some(Violation::new(path, code, in_words(sentence)))
}

/// What Serde expected, without the names of its types.
fn in_words(sentence: &str) -> String {
    let Some((head, kind)) = sentence.rsplit_once("expected ") else { return sentence.to_owned() };
    let words = match kind {
        "f64" => "a number",
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number from 0 on",
        "i8" | "i16" | "i32" | "i64" => "a whole number",
        _ => return sentence.to_owned(),
    };
    format!("{head}expected {words}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(rename_all = "snake_case")]
    enum Word {
        Held,
        Linear,
    }

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(rename_all = "snake_case")]
    enum Choice {
        All,
        Grid(Inner),
        List { speeds: Vec<f64> },
    }

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Inner {
        from: f64,
        #[serde(default)]
        to: Option<f64>,
    }

    #[derive(Debug, PartialEq, Deserialize, Default)]
    #[serde(deny_unknown_fields, default)]
    struct Outer {
        inner: Option<Inner>,
        knots: Vec<Inner>,
        word: Option<Word>,
        choice: Option<Choice>,
        band_hz: Option<(f64, f64)>,
        name: String,
        any: serde_json::Value,
    }

    fn refused(json: &str) -> (String, &'static str) {
        match read::<Outer>(json.as_bytes()).unwrap_err() {
            Wrong::Malformed(_) => (String::new(), "malformed"),
            Wrong::Field(violation) => (violation.path, violation.code),
        }
    }

    #[test]
    fn what_fits_is_read_as_serde_reads_it() {
        for json in [
            "{}",
            r#"{"inner":{"from":1,"to":null},"knots":[{"from":2.5},{"from":3,"to":4}],"band_hz":[1,2]}"#,
            r#" {"word":"held","choice":"all","name":"a\u00e9","any":[{"a":[1]},null,"x"]} "#,
            r#"{"word":"linear","choice":{"grid":{"from":1}}}"#,
            r#"{"choice":{"list":{"speeds":[1,2]}},"word":null}"#,
            r#"{"choice":{"all":null}}"#,
        ] {
            assert_eq!(
                read::<Outer>(json.as_bytes()).unwrap(),
                serde_json::from_str::<Outer>(json).unwrap(),
                "{json}"
            );
        }
    }

    #[test]
    fn an_object_is_no_list_of_its_values() {
        for (json, path) in [
            ("[]", ""),
            (r#"{"inner":[1,2]}"#, "inner"),
            (r#"{"knots":[{"from":1},[1,2]]}"#, "knots[1]"),
            (r#"{"choice":{"grid":[1,2]}}"#, "choice.grid"),
            (r#"{"choice":{"list":[[1,2]]}}"#, "choice.list"),
        ] {
            assert_eq!(refused(json), (path.to_owned(), "wrong_type"), "{json}");
        }
    }

    #[test]
    fn whatever_is_of_another_type_is_named_by_its_path() {
        for (json, path, code) in [
            (r#"{"word":5}"#, "word", "wrong_type"),
            (r#"{"word":[]}"#, "word", "wrong_type"),
            (r#"{"word":{}}"#, "word", "wrong_type"),
            (r#"{"word":"curved"}"#, "word", "invalid_value"),
            (r#"{"choice":true}"#, "choice", "wrong_type"),
            (r#"{"choice":{"grid":{"from":1},"all":null}}"#, "choice", "invalid_value"),
            (r#"{"choice":{"grid":{"from":"1"}}}"#, "choice.grid.from", "wrong_type"),
            (r#"{"choice":{"grid":{}}}"#, "choice.grid.from", "missing_field"),
            (r#"{"choice":{"grid":{"from":1,"by":2}}}"#, "choice.grid.by", "unknown_field"),
            (r#"{"choice":{"list":{"speeds":[1,null]}}}"#, "choice.list.speeds[1]", "wrong_type"),
            (r#"{"choice":"grid"}"#, "choice.grid", "wrong_type"),
            (r#"{"band_hz":[1,2,3]}"#, "band_hz", "invalid_value"),
            (r#"{"band_hz":[1]}"#, "band_hz", "invalid_value"),
            (r#"{"knots":{}}"#, "knots", "wrong_type"),
            (r#"{"name":1}"#, "name", "wrong_type"),
            (r#"{"inner":{"from":1,"from":2}}"#, "inner.from", "duplicate_field"),
            (r#"{"inner":{"from":1e999}}"#, "inner.from", "number_out_of_range"),
            (r#"{"inner":{"from":-Infinity}}"#, "inner.from", "not_finite"),
            ("5", "", "wrong_type"),
            ("null", "", "wrong_type"),
        ] {
            assert_eq!(refused(json), (path.to_owned(), code), "{json}");
        }
        let told = |json: &str| match read::<Outer>(json.as_bytes()).unwrap_err() {
            Wrong::Malformed(text) => text,
            Wrong::Field(violation) => violation.message,
        };
        assert_eq!(told(r#"{"inner":[1,2]}"#), "invalid type: sequence, expected an object");
        assert_eq!(
            told(r#"{"word":null,"choice":5}"#),
            "invalid type: integer `5`, expected one of `all`, `grid`, `list`"
        );
        assert_eq!(told(r#"{"band_hz":[1,2,3]}"#), "invalid length 3, expected a tuple of size 2");
    }

    #[test]
    fn what_is_no_json_is_told_as_that_even_where_a_rule_is_broken_before() {
        for json in
            ["", "{", "{}{}", "{} x", r#"{"word":5,"#, r#"{"inner":{"from":}}"#, r#"{"name":"\ud800"}"#]
        {
            assert_eq!(refused(json), (String::new(), "malformed"), "{json}");
        }
        let Err(Wrong::Malformed(why)) = read::<Outer>(br#"{"other":5,"#) else { panic!("it is torn") };
        assert!(why.starts_with("EOF"), "of the tear, not of a rule that was broken before: {why}");
        let Err(Wrong::Malformed(why)) = read::<Outer>(b"\xef\xbb\xbf{}") else { panic!("JSON has no mark") };
        assert!(why.contains("byte order mark"), "{why}");
        let deep = format!("{{\"any\":{}{}}}", "[".repeat(1000), "]".repeat(1000));
        assert_eq!(refused(&deep).1, "malformed", "nested deeper than is followed");
    }
}
