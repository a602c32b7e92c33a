//! Content encodings: gzip and zstd, with a bound on what comes out.

use bytes::Bytes;
use std::io::Read;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::timeout;

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
    /// It is large, and others that are have all places: try again.
    Busy,
}

/// Decompressed bodies up to this need no place, bytes.
const SMALL_BYTES: usize = 256 * 1024;
/// Larger ones that one unpacker keeps at once: each may be a thousand times what was sent.
const LARGE_AT_ONCE: usize = 4;
/// How long a large one waits for its place.
const PATIENCE: Duration = Duration::from_secs(2);

/// Decompresses bodies, few large ones at a time.
#[derive(Debug)]
pub struct Unpacker {
    places: Arc<Semaphore>,
    patience: Duration,
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
        Self { places: Arc::new(Semaphore::new(LARGE_AT_ONCE)), patience: PATIENCE }
    }
}

impl Unpacker {
    /// As [`decompress`], off the threads that serve connections. What proves to be large waits for a place.
    pub async fn unpack(
        &self,
        encoding: Encoding,
        bytes: Bytes,
        bound: usize,
    ) -> Result<Unpacked, ContentError> {
        let small = bound.min(SMALL_BYTES);
        match run(encoding, bytes.clone(), small, None).await {
            Err(ContentError::TooLarge) if bound > small => {}
            done => return done,
        }
        let place = timeout(self.patience, self.places.clone().acquire_owned()).await;
        let Ok(Ok(place)) = place else { return Err(ContentError::Busy) };
        run(encoding, bytes, bound, Some(place)).await
    }
}

/// The place is held by what decompresses: that goes on where nobody waits for it any more.
async fn run(
    encoding: Encoding,
    bytes: Bytes,
    bound: usize,
    place: Option<OwnedSemaphorePermit>,
) -> Result<Unpacked, ContentError> {
    let unpack = move || {
        let bytes = decompress(encoding, bytes.to_vec(), bound)?.into();
        Ok(Unpacked { bytes, place })
    };
    // It is cancelled only where the process ends.
    tokio::task::spawn_blocking(unpack).await.unwrap_or(Err(ContentError::Busy))
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
        let unpacker = Unpacker { patience: Duration::from_millis(5), ..Unpacker::default() };
        let unpack = async |bytes: usize| {
            let packed = Bytes::from(gzip(&vec![b' '; bytes]));
            unpacker.unpack(Encoding::Gzip, packed, 1 << 20).await
        };
        let mut kept = Vec::new();
        for _ in 0..LARGE_AT_ONCE {
            kept.push(unpack(SMALL_BYTES + 1).await.unwrap());
        }
        assert_eq!(unpack(SMALL_BYTES + 1).await.unwrap_err(), ContentError::Busy);
        let small = unpack(SMALL_BYTES).await.unwrap();
        assert!(small.place.is_none() && small.bytes.len() == SMALL_BYTES, "small ones pass by");
        kept.pop();
        assert_eq!(unpack(2 << 20).await.unwrap_err(), ContentError::TooLarge);
        assert_eq!(unpacker.places.available_permits(), 1, "refused ones keep none");
        assert_eq!(unpack(1 << 20).await.unwrap().bytes.len(), 1 << 20);
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
