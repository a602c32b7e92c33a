//! Enums of the core and the store as the words that JSON holds.

use feedwright_core::cycle::Outcome;
use feedwright_core::feed::life_cycle::VersionState;
use feedwright_core::feed::profile::SectionKind;
use feedwright_core::machine::LoadReference;
use feedwright_core::tool::ToolEventKind;
use feedwright_core::units::{Process, Strategy};
use feedwright_store::{AlarmKind, ProfileSource, Role};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::borrow::Cow;
use utoipa::openapi::{ObjectBuilder, RefOr, Schema, Type};
use utoipa::{PartialSchema, ToSchema};

macro_rules! words {
    ($($(#[$doc:meta])* $word:ident $(+ $derive:ident)?, $type:ident: $values:expr;)*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq $(, $derive)?)]
        pub struct $word(pub $type);

        impl $word {
            const VALUES: &'static [$type] = &$values;
        }

        impl Serialize for $word {
            fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
                to.serialize_str(self.0.as_str())
            }
        }

        impl<'de> Deserialize<'de> for $word {
            fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
                let text = Cow::<str>::deserialize(from)?;
                let known = Self::VALUES.iter().copied().find(|value| value.as_str() == text);
                known.map(Self).ok_or_else(|| {
                    let all: Vec<_> = Self::VALUES.iter().map(|value| value.as_str()).collect();
                    let all = all.join(", ");
                    serde::de::Error::custom(format!("unknown word `{text}`, must be one of {all}"))
                })
            }
        }

        impl PartialSchema for $word {
            fn schema() -> RefOr<Schema> {
                let words = Self::VALUES.iter().map(|value| value.as_str());
                ObjectBuilder::new().schema_type(Type::String).enum_values(Some(words)).into()
            }
        }

        impl ToSchema for $word {
            fn name() -> Cow<'static, str> {
                Cow::Borrowed(stringify!($type))
            }
        }
    )*};
}

words! {
    /// What a load in percent refers to.
    LoadReferenceWord + Default, LoadReference: LoadReference::ALL;
    /// A process.
    ProcessWord, Process: Process::ALL;
    /// How a feed was chosen.
    StrategyWord, Strategy: Strategy::ALL;
    /// What happened to a tool.
    ToolEventKindWord, ToolEventKind: ToolEventKind::ALL;
    /// A kind of alarm.
    AlarmKindWord, AlarmKind: AlarmKind::ALL;
    /// A role.
    RoleWord, Role: Role::ALL;
    /// What happens in a section of a feed profile.
    SectionKindWord, SectionKind: SectionKind::ALL;
    /// Where a version of a feed profile stands.
    VersionStateWord, VersionState: VersionState::ALL;
    /// Where a version of a feed profile comes from.
    ProfileSourceWord, ProfileSource: ProfileSource::ALL;
    /// How a cycle ended.
    OutcomeWord, Outcome: [Outcome::Completed, Outcome::Aborted];
}
