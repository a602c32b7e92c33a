//! What a body may take: bounds on what is decompressed, and on all large bodies together.

use bytes::Bytes;
use std::io::{Read, Write};
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
const SMALL_BYTES: usize = 256 * 1024;
/// Of a body that does not tell its length this much is asked for first, bytes; most are smaller.
const MEDIUM_BYTES: usize = 4 * 1024 * 1024;
/// How long a large one waits for its room.
const PATIENCE: Duration = Duration::from_secs(10);
/// Room is counted by so many bytes.
const UNIT: usize = 1024;

/// Room for large bodies, which all of them together do not exceed: each may be a thousand times what was sent, and a shop's
/// machines may all come back at once.
#[derive(Debug)]
pub struct Room {
    /// Of bodies as they are sent. Whoever has a place there may wait for one below, and never the other way round.
    sent: Share,
    /// Of those that were decompressed.
    unpacked: Share,
}

#[derive(Debug)]
struct Share {
    free: Arc<Semaphore>,
    units: u32,
    patience: Duration,
}

/// What of the room a body takes, given back where this is dropped: with the body itself.
#[derive(Debug)]
pub struct Place(OwnedSemaphorePermit);

/// A body as it is read, with what it takes of the room where it is large.
#[derive(Debug)]
pub struct Unpacked {
    /// The body.
    pub bytes: Bytes,
    /// Its place.
    pub place: Option<Place>,
}

/// The place of a body that does not tell its length, which grows with it.
#[derive(Debug)]
pub struct Growing<'a> {
    room: &'a Room,
    most: usize,
    place: Option<Place>,
}

impl Growing<'_> {
    /// Makes room for so many bytes in all, at most as many as it may become.
    pub async fn grow_to(&mut self, bytes: usize) -> Result<(), ContentError> {
        if bytes <= SMALL_BYTES || self.place.as_ref().is_some_and(|place| bytes <= place.bytes()) {
            return Ok(());
        }
        let wanted = if bytes <= MEDIUM_BYTES { MEDIUM_BYTES.min(self.most) } else { self.most };
        match &mut self.place {
            None => self.place = Some(self.room.sent.place(wanted).await?),
            Some(place) => {
                let more = self.room.sent.place(wanted.saturating_sub(place.bytes())).await?;
                place.0.merge(more.0);
            }
        }
        Ok(())
    }

    /// The place of a body that has come in.
    pub fn ended(mut self, bytes: usize) -> Option<Place> {
        if let Some(Place(place)) = &mut self.place {
            drop(place.split(place.num_permits().saturating_sub(bytes.div_ceil(UNIT))));
        }
        self.place
    }
}

impl Place {
    fn bytes(&self) -> usize {
        self.0.num_permits() * UNIT
    }
}

impl Share {
    fn new(bytes: usize) -> Self {
        let units = u32::try_from(bytes.div_ceil(UNIT)).unwrap_or(u32::MAX).clamp(1, MOST_UNITS);
        Self { free: Arc::new(Semaphore::new(units as usize)), units, patience: PATIENCE }
    }

    /// A place for so many bytes; whoever is larger than all of it has all of it.
    async fn place(&self, bytes: usize) -> Result<Place, ContentError> {
        let units = u32::try_from(bytes.div_ceil(UNIT)).unwrap_or(u32::MAX).min(self.units);
        match timeout(self.patience, Arc::clone(&self.free).acquire_many_owned(units)).await {
            Ok(Ok(place)) => Ok(Place(place)),
            Ok(Err(_)) | Err(_) => Err(ContentError::Busy),
        }
    }
}

impl Room {
    /// For so many bytes as they are sent, and as many that are decompressed.
    pub fn new(bytes: usize) -> Self {
        Self { sent: Share::new(bytes), unpacked: Share::new(bytes) }
    }

    /// A place for a body that tells its length; none where it needs none.
    pub async fn place(&self, bytes: usize) -> Result<Option<Place>, ContentError> {
        if bytes <= SMALL_BYTES { Ok(None) } else { self.sent.place(bytes).await.map(Some) }
    }

    /// That of one that does not, and is of `most` bytes at the most.
    pub const fn growing(&self, most: usize) -> Growing<'_> {
        Growing { room: self, most, place: None }
    }

    /// As [`decompress`], off the threads that serve connections. What proves to be large is measured before it is kept, and waits
    /// for its place.
    pub async fn unpack(
        &self,
        encoding: Encoding,
        bytes: Bytes,
        bound: usize,
    ) -> Result<Unpacked, ContentError> {
        let small = bound.min(SMALL_BYTES);
        let packed = bytes.clone();
        match aside(move || decompress(encoding, &packed, small)).await {
            Ok(bytes) => return Ok(Unpacked { bytes: bytes.into(), place: None }),
            Err(ContentError::TooLarge) if bound > small => {}
            Err(error) => return Err(error),
        }
        let packed = bytes.clone();
        let length = aside(move || measure(encoding, &packed, bound)).await?;
        let place = self.unpacked.place(length).await?;
        // The place is held by what decompresses: that goes on where nobody waits for it any more.
        aside(move || {
            let bytes = decompress(encoding, &bytes, length)?.into();
            Ok(Unpacked { bytes, place: Some(place) })
        })
        .await
    }
}

/// Runs it off the threads that serve connections.
async fn aside<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, ContentError> + Send + 'static,
) -> Result<T, ContentError> {
    // It is cancelled only where the process ends.
    tokio::task::spawn_blocking(work).await.unwrap_or(Err(ContentError::Busy))
}

/// No semaphore counts more.
const MOST_UNITS: u32 = u32::MAX >> 3;

/// What comes out of `bytes`, read one after the other.
fn reader(encoding: Encoding, bytes: &[u8]) -> Result<Box<dyn Read + '_>, ContentError> {
    let malformed = |error: std::io::Error| ContentError::Malformed(error.to_string());
    Ok(match encoding {
        Encoding::Identity => Box::new(bytes),
        Encoding::Gzip => Box::new(flate2::read::MultiGzDecoder::new(bytes)),
        Encoding::Zstd => {
            let mut decoder = zstd::stream::read::Decoder::new(bytes).map_err(malformed)?;
            // A frame may ask for a window of gigabytes; 2^23 is what its format guarantees decoders to bear.
            decoder.window_log_max(23).map_err(malformed)?;
            Box::new(decoder)
        }
    })
}

/// Decompresses `bytes`, never holding more than `bound` bytes of output.
pub fn decompress(encoding: Encoding, bytes: &[u8], bound: usize) -> Result<Vec<u8>, ContentError> {
    let mut out = Vec::new();
    copy(encoding, bytes, bound, &mut out)?;
    out.shrink_to_fit();
    Ok(out)
}

/// How many bytes come out of `bytes`, none of which is kept; at most `bound`.
fn measure(encoding: Encoding, bytes: &[u8], bound: usize) -> Result<usize, ContentError> {
    copy(encoding, bytes, bound, &mut std::io::sink())
}

fn copy(
    encoding: Encoding,
    bytes: &[u8],
    bound: usize,
    into: &mut impl Write,
) -> Result<usize, ContentError> {
    // One byte more than allowed tells a full bound from too much.
    let limit = u64::try_from(bound).unwrap_or(u64::MAX).saturating_add(1);
    let copied = std::io::copy(&mut reader(encoding, bytes)?.take(limit), into)
        .map_err(|error| ContentError::Malformed(error.to_string()))?;
    usize::try_from(copied).ok().filter(|copied| *copied <= bound).ok_or(ContentError::TooLarge)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    #[test]
    fn what_was_compressed_comes_back() {
        let text = b"{\"cycle_id\":\"c1\"}".repeat(100);
        assert_eq!(decompress(Encoding::Gzip, &gzip(&text), 10_000).unwrap(), text);
        let packed = zstd::encode_all(text.as_slice(), 1).unwrap();
        assert_eq!(decompress(Encoding::Zstd, &packed, 10_000).unwrap(), text);
        assert_eq!(decompress(Encoding::Identity, &text, text.len()).unwrap(), text);
    }

    #[test]
    fn bombs_are_cut_off_at_the_bound() {
        let zeros = vec![0_u8; 20 << 20];
        for (encoding, bomb) in
            [(Encoding::Gzip, gzip(&zeros)), (Encoding::Zstd, zstd::encode_all(zeros.as_slice(), 1).unwrap())]
        {
            assert!(bomb.len() < 100_000);
            assert_eq!(decompress(encoding, &bomb, 1 << 20), Err(ContentError::TooLarge), "{encoding:?}");
        }
    }

    fn impatient(bytes: usize) -> Room {
        let share = || Share { patience: Duration::from_millis(5), ..Share::new(bytes) };
        Room { sent: share(), unpacked: share() }
    }

    #[tokio::test]
    async fn large_bodies_share_their_room() {
        let room = impatient(1 << 20);
        let unpack = async |bytes: usize| {
            let packed = Bytes::from(gzip(&vec![b' '; bytes]));
            room.unpack(Encoding::Gzip, packed, 1 << 20).await
        };
        let large = unpack(700 * UNIT).await.unwrap();
        assert_eq!(room.unpacked.free.available_permits(), 1024 - 700, "what it takes is kept");
        assert_eq!(unpack(400 * UNIT).await.unwrap_err(), ContentError::Busy);
        let other = unpack(SMALL_BYTES + 1).await.unwrap();
        let small = unpack(SMALL_BYTES).await.unwrap();
        assert!(small.place.is_none() && small.bytes.len() == SMALL_BYTES, "small ones pass by");
        let sent = room.place(700 * UNIT).await.unwrap();
        assert_eq!(room.place(400 * UNIT).await.unwrap_err(), ContentError::Busy);
        assert!(room.place(SMALL_BYTES).await.unwrap().is_none());
        drop((large, other, sent));
        assert_eq!(unpack(2 << 20).await.unwrap_err(), ContentError::TooLarge);
        assert_eq!(room.unpacked.free.available_permits(), 1 << 10, "refused ones keep none");
        assert_eq!(unpack(1 << 20).await.unwrap().bytes.len(), 1 << 20);
        let all = room.place(usize::MAX).await.unwrap().unwrap();
        assert_eq!((all.bytes(), room.sent.free.available_permits()), (1 << 20, 0), "more than there is");
    }

    #[tokio::test]
    async fn who_keeps_what_was_sent_has_room_for_what_comes_of_it() {
        // As large as all of the room, both ways, and several at once.
        let room = impatient(8 << 20);
        let packed = Bytes::from(gzip(&vec![b' '; 8 << 20]));
        let sent = room.place(8 << 20).await.unwrap();
        let unpacked = room.unpack(Encoding::Gzip, packed.clone(), 8 << 20).await.unwrap();
        let place = unpacked.place.map(|place| place.bytes());
        assert_eq!((unpacked.bytes.len(), place), (8 << 20, Some(8 << 20)));
        drop(sent);
        let held = [room.place(4 << 20).await.unwrap(), room.place(4 << 20).await.unwrap()];
        for _ in &held {
            assert!(room.unpack(Encoding::Gzip, packed.clone(), 8 << 20).await.is_ok());
        }
    }

    #[tokio::test]
    async fn a_place_grows_with_a_body_that_does_not_tell_its_length() {
        let room = impatient(8 << 20);
        let mut place = room.growing(6 << 20);
        place.grow_to(SMALL_BYTES).await.unwrap();
        assert_eq!(room.sent.free.available_permits(), 8 << 10);
        for (bytes, left) in
            [(SMALL_BYTES + 1, 4 << 10), (MEDIUM_BYTES, 4 << 10), (MEDIUM_BYTES + 1, 2 << 10)]
        {
            place.grow_to(bytes).await.unwrap();
            assert_eq!(room.sent.free.available_permits(), left, "{bytes}");
        }
        let mut other = room.growing(6 << 20);
        assert_eq!(other.grow_to(SMALL_BYTES + 1).await.unwrap_err(), ContentError::Busy);
        let ended = place.ended(5 << 20).unwrap();
        assert_eq!((ended.bytes(), room.sent.free.available_permits()), (5 << 20, 3 << 10));
        drop(ended);
        assert_eq!(room.sent.free.available_permits(), 8 << 10);
        assert!(room.growing(6 << 20).ended(10).is_none());
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
                matches!(decompress(encoding, &bytes, 1000), Err(ContentError::Malformed(_))),
                "{encoding:?}"
            );
        }
        assert_eq!(Encoding::parse(Some("br")), None);
    }
}
