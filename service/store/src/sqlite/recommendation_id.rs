//! How SQLite keeps a recommendation's id: by the bytes that it is a text of. One stands for every cycle.

use crate::error::StoreResult;
use feedwright_core::ids::{REFERENCE_ID_ENDING, RecommendationId};
use uuid::Uuid;

/// Stands behind the bytes of an id that asks for a reference cycle.
const REFERENCE: u8 = 1;

/// What stands in the column for this id: 16 bytes, and one more where it ends as the id of a reference cycle does. One of another
/// form, which this program gives none, is its text.
pub(crate) fn to_column(id: &str) -> Vec<u8> {
    let (text, is_reference) = match id.strip_suffix(REFERENCE_ID_ENDING) {
        Some(text) => (text, true),
        None => (id, false),
    };
    let Some(uuid) = Uuid::try_parse(text).ok().filter(|uuid| is_text_of(text, uuid)) else {
        let mut other = id.as_bytes().to_vec();
        if (16..=17).contains(&other.len()) {
            // Not as long as one of bytes: no id has such a character.
            other.resize(18, 0);
        }
        return other;
    };
    let mut key = Vec::with_capacity(17);
    key.extend_from_slice(uuid.as_bytes());
    key.extend(is_reference.then_some(REFERENCE));
    key
}

/// The id that stands in the column.
pub(crate) fn from_column(key: &[u8]) -> StoreResult<RecommendationId> {
    let text = match key.split_first_chunk::<16>() {
        Some((bytes, [])) => text_of(*bytes, ""),
        Some((bytes, [REFERENCE])) => text_of(*bytes, REFERENCE_ID_ENDING),
        _ => String::from_utf8_lossy(key).trim_end_matches('\0').to_owned(),
    };
    crate::rows::id("recommendation_id", &text)
}

fn text_of(bytes: [u8; 16], ending: &str) -> String {
    format!("{}{ending}", Uuid::from_bytes(bytes))
}

/// Whether this is the text that an id is given, and not another one that is read as the same.
fn is_text_of(text: &str, uuid: &Uuid) -> bool {
    let mut buffer = Uuid::encode_buffer();
    uuid.hyphenated().encode_lower(&mut buffer) == text
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn ids_are_their_bytes() {
        let text = "01a22195-189c-785c-a21c-8d64e0196669";
        let key = to_column(text);
        assert_eq!(key[..4], [0x01, 0xa2, 0x21, 0x95]);
        assert_eq!((key.len(), from_column(&key).unwrap().as_str()), (16, text));
        let reference = format!("{text}{REFERENCE_ID_ENDING}");
        let key = to_column(&reference);
        assert_eq!((key.len(), key[16], from_column(&key).unwrap().as_str()), (17, 1, reference.as_str()));
        // The same bytes in other words are another id.
        for other in [text.to_uppercase(), text.replace('-', ""), format!("{text}-"), "x".repeat(128)] {
            assert_eq!(from_column(&to_column(&other)).unwrap().as_str(), other);
            assert_ne!(to_column(&other), to_column(text));
        }
        assert!(
            from_column(&[]).is_err() && from_column(&[0xff; 15]).is_err() && from_column(&[2; 17]).is_err()
        );
    }

    proptest! {
        #[test]
        fn any_id_comes_back(bytes in any::<[u8; 16]>(), other in "[A-Za-z0-9_.-]{1,128}", reference in any::<bool>()) {
            let id = text_of(bytes, if reference { REFERENCE_ID_ENDING } else { "" });
            prop_assert_eq!(from_column(&to_column(&id)).unwrap().to_string(), id);
            if RecommendationId::try_from(other.as_str()).is_ok() {
                prop_assert_eq!(from_column(&to_column(&other)).unwrap().to_string(), other);
            }
        }

        /// Rows of both engines are compared in the order of their keys.
        #[test]
        fn later_ids_have_later_keys(a in any::<[u8; 16]>(), b in any::<[u8; 16]>()) {
            let (a, b) = (text_of(a, ""), text_of(b, REFERENCE_ID_ENDING));
            prop_assert_eq!(a.cmp(&b), to_column(&a).cmp(&to_column(&b)));
        }
    }
}
