//! The stored form of a cycle's digest over depth: each of its columns by how it changes from millimetre to millimetre.
//!
//! ```text
//! u8 format: 3, or 4 with a breakthrough     u8 bins, 1 ..= 64
//! way, time, energy of the first bin, each a zig-zag varint
//! format 4: varint depth of the breakthrough, µm
//! where there is a second bin: u8 bits of a usual residual for each of the three, and then in one stream of bits the
//! ways, the times and the energies of the others, each by how much it is more than the one before, zig-zag, as Rice
//! codes (see `rice.rs`)
//! ```
//!
//! A digest whose numbers jump is stored as it gives itself, in formats 1 and 2, whichever is shorter.

use super::input::{Input, put_varint};
use super::predict::{unzigzag, zigzag};
use super::rice::{self, BitReader, BitWriter, Parameter};
use feedwright_core::summary::{DepthDigest, MOST_DIGEST_BINS};

/// Without and with a breakthrough. Those below are the digest's own.
const FORMATS: [u8; 2] = [3, 4];

/// The stored form.
pub(crate) fn pack(digest: &DepthDigest) -> Vec<u8> {
    let plain = digest.to_bytes();
    let packed = packed(digest);
    if packed.len() < plain.len() { packed } else { plain }
}

fn packed(digest: &DepthDigest) -> Vec<u8> {
    let bins: Vec<[i64; 3]> = digest.bins().collect();
    let mut out = Vec::with_capacity(16 + 5 * bins.len());
    out.push(FORMATS[usize::from(digest.breakthrough_um().is_some())]);
    out.push(u8::try_from(bins.len()).unwrap_or(u8::MAX));
    for first in bins.iter().take(1).flatten() {
        put_varint(&mut out, zigzag(*first));
    }
    if let Some(depth) = digest.breakthrough_um() {
        put_varint(&mut out, u64::from(depth));
    }
    if bins.len() < 2 {
        return out;
    }
    let residuals = [0, 1, 2].map(|column| {
        let changes = bins.windows(2).map(|pair| zigzag(pair[1][column].wrapping_sub(pair[0][column])));
        changes.collect::<Vec<u64>>()
    });
    let bits = residuals.each_ref().map(|column| rice::usual_bits(column));
    out.extend(bits);
    let mut writer = BitWriter::after(out);
    for (column, bits) in residuals.iter().zip(bits) {
        writer.residuals(column, Parameter::new(bits));
    }
    writer.finish()
}

/// The digest of a stored form; `None` where it is damaged.
pub(crate) fn unpack(bytes: &[u8]) -> Option<DepthDigest> {
    match bytes.first().and_then(|format| FORMATS.iter().position(|known| known == format)) {
        Some(opens) => unpacked(&bytes[1..], opens == 1),
        None => DepthDigest::from_bytes(bytes),
    }
}

fn unpacked(bytes: &[u8], opens: bool) -> Option<DepthDigest> {
    let mut input = Input(bytes);
    let count = usize::from(input.byte().ok()?);
    if count == 0 || count > MOST_DIGEST_BINS {
        return None;
    }
    let mut first = [0; 3];
    for number in &mut first {
        *number = unzigzag(input.varint().ok()?);
    }
    let breakthrough = if opens { Some(u32::try_from(input.varint().ok()?).ok()?) } else { None };
    let mut bins = vec![first; count];
    if count == 1 {
        return input.0.is_empty().then(|| DepthDigest::of_bins(&bins, breakthrough))?;
    }
    let mut parameters = [Parameter::new(1); 3];
    for parameter in &mut parameters {
        *parameter = Parameter::of(input.byte().ok()?)?;
    }
    let mut reader = BitReader::new(input.0);
    for (column, mut parameter) in parameters.into_iter().enumerate() {
        for at in 1..count {
            let change = unzigzag(reader.rice(&mut parameter)?);
            bins[at][column] = bins[at - 1][column].wrapping_add(change);
        }
    }
    reader.is_at_end().then(|| DepthDigest::of_bins(&bins, breakthrough))?
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn bin() -> impl Strategy<Value = [i64; 3]> {
        prop_oneof![
            (900_i64..1_100, 10_000_i64..30_000, 0_i64..900_000)
                .prop_map(|(way, time, energy)| [way, time, energy]),
            (0_i64..1 << 32, 0_i64..1 << 32, any::<i64>())
                .prop_map(|(way, time, energy)| [way, time, energy]),
        ]
    }

    #[test]
    fn the_bytes_are_fixed_for_ever() {
        let digest = DepthDigest::of_bins(
            &[[998, 17_032, 18_446], [1000, 16_900, -40], [1000, 16_912, 0]],
            Some(2_150),
        );
        let digest = digest.unwrap();
        let bytes =
            [4, 3, 204, 15, 144, 138, 2, 156, 160, 2, 230, 16, 2, 8, 15, 195, 7, 24, 200, 53, 128, 80];
        assert_eq!(packed(&digest), bytes);
        assert_eq!(unpack(&bytes), Some(digest.clone()));
        // As it was stored before, and is where that is shorter.
        assert_eq!(unpack(&digest.to_bytes()), Some(digest));
    }

    #[test]
    fn one_that_is_usual_is_much_shorter() {
        let bins: Vec<_> =
            (0..17).map(|mm: i64| [1000, 17_000 + 40 * mm, 400_000 + 3_000 * mm * (17 - mm)]).collect();
        let digest = DepthDigest::of_bins(&bins, Some(1_800)).unwrap();
        assert!(pack(&digest).len() * 3 < digest.to_bytes().len() * 2, "{}", pack(&digest).len());
    }

    proptest! {
        #[test]
        fn what_is_stored_comes_back_and_is_never_longer(
            bins in prop::collection::vec(bin(), 1..=64),
            opened in prop::option::of(any::<u32>()),
            cut in any::<prop::sample::Index>(),
        ) {
            let digest = DepthDigest::of_bins(&bins, opened).unwrap();
            let bytes = pack(&digest);
            prop_assert!(bytes.len() <= digest.to_bytes().len());
            prop_assert_eq!(unpack(&bytes), Some(digest.clone()));
            let bytes = packed(&digest);
            prop_assert_eq!(unpack(&bytes), Some(digest));
            prop_assert_eq!(unpack(&bytes[..cut.index(bytes.len())]), None);
            prop_assert_eq!(unpack(&[bytes.as_slice(), &[0]].concat()), None);
        }

        #[test]
        fn any_bytes_are_a_digest_or_none(
            format in 0_u8..6,
            bytes in prop::collection::vec(any::<u8>(), 0..200),
        ) {
            let bytes = [&[format], bytes.as_slice()].concat();
            if let Some(digest) = unpack(&bytes) {
                prop_assert_eq!(unpack(&pack(&digest)), Some(digest));
            }
        }
    }
}
