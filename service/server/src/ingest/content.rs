//! Content encodings: gzip and zstd, with a bound on what comes out.

use std::io::Read;

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
