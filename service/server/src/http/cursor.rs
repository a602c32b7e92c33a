//! Pages of lists: opaque keyset cursors, bounded, tied to the list and filters they came from.

use super::problem::Problem;
use crate::state::AppState;
use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use feedwright_core::ids::{CycleId, MachineId, ModelId, OperationId, ProfileId, ToolId};
use feedwright_core::invalid::Violation;
use feedwright_core::units::Timestamp;
use feedwright_store::{CycleKey, Page};
use serde::Serialize;
use utoipa::ToSchema;

/// Version of the cursors; one of another version is refused.
const VERSION: u8 = 1;
/// Bytes of the check value.
const CHECK: usize = 8;
/// Separates the parts of a key; no identifier holds it.
const SEPARATOR: char = '\n';

/// A key that a page can go on after.
pub trait CursorKey: Sized {
    /// The key as text.
    fn write(&self) -> String;

    /// The key of that text.
    fn read(text: &str) -> Option<Self>;
}

macro_rules! cursor_key {
    (ids: $($id:ty),*; numbers: $($number:ty),*) => {
        $(impl CursorKey for $id {
            fn write(&self) -> String {
                self.as_str().to_owned()
            }

            fn read(text: &str) -> Option<Self> {
                Self::try_from(text).ok()
            }
        })*
        $(impl CursorKey for $number {
            fn write(&self) -> String {
                self.to_string()
            }

            fn read(text: &str) -> Option<Self> {
                text.parse().ok()
            }
        })*
    };
}

cursor_key! { ids: MachineId, ToolId, OperationId, CycleId, ModelId, ProfileId; numbers: i64, u32, String }

impl CursorKey for CycleKey {
    fn write(&self) -> String {
        let (at, machine, cycle) = self;
        format!("{}{SEPARATOR}{machine}{SEPARATOR}{cycle}", at.micros())
    }

    fn read(text: &str) -> Option<Self> {
        let mut parts = text.split(SEPARATOR);
        let at = Timestamp::from_micros(parts.next()?.parse().ok()?);
        let machine = MachineId::try_from(parts.next()?).ok()?;
        let cycle = CycleId::try_from(parts.next()?).ok()?;
        parts.next().is_none().then_some((at, machine, cycle))
    }
}

/// A page of a list.
#[derive(Debug, Serialize, ToSchema)]
pub struct List<T> {
    /// The rows.
    pub items: Vec<T>,
    /// Goes on after the last row, as `cursor`; absent on the last page.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub next_cursor: Option<String>,
}

/// What was asked for: a page of the list named `scope`, which names its filters too.
#[derive(Debug)]
pub struct Paging<K> {
    scope: String,
    limit: u32,
    after: Option<K>,
}

impl<K: CursorKey + Clone> Paging<K> {
    /// Reads `limit` and `cursor`: 400 where the limit is out of bounds, or the cursor was not made by this list with
    /// these filters.
    pub fn new(
        state: &AppState,
        scope: impl Into<String>,
        limit: Option<u32>,
        cursor: Option<&str>,
    ) -> Result<Self, Problem> {
        let scope = scope.into();
        let limits = &state.config.limits;
        let limit = limit.unwrap_or(limits.default_page_size);
        if limit == 0 || limit > limits.max_page_size {
            let message = format!("must be within 1 to {}, is {limit}", limits.max_page_size);
            let violation = Violation::new("limit", "out_of_range", message);
            return Err(Problem { code: "invalid_limit", ..Problem::invalid_query(violation) });
        }
        let after = cursor.map(|cursor| decode(&scope, cursor).ok_or_else(foreign)).transpose()?;
        Ok(Self { scope, limit, after })
    }

    /// The page to ask the store for: one row more than wanted, which tells whether there is another page.
    pub fn page(&self) -> Page<K> {
        Page { after: self.after.clone(), limit: self.limit.saturating_add(1) }
    }

    /// Makes the list of what the store returned.
    pub fn list<R, T>(&self, mut rows: Vec<R>, key: impl Fn(&R) -> K, view: impl Fn(R) -> T) -> List<T> {
        let wanted = usize::try_from(self.limit).unwrap_or(usize::MAX);
        let more = rows.len() > wanted;
        rows.truncate(wanted);
        let last = rows.last().filter(|_| more).map(key);
        let next_cursor = last.map(|key| encode(&self.scope, &key));
        List { items: rows.into_iter().map(view).collect(), next_cursor }
    }
}

/// The check value over the list, its filters and the key. It finds damage and mix-ups; it protects nothing, since a
/// cursor gives no access that its list does not give.
fn check(scope: &str, key: &str) -> [u8; CHECK] {
    let hash = blake3::hash(format!("{scope}\0{key}").as_bytes());
    std::array::from_fn(|at| hash.as_bytes()[at])
}

/// The cursor that goes on after `key` in the list named `scope`.
pub(super) fn encode<K: CursorKey>(scope: &str, key: &K) -> String {
    let key = key.write();
    let mut bytes = vec![VERSION];
    bytes.extend(check(scope, &key));
    bytes.extend(key.as_bytes());
    URL_SAFE_NO_PAD.encode(bytes)
}

/// The key of a cursor; `None` where it was not made by the list named `scope`.
pub(super) fn decode<K: CursorKey>(scope: &str, cursor: &str) -> Option<K> {
    let bytes = URL_SAFE_NO_PAD.decode(cursor).ok()?;
    let (&version, rest) = bytes.split_first()?;
    let (checked, key) = rest.split_at_checked(CHECK)?;
    let key = std::str::from_utf8(key).ok()?;
    (version == VERSION && checked == check(scope, key)).then(|| K::read(key)).flatten()
}

fn foreign() -> Problem {
    let message = "is not one that this list gave with these filters";
    let violation = Violation::new("cursor", "invalid_cursor", message);
    Problem { code: "invalid_cursor", ..Problem::invalid_query(violation) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cursor_comes_back_and_a_changed_one_does_not() {
        let key: CycleKey = (
            Timestamp::from_micros(-5),
            MachineId::try_from("M:1").unwrap(),
            CycleId::try_from("a.b-c").unwrap(),
        );
        let cursor = encode("cycles", &key);
        assert_eq!(decode("cycles", &cursor), Some(key));
        assert_eq!(decode::<CycleKey>("cycles|tool=T1", &cursor), None);
        assert_eq!(foreign().code, "invalid_cursor");
        for at in 0..cursor.len() {
            let mut changed = cursor.clone();
            let other = if &cursor[at..=at] == "A" { "B" } else { "A" };
            changed.replace_range(at..=at, other);
            assert_eq!(decode::<CycleKey>("cycles", &changed), None, "{at}");
        }
        for text in ["", "%", "AQ", &cursor[..cursor.len() - 2]] {
            assert_eq!(decode::<CycleKey>("cycles", text), None);
        }
    }
}
