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
//! blake3 over the following, integers little-endian, `text` = length as u32 and then UTF-8, `float` = its bits as u64,
//! `option` = 0 or 1 followed by the value:
//!
//! ```text
//! "feedwright cycle content v1\n"
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
//! column: u8 form, then per value i64 m (forms 0..=9) or u64 bits (form 255)
//! ```
//!
//! # Block format v1
//!
//! ```text
//! "FB"  u8 version = 1
//! varint samples per column       1 ..= the reader's limit
//! u8 number of blocks             1 ..= 17
//! u8 0, f64 bits of the period    or  u8 1: the first block holds the times
//! per block, times first, then channels in ascending code:
//!   u8 channel code (0: times)
//!   u8 form | 0x80 where the payload is a zstd frame; form 0..=9 or 15 for exact bits
//!   varint plain length           varint stored length, where compressed
//!   payload
//! u64 first eight bytes of blake3 over everything before
//! ```
//!
//! The plain payload of forms 0..=9 is a varint each: zig-zag of the first `m`, then of each difference to the one
//! before. Of form 15 it is the bits, byte plane by byte plane: all lowest bytes first. Varints are LEB128.
//! A payload is compressed (zstd level 1) only where that makes it shorter.

mod column;
mod frame;
mod hash;
mod overrides;

pub use frame::{decode_samples, encode_samples};
pub use hash::content_hash;
pub use overrides::{decode_overrides, encode_overrides};

use crate::record::EncodedCycle;
use feedwright_core::cycle::Cycle;

/// Makes the content hash and the sample blocks of a cycle.
pub fn encode(cycle: &Cycle) -> EncodedCycle {
    let samples = cycle.samples.as_ref();
    let columns = samples.map(column::Columns::of);
    EncodedCycle {
        hash: hash::of_parts(cycle, columns.as_ref()),
        samples: columns.as_ref().map(frame::encode_columns),
    }
}
