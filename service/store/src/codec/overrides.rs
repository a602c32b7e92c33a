//! What each sample of a streamed cycle was answered: overrides and reasons, compressed.
//!
//! ```text
//! u8 version = 1
//! zstd frame of: u32 samples, f64 override each, u32 runs, per run u32 samples and u64 reasons; little-endian
//! ```

use crate::error::{StoreError, StoreResult};

const VERSION: u8 = 1;
/// Most samples that are read back; more than any setting permits a stream to hold.
const MOST_SAMPLES: usize = 10_000_000;

/// Packs an override in percent and the bits of its reasons for each sample, in their order.
pub fn encode_overrides(samples: &[(f64, u64)]) -> StoreResult<Vec<u8>> {
    let mut plain = Vec::with_capacity(8 + samples.len() * 9);
    plain.extend(u32::try_from(samples.len()).unwrap_or(u32::MAX).to_le_bytes());
    samples.iter().for_each(|(percent, _)| plain.extend(percent.to_le_bytes()));
    let mut runs: Vec<(u32, u64)> = Vec::new();
    for (_, reasons) in samples {
        match runs.last_mut() {
            Some((length, last)) if last == reasons => *length += 1,
            _ => runs.push((1, *reasons)),
        }
    }
    plain.extend(u32::try_from(runs.len()).unwrap_or(u32::MAX).to_le_bytes());
    for (length, reasons) in runs {
        plain.extend(length.to_le_bytes());
        plain.extend(reasons.to_le_bytes());
    }
    let mut block = vec![VERSION];
    block.extend(zstd::bulk::compress(&plain, 1).map_err(|error| StoreError::Database(Box::new(error)))?);
    Ok(block)
}

/// Unpacks what [`encode_overrides`] made.
pub fn decode_overrides(block: &[u8]) -> StoreResult<Vec<(f64, u64)>> {
    let damaged = || StoreError::Damaged { what: "overrides of a cycle".to_owned() };
    let Some((&VERSION, frame)) = block.split_first() else { return Err(damaged()) };
    let plain = zstd::bulk::decompress(frame, 8 + MOST_SAMPLES * 20).map_err(|_| damaged())?;
    let mut rest = plain.as_slice();
    let mut take = |n: usize| -> StoreResult<&[u8]> {
        let (head, tail) = rest.split_at_checked(n).ok_or_else(damaged)?;
        rest = tail;
        Ok(head)
    };
    let four = |bytes: &[u8]| bytes.try_into().map(u32::from_le_bytes).map_err(|_| damaged());
    let eight = |bytes: &[u8]| bytes.try_into().map(u64::from_le_bytes).map_err(|_| damaged());
    let count = four(take(4)?)? as usize;
    if count > MOST_SAMPLES {
        return Err(damaged());
    }
    let mut samples = Vec::new();
    for bytes in take(8 * count)?.chunks_exact(8) {
        samples.push((f64::from_bits(eight(bytes)?), 0));
    }
    let runs = four(take(4)?)?;
    let mut at = 0;
    for _ in 0..runs {
        let (length, reasons) = (four(take(4)?)? as usize, eight(take(8)?)?);
        let run = samples.get_mut(at..at + length).ok_or_else(damaged)?;
        run.iter_mut().for_each(|sample| sample.1 = reasons);
        at += length;
    }
    if at == count && rest.is_empty() { Ok(samples) } else { Err(damaged()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn overrides_come_back_and_damage_is_told(
            samples in proptest::collection::vec((5.0..200.0_f64, 0..4_u64), 0..200), cut in 0..50_usize,
        ) {
            let block = encode_overrides(&samples).unwrap();
            prop_assert_eq!(decode_overrides(&block).unwrap(), samples);
            prop_assert!(decode_overrides(&block[..cut.min(block.len() - 1)]).is_err());
        }
    }
}
