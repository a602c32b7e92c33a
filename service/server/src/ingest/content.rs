//! Content encodings: gzip and zstd, with a bound on what comes out.

use bytes::Bytes;
use std::io::Read;
use std::sync::Arc;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// How a body is compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// Not at all.
    Identity,
    /// gzip.
    Gzip,
    /// Zstandard.
    Zstd,
}

impl Encoding {
    /// The encoding that a `Content-Encoding` header names; `None` where it is not known.
    pub fn parse(header: Option<&str>) -> Option<Self> {
        match header.map(str::trim) {
            None => Some(Self::Identity),
            Some(text) if text.is_empty() || text.eq_ignore_ascii_case("identity") => Some(Self::Identity),
            Some(text) if text.eq_ignore_ascii_case("gzip") || text.eq_ignore_ascii_case("x-gzip") => {
                Some(Self::Gzip)
            }
            Some(text) if text.eq_ignore_ascii_case("zstd") => Some(Self::Zstd),
            Some(_) => None,
        }
    }
}

/// Why a body cannot be decompressed.
#[derive(Debug, PartialEq, Eq)]
pub enum ContentError {
    /// It grows beyond the bound: a bomb, or too much.
    TooLarge,
    /// It is not of that encoding, or torn.
    Malformed(String),
}

/// Decompressed bodies up to this are kept as many as there are, bytes.
const SMALL_BYTES: usize = 256 * 1024;
/// Larger ones that one unpacker keeps at once: each may be a thousand times what was sent.
const LARGE_AT_ONCE: usize = 4;

/// Decompresses bodies, few at a time.
#[derive(Debug)]
pub struct Unpacker {
    places: Arc<Semaphore>,
}

/// A decompressed body.
#[derive(Debug)]
pub struct Unpacked {
    /// The body.
    pub bytes: Bytes,
    /// The place of a large one among the few there are, given back where this is dropped: with the body itself.
    pub place: Option<OwnedSemaphorePermit>,
}

impl Default for Unpacker {
    fn default() -> Self {
        Self { places: Arc::new(Semaphore::new(LARGE_AT_ONCE)) }
    }
}

impl Unpacker {
    /// As [`decompress`], off the threads that serve connections. Waits until there is a place.
    ///
    /// # Errors
    ///
    /// `None` where the process ends.
    pub async fn unpack(
        &self,
        encoding: Encoding,
        bytes: Bytes,
        bound: usize,
    ) -> Option<Result<Unpacked, ContentError>> {
        let place = self.places.clone().acquire_owned().await.ok()?;
        let unpack = move || decompress(encoding, bytes.to_vec(), bound);
        let unpacked = tokio::task::spawn_blocking(unpack).await.ok()?;
        Some(unpacked.map(|bytes| {
            let place = (bytes.len() > SMALL_BYTES).then_some(place);
            Unpacked { bytes: bytes.into(), place }
        }))
    }
}

/// Decompresses `bytes`, never holding more than `bound` bytes of output.
pub fn decompress(encoding: Encoding, bytes: Vec<u8>, bound: usize) -> Result<Vec<u8>, ContentError> {
    match encoding {
        Encoding::Identity if bytes.len() > bound => Err(ContentError::TooLarge),
        Encoding::Identity => Ok(bytes),
        Encoding::Gzip => read_bounded(flate2::read::MultiGzDecoder::new(bytes.as_slice()), bound),
        Encoding::Zstd => {
            let mut decoder = zstd::stream::read::Decoder::new(bytes.as_slice())
                .map_err(|error| ContentError::Malformed(error.to_string()))?;
            // A frame may ask for a window of gigabytes; 2^23 is what its format guarantees decoders to bear.
            decoder.window_log_max(23).map_err(|error| ContentError::Malformed(error.to_string()))?;
            read_bounded(decoder, bound)
        }
    }
}

fn read_bounded(reader: impl Read, bound: usize) -> Result<Vec<u8>, ContentError> {
    let mut out = Vec::new();
    // One byte more than allowed tells a full bound from too much.
    let limit = u64::try_from(bound).unwrap_or(u64::MAX).saturating_add(1);
    reader.take(limit).read_to_end(&mut out).map_err(|error| ContentError::Malformed(error.to_string()))?;
    if out.len() > bound { Err(ContentError::TooLarge) } else { Ok(out) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    #[test]
    fn what_was_compressed_comes_back() {
        let text = b"{\"cycle_id\":\"c1\"}".repeat(100);
        assert_eq!(decompress(Encoding::Gzip, gzip(&text), 10_000).unwrap(), text);
        let packed = zstd::encode_all(text.as_slice(), 1).unwrap();
        assert_eq!(decompress(Encoding::Zstd, packed, 10_000).unwrap(), text);
        assert_eq!(decompress(Encoding::Identity, text.clone(), text.len()).unwrap(), text);
    }

    #[test]
    fn bombs_are_cut_off_at_the_bound() {
        let zeros = vec![0_u8; 20 << 20];
        for (encoding, bomb) in
            [(Encoding::Gzip, gzip(&zeros)), (Encoding::Zstd, zstd::encode_all(zeros.as_slice(), 1).unwrap())]
        {
            assert!(bomb.len() < 100_000);
            assert_eq!(decompress(encoding, bomb, 1 << 20), Err(ContentError::TooLarge), "{encoding:?}");
        }
    }

    #[tokio::test]
    async fn few_large_bodies_are_kept_at_once() {
        let unpacker = Unpacker::default();
        let unpack = async |bytes: usize| {
            let packed = Bytes::from(gzip(&vec![b' '; bytes]));
            unpacker.unpack(Encoding::Gzip, packed, 1 << 20).await.unwrap()
        };
        let mut kept = Vec::new();
        for _ in 0..LARGE_AT_ONCE {
            kept.push(unpack(SMALL_BYTES + 1).await.unwrap());
        }
        let mut next = Box::pin(unpack(SMALL_BYTES));
        assert!(futures_util::poll!(&mut next).is_pending());
        assert_eq!(unpacker.places.available_permits(), 0, "it waits for a place");
        kept.pop();
        assert_eq!(next.await.unwrap().bytes.len(), SMALL_BYTES);
        let small = unpack(SMALL_BYTES).await.unwrap();
        assert!(small.place.is_none(), "small ones need none once they are decompressed");
        assert_eq!(unpack(2 << 20).await.unwrap_err(), ContentError::TooLarge);
        assert_eq!(unpacker.places.available_permits(), 1, "refused ones keep none");
    }

    #[test]
    fn torn_and_foreign_bodies_are_malformed() {
        let whole = gzip(b"{\"cycle_id\":\"c1\"}");
        for (encoding, bytes) in [
            (Encoding::Gzip, whole[..whole.len() - 5].to_vec()),
            (Encoding::Gzip, b"{}".to_vec()),
            (Encoding::Zstd, whole),
        ] {
            assert!(
                matches!(decompress(encoding, bytes, 1000), Err(ContentError::Malformed(_))),
                "{encoding:?}"
            );
        }
        assert_eq!(Encoding::parse(Some("br")), None);
    }
}
