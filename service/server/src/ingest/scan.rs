//! Tells JSON that is broken only by numbers such as NaN from text that is no JSON.
//!
//! Controls and scripts do send `NaN`, `Infinity` and `1e999`. A body that has one is no use as it is, but it was
//! meant as a cycle: it is named by its path and goes to quarantine, while torn bodies are refused.

/// Deepest nesting that is followed; a cycle's body has three levels.
const MAX_DEPTH: usize = 64;

const LITERALS: [&str; 8] = ["NaN", "nan", "Infinity", "-Infinity", "inf", "-inf", "-NaN", "+Infinity"];

/// Path and literal of the first number that is not finite, where the text is JSON but for such numbers.
pub(crate) fn first_non_finite(json: &[u8]) -> Option<(String, String)> {
    let mut scan = Scan::of(std::str::from_utf8(json).ok()?);
    scan.value(0)?;
    scan.rest.is_empty().then_some(scan.found).flatten()
}

/// The text of a field of the outermost object, where all before it is JSON but for such numbers. It is looked for in the
/// first [`MOST_LOOKED_THROUGH`] bytes.
pub(crate) fn text_of(json: &[u8], field: &str) -> Option<String> {
    let begins = json.get(..MOST_LOOKED_THROUGH).unwrap_or(json);
    let text = match std::str::from_utf8(begins) {
        Ok(text) => text,
        Err(error) => std::str::from_utf8(&begins[..error.valid_up_to()]).ok()?,
    };
    let mut scan = Scan::of(text);
    scan.eat("{")?;
    loop {
        let name = scan.string()?;
        scan.eat(":")?;
        let value = scan.rest;
        scan.value(1)?;
        if name == field {
            return serde_json::from_str(value[..value.len() - scan.rest.len()].trim_end()).ok();
        }
        scan.eat(",")?;
    }
}

/// Some milliseconds: whoever asks for a field is not to hold up others.
const MOST_LOOKED_THROUGH: usize = 1 << 20;

struct Scan<'a> {
    rest: &'a str,
    /// Where it is.
    steps: Vec<Step<'a>>,
    found: Option<(String, String)>,
}

/// A step of a path.
#[derive(Clone, Copy)]
enum Step<'a> {
    Field(&'a str),
    Element(usize),
}

impl<'a> Scan<'a> {
    fn of(text: &'a str) -> Self {
        Self { rest: behind_space(text), steps: Vec::new(), found: None }
    }

    fn path(&self) -> String {
        let mut path = String::new();
        for step in &self.steps {
            match step {
                Step::Field(name) => {
                    // A name may be escaped; its field is told as whoever knows it writes it.
                    let plain =
                        name.contains('\\').then(|| serde_json::from_str::<String>(&format!("\"{name}\"")));
                    let plain = plain.and_then(Result::ok);
                    path.extend([if path.is_empty() { "" } else { "." }, plain.as_deref().unwrap_or(name)]);
                }
                Step::Element(index) => path.push_str(&format!("[{index}]")),
            }
        }
        path
    }

    fn value(&mut self, depth: usize) -> Option<()> {
        if depth > MAX_DEPTH {
            return None;
        }
        match self.rest.as_bytes().first()? {
            b'{' => self.object(depth),
            b'[' => self.array(depth),
            b'"' => self.string().map(drop),
            _ => self.scalar(),
        }
    }

    fn eat(&mut self, token: &str) -> Option<()> {
        self.rest = behind_space(self.rest.strip_prefix(token)?);
        Some(())
    }

    fn object(&mut self, depth: usize) -> Option<()> {
        self.eat("{")?;
        if self.eat("}").is_some() {
            return Some(());
        }
        loop {
            let name = self.string()?;
            self.eat(":")?;
            self.steps.push(Step::Field(name));
            self.value(depth + 1)?;
            self.steps.pop();
            if self.eat(",").is_none() {
                return self.eat("}");
            }
        }
    }

    fn array(&mut self, depth: usize) -> Option<()> {
        self.eat("[")?;
        if self.eat("]").is_some() {
            return Some(());
        }
        let mut index = 0_usize;
        loop {
            self.steps.push(Step::Element(index));
            self.value(depth + 1)?;
            self.steps.pop();
            index += 1;
            if self.eat(",").is_none() {
                return self.eat("]");
            }
        }
    }

    fn string(&mut self) -> Option<&'a str> {
        let inner = self.rest.strip_prefix('"')?;
        let (mut escaped, mut plain) = (false, true);
        for (at, byte) in inner.bytes().enumerate() {
            match byte {
                _ if escaped => escaped = false,
                b'\\' => (escaped, plain) = (true, false),
                b'"' => {
                    let (text, rest) = self.rest.split_at(at + 2);
                    // What an escape may say is known where texts are read.
                    if !plain {
                        serde_json::from_str::<String>(text).ok()?;
                    }
                    self.rest = behind_space(rest);
                    return Some(&inner[..at]);
                }
                ..b' ' => return None,
                _ => {}
            }
        }
        None
    }

    fn scalar(&mut self) -> Option<()> {
        let end = self.rest.find([',', ']', '}', ' ', '\n', '\r', '\t']).unwrap_or(self.rest.len());
        let (literal, rest) = self.rest.split_at(end);
        self.rest = behind_space(rest);
        if matches!(literal, "true" | "false" | "null") {
            return Some(());
        }
        let not_finite = LITERALS.contains(&literal)
            || is_json_number(literal)? && literal.parse::<f64>().ok()?.is_infinite();
        if not_finite && self.found.is_none() {
            self.found = Some((self.path(), literal.to_owned()));
        }
        Some(())
    }
}

/// Space as JSON has it: other characters that are blank are none.
const SPACE: [char; 4] = [' ', '\n', '\r', '\t'];

fn behind_space(text: &str) -> &str {
    text.trim_start_matches(SPACE)
}

/// `Some(true)` for what JSON calls a number; `None` for anything else.
fn is_json_number(literal: &str) -> Option<bool> {
    let unsigned = literal.strip_prefix('-').unwrap_or(literal);
    let (mantissa, exponent) = match unsigned.split_once(['e', 'E']) {
        Some((mantissa, exponent)) => (mantissa, Some(exponent.strip_prefix(['+', '-']).unwrap_or(exponent))),
        None => (unsigned, None),
    };
    let (whole, fraction) = match mantissa.split_once('.') {
        Some((whole, fraction)) => (whole, Some(fraction)),
        None => (mantissa, None),
    };
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let whole_fits = digits(whole) && (whole == "0" || !whole.starts_with('0'));
    (whole_fits && fraction.is_none_or(digits) && exponent.is_none_or(digits)).then_some(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(json: &str) -> Option<(String, String)> {
        first_non_finite(json.as_bytes())
    }

    #[test]
    fn names_the_first_number_that_is_not_finite() {
        let at = |path: &str, literal: &str| Some((path.to_owned(), literal.to_owned()));
        assert_eq!(found(r#"{"samples":{"a":[1,NaN,Infinity]}}"#), at("samples.a[1]", "NaN"));
        assert_eq!(found(r#"{"a":{"x":"]}\""},"b":[[],[ -Infinity ]]}"#), at("b[1][0]", "-Infinity"));
        assert_eq!(found(r#"{"a":1e999}"#), at("a", "1e999"));
        assert_eq!(found(r#"{"depth\u005fmm":[1,NaN]}"#), at("depth_mm[1]", "NaN"));
        assert_eq!(found(r#"{"a":-1E+400,"b":true}"#), at("a", "-1E+400"));
    }

    #[test]
    fn a_field_is_told_beside_numbers_that_are_not_finite() {
        let told = |json: &str| text_of(json.as_bytes(), "cycle_id");
        let id = |text: &str| Some(text.to_owned());
        assert_eq!(told(r#"{"a":[NaN],"cycle_id": "c\u0031" ,"b":{"cycle_id":"x"}}"#), id("c1"));
        assert_eq!(told(r#" {"b":{"cycle_id":"x"},"cycle_id":"c1","b":NaN}"#), id("c1"));
        let far = |values: usize| format!(r#"{{"a":[{}NaN],"cycle_id":"ä"}}"#, "1,".repeat(values));
        assert_eq!(told(&far(1000)), id("ä"));
        assert_eq!(told(&far(MOST_LOOKED_THROUGH / 2)), None);
        // Cut within a letter.
        let cut = format!(r#"{{"cycle_id":"c1","a":"{}"#, "ä".repeat(MOST_LOOKED_THROUGH));
        assert_eq!(told(&cut), id("c1"));
        for none in
            [r#"{"cycle_id":NaN}"#, r#"{"b":{"cycle_id":"x"}}"#, r#"[{"cycle_id":"x"}]"#, r#"{"cycle_id":"x"#]
        {
            assert_eq!(told(none), None, "{none}");
        }
    }

    #[test]
    fn what_is_no_json_stays_no_json() {
        for text in [
            "",
            "{",
            r#"{"a":NaN"#,
            r#"{"a":NaN}}"#,
            r#"{"a":NaN,}"#,
            r#"{a:NaN}"#,
            r#"{"a":01,"b":NaN}"#,
            r#"{"a":"x,"b":NaN}"#,
            r#"{"a":nope,"b":NaN}"#,
            "[1 2, NaN]",
            r#"{"a":"\q","b":NaN}"#,
            r#"{"a":"\u12g4","b":NaN}"#,
            r#"{"a":"\ud800","b":NaN}"#,
            r#"{"a\udc00":"","b":NaN}"#,
            "{\"a\":\"\n\",\"b\":NaN}",
            "{\"a\":\"\\\n\",\"b\":NaN}",
            "{\u{a0}\"b\":NaN}",
            "{\"b\":NaN}\u{c}",
        ] {
            assert_eq!(found(text), None, "{text}");
        }
        assert_eq!(found(&"[".repeat(100_000)), None);
        assert_eq!(found(r#"{"a":1}"#), None);
    }
}
