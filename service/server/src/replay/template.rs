//! Texts with named holes: `experiment_{experiment}.csv` reads a file name, `layer-{layer}` writes an id.

use serde::Deserialize;
use std::collections::BTreeMap;

/// Values by name, for filling holes.
pub type Values = BTreeMap<String, String>;

#[derive(Debug, Clone, PartialEq)]
enum Part {
    Text(String),
    Hole { name: String, digits: usize },
}

/// A text with named holes. `{index:05}` pads a number with zeros to five digits.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(try_from = "String")]
pub struct Template {
    source: String,
    parts: Vec<Part>,
}

impl Template {
    /// Parses `source`; braces that do not pair, holes without a name and adjoining holes are refused.
    pub fn parse(source: &str) -> Result<Self, String> {
        let mut parts = Vec::new();
        let mut rest = source;
        while let Some(open) = rest.find(['{', '}']) {
            let bad = || format!("{source:?}: braces must enclose a name, as in {{file}}");
            let (text, tail) = rest.split_at(open);
            let (hole, tail) =
                tail.strip_prefix('{').and_then(|tail| tail.split_once('}')).ok_or_else(bad)?;
            if !text.is_empty() {
                parts.push(Part::Text(text.to_owned()));
            } else if matches!(parts.last(), Some(Part::Hole { .. })) {
                return Err(format!("{source:?}: two holes need a text between them"));
            }
            let (name, digits) = match hole.split_once(":0") {
                Some((name, digits)) => (name, digits.parse().map_err(|_| bad())?),
                None => (hole, 0),
            };
            let named = !name.is_empty() && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_');
            if !named || digits > 20 {
                return Err(bad());
            }
            parts.push(Part::Hole { name: name.to_owned(), digits });
            rest = tail;
        }
        if !rest.is_empty() {
            parts.push(Part::Text(rest.to_owned()));
        }
        Ok(Self { source: source.to_owned(), parts })
    }

    /// The text as it was written.
    pub fn as_str(&self) -> &str {
        &self.source
    }

    /// Names of the holes.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.parts.iter().filter_map(|part| match part {
            Part::Hole { name, .. } => Some(name.as_str()),
            Part::Text(_) => None,
        })
    }

    /// What the holes hold where `text` has this shape. A hole holds at least one character and as few as fit;
    /// the last takes the rest.
    pub fn read(&self, text: &str) -> Option<Values> {
        let mut values = Values::new();
        let mut rest = text;
        let mut parts = self.parts.iter().peekable();
        while let Some(part) = parts.next() {
            let name = match part {
                Part::Text(literal) => {
                    rest = rest.strip_prefix(literal.as_str())?;
                    continue;
                }
                Part::Hole { name, .. } => name,
            };
            let taken = match parts.next() {
                None => std::mem::take(&mut rest),
                Some(Part::Text(literal)) => {
                    let end = if parts.peek().is_none() {
                        rest.strip_suffix(literal.as_str())?.len()
                    } else {
                        rest.find(literal.as_str())?
                    };
                    let taken = &rest[..end];
                    rest = &rest[end + literal.len()..];
                    taken
                }
                Some(Part::Hole { .. }) => return None,
            };
            if taken.is_empty() || values.get(name).is_some_and(|known| known != taken) {
                return None;
            }
            values.insert(name.clone(), taken.to_owned());
        }
        rest.is_empty().then_some(values)
    }

    /// The text with its holes filled; names the hole that has no value.
    pub fn fill(&self, values: &Values) -> Result<String, String> {
        let mut text = String::new();
        for part in &self.parts {
            match part {
                Part::Text(literal) => text.push_str(literal),
                Part::Hole { name, digits } => {
                    let value = values.get(name).ok_or_else(|| {
                        let known: Vec<&str> = values.keys().map(String::as_str).collect();
                        format!(
                            "{:?}: nothing is called {name:?}; known are {}",
                            self.source,
                            known.join(", ")
                        )
                    })?;
                    text.extend(std::iter::repeat_n('0', digits.saturating_sub(value.len())));
                    text.push_str(value);
                }
            }
        }
        Ok(text)
    }
}

impl TryFrom<String> for Template {
    type Error = String;
    fn try_from(source: String) -> Result<Self, String> {
        Self::parse(&source)
    }
}

/// A cell as it goes into an id: of a plain decimal without the zeros at its end, so that `6.0` and `6` name one thing.
///
/// It stays text: what reads as a number may be a serial number, of which no digit, leading zero or `E` is superfluous.
pub fn tidy(cell: &str) -> String {
    let cell = cell.trim();
    let Some((whole, fraction)) = cell.split_once('.') else { return cell.to_owned() };
    let digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    let magnitude = whole.strip_prefix('-').unwrap_or(whole);
    let plain = magnitude == "0" || (!magnitude.is_empty() && !magnitude.starts_with('0'));
    if !plain || !digits(magnitude) || !digits(fraction) {
        return cell.to_owned();
    }
    match fraction.trim_end_matches('0') {
        "" => whole.to_owned(),
        fraction => format!("{whole}.{fraction}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn template(source: &str) -> Template {
        Template::parse(source).unwrap()
    }

    #[test]
    fn reads_what_it_would_write() {
        let file = template("experiment_{experiment}.csv");
        let values = file.read("experiment_04.csv").unwrap();
        assert_eq!(values["experiment"], "04");
        assert_eq!(file.fill(&values).unwrap(), "experiment_04.csv");
        assert_eq!(file.read("experiment_.csv"), None);
        assert_eq!(file.read("experiment_04.csv.bak"), None);
        let label = template("Layer {layer} Up");
        assert_eq!(label.read("Layer 2 Up").unwrap()["layer"], "2");
        assert_eq!(label.read("Layer 2 Down"), None);
        assert_eq!(template("a{x}-{y}").read("a1-2-3").unwrap()["y"], "2-3");
        assert_eq!(template("{x}-{x}").read("1-2"), None);
    }

    #[test]
    fn pads_numbers_and_names_what_is_missing() {
        let values = Values::from([("index".to_owned(), "7".to_owned())]);
        assert_eq!(template("c{index:04}").fill(&values).unwrap(), "c0007");
        assert!(template("{other}").fill(&values).unwrap_err().contains("known are index"));
    }

    #[test]
    fn refuses_broken_braces() {
        for wrong in ["{", "}", "a{}", "{a}{b}", "{a b}", "{a:0x}"] {
            assert!(Template::parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn tidies_plain_decimals_only() {
        assert_eq!(tidy("6.0"), "6");
        assert_eq!(tidy(" 2.50 "), "2.5");
        assert_eq!(tidy("-0.30"), "-0.3");
        for serial in [
            "12345678901234567890",
            "12345678901234567891",
            "1E5",
            "100000",
            "0815",
            "007.10",
            "1.0E5",
            "1.2.0",
            ".50",
            "-",
        ] {
            assert_eq!(tidy(serial), serial);
        }
        assert_eq!(tidy("unworn"), "unworn");
        assert_eq!(tidy("inf"), "inf");
    }
}
