//! What a body may take: bounds on what is decompressed, and on all large bodies together.

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

/// Bodies up to this need no room of their own, bytes.
pub const SMALL_BYTES: usize = 256 * 1024;
/// Most of those that are larger are smaller than this once they are decompressed, bytes.
const MEDIUM_BYTES: usize = 4 * 1024 * 1024;
/// How long a large one waits for its room.
const PATIENCE: Duration = Duration::from_secs(10);
/// Room is counted by so many bytes.
const UNIT: usize = 1024;

/// Room for large bodies, which all of them together do not exceed: each may be a thousand times what was sent, and a shop's
/// machines may all come back at once.
#[derive(Debug)]
pub struct Room {
    free: Arc<Semaphore>,
    units: u32,
    patience: Duration,
}

/// What of the room a body takes, given back where this is dropped: with the body itself.
#[derive(Debug)]
pub struct Place(OwnedSemaphorePermit);

impl Place {
    /// Gives back what a body that has come in does not need of it.
    pub fn shrink_to(&mut self, bytes: usize) {
        let spare = self.0.num_permits().saturating_sub(bytes.div_ceil(UNIT));
        drop(self.0.split(spare));
    }
}

/// A body as it is read, with what it takes of the room where it is large.
#[derive(Debug)]
pub struct Unpacked {
    /// The body.
    pub bytes: Bytes,
    /// Its place.
    pub place: Option<Place>,
}

impl Room {
    /// For so many bytes.
    pub fn new(bytes: usize) -> Self {
        let units = u32::try_from(bytes / UNIT).unwrap_or(u32::MAX).clamp(1, MOST_UNITS);
        Self { free: Arc::new(Semaphore::new(units as usize)), units, patience: PATIENCE }
    }

    /// A place for a body of at most so many bytes; whoever is larger than all of it has all of it.
    pub async fn place(&self, bytes: usize) -> Result<Place, ContentError> {
        let units = u32::try_from(bytes.div_ceil(UNIT)).unwrap_or(u32::MAX).min(self.units);
        match timeout(self.patience, Arc::clone(&self.free).acquire_many_owned(units)).await {
            Ok(Ok(place)) => Ok(Place(place)),
            Ok(Err(_)) | Err(_) => Err(ContentError::Busy),
        }
    }

    /// As [`decompress`], off the threads that serve connections. What proves to be large waits for its place.
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
        let medium = bound.min(MEDIUM_BYTES);
        let place = self.place(medium).await?;
        match run(encoding, bytes.clone(), medium, Some(place)).await {
            Err(ContentError::TooLarge) if bound > medium => {}
            done => return done,
        }
        let place = self.place(bound).await?;
        run(encoding, bytes, bound, Some(place)).await
    }
}

/// No semaphore counts more.
const MOST_UNITS: u32 = u32::MAX >> 3;

/// The place is held by what decompresses: that goes on where nobody waits for it any more.
async fn run(
    encoding: Encoding,
    bytes: Bytes,
    bound: usize,
    place: Option<Place>,
) -> Result<Unpacked, ContentError> {
    let unpack = move || {
        let bytes = Bytes::from(decompress(encoding, bytes.to_vec(), bound)?);
        let mut place = place;
        if let Some(place) = &mut place {
            place.shrink_to(bytes.len());
        }
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
    async fn large_bodies_share_their_room() {
        let room = Room { patience: Duration::from_millis(5), ..Room::new(1 << 20) };
        let unpack = async |bytes: usize| {
            let packed = Bytes::from(gzip(&vec![b' '; bytes]));
            room.unpack(Encoding::Gzip, packed, 1 << 20).await
        };
        let large = unpack(SMALL_BYTES + 1).await.unwrap();
        let left = (1 << 10) - SMALL_BYTES / UNIT - 1;
        assert_eq!(room.free.available_permits(), left, "only what it takes is kept");
        // Not known before: it may be as large as any.
        assert_eq!(unpack(SMALL_BYTES + 1).await.unwrap_err(), ContentError::Busy);
        let small = unpack(SMALL_BYTES).await.unwrap();
        assert!(small.place.is_none() && small.bytes.len() == SMALL_BYTES, "small ones pass by");
        let known = room.place(700 * UNIT).await.unwrap();
        assert_eq!(room.place(100 * UNIT).await.unwrap_err(), ContentError::Busy);
        drop((large, known));
        assert_eq!(unpack(2 << 20).await.unwrap_err(), ContentError::TooLarge);
        assert_eq!(room.free.available_permits(), 1 << 10, "refused ones keep none");
        assert_eq!(unpack(1 << 20).await.unwrap().bytes.len(), 1 << 20);
        let all = room.place(usize::MAX).await.unwrap();
        assert_eq!((all.0.num_permits(), room.free.available_permits()), (1 << 10, 0), "more than there is");
    }

    #[tokio::test]
    async fn one_that_proves_larger_than_most_has_what_it_needs() {
        let room = Room::new(16 << 20);
        let packed = Bytes::from(gzip(&vec![b' '; MEDIUM_BYTES + 1]));
        let unpacked = room.unpack(Encoding::Gzip, packed, 16 << 20).await.unwrap();
        assert_eq!(unpacked.bytes.len(), MEDIUM_BYTES + 1);
        assert_eq!(unpacked.place.unwrap().0.num_permits(), MEDIUM_BYTES / UNIT + 1);
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
