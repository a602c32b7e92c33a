//! Rice codes whose parameter follows the residuals (Rice and Plaunt, 1971; adapted backwards as in LOCO-I, Weinberger
//! et al., 2000): no table, some nanoseconds a value, within a tenth of a bit of noise's entropy.

/// A quotient of so many ones is no quotient: 64 plain bits follow.
const ESCAPE: u32 = 24;
/// The mean is kept in 1/2^4.
const MEMORY: u32 = 4;

/// Most bits that a block may call usual.
const MOST_BITS: u8 = 58;

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

    const fn follow(&mut self, residual: u64) {
        // Below 2^60 whatever comes: an escape's 64 bits are counted as no more.
        let capped = if residual < 1 << 58 { residual } else { 1 << 58 };
        self.sum = self.sum - (self.sum >> MEMORY) + capped;
    }
}

/// Bits of a usual residual: what [`Parameter::new`] takes.
pub(super) fn usual_bits(residuals: &[u64]) -> u8 {
    let sum = residuals.iter().take(32).fold(0_u64, |sum, &residual| sum.saturating_add(residual));
    let mean = sum / (residuals.len().clamp(1, 32) as u64);
    u8::try_from(u64::BITS - mean.leading_zeros()).unwrap_or(MOST_BITS).clamp(1, MOST_BITS)
}

/// Bits, the first one highest in its byte.
#[derive(Debug, Default)]
pub(super) struct BitWriter {
    out: Vec<u8>,
    waiting: u64,
    count: u32,
}

impl BitWriter {
    pub(super) const fn after(out: Vec<u8>) -> Self {
        Self { out, waiting: 0, count: 0 }
    }

    /// At most 32 bits, which `value` does not exceed. Fewer than 32 wait before and after.
    #[expect(clippy::cast_possible_truncation, reason = "the highest 32 bits of those that wait")]
    fn put(&mut self, value: u64, bits: u32) {
        self.waiting = self.waiting << bits | value;
        self.count += bits;
        if self.count >= 32 {
            self.count -= 32;
            self.out.extend_from_slice(&((self.waiting >> self.count) as u32).to_be_bytes());
        }
    }

    fn put_long(&mut self, value: u64, bits: u32) {
        if bits > 32 {
            self.put(value >> 32 & ((1 << (bits - 32)) - 1), bits - 32);
            self.put(value & 0xffff_ffff, 32);
        } else {
            self.put(value & ((1 << bits) - 1), bits);
        }
    }

    pub(super) fn rice(&mut self, residual: u64, parameter: &mut Parameter) {
        let k = parameter.get();
        let quotient = residual >> k;
        if quotient < u64::from(ESCAPE) {
            // Ones and a zero.
            let ones = (1_u64 << (quotient + 1)) - 2;
            let bits = u32::try_from(quotient).unwrap_or(ESCAPE) + 1;
            if bits + k <= 32 {
                self.put(ones << k | residual & ((1 << k) - 1), bits + k);
            } else {
                self.put(ones, bits);
                self.put_long(residual, k);
            }
        } else {
            self.put((1 << ESCAPE) - 1, ESCAPE);
            self.put_long(residual, 64);
        }
        parameter.follow(residual);
    }

    #[expect(clippy::cast_possible_truncation, reason = "the highest byte of those that wait")]
    pub(super) fn finish(mut self) -> Vec<u8> {
        // The last byte is filled up with zeros; what waits is below 40 bits then.
        let padding = self.count.next_multiple_of(8) - self.count;
        self.waiting <<= padding;
        self.count += padding;
        while self.count > 0 {
            self.count -= 8;
            self.out.push((self.waiting >> self.count) as u8);
        }
        self.out
    }
}

/// Reads what [`BitWriter`] wrote; `None` beyond the end.
pub(super) struct BitReader<'a> {
    rest: &'a [u8],
    /// Bits not used yet, the next one highest.
    bits: u64,
    count: u32,
}

impl<'a> BitReader<'a> {
    pub(super) const fn new(rest: &'a [u8]) -> Self {
        Self { rest, bits: 0, count: 0 }
    }

    fn fill(&mut self) {
        if self.count <= 56
            && let Some(next) = self.rest.first_chunk()
        {
            // Bits beyond the whole bytes that are counted are those that come next: once they are counted, they stand
            // there already.
            self.bits |= u64::from_be_bytes(*next) >> self.count;
            let whole = (63 - self.count) / 8;
            self.count += whole * 8;
            self.rest = &self.rest[whole as usize..];
            return;
        }
        while self.count <= 56
            && let Some((&byte, rest)) = self.rest.split_first()
        {
            self.bits |= u64::from(byte) << (56 - self.count);
            self.count += 8;
            self.rest = rest;
        }
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

    pub(super) fn rice(&mut self, parameter: &mut Parameter) -> Option<u64> {
        self.fill();
        let k = parameter.get();
        let ones = self.bits.leading_ones();
        let used = ones + 1 + k;
        let residual = if ones < ESCAPE && k > 0 && used <= self.count.min(63) {
            let residual = u64::from(ones) << k | (self.bits << (ones + 1)) >> (64 - k);
            self.bits <<= used;
            self.count -= used;
            residual
        } else if ones < ESCAPE {
            self.take(ones + 1)?;
            u64::from(ones) << k | self.take_long(k)?
        } else {
            self.take(ESCAPE)?;
            self.take_long(64)?
        };
        parameter.follow(residual);
        Some(residual)
    }

    /// Whether nothing but the last byte's padding is left.
    pub(super) const fn is_at_end(&self) -> bool {
        self.rest.is_empty() && self.count < 8 && self.bits == 0
    }
}

/// Appends residuals to `out`, `parameter` being that of the first.
pub(super) fn write(out: Vec<u8>, residuals: &[u64], mut parameter: Parameter) -> Vec<u8> {
    let mut writer = BitWriter::after(out);
    residuals.iter().for_each(|&residual| writer.rice(residual, &mut parameter));
    writer.finish()
}
