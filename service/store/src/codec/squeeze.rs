//! zstd, by a context that each thread keeps: it allocates some hundred kilobytes, and making one takes longer than using it.

use std::cell::RefCell;

thread_local! {
    static COMPRESSOR: RefCell<Option<zstd::bulk::Compressor<'static>>> = const { RefCell::new(None) };
    static DECOMPRESSOR: RefCell<Option<zstd::bulk::Decompressor<'static>>> = const { RefCell::new(None) };
}

/// A zstd frame of the bytes; `None` where zstd fails, which it does for want of memory only.
pub(super) fn compress(plain: &[u8], level: i32) -> Option<Vec<u8>> {
    COMPRESSOR.with_borrow_mut(|slot| {
        if slot.is_none() {
            *slot = zstd::bulk::Compressor::new(level).ok();
        }
        let compressor = slot.as_mut()?;
        compressor.set_compression_level(level).ok()?;
        compressor.compress(plain).ok()
    })
}

/// The bytes of a frame that has exactly so many.
pub(super) fn decompress(packed: &[u8], plain_length: usize) -> Result<Vec<u8>, &'static str> {
    DECOMPRESSOR.with_borrow_mut(|slot| {
        if slot.is_none() {
            *slot = zstd::bulk::Decompressor::new().ok();
        }
        let decompressor = slot.as_mut().ok_or("no memory to decompress")?;
        let mut plain = Vec::with_capacity(plain_length);
        // Writes into the capacity and no further: a bomb fails.
        decompressor.decompress_to_buffer(packed, &mut plain).map_err(|_| "not decompressible")?;
        if plain.len() == plain_length { Ok(plain) } else { Err("length differs after decompression") }
    })
}
