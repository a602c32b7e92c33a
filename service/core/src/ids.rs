//! Identifiers: short, printable, case-sensitive names that people and machines choose.

use crate::invalid::Violation;
use std::fmt;
use std::sync::Arc;

/// Longest identifier in bytes; long enough for a UUID with a prefix, short enough for an index.
pub const MAX_ID_LENGTH: usize = 128;

fn check(path: &str, text: &str) -> Result<(), Violation> {
    let bytes = text.as_bytes();
    let Some(first) = bytes.first() else {
        return Err(Violation::new(path, "empty", "must not be empty"));
    };
    if bytes.len() > MAX_ID_LENGTH {
        return Err(Violation::new(
            path,
            "too_long",
            format!("must have at most {MAX_ID_LENGTH} bytes, has {}", bytes.len()),
        ));
    }
    let inner = |b: &u8| b.is_ascii_alphanumeric() || matches!(b, b'.' | b'_' | b':' | b'-');
    if !first.is_ascii_alphanumeric() || !bytes.iter().all(inner) {
        return Err(Violation::new(
            path,
            "invalid_id",
            "must begin with a letter or digit and hold only letters, digits and . _ : -",
        ));
    }
    Ok(())
}

macro_rules! id {
    ($($(#[$doc:meta])* $name:ident, $path:literal;)*) => {$(
        $(#[$doc])*
        #[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(Arc<str>);

        impl $name {
            /// Accepts `[A-Za-z0-9][A-Za-z0-9._:-]{0,127}`; `path` names the field in the violation.
            pub fn parse(path: &str, text: &str) -> Result<Self, Violation> {
                check(path, text)?;
                Ok(Self(text.into()))
            }

            /// The identifier as text.
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl TryFrom<&str> for $name {
            type Error = Violation;
            fn try_from(text: &str) -> Result<Self, Violation> {
                Self::parse($path, text)
            }
        }

        impl PartialEq<str> for $name {
            fn eq(&self, text: &str) -> bool {
                *self.0 == *text
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(&self.0)
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{}({:?})", stringify!($name), self.as_str())
            }
        }
    )*};
}

id! {
    /// Names a machine.
    MachineId, "machine";
    /// Names one physical tool, as its serial number does.
    ToolId, "tool";
    /// Names an operation: what is machined.
    OperationId, "operation";
    /// Names a cycle within its machine; `(MachineId, CycleId)` is its identity for ever.
    CycleId, "cycle_id";
    /// Names a recommendation that was handed out.
    RecommendationId, "recommendation_id";
    /// Names a feed profile.
    ProfileId, "profile";
    /// Names an entry of the model library within its kind.
    ModelId, "model";
}

/// How the id of a recommendation ends that asks for a reference cycle: a cycle that names it says with its own
/// content, for ever and without a look into what was handed out, that it was asked for as one.
pub const REFERENCE_ID_ENDING: &str = "-reference";

impl RecommendationId {
    /// Whether it asked for a reference cycle.
    pub fn asks_for_reference(&self) -> bool {
        self.as_str().ends_with(REFERENCE_ID_ENDING)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accepts_what_the_grammar_says() {
        for text in ["a", "0", "M-1", "boot7:000123", "0192f0c1-7e1d-7cc3-98c4-dc0c0c07398f", "A.b_c:d-e"] {
            assert_eq!(MachineId::try_from(text).unwrap().as_str(), text);
        }
        assert!(MachineId::try_from("a".repeat(128).as_str()).is_ok());
    }

    #[test]
    fn refuses_the_rest_with_a_code() {
        let code = |text: &str| ToolId::try_from(text).unwrap_err().code;
        assert_eq!(code(""), "empty");
        assert_eq!(code(&"a".repeat(129)), "too_long");
        // Letters that no id has may be more than a byte each: of those there are told bytes.
        let long = ToolId::try_from("é".repeat(128).as_str()).unwrap_err();
        assert_eq!((long.code, long.message.as_ref()), ("too_long", "must have at most 128 bytes, has 256"));
        for text in ["-a", ".a", "a b", "a/b", "é", "a\0", "a\n", "%41"] {
            assert_eq!(code(text), "invalid_id", "{text:?}");
        }
    }
}
