//! An adaptive binary range coder (Martin, 1979; carries as in LZMA) over the bits of residuals: block formats 2 and 3 had it for
//! columns whose values hardly surprise (an override, a programmed feed, an integrated depth). It is only read.

use super::predict::{Residuals, unzigzag};
use std::hint::select_unpredictable;

/// Probabilities are in 1/2^12.
const SCALE: u32 = 12;
/// A probability moves by 1/2^4 of what it was off.
const RATE: u32 = 4;
/// Below, the range is widened by a byte.
const TOP: u32 = 1 << 24;

/// How likely a bit is 0, learnt from those before.
#[derive(Debug, Clone, Copy)]
struct Bit(u16);

impl Bit {
    const EVEN: Self = Self(1 << (SCALE - 1));

    /// After a 1. Both stay within 15 ..= 4081 by their arithmetic.
    const fn less(self) -> u16 {
        self.0 - (self.0 >> RATE)
    }

    /// After a 0.
    const fn more(self) -> u16 {
        self.0 + (((1 << SCALE) - self.0) >> RATE)
    }

    fn follow(&mut self, one: bool) {
        self.0 = select_unpredictable(one, self.less(), self.more());
    }
}

/// Sizes that are told apart by what came before.
const SIZES: usize = 8;
/// Longest residual, bits.
const LONGEST: usize = 64;

/// What is known of the bits of residuals.
struct Bits {
    zero: [[Bit; 2]; SIZES],
    length: [[Bit; LONGEST]; SIZES],
    /// Zig-zag: the lowest bit is the sign, told by the sign before.
    sign: [Bit; 3],
    high: [[Bit; 4]; LONGEST],
}

/// What is known of the next residual. The bits stand elsewhere, so that the rest can stay in registers.
struct Model {
    bits: Box<Bits>,
    size: u64,
    /// 0 for none, 1 for up, 2 for down.
    last: usize,
}

/// Codes one bit, either way. All of it is inlined for each predictor, or its state would go through memory at every value.
trait Coder {
    /// The bit as it was, which a writer is told and a reader finds. With a branch, for what decides what comes next: the
    /// branch is taken anyhow, and what is foretold does not wait.
    fn code(&mut self, bit: &mut Bit, one: bool) -> bool;
    /// The same without a branch, for what nothing depends on.
    fn code_unpredictable(&mut self, bit: &mut Bit, one: bool) -> bool;
    /// The lowest `count` bits of `value`, each as likely 0 as 1.
    fn plain(&mut self, value: u64, count: u32) -> u64;
}

impl Model {
    fn new() -> Self {
        let bits = Bits {
            zero: [[Bit::EVEN; 2]; SIZES],
            length: [[Bit::EVEN; LONGEST]; SIZES],
            sign: [Bit::EVEN; 3],
            high: [[Bit::EVEN; 4]; LONGEST],
        };
        Self { bits: Box::new(bits), size: 8, last: 0 }
    }

    /// Codes a residual, zig-zag: whether it is 0, and if not the rest of it. Only what a reader finds may be none.
    #[inline(always)]
    fn residual(&mut self, coder: &mut impl Coder, residual: u64) -> Option<u64> {
        let context = ((u64::BITS - (self.size >> 2).leading_zeros()) as usize).min(SIZES - 1);
        self.size -= self.size >> 3;
        if !coder.code(&mut self.bits.zero[context][self.last.min(1)], residual != 0) {
            self.last = 0;
            return Some(0);
        }
        let down = coder.code_unpredictable(&mut self.bits.sign[self.last], residual & 1 == 1);
        self.last = 1 + usize::from(down);
        let magnitude = self.magnitude(coder, context, residual.div_ceil(2))?;
        self.size = self.size.saturating_add(magnitude.min(1 << 56));
        // Zig-zag again: 2m for up, 2m − 1 for down.
        Some(magnitude.wrapping_mul(2).wrapping_sub(u64::from(down)))
    }

    /// Codes a size other than 0: its length in unary; the two bits below the highest; the rest plain.
    #[inline(always)]
    fn magnitude(&mut self, coder: &mut impl Coder, context: usize, magnitude: u64) -> Option<u64> {
        let wanted = magnitude.max(1).ilog2();
        let mut length = 0;
        while coder.code(self.bits.length[context].get_mut(length as usize)?, length < wanted) {
            length += 1;
        }
        let high = self.bits.high.get_mut(length as usize)?;
        let (mut value, mut rest, mut place) = (1, length, 1);
        while rest > 0 && length - rest < 2 {
            rest -= 1;
            let bit = coder.code_unpredictable(&mut high[place & 3], magnitude >> rest & 1 == 1);
            place = place * 2 + usize::from(bit);
            value = value << 1 | u64::from(bit);
        }
        if rest > 0 {
            value = value << rest | coder.plain(magnitude & ((1 << rest) - 1), rest);
        }
        Some(value)
    }
}

struct Reading<'a> {
    rest: &'a [u8],
    code: u32,
    range: u32,
}

impl<'a> Reading<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        let mut coder = Reading { rest: bytes, code: 0, range: u32::MAX };
        for _ in 0..4 {
            coder.code = coder.code << 8 | u32::from(coder.byte());
        }
        coder
    }

    /// The next byte: zeros beyond the end, as many as are asked for. A column that never surprises is nothing but zeros,
    /// all of them left out; how many values it has is told elsewhere.
    fn byte(&mut self) -> u8 {
        let Some((&byte, rest)) = self.rest.split_first() else { return 0 };
        self.rest = rest;
        byte
    }

    fn widen(&mut self) {
        while self.range < TOP {
            self.range <<= 8;
            self.code = self.code << 8 | u32::from(self.byte());
        }
    }
}

impl Coder for Reading<'_> {
    fn code(&mut self, bit: &mut Bit, _: bool) -> bool {
        let bound = (self.range >> SCALE) * u32::from(bit.0);
        if self.code >= bound {
            self.code -= bound;
            self.range -= bound;
            bit.0 = bit.less();
            self.widen();
            true
        } else {
            self.range = bound;
            bit.0 = bit.more();
            self.widen();
            false
        }
    }

    #[inline(always)]
    fn code_unpredictable(&mut self, bit: &mut Bit, _: bool) -> bool {
        let bound = (self.range >> SCALE) * u32::from(bit.0);
        let one = self.code >= bound;
        self.code -= select_unpredictable(one, bound, 0);
        self.range = select_unpredictable(one, self.range - bound, bound);
        bit.follow(one);
        self.widen();
        one
    }

    fn plain(&mut self, _: u64, count: u32) -> u64 {
        let mut value = 0;
        for _ in 0..count {
            self.range >>= 1;
            let one = self.code >= self.range;
            if one {
                self.code -= self.range;
            }
            value = value << 1 | u64::from(one);
            self.widen();
        }
        value
    }
}

/// Reads residuals.
pub(super) struct RangeReader<'a> {
    coder: Reading<'a>,
    model: Model,
}

impl<'a> RangeReader<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { coder: Reading::new(bytes), model: Model::new() }
    }

    /// Whether every byte was used.
    pub(super) const fn is_at_end(&self) -> bool {
        self.coder.rest.is_empty()
    }
}

/// What a [`RangeReader`] reads where there are no bytes.
pub(super) struct Zeros;

impl Residuals for Zeros {
    fn next(&mut self) -> Option<i64> {
        Some(0)
    }

    fn read(&mut self, residuals: &mut [i64]) -> Option<()> {
        residuals.fill(0);
        Some(())
    }
}

impl Residuals for RangeReader<'_> {
    #[inline(always)]
    fn next(&mut self) -> Option<i64> {
        self.model.residual(&mut self.coder, 0).map(unzigzag)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Writes with the last byte and all the 0xff behind it held back until no carry can reach them.
    struct Plain {
        out: Vec<u8>,
        low: u64,
        range: u32,
        held: Option<u8>,
        full: usize,
    }

    impl Plain {
        fn shift(&mut self) {
            let [.., carry, byte, _, _, _] = self.low.to_be_bytes();
            if carry == 0 && byte == 0xff {
                self.full += 1;
            } else {
                self.out.extend(self.held.map(|held| held + carry));
                self.out.extend(vec![0xff_u8.wrapping_add(carry); self.full]);
                (self.held, self.full) = (Some(byte), 0);
            }
            self.low = (self.low & 0x00ff_ffff) << 8;
        }

        fn cut(&mut self, below: u32, one: bool) {
            if one {
                self.low += u64::from(below);
                self.range -= below;
            } else {
                self.range = below;
            }
            while self.range < TOP {
                self.range <<= 8;
                self.shift();
            }
        }

        /// To the value within the range that has the fewest bytes other than 0.
        fn finish(mut self) -> Vec<u8> {
            let end = self.low + u64::from(self.range) - 1;
            let rounded = (8..=32).rev().step_by(8).map(|bits| end >> bits << bits);
            self.low = rounded.into_iter().find(|&rounded| rounded >= self.low).unwrap_or(self.low);
            (0..5).for_each(|_| self.shift());
            let used = self.out.iter().rposition(|&byte| byte != 0).map_or(0, |at| at + 1);
            self.out.truncate(used);
            self.out
        }
    }

    impl Coder for Plain {
        fn code(&mut self, bit: &mut Bit, one: bool) -> bool {
            self.cut((self.range >> SCALE) * u32::from(bit.0), one);
            bit.follow(one);
            one
        }

        fn code_unpredictable(&mut self, bit: &mut Bit, one: bool) -> bool {
            self.code(bit, one)
        }

        fn plain(&mut self, value: u64, count: u32) -> u64 {
            for place in (0..count).rev() {
                let half = self.range >> 1;
                // Of an odd range one is lost.
                self.range = 2 * half;
                self.cut(half, value >> place & 1 == 1);
            }
            value
        }
    }

    fn residuals() -> impl Strategy<Value = Vec<u64>> {
        // Long runs of what is sure take probabilities to their ends, and what comes then the range.
        let run = (prop_oneof![0_u64..4, 0_u64..300, any::<u64>()], prop_oneof![1_usize..4, 1_usize..200]);
        prop::collection::vec(run, 0..30)
            .prop_map(|runs| runs.into_iter().flat_map(|(residual, count)| vec![residual; count]).collect())
    }

    proptest! {
        #[test]
        fn what_a_plain_coder_wrote_comes_back(residuals in residuals()) {
            let mut plain = Plain { out: Vec::new(), low: 0, range: u32::MAX, held: None, full: 0 };
            let mut model = Model::new();
            for &residual in &residuals {
                prop_assert_eq!(model.residual(&mut plain, residual), Some(residual));
            }
            let written = plain.finish();
            let mut reader = RangeReader::new(&written);
            prop_assert!(residuals.iter().all(|&residual| reader.next() == Some(unzigzag(residual))));
            prop_assert!(reader.is_at_end());
        }
    }

    /// Why who reads may pass the coder by.
    #[test]
    fn zeros_alone_leave_nothing() {
        for len in [0, 1, 2, 8, 500, 3000, 5000, 60_000] {
            let mut reader = RangeReader::new(&[]);
            assert!((0..len).all(|_| reader.next() == Some(0)) && reader.is_at_end());
        }
    }
}
