//! Tokens that were looked up a moment ago.
//!
//! A revocation through this process acts on the next request; one through another process or replica within
//! [`LIFE`]. Only tokens that were good are kept, under their hash; nothing is kept of those that were refused.
//! While the database cannot be asked, `/metrics` believes one for longer ([`OUTAGE_LIFE`]).

use feedwright_store::TokenRecord;
use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How long a token is believed without looking: what a revocation elsewhere may take to act here.
const LIFE: Duration = Duration::from_secs(2);
/// How long a token that was good is believed by `/metrics`, and by nothing else, while the database cannot be asked: long
/// enough that whoever is on call is told what it is that fails.
const OUTAGE_LIFE: Duration = Duration::from_secs(60 * 60);
/// Tokens kept at the most; a plant has hundreds of machines.
const MOST: usize = 4096;

/// Tokens that were good a moment ago.
#[derive(Debug, Default)]
pub(crate) struct KnownTokens {
    known: Mutex<Known>,
}

#[derive(Debug, Default)]
struct Known {
    tokens: HashMap<[u8; 32], Good>,
    /// Counts revocations: a look-up that began before one is not kept, and what was kept before is looked up again.
    epoch: u64,
}

/// A token that was good.
#[derive(Debug)]
struct Good {
    record: TokenRecord,
    /// When its look-up began.
    at: Instant,
    /// Revocations before that.
    epoch: u64,
}

/// When a look-up began.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Epoch(u64);

impl KnownTokens {
    /// The token of that hash, where it was looked up a moment before `now`; else the ticket for keeping it.
    pub(crate) fn get(&self, hash: &[u8; 32], now: Instant) -> Result<TokenRecord, Epoch> {
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        match known.tokens.get(hash) {
            Some(good) if good.epoch == known.epoch && now.saturating_duration_since(good.at) < LIFE => {
                Ok(good.record.clone())
            }
            _ => Err(Epoch(known.epoch)),
        }
    }

    /// The token of that hash, where the last look-up, not long before `now`, found it good: for `/metrics` alone.
    pub(super) fn lately(&self, hash: &[u8; 32], now: Instant) -> Option<TokenRecord> {
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let good = known.tokens.get(hash)?;
        (now.saturating_duration_since(good.at) < OUTAGE_LIFE).then(|| good.record.clone())
    }

    /// A look-up has found no good token of that hash.
    pub(super) fn refuse(&self, hash: &[u8; 32]) {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        known.tokens.remove(hash);
    }

    /// Keeps a token that was looked up from `now` on; a revoked one, or one whose look-up began before something was
    /// revoked, is not kept.
    pub(crate) fn keep(&self, record: &TokenRecord, began: Epoch, now: Instant) {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if known.epoch != began.0 || record.revoked_at.is_some() {
            return;
        }
        if known.tokens.len() >= MOST {
            known.tokens.clear();
        }
        known.tokens.insert(record.hash, Good { record: record.clone(), at: now, epoch: began.0 });
    }

    /// The token of that id was revoked, or may have been. It is forgotten, in an outage too; every other one is looked up
    /// again where the database can be asked.
    pub(crate) fn revoked(&self, id: &str) {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        known.epoch += 1;
        known.tokens.retain(|_, good| good.record.id != id);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use feedwright_core::units::Timestamp;
    use feedwright_store::Role;

    fn record(hash: u8, revoked: bool) -> TokenRecord {
        TokenRecord {
            id: format!("t{hash}"),
            name: String::new(),
            hash: [hash; 32],
            role: Role::Viewer,
            machine: None,
            created_at: Timestamp::from_micros(0),
            revoked_at: revoked.then(|| Timestamp::from_micros(1)),
        }
    }

    #[test]
    fn a_token_is_known_for_a_moment_and_not_after_a_revocation() {
        let (tokens, now) = (KnownTokens::default(), Instant::now());
        let first = tokens.get(&[1; 32], now).unwrap_err();
        tokens.keep(&record(1, false), first, now);
        assert_eq!(tokens.get(&[1; 32], now + LIFE / 2).unwrap(), record(1, false));
        assert!(tokens.get(&[1; 32], now + LIFE).is_err(), "its life is over");
        assert!(tokens.get(&[2; 32], now).is_err());

        // This look-up read the database before the revocation and returns after it.
        let slow = tokens.get(&[2; 32], now).unwrap_err();
        tokens.revoked("t2");
        tokens.keep(&record(2, false), slow, now);
        assert!(tokens.get(&[2; 32], now).is_err());
        assert_eq!(tokens.lately(&[2; 32], now), None);
        let again = tokens.get(&[1; 32], now).unwrap_err();
        tokens.keep(&record(1, false), again, now);
        assert_eq!(tokens.get(&[1; 32], now).unwrap(), record(1, false));

        let later = tokens.get(&[3; 32], now).unwrap_err();
        tokens.keep(&record(3, true), later, now);
        assert!(tokens.get(&[3; 32], now).is_err(), "a revoked token is never kept");
    }

    #[test]
    fn it_is_remembered_for_an_outage_until_it_is_known_to_be_no_good() {
        let (tokens, now) = (KnownTokens::default(), Instant::now());
        for hash in 1..=3 {
            let ticket = tokens.get(&[hash; 32], now).unwrap_err();
            tokens.keep(&record(hash, false), ticket, now);
        }
        let later = now + OUTAGE_LIFE / 2;
        assert!(tokens.get(&[1; 32], later).is_err(), "by other routes it is not believed");
        assert_eq!(tokens.lately(&[1; 32], later), Some(record(1, false)));
        assert_eq!(tokens.lately(&[1; 32], now + OUTAGE_LIFE), None);
        assert_eq!(tokens.lately(&[9; 32], later), None, "nobody has looked it up");
        // Revoked by another server, and seen by a look-up since.
        tokens.refuse(&[2; 32]);
        assert_eq!(
            (tokens.lately(&[2; 32], later), tokens.lately(&[3; 32], later)),
            (None, Some(record(3, false)))
        );
        // Revoked here: the others are looked up anew, and remembered where they cannot be.
        tokens.revoked("t3");
        assert_eq!(
            (tokens.lately(&[1; 32], later), tokens.lately(&[3; 32], later)),
            (Some(record(1, false)), None)
        );
        assert!(tokens.get(&[1; 32], now).is_err());
    }

    #[test]
    fn it_is_bounded() {
        let (tokens, now) = (KnownTokens::default(), Instant::now());
        for index in 0..2 * MOST {
            let mut hash = [0; 32];
            hash[..8].copy_from_slice(&index.to_le_bytes());
            let ticket = tokens.get(&hash, now).unwrap_err();
            tokens.keep(&TokenRecord { hash, ..record(0, false) }, ticket, now);
        }
        assert!(tokens.known.lock().unwrap().tokens.len() <= MOST);
    }
}
