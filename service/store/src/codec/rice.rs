//! Rice codes whose parameter follows the residuals (Rice and Plaunt, 1971; adapted backwards as in LOCO-I, Weinberger
//! et al., 2000): no table, some nanoseconds a value, within a tenth of a bit of noise's entropy.

use super::predict::{Residuals, unzigzag};

/// A quotient of so many ones is no quotient: 64 plain bits follow.
const ESCAPE: u32 = 24;
/// The mean is kept in 1/2^4.
const MEMORY: u32 = 4;

/// Most bits that a block may call usual.
const MOST_BITS: u8 = 58;

/// What a residual counts at the most, an escape's 64 bits for one, so that the sum stays below 2^63.
const MOST_COUNTED: u64 = 1 << 58;

/// The parameter for the next residual, from those before.
#[derive(Debug, Clone, Copy)]
pub(super) struct Parameter {
    sum: u64,
}

impl Parameter {
    /// From the bits of a usual residual, 1 to [`MOST_BITS`].
    pub(super) const fn new(bits: u8) -> Self {
        Self { sum: 1 << (bits as u32 + MEMORY - 1) }
    }

    /// As [`Parameter::new`], where a block says so.
    pub(super) fn of(bits: u8) -> Option<Self> {
        (1..=MOST_BITS).contains(&bits).then(|| Self::new(bits))
    }

    const fn get(self) -> u32 {
        // Three quarters of the mean: between its median and its mean, noise wants its half.
        let wanted = (self.sum - (self.sum >> 2)) >> MEMORY;
        u64::BITS - wanted.leading_zeros()
    }

    /// `residual` is no more than [`MOST_COUNTED`].
    const fn follow(&mut self, residual: u64) {
        self.sum = self.sum - (self.sum >> MEMORY) + residual;
    }

    fn follow_any(&mut self, residual: u64) {
        self.follow(residual.min(MOST_COUNTED));
    }
}

/// Bits of a usual residual: what [`Parameter::new`] takes.
pub(super) fn usual_bits(residuals: &[u64]) -> u8 {
    let sum = residuals.iter().take(32).fold(0_u64, |sum, &residual| sum.saturating_add(residual));
    let mean = sum / (residuals.len().clamp(1, 32) as u64);
    u8::try_from(u64::BITS - mean.leading_zeros()).unwrap_or(MOST_BITS).clamp(1, MOST_BITS)
}

/// Residuals that are written before room is made for more.
const AT_ONCE: usize = 32;
/// Bytes that so many take at the most, [`ESCAPE`] and 64 bits each, and those that [`BitWriter::put`] writes besides.
const ROOM: usize = AT_ONCE * 11 + 8;

/// Bits, the first one highest in its byte.
pub(super) struct BitWriter {
    out: Vec<u8>,
    end: End,
}

/// The end of what is written. By value wherever a function is called, so that it can stay in registers.
#[derive(Clone, Copy)]
struct End {
    /// Where the next byte goes.
    at: usize,
    /// The bits of that byte so far, the first one highest, and nothing below them.
    waiting: u64,
    /// How many they are, fewer than 8.
    count: u32,
}

impl BitWriter {
    pub(super) const fn after(out: Vec<u8>) -> Self {
        Self { end: End { at: out.len(), waiting: 0, count: 0 }, out }
    }

    /// Appends residuals, `parameter` being that of the first.
    pub(super) fn residuals(&mut self, residuals: &[u64], mut parameter: Parameter) {
        let mut end = self.end;
        for residuals in residuals.chunks(AT_ONCE) {
            self.out.resize(end.at + ROOM, 0);
            let room = self.out.as_mut_slice();
            residuals.iter().for_each(|&residual| end.rice(room, residual, &mut parameter));
        }
        self.end = end;
    }

    /// The last byte is filled up with zeros.
    pub(super) fn finish(mut self) -> Vec<u8> {
        self.out.truncate(self.end.at + usize::from(self.end.count > 0));
        self.out
    }
}

impl End {
    /// 1 to 56 bits, which `value` does not exceed. All that waits is written each time, and once more with what comes
    /// next where it ends within a byte: that needs no branch, and how long codes are could not be foretold.
    #[inline]
    fn put(&mut self, room: &mut [u8], value: u64, bits: u32) {
        self.waiting |= value << (u64::BITS - self.count - bits);
        if let Some(room) = room.get_mut(self.at..).and_then(|rest| rest.first_chunk_mut()) {
            *room = self.waiting.to_be_bytes();
        }
        self.count += bits;
        self.at += (self.count / 8) as usize;
        self.waiting <<= self.count & !7;
        self.count %= 8;
    }

    /// The lowest `bits` of `value`, 33 to 64.
    fn put_long(&mut self, room: &mut [u8], value: u64, bits: u32) {
        self.put(room, value >> 32 & ((1 << (bits - 32)) - 1), bits - 32);
        self.put(room, value & 0xffff_ffff, 32);
    }

    #[inline]
    fn rice(&mut self, room: &mut [u8], residual: u64, parameter: &mut Parameter) {
        let k = parameter.get();
        let quotient = residual >> k;
        if quotient < u64::from(ESCAPE) && k <= 32 {
            // Ones and a zero, and below them what the quotient leaves: `residual` has the quotient above its `k` bits,
            // which is taken from the ones.
            let ones = (2 << quotient) - 2;
            let bits = u32::try_from(quotient).unwrap_or(ESCAPE) + 1;
            self.put(room, ((ones - quotient) << k) + residual, bits + k);
            parameter.follow(residual);
        } else {
            *self = self.after_long(room, residual, k);
            parameter.follow_any(residual);
        }
    }

    /// What is more than 56 bits, or nearly.
    #[cold]
    #[inline(never)]
    fn after_long(mut self, room: &mut [u8], residual: u64, k: u32) -> Self {
        let quotient = residual >> k;
        if quotient < u64::from(ESCAPE) {
            self.put(room, (2 << quotient) - 2, u32::try_from(quotient).unwrap_or(ESCAPE) + 1);
            self.put_long(room, residual, k);
        } else {
            self.put(room, (1 << ESCAPE) - 1, ESCAPE);
            self.put_long(room, residual, 64);
        }
        self
    }
}

/// Reads what [`BitWriter`] wrote; `None` beyond the end. By value where what is unusual is called, so that it can stay in
/// registers.
#[derive(Clone, Copy)]
pub(super) struct BitReader<'a> {
    bytes: &'a [u8],
    /// Of the next byte that is not among the bits.
    at: usize,
    /// Bits not used yet, the next one highest.
    bits: u64,
    count: u32,
}

impl<'a> BitReader<'a> {
    pub(super) const fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0, bits: 0, count: 0 }
    }

    /// To 56 bits at least, as long as there are as many.
    #[inline(always)]
    fn fill(&mut self) {
        if let Some(next) = self.bytes.get(self.at..).and_then(|rest| rest.first_chunk())
            && self.count < u64::BITS
        {
            // Bits beyond the whole bytes that are counted are those that come next: once they are counted, they stand
            // there already.
            self.bits |= u64::from_be_bytes(*next) >> self.count;
            self.at += ((63 - self.count) / 8) as usize;
            self.count |= 56;
        } else {
            *self = self.filled_from_few();
        }
    }

    #[cold]
    #[inline(never)]
    fn filled_from_few(mut self) -> Self {
        while self.count <= 56
            && let Some(&byte) = self.bytes.get(self.at)
        {
            self.bits |= u64::from(byte) << (56 - self.count);
            self.count += 8;
            self.at += 1;
        }
        self
    }

    /// At most 32 bits.
    fn take(&mut self, bits: u32) -> Option<u64> {
        if bits == 0 {
            return Some(0);
        }
        self.fill();
        if self.count < bits {
            return None;
        }
        let value = self.bits >> (64 - bits);
        self.bits <<= bits;
        self.count -= bits;
        Some(value)
    }

    fn take_long(&mut self, bits: u32) -> Option<u64> {
        if bits > 32 { Some(self.take(bits - 32)? << 32 | self.take(32)?) } else { self.take(bits) }
    }

    /// The next residual, zig-zag. Inlined, as is what it calls: through memory its state would take longer than all else.
    #[inline(always)]
    pub(super) fn rice(&mut self, parameter: &mut Parameter) -> Option<u64> {
        self.fill();
        let k = parameter.get();
        let ones = self.bits.leading_ones();
        let used = ones + 1 + k;
        if ones < ESCAPE && used <= self.count.min(56) {
            // In two steps: there may be no bits to take.
            let low = (self.bits << (ones + 1)) >> 1 >> (63 - k);
            let residual = u64::from(ones) << k | low;
            self.bits <<= used;
            self.count -= used;
            parameter.follow(residual);
            Some(residual)
        } else {
            let residual;
            (*self, residual) = self.after_long(ones, k)?;
            parameter.follow_any(residual);
            Some(residual)
        }
    }

    /// What is more than 56 bits, or the last ones.
    #[cold]
    #[inline(never)]
    fn after_long(mut self, ones: u32, k: u32) -> Option<(Self, u64)> {
        let residual = if ones < ESCAPE {
            self.take(ones + 1)?;
            u64::from(ones) << k | self.take_long(k)?
        } else {
            self.take(ESCAPE)?;
            self.take_long(64)?
        };
        Some((self, residual))
    }

    /// Whether nothing but the last byte's padding is left.
    pub(super) const fn is_at_end(&self) -> bool {
        self.at >= self.bytes.len() && self.count < 8 && self.bits == 0
    }
}

/// Reads the residuals of one column.
pub(super) struct RiceReader<'a> {
    bits: BitReader<'a>,
    parameter: Parameter,
}

impl<'a> RiceReader<'a> {
    /// `None` where no block calls so many bits usual.
    pub(super) fn of(usual_bits: u8, bytes: &'a [u8]) -> Option<Self> {
        Some(Self { bits: BitReader::new(bytes), parameter: Parameter::of(usual_bits)? })
    }

    pub(super) const fn is_at_end(&self) -> bool {
        self.bits.is_at_end()
    }
}

impl Residuals for RiceReader<'_> {
    #[inline(always)]
    fn next(&mut self) -> Option<i64> {
        self.bits.rice(&mut self.parameter).map(unzigzag)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn bits(value: u64, count: u32) -> impl Iterator<Item = bool> {
        (0..count).rev().map(move |place| value >> place & 1 == 1)
    }

    /// The code of each residual bit by bit, filled up to whole bytes.
    fn plain(residuals: &[u64], mut parameter: Parameter) -> Vec<u8> {
        let mut code = Vec::new();
        for &residual in residuals {
            let k = parameter.get();
            let quotient = residual >> k;
            if quotient < u64::from(ESCAPE) {
                code.extend((0..quotient).map(|_| true).chain([false]).chain(bits(residual, k)));
            } else {
                code.extend((0..ESCAPE).map(|_| true).chain(bits(residual, 64)));
            }
            parameter.follow_any(residual);
        }
        let byte =
            |bits: &[bool]| (0..).zip(bits).fold(0, |byte, (at, &bit)| byte | u8::from(bit) << (7 - at));
        code.chunks(8).map(byte).collect()
    }

    fn residuals() -> impl Strategy<Value = Vec<u64>> {
        let run = (0_u32..=64, prop::collection::vec(any::<u64>(), 1..40));
        let of_some_bits = |(bits, run): (u32, Vec<u64>)| {
            run.into_iter().map(move |residual| residual.checked_shr(64 - bits).unwrap_or(0))
        };
        prop::collection::vec(run, 0..6)
            .prop_map(move |runs| runs.into_iter().flat_map(of_some_bits).collect())
    }

    proptest! {
        #[test]
        fn what_is_written_is_as_bit_by_bit_and_comes_back(
            residuals in residuals(),
            usual in 1..=MOST_BITS,
            cut in any::<prop::sample::Index>(),
        ) {
            let mut writer = BitWriter::after(vec![7]);
            writer.residuals(&residuals, Parameter::new(usual));
            let written = writer.finish();
            prop_assert_eq!(written[0], 7);
            prop_assert_eq!(&written[1..], plain(&residuals, Parameter::new(usual)));
            let mut reader = RiceReader::of(usual, &written[1..]).unwrap();
            prop_assert!(residuals.iter().all(|&residual| reader.next() == Some(unzigzag(residual))));
            prop_assert!(reader.is_at_end());
            let mut reader = RiceReader::of(usual, &written[1..][..cut.index(written.len())]).unwrap();
            let whole = residuals.iter().all(|_| reader.next().is_some());
            prop_assert_eq!(whole, cut.index(written.len()) + 1 == written.len());
        }
    }
}
