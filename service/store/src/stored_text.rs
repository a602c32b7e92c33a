//! Texts by their bytes, whether they decode or not: one that is damaged is gone past and told, and takes nothing else away.

use sqlx::encode::IsNull;
use sqlx::error::BoxDynError;
use sqlx::{Database, Decode, Encode, Postgres, Sqlite, Type};
use std::fmt;

/// A text as it is stored. Bound to a statement it stands as `CAST($1 AS TEXT)`, as SQLite is given its bytes.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct StoredText(Vec<u8>);

impl StoredText {
    /// The text where it is one.
    pub fn as_str(&self) -> Option<&str> {
        std::str::from_utf8(&self.0).ok()
    }

    /// Whether it decodes.
    pub(crate) fn is_sound(&self) -> bool {
        self.as_str().is_some()
    }

    /// As people are shown it: what does not decode is replaced. For nothing that decides.
    pub(crate) fn shown(&self) -> String {
        String::from_utf8_lossy(&self.0).into_owned()
    }
}

impl From<&str> for StoredText {
    fn from(text: &str) -> Self {
        Self(text.as_bytes().to_vec())
    }
}

/// On one line, as faults are told.
impl fmt::Display for StoredText {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.shown().replace(char::is_control, "\u{fffd}"))
    }
}

impl Type<Sqlite> for StoredText {
    fn type_info() -> <Sqlite as Database>::TypeInfo {
        <[u8] as Type<Sqlite>>::type_info()
    }

    fn compatible(of: &<Sqlite as Database>::TypeInfo) -> bool {
        <str as Type<Sqlite>>::compatible(of)
    }
}

impl<'r> Decode<'r, Sqlite> for StoredText {
    fn decode(value: <Sqlite as Database>::ValueRef<'r>) -> Result<Self, BoxDynError> {
        <Vec<u8> as Decode<'r, Sqlite>>::decode(value).map(Self)
    }
}

impl<'q> Encode<'q, Sqlite> for StoredText {
    fn encode_by_ref(
        &self,
        buffer: &mut <Sqlite as Database>::ArgumentBuffer,
    ) -> Result<IsNull, BoxDynError> {
        <Vec<u8> as Encode<'q, Sqlite>>::encode_by_ref(&self.0, buffer)
    }
}

impl Type<Postgres> for StoredText {
    fn type_info() -> <Postgres as Database>::TypeInfo {
        <str as Type<Postgres>>::type_info()
    }

    fn compatible(of: &<Postgres as Database>::TypeInfo) -> bool {
        <str as Type<Postgres>>::compatible(of)
    }
}

impl<'r> Decode<'r, Postgres> for StoredText {
    fn decode(value: <Postgres as Database>::ValueRef<'r>) -> Result<Self, BoxDynError> {
        Ok(Self(value.as_bytes()?.to_vec()))
    }
}

impl<'q> Encode<'q, Postgres> for StoredText {
    fn encode_by_ref(
        &self,
        buffer: &mut <Postgres as Database>::ArgumentBuffer,
    ) -> Result<IsNull, BoxDynError> {
        buffer.extend_from_slice(&self.0);
        Ok(IsNull::No)
    }
}
