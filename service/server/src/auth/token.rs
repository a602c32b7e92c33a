//! Tokens: `fwt_<id>_<secret>_<checksum>`, so that a leaked one can be recognised and a mistyped one costs no look-up.

use crate::clock::Clock;
use feedwright_core::ids::MachineId;
use feedwright_store::{Role, TokenRecord};
use secrecy::{ExposeSecret, SecretString};
use std::fmt::Write;

/// Begins every token; secret scanners look for it.
const PREFIX: &str = "fwt";
/// Hex digits of an id: 48 bits of time, so that ids ascend, and 48 random ones.
const ID_LENGTH: usize = 24;
/// Hex digits of the secret's 256 bits.
const SECRET_LENGTH: usize = 64;
/// Hex digits of the checksum.
const CHECKSUM_LENGTH: usize = 8;

/// A token as a client presents it; well-formed, which says nothing about whether it is known.
#[derive(Debug, Clone)]
pub struct Token {
    id: String,
    text: SecretString,
}

impl Token {
    /// Checks form and checksum.
    pub fn parse(text: &str) -> Option<Self> {
        let mut parts = text.split('_');
        let (prefix, id) = (parts.next()?, parts.next()?);
        let (secret, checksum) = (parts.next()?, parts.next()?);
        let formed = prefix == PREFIX && parts.next().is_none();
        let formed = formed
            && is_hex(id, ID_LENGTH)
            && is_hex(secret, SECRET_LENGTH)
            && is_hex(checksum, CHECKSUM_LENGTH);
        (formed && checksum == checksum_of(id, secret))
            .then(|| Self { id: id.to_owned(), text: SecretString::from(text) })
    }

    /// The id in what begins as a token does, up to the whole of it, or is an id alone.
    pub fn id_of(text: &str) -> Option<&str> {
        let rest = text.strip_prefix(PREFIX).and_then(|rest| rest.strip_prefix('_')).unwrap_or(text);
        let id = rest.split_once('_').map_or(rest, |(id, _)| id);
        is_hex(id, ID_LENGTH).then_some(id)
    }

    /// Its public id.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// What is stored instead of it. The secret has 256 random bits, so a plain hash is enough.
    pub fn hash(&self) -> [u8; 32] {
        *blake3::hash(self.text.expose_secret().as_bytes()).as_bytes()
    }
}

fn is_hex(part: &str, length: usize) -> bool {
    part.len() == length && part.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'))
}

fn checksum_of(id: &str, secret: &str) -> String {
    let hash = blake3::hash(format!("{PREFIX}_{id}_{secret}").as_bytes());
    hash.to_hex()[..CHECKSUM_LENGTH].to_owned()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

/// A token that was just made: what is stored, and the text that is shown once.
#[derive(Debug)]
pub struct Issued {
    /// What is stored.
    pub record: TokenRecord,
    /// What is shown once.
    pub text: SecretString,
}

impl Issued {
    /// Makes a token; fails where the system has no randomness.
    pub fn new(
        name: &str,
        role: Role,
        machine: Option<MachineId>,
        clock: &Clock,
    ) -> Result<Self, getrandom::Error> {
        let mut random = [0_u8; 38];
        getrandom::fill(&mut random)?;
        let (id, secret) = random.split_at(6);
        let now = clock.now();
        let millis = now.micros().max(0) / 1000;
        let id = format!("{}{}", hex(&millis.to_be_bytes()[2..]), hex(id));
        let secret = hex(secret);
        let text = SecretString::from(format!("{PREFIX}_{id}_{secret}_{}", checksum_of(&id, &secret)));
        let hash = Token { id: id.clone(), text: text.clone() }.hash();
        let record =
            TokenRecord { id, name: name.to_owned(), hash, role, machine, created_at: now, revoked_at: None };
        Ok(Self { record, text })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use feedwright_core::units::Timestamp;

    #[test]
    fn a_token_is_recognised_and_a_damaged_one_is_not() {
        let clock = Clock::fixed(Timestamp::from_micros(1_700_000_000_000_000));
        let issued = Issued::new("press 1", Role::Viewer, None, &clock).unwrap();
        let text = issued.text.expose_secret();
        let token = Token::parse(text).unwrap();
        assert_eq!((token.id(), token.hash()), (issued.record.id.as_str(), issued.record.hash));
        assert!(!format!("{issued:?}{token:?}").contains(&text[30..90]), "a secret is printed");

        let id = token.id();
        for begun in [id, &format!("fwt_{id}"), &format!("fwt_{id}_"), &text[..40], text] {
            assert_eq!(Token::id_of(begun), Some(id), "{begun}");
        }
        for none in ["", "fwt_", "fwt", &text[29..], &id[1..], "a/b", &id.to_uppercase()] {
            assert_eq!(Token::id_of(none), None, "{none}");
        }

        let mut wrong = text.to_owned();
        let digit = if wrong.ends_with('0') { "1" } else { "0" };
        wrong.replace_range(wrong.len() - 1.., digit);
        for damaged in [
            wrong.as_str(),
            &text[1..],
            &text[..90],
            "",
            "fwt_",
            "fwt____",
            &text.to_uppercase(),
            &format!("{text}_"),
        ] {
            assert!(Token::parse(damaged).is_none(), "{damaged}");
        }
        let other = Issued::new("press 1", Role::Viewer, None, &clock).unwrap();
        assert_ne!(other.record.hash, issued.record.hash);
        assert_ne!(other.record.id, issued.record.id);
    }
}
