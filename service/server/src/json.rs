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
    if let Err(wrong) = well_formed(json) {
        return wrong;
    }
    let mut deserializer = serde_json::Deserializer::from_slice(json);
    match serde_path_to_error::deserialize::<_, T>(Strict(&mut deserializer)) {
        Err(error) => {
            explained(&error.path().to_string(), error.inner()).map_or_else(malformed, Wrong::Field)
        }
        Ok(_) => malformed(),
    }
}

/// Refuses what is no JSON, wherever its fault is: in texts that nobody reads too, which Serde skips without a look at their
/// characters. So the verdict does not depend on the order of fields. It keeps nothing, however large the text is.
///
/// # Errors
/// [`Wrong::Malformed`]; [`Wrong::Field`] with `not_finite` where it is JSON but for words like NaN.
pub(crate) fn well_formed(json: &[u8]) -> Result<(), Wrong> {
    if let Err(torn) = serde_json::from_slice::<IgnoredAny>(json) {
        // Meant as JSON but for a word like NaN: named like every other bad field.
        if let Some((path, literal)) = first_non_finite(json) {
            let message = format!("must be a finite number, is {literal}");
            return Err(Wrong::Field(Violation::new(path, "not_finite", message)));
        }
        let marked = json.starts_with(BYTE_ORDER_MARK).then(|| {
            "it begins with a byte order mark (EF BB BF), which JSON must not have: write UTF-8 without it".to_owned()
        });
        return Err(Wrong::Malformed(marked.unwrap_or_else(|| torn.to_string())));
    }
    let at = |what: &str, index: usize| {
        let before = json.get(..index).unwrap_or(json);
        let mut lines = before.split(|byte| *byte == b'\n');
        let (line, column) = (lines.clone().count(), lines.next_back().map_or(0, <[u8]>::len) + 1);
        Err(Wrong::Malformed(format!("{what} at line {line} column {column}")))
    };
    match std::str::from_utf8(json) {
        Err(error) => at("a byte that is no UTF-8", error.valid_up_to()),
        Ok(text) => match lone_surrogate(text) {
            Some(index) => at("a lone surrogate, which is half a character,", index),
            None => Ok(()),
        },
    }
}

/// Where the first escape of half a character stands, in what is JSON otherwise: it has backslashes nowhere but in texts.
fn lone_surrogate(json: &str) -> Option<usize> {
    let unit = |at: usize| {
        let digits = json.get(at..at + 6)?.strip_prefix("\\u")?;
        u16::from_str_radix(digits, 16).ok()
    };
    let mut from = 0;
    while let Some(distance) = json.get(from..)?.find('\\') {
        let at = from + distance;
        from = at
            + match unit(at) {
                Some(0xD800..=0xDBFF) if matches!(unit(at + 6), Some(0xDC00..=0xDFFF)) => 12,
                Some(0xD800..=0xDFFF) => return Some(at),
                Some(_) => 6,
                None => 2,
            };
    }
    None
}

/// The field that Serde names where it is unknown, missing or given twice, with the code for it.
pub(crate) fn named_field(sentence: &str) -> Option<(&str, &'static str)> {
    if let Some(named) = sentence.strip_prefix("unknown field `") {
        // The name is as it came, and may have anything in it; the fields there are, which are told behind it, have not.
        let name = named.strip_suffix("`, there are no fields");
        return Some((name.or_else(|| Some(named.rsplit_once("`, expected ")?.0))?, "unknown_field"));
    }
    [("missing field `", "missing_field"), ("duplicate field `", "duplicate_field")]
        .into_iter()
        .find_map(|(prefix, code)| Some((sentence.strip_prefix(prefix)?.strip_suffix('`')?, code)))
}

/// What is wrong and where; `None` where it is nested deeper than is followed.
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
    let (least, most): (i64, u64) = match kind {
        "f64" => return format!("{head}expected a number"),
        "u8" => (0, u8::MAX.into()),
        "u16" => (0, u16::MAX.into()),
        "u32" => (0, u32::MAX.into()),
        // How large it may be is the field's to say: of none it is as much as that.
        "u64" | "usize" => return format!("{head}expected a whole number from 0 on"),
        "i8" => (i8::MIN.into(), i8::MAX.unsigned_abs().into()),
        "i16" => (i16::MIN.into(), i16::MAX.unsigned_abs().into()),
        "i32" => (i32::MIN.into(), i32::MAX.unsigned_abs().into()),
        "i64" => (i64::MIN, i64::MAX.unsigned_abs()),
        _ => return sentence.to_owned(),
    };
    format!("{head}expected a whole number from {least} to {most}")
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
        version: u32,
        offset: i16,
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
        assert_eq!(
            told(r#"{"version":4294967296}"#),
            "invalid value: integer `4294967296`, expected a whole number from 0 to 4294967295"
        );
        assert_eq!(
            told(r#"{"offset":1.5}"#),
            "invalid type: floating point `1.5`, expected a whole number from -32768 to 32767"
        );
    }

    #[test]
    fn an_unknown_field_is_named_whatever_its_name_is() {
        for name in [
            "by`",
            "b`y",
            "`",
            "from`",
            "from`, expected `to`",
            "`, there are no fields",
            "a.b",
            " at line 1",
        ] {
            for (json, path) in [
                (format!(r#"{{"{name}":1}}"#), name.to_owned()),
                (format!(r#"{{"inner":{{"{name}":1}}}}"#), format!("inner.{name}")),
                (format!(r#"{{"knots":[{{"{name}":1}}]}}"#), format!("knots[0].{name}")),
            ] {
                assert_eq!(refused(&json), (path, "unknown_field"), "{json}");
            }
        }
        assert_eq!(named_field("unknown field `a`b`, there are no fields"), Some(("a`b", "unknown_field")));
    }

    #[test]
    fn what_is_no_json_is_told_as_that_even_where_a_rule_is_broken_before() {
        for json in ["", "{", "{}{}", "{} x", r#"{"word":5,"#, r#"{"inner":{"from":}}"#] {
            assert_eq!(refused(json), (String::new(), "malformed"), "{json}");
        }
        // Whatever a text holds that none may hold, and whether anybody reads that text.
        for text in [
            r"\ud800",
            r"\udc00",
            r"\uD83D\u0041",
            r"\ud83d\ud83d\ude00",
            r"\ude00\ud83d",
            r"\\\ud83dx",
            r"\q",
            "\t",
        ] {
            for json in [
                format!(r#"{{"name":"{text}"}}"#),
                format!(r#"{{"other":1,"name":"{text}"}}"#),
                format!(r#"{{"name":"{text}","other":1}}"#),
                format!(r#"{{"other":"{text}"}}"#),
                format!(r#"{{"word":5,"{text}":1}}"#),
                format!(r#"{{"name":"","name":"{text}"}}"#),
                format!(r#"{{"name":"{text}","inner":{{"from":NaN}}}}"#),
                format!(r#"{{"inner":{{"from":NaN}},"{text}":1}}"#),
            ] {
                assert_eq!(refused(&json), (String::new(), "malformed"), "{json}");
            }
        }
        for text in [r"\ud83d\ude00", r"\\ud800", r"\\\\udc00\u0041\n", "😀é"] {
            let json = format!(r#"{{"name":"{text}","other":"{text}"}}"#);
            assert_eq!(refused(&json), ("other".to_owned(), "unknown_field"), "{json}");
            let json = format!(r#"{{"name":"{text}","inner":{{"from":NaN}}}}"#);
            assert_eq!(refused(&json), ("inner.from".to_owned(), "not_finite"), "{json}");
        }
        for json in [
            b"{\"name\":\"a\xff\"}".as_slice(),
            b"{\"other\":1,\"name\":\"a\xff\"}",
            b"{\"other\":\"\xc3\",\"name\":\"\"}",
            b"{\"inner\":{\"from\":NaN},\"name\":\"\xed\xa0\x80\"}",
        ] {
            assert!(matches!(read::<Outer>(json), Err(Wrong::Malformed(_))), "{}", json.escape_ascii());
        }
        let told = |json: &[u8]| match read::<Outer>(json) {
            Err(Wrong::Malformed(why)) => why,
            other => panic!("{other:?}"),
        };
        assert_eq!(told(b"{\n \"name\":\"a\xff\"}"), "a byte that is no UTF-8 at line 2 column 11");
        assert_eq!(
            told(br#"{"other":"\ud800"}"#),
            "a lone surrogate, which is half a character, at line 1 column 11"
        );
        let Err(Wrong::Malformed(why)) = read::<Outer>(br#"{"other":5,"#) else { panic!("it is torn") };
        assert!(why.starts_with("EOF"), "of the tear, not of a rule that was broken before: {why}");
        let Err(Wrong::Malformed(why)) = read::<Outer>(b"\xef\xbb\xbf{}") else { panic!("JSON has no mark") };
        assert!(why.contains("byte order mark"), "{why}");
        let deep = format!("{{\"any\":{}{}}}", "[".repeat(1000), "]".repeat(1000));
        assert_eq!(refused(&deep).1, "malformed", "nested deeper than is followed");
    }
}
