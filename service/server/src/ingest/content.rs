//! What a body may take: bounds on what is decompressed, and on all large bodies together.

use super::room::{Growing, Place, SMALL_BYTES, Share};
use bytes::Bytes;
use std::io::{Read, Write};

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

/// Room for large bodies, which all of them together do not exceed: each may be a thousand times what was sent, and a shop's
/// machines may all come back at once.
#[derive(Debug)]
pub struct Room {
    /// Of bodies as they are sent. Whoever has a place there may wait for one below, and never the other way round.
    sent: Share,
    /// Of those that were decompressed.
    unpacked: Share,
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
    /// For so many bytes as they are sent, of which a body is `largest` at the most, and as many that are decompressed.
    pub fn new(bytes: usize, largest: usize) -> Self {
        Self { sent: Share::new(bytes, largest), unpacked: Share::new(bytes, bytes) }
    }

    /// A place for a body that tells its length; none where it needs none.
    pub async fn place(&self, bytes: usize) -> Result<Option<Place>, ContentError> {
        if bytes <= SMALL_BYTES { Ok(None) } else { self.sent.place(bytes).await.map(Some) }
    }

    /// That of one that does not.
    pub const fn growing(&self) -> Growing<'_> {
        self.sent.growing()
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
    use super::super::room::UNIT;
    use super::*;
    use std::time::Duration;

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
        let share = || Share::new(bytes, bytes).with_patience(Duration::from_millis(5));
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
        assert_eq!(room.unpacked.free(), 1024 - 700, "what it takes is kept");
        assert_eq!(unpack(400 * UNIT).await.unwrap_err(), ContentError::Busy);
        let other = unpack(SMALL_BYTES + 1).await.unwrap();
        let small = unpack(SMALL_BYTES).await.unwrap();
        assert!(small.place.is_none() && small.bytes.len() == SMALL_BYTES, "small ones pass by");
        let sent = room.place(700 * UNIT).await.unwrap();
        assert_eq!(room.place(400 * UNIT).await.unwrap_err(), ContentError::Busy);
        assert!(room.place(SMALL_BYTES).await.unwrap().is_none());
        drop((large, other, sent));
        assert_eq!(unpack(2 << 20).await.unwrap_err(), ContentError::TooLarge);
        assert_eq!(room.unpacked.free(), 1 << 10, "refused ones keep none");
        assert_eq!(unpack(1 << 20).await.unwrap().bytes.len(), 1 << 20);
        let all = room.place(usize::MAX).await.unwrap().unwrap();
        assert_eq!((all.bytes(), room.sent.free()), (1 << 20, 0), "more than there is");
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
