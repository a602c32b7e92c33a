//! An adaptive binary range coder (Martin, 1979; carries as in LZMA) over the bits of residuals: for columns whose
//! values hardly surprise (an override, a programmed feed, an integrated depth) it needs a fraction of a bit a value,
//! where a Rice code needs one at the least.

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

    const fn follow(&mut self, one: bool) {
        // Stays within 31 ..= 4065 by its arithmetic.
        if one {
            self.0 -= self.0 >> RATE;
        } else {
            self.0 += ((1 << SCALE) - self.0) >> RATE;
        }
    }
}

/// Sizes that are told apart by what came before.
const SIZES: usize = 8;
/// Longest residual, bits.
const LONGEST: usize = 64;

/// What is known of the bits of the next residual.
struct Model {
    zero: [[Bit; 2]; SIZES],
    length: [[Bit; LONGEST]; SIZES],
    /// Zig-zag: the lowest bit is the sign, told by the sign before.
    sign: [Bit; 3],
    high: [[Bit; 4]; LONGEST],
    size: u64,
    /// 0 for none, 1 for up, 2 for down.
    last: usize,
}

/// Codes one bit, either way.
trait Coder {
    /// The bit as it was, which a writer is told and a reader finds.
    fn code(&mut self, bit: &mut Bit, one: bool) -> Option<bool>;
    /// The lowest `count` bits of `value`, each as likely 0 as 1.
    fn plain(&mut self, value: u64, count: u32) -> Option<u64>;
}

impl Model {
    const fn new() -> Self {
        Self {
            zero: [[Bit::EVEN; 2]; SIZES],
            length: [[Bit::EVEN; LONGEST]; SIZES],
            sign: [Bit::EVEN; 3],
            high: [[Bit::EVEN; 4]; LONGEST],
            size: 8,
            last: 0,
        }
    }

    /// Codes a residual, zig-zag: whether it is 0; its sign; the length of its size in unary; the two bits below the
    /// highest; the rest plain.
    fn residual(&mut self, coder: &mut impl Coder, residual: u64) -> Option<u64> {
        let context = ((u64::BITS - (self.size >> 2).leading_zeros()) as usize).min(SIZES - 1);
        let (magnitude, down) = (residual.div_ceil(2), residual & 1 == 1);
        let some = coder.code(&mut self.zero[context][self.last.min(1)], magnitude != 0)?;
        let mut value = 0;
        let mut sign = 0;
        if some {
            let down = coder.code(&mut self.sign[self.last], down)?;
            sign = 1 + usize::from(down);
            let wanted = u64::BITS - magnitude.max(1).leading_zeros() - 1;
            let mut length = 0;
            while coder.code(self.length[context].get_mut(length as usize)?, length < wanted)? {
                length += 1;
            }
            value = 1;
            let mut rest = length;
            let mut place = 1;
            while rest > 0 && length - rest < 2 {
                rest -= 1;
                let bit = coder.code(&mut self.high[length as usize][place], magnitude >> rest & 1 == 1)?;
                place = place * 2 + usize::from(bit);
                value = value << 1 | u64::from(bit);
                place &= 3;
            }
            if rest > 0 {
                value = value << rest | coder.plain(magnitude & ((1 << rest) - 1), rest)?;
            }
        }
        self.size = (self.size - (self.size >> 3)).saturating_add(value.min(1 << 56));
        self.last = sign;
        // Zig-zag again: 2m for up, 2m − 1 for down.
        Some(if sign == 2 { value.wrapping_mul(2).wrapping_sub(1) } else { value.wrapping_mul(2) })
    }
}

struct Writing {
    out: Vec<u8>,
    low: u64,
    range: u32,
    /// The byte that a carry may still change, and how many 0xff follow it.
    held: u8,
    full: u64,
    begun: bool,
}

impl Writing {
    #[expect(clippy::cast_possible_truncation, reason = "byte by byte")]
    fn shift(&mut self) {
        if self.low < 0xff00_0000 || self.low > 0xffff_ffff {
            let carry = (self.low >> 32) as u8;
            if self.begun {
                self.out.push(self.held.wrapping_add(carry));
            }
            self.begun = true;
            for _ in 0..self.full {
                self.out.push(0xff_u8.wrapping_add(carry));
            }
            self.full = 0;
            self.held = (self.low >> 24) as u8;
        } else {
            self.full += 1;
        }
        self.low = (self.low & 0x00ff_ffff) << 8;
    }
}

impl Coder for Writing {
    fn code(&mut self, bit: &mut Bit, one: bool) -> Option<bool> {
        let bound = (self.range >> SCALE) * u32::from(bit.0);
        if one {
            self.low += u64::from(bound);
            self.range -= bound;
        } else {
            self.range = bound;
        }
        bit.follow(one);
        while self.range < TOP {
            self.range <<= 8;
            self.shift();
        }
        Some(one)
    }

    fn plain(&mut self, value: u64, count: u32) -> Option<u64> {
        for place in (0..count).rev() {
            self.range >>= 1;
            if value >> place & 1 == 1 {
                self.low += u64::from(self.range);
            }
            while self.range < TOP {
                self.range <<= 8;
                self.shift();
            }
        }
        Some(value)
    }
}

/// Appends residuals to `out`.
pub(super) fn write(out: Vec<u8>, residuals: &[u64]) -> Vec<u8> {
    // Zeros alone leave nothing but zeros, all of them left out: most columns that come here are constant.
    if residuals.iter().fold(0, |any, residual| any | residual) == 0 { out } else { code(out, residuals) }
}

fn code(out: Vec<u8>, residuals: &[u64]) -> Vec<u8> {
    // What stands there is not this coder's to shorten.
    let begins = out.len();
    // Both live here and nowhere else, so that the loop keeps them in registers.
    let mut coder = Writing { out, low: 0, range: u32::MAX, held: 0, full: 0, begun: false };
    let mut model = Model::new();
    for &residual in residuals {
        // Only what a reader finds may be no residual.
        let _ = model.residual(&mut coder, residual);
    }
    // Any value within the range will do: the one with the fewest bytes that are not 0.
    let end = coder.low + u64::from(coder.range) - 1;
    for bits in (8..=32).rev().step_by(8) {
        let rounded = end >> bits << bits;
        if rounded >= coder.low {
            coder.low = rounded;
            break;
        }
    }
    for _ in 0..5 {
        coder.shift();
    }
    let mut out = coder.out;
    // A reader takes zeros beyond the end.
    while out.len() > begins && out.last() == Some(&0) {
        out.pop();
    }
    out
}

/// Reads residuals.
pub(super) struct RangeReader<'a> {
    coder: Reading<'a>,
    model: Box<Model>,
}

struct Reading<'a> {
    rest: &'a [u8],
    code: u32,
    range: u32,
}

impl<'a> Reading<'a> {
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
    fn code(&mut self, bit: &mut Bit, _: bool) -> Option<bool> {
        let bound = (self.range >> SCALE) * u32::from(bit.0);
        let one = self.code >= bound;
        if one {
            self.code -= bound;
            self.range -= bound;
        } else {
            self.range = bound;
        }
        bit.follow(one);
        self.widen();
        Some(one)
    }

    fn plain(&mut self, _: u64, count: u32) -> Option<u64> {
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
        Some(value)
    }
}

impl<'a> RangeReader<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        let mut coder = Reading { rest: bytes, code: 0, range: u32::MAX };
        for _ in 0..4 {
            coder.code = coder.code << 8 | u32::from(coder.byte());
        }
        Self { coder, model: Box::new(Model::new()) }
    }

    pub(super) fn next(&mut self) -> Option<u64> {
        self.model.residual(&mut self.coder, 0)
    }

    /// Whether every byte was used.
    pub(super) const fn is_at_end(&self) -> bool {
        self.coder.rest.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Why [`write`] and who reads may pass the coder by.
    #[test]
    fn zeros_alone_leave_nothing() {
        for len in [0, 1, 2, 8, 500, 3000, 5000, 60_000] {
            assert_eq!(code(vec![7], &vec![0; len]), [7]);
            let mut reader = RangeReader::new(&[]);
            assert!((0..len).all(|_| reader.next() == Some(0)) && reader.is_at_end());
        }
    }
}
