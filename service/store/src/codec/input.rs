//! Bytes that are read with every bound checked, and integers of seven bits a byte (LEB128).

/// Longest varint of a 64-bit integer.
pub(super) const MAX_VARINT: usize = 10;

/// LEB128: seven bits a byte, the lowest first, the highest bit set where more follow.
#[expect(clippy::cast_possible_truncation, reason = "seven bits at a time")]
pub(super) fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// What [`put_varint`] wrote, byte by byte; `overflows` where it is more than 64 bits.
pub(crate) fn varint<E>(mut next: impl FnMut() -> Result<u8, E>, overflows: E) -> Result<u64, E> {
    let mut value = 0_u64;
    for shift in (0..64).step_by(7) {
        let byte = next()?;
        let bits = u64::from(byte & 0x7f);
        if shift == 63 && bits > 1 {
            return Err(overflows);
        }
        value |= bits << shift;
        if byte & 0x80 == 0 {
            return Ok(value);
        }
    }
    Err(overflows)
}

/// What is left to be read.
pub(super) struct Input<'a>(pub(super) &'a [u8]);

impl<'a> Input<'a> {
    pub(super) fn take(&mut self, count: usize) -> Result<&'a [u8], &'static str> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or("too short")?;
        self.0 = rest;
        Ok(taken)
    }

    pub(super) fn byte(&mut self) -> Result<u8, &'static str> {
        Ok(self.take(1)?[0])
    }

    pub(super) fn varint(&mut self) -> Result<u64, &'static str> {
        varint(|| self.byte(), "varint overflows")
    }

    pub(super) fn length(&mut self) -> Result<usize, &'static str> {
        usize::try_from(self.varint()?).map_err(|_| "length overflows")
    }
}
