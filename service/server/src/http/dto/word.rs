//! Enums of the core and the store as the words that JSON holds.

use feedwright_core::cycle::Outcome;
use feedwright_core::machine::LoadReference;
use feedwright_core::tool::ToolEventKind;
use feedwright_core::units::{Process, Strategy};
use feedwright_store::{AlarmKind, Role};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::borrow::Cow;
use utoipa::openapi::{ObjectBuilder, RefOr, Schema, Type};
use utoipa::{PartialSchema, ToSchema};

/// An enum that has a word for each of its values.
pub trait Words: Copy + Sized + 'static {
    /// Its name in the API's description.
    const NAME: &'static str;
    /// Every value.
    const VALUES: &'static [Self];

    /// The word of a value.
    fn word(self) -> &'static str;
}

macro_rules! words {
    ($($type:ident: $values:expr;)*) => {$(
        impl Words for $type {
            const NAME: &'static str = stringify!($type);
            const VALUES: &'static [Self] = $values;

            fn word(self) -> &'static str {
                self.as_str()
            }
        }
    )*};
}

words! {
    LoadReference: &LoadReference::ALL;
    Process: &Process::ALL;
    Strategy: &Strategy::ALL;
    ToolEventKind: &ToolEventKind::ALL;
    AlarmKind: &AlarmKind::ALL;
    Role: &Role::ALL;
    Outcome: &[Outcome::Completed, Outcome::Aborted];
}

/// A value of such an enum in JSON.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Word<T>(pub T);

impl<T: Words> Serialize for Word<T> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(self.0.word())
    }
}

impl<'de, T: Words> Deserialize<'de> for Word<T> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let text = Cow::<str>::deserialize(from)?;
        let known = T::VALUES.iter().copied().find(|value| value.word() == text);
        known.map(Self).ok_or_else(|| {
            let all: Vec<_> = T::VALUES.iter().map(|value| value.word()).collect();
            serde::de::Error::custom(format!("unknown word `{text}`, must be one of {}", all.join(", ")))
        })
    }
}

impl<T: Words> PartialSchema for Word<T> {
    fn schema() -> RefOr<Schema> {
        let words = T::VALUES.iter().map(|value| value.word());
        ObjectBuilder::new().schema_type(Type::String).enum_values(Some(words)).into()
    }
}

impl<T: Words> ToSchema for Word<T> {
    fn name() -> Cow<'static, str> {
        Cow::Borrowed(T::NAME)
    }
}
