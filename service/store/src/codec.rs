//! Content hash and sample blocks of a cycle, byte by byte. JSON, SQL and compaction do not belong here.
//!
//! # Canonical column
//!
//! The form of a column of finite `f64` is the smallest scale `s` in 0..=9 for which every value `v` is a decimal of
//! `s` places: with `m = round(v × 10^s)` (IEEE product, ties away from zero), |m| < 2^53 and `m as f64 / 10^s` has the
//! very bits of `v`. Where there is no such scale the form is 255 and the column is its exact bits. The form follows
//! from the values alone, so resolution, text and compression of an upload cannot change it.
//!
//! # Content hash
//!
//! blake3 over the following, integers little-endian, `text` = length as u32 and then UTF-8, `float` = its bits as u64 (those of 0 for −0),
//! `option` = 0 or 1 followed by the value:
//!
//! ```text
//! "feedwright cycle content v3\n"
//! text machine   text cycle   text tool   text operation
//! i64 started_at µs           option u64 seq
//! option text process         option text strategy          option text law version
//! option (text profile, u32 version)                        option text recommendation
//! option float spindle speed  text outcome
//! 8 × option float            what the control reports, in the order of the struct
//! option samples:
//!   u8 0, float period ms     or  u8 1, column of times
//!   u32 samples per column    u16 channels, and per channel in ascending code: u8 code, column
//! where anything of a cut is reported:
//!   text "cut"                5 × option float, in the order of the struct
//! where its machine says whether it is a reference cycle:
//!   text "reference"          u8 0 or 1
//! column:
//!   u8 form 0..=9, u8 width, per value m as a signed integer of that width: the first of 2, 4 and 8 bytes that holds each
//!   u8 form 255, per value u64 bits
//! of 1,025 to 8,192 bytes: zeros, up to the next power of two
//! ```
//!
//! Version 2 begins with `v2` and has no zeros; version 1 begins with `v1`, and has no zeros and no width: per value i64 m. What was
//! stored under them keeps them; the same content again is known by any.
//!
//! # Block format v6
//!
//! ```text
//! "FB"  u8 version = 6
//! varint samples per column       1 ..= the reader's limit
//! u8 number of blocks             1 ..= 17
//! u8 0, f64 bits of the period    or  u8 1: the first block holds the times
//! per block, times first, then channels in ascending code:
//!   u8 channel code (0: times)
//!   u8 form
//!   form 0..=9:     u8 predictor | law, or memory | guide | law; with a guide u8 which, and where it has one its factor as a
//!                   zig-zag varint (LEB128); the first m as a zig-zag varint, and with a law u8 level of the first mean
//!   form 15:        varint length, the bits byte plane by byte plane: all lowest bytes first
//!   form 15 | 0x80: varint plain length, varint stored length, the same as a zstd frame
//! where any block has a law:
//!   residuals of those that have one, block by block, see `ans.rs` and `noise.rs`
//! u64 first eight bytes of blake3 over everything before
//! ```
//!
//! A residual is how far each `m` after the first is off its prediction:
//!
//! * predictors, over the values before, `a` the newest; until enough of them are there it is `a`: 0: `a` · 1: `2a − b` ·
//!   2: `(a + b) >> 1` · 3: `(3(a + b) − (c + d)) >> 2` · the line of least squares through the last N values, rounded
//!   down after adding half, with S their sum and J the sum of each times its place, 1 being the newest: 4 (N = 8):
//!   `(17 S − 3 J) / 28` · 5 (N = 16): `(11 S − J) / 40`
//! * laws: 0x00: every residual is 0 · 0x10: normal · 0x20: Laplace.
//!
//! With a guide, 0x08, the three bits below are a memory M, 0 to 7, in place of a predictor, and the prediction is what other
//! columns say of the value. Residuals of columns that have none stand first, then that of the actual feed, then the others,
//! each in the order of the blocks. With `g` what is said of `m` in 1/2^16, `e = 2^16 m − g`, and integers modulo 2^64, the prediction is
//! `(g + o + 2^15) >> 16`; `o` is the first `e`, and becomes `o + ((e − o) >> M)` with each value, where the n-th value after the first takes
//! ⌊log2(n + 1)⌋ for M as long as that is less. With P and O the integers of programmed feed and override at the same place,
//! s_P and s_O their forms, `g` is
//!
//! * of an actual feed of form s, guide 0: the lowest 64 bits of `(p f) >> 32`, p being `P O` modulo 2^64, signed, p f not modulo 2^64, and f 2^48 · 10^x to the nearest
//!   integer for x = s − s_P − s_O − 2, −9 ≤ x ≤ 3
//! * of a depth, guide 0 (of P O) or 3 (of the integers of the actual feed), with a factor f: `(f · sum) >> 8`, the sum being that of all
//!   those integers up to here but the first
//! * of another column, with a factor f: `f m`, m being the integer of the column that has the guide for its code, which may be any
//!   before it in: torque, torque of the spindle's motor, spindle power, spindle current, spindle load; or in: thrust, torque of the feed
//!   drive's motor, feed-drive power, feed-drive current, feed-drive load.
//!
//! # Block format v5
//!
//! It is still read. It differs from version 6 in its version, and in how the mean of residuals follows them, see `noise.rs`.
//!
//! # Block format v4
//!
//! It is still read. It differs from version 5 in its version, and in that no column has a guide.
//!
//! # Block format v3
//!
//! It is still read. It differs from version 4 in its version and in form 0..=9, which was a varint length and, of that length, `u8 predictor |
//! coder`, the first `m`, for the Rice coder `u8` bits of a usual residual, and the residuals, zig-zag:
//!
//! * coder 0x00, Rice: with parameter `k` the quotient by 2^k as ones and a zero, then `k` bits; 24 ones are followed by
//!   64 bits. `k` is the bit length of 3/4 of the running mean, see `rice.rs`. Bits fill bytes from the top.
//! * coder 0x10, an adaptive binary range coder, see `range.rs`, taken where a mean residual was no more than 1.25.
//!
//! # Block format v2
//!
//! It is still read. It differs from version 3 in its version, and in that it has predictors 0 to 3 only.
//!
//! # Block format v1
//!
//! It is still read. It differs in its version and in form 0..=9, which was like form 15, with 0x80 for zstd, over a
//! zig-zag varint of the first `m` and of each difference to the one before.

mod ans;
mod column;
pub(crate) mod digest;
mod frame;
mod guide;
mod habit;
mod hash;
pub(crate) mod input;
mod noise;
mod overrides;
pub(crate) mod pack;
mod predict;
pub(crate) mod ran;
mod range;
mod rice;
mod squeeze;
pub(crate) mod state;
pub(crate) mod zeros;

pub(crate) use column::extend_decimals;
pub use column::{Column, Columns, Places, Time};
#[cfg(test)]
pub(crate) use frame::tests::cycle as cycle_of_every_field;
pub use frame::{decode_columns, decode_samples, encode_samples};
pub use habit::Habits;
pub use hash::{content_hash, is_hash_of};
pub use overrides::{decode_overrides, encode_overrides};
pub(crate) use predict::unzigzag;

use crate::record::EncodedCycle;
use feedwright_core::cycle::Cycle;

/// The first bytes of blake3 over some: what shows that they were damaged.
fn checksum<const N: usize>(bytes: &[u8]) -> [u8; N] {
    let mut first = [0; N];
    first.copy_from_slice(&blake3::hash(bytes).as_bytes()[..N]);
    first
}

/// The smallest scale at which all values are decimals, with their integers; `None` where there is none.
pub(crate) fn canonical_column(values: &[f64]) -> Option<(u8, Vec<i64>)> {
    match column::Column::of(values, None) {
        column::Column::Decimal { scale, values } => Some((scale, values)),
        column::Column::Exact(_) => None,
    }
}

/// Makes the content hash and the sample blocks of a cycle. Of many cycles [`Habits::encode`] takes less time.
pub fn encode(cycle: &Cycle) -> EncodedCycle {
    let samples = cycle.samples.as_ref();
    let columns = samples.map(column::Columns::of);
    EncodedCycle {
        hash: hash::of_parts(cycle, columns.as_ref()),
        samples: columns.as_ref().map(frame::encode_columns),
    }
}
