//! What a cycle did over depth, in few bytes: way, time and energy of every millimetre, and where the sheet opened.
//!
//! It is what feed-compensated wear needs of a cycle whose samples may be gone. Quantised when it is made, so that the
//! stored form and the one in memory are the same.

use super::{Context, SampleClock, scan};
use crate::cycle::{Channel, Cycle, Flag, Flags, Samples};
use crate::friction::relation::{DepthBin, DepthProfile, RelationConfig, RelationParams};
use crate::friction::stages::{StageConfig, StageDetector};
use crate::units::Process;

/// Depth that a digest may cover, mm, in bins of one millimetre; bushings are shorter than their tools' 40 mm.
pub const DIGEST_DEPTH_MM: f64 = 64.0;
/// Bins of a digest at the most.
pub const MOST_DIGEST_BINS: usize = 64;
/// Longest stored form: two bytes, and three numbers of at most 5, 5 and 10 bytes a bin. A digest of the most bins has no
/// breakthrough, which would need 5 bytes more.
pub const MOST_DIGEST_BYTES: usize = 2 + MOST_DIGEST_BINS * 20;

/// Without and with a breakthrough.
const FORMATS: [u8; 2] = [1, 2];
const WAY_MM: f64 = 1e-3;
const TIME_S: f64 = 1e-5;
const ENERGY_J: f64 = 1e-3;
/// Depth at the surface that is still the surface, mm.
pub(crate) const SURFACE_MM: f64 = 0.02;
/// The same, and depth short of the deepest that is already the end, mm: what an
/// encoder's noise or a standing axis adds.
const STANDING_MM: f64 = SURFACE_MM;
/// A contact that the loads show later than so many mm, or after this part of the way to breakthrough, is none.
const LATEST_CONTACT_MM: f64 = 1.0;
const LATEST_CONTACT: f64 = 0.5;
/// Feeds of a constant program differ by no more than this factor from bin to bin: drives settle, percents round.
const CONSTANT_WITHIN: f64 = 1.15;

/// One millimetre of depth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct DigestBin {
    /// Way, µm.
    way: u32,
    /// Time, 10 µs.
    time: u32,
    /// Energy, mJ.
    energy: i64,
}

/// Way, time and energy over depth, from contact to the largest depth.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DepthDigest {
    bins: Vec<DigestBin>,
    /// Depth at which the sheet opened, µm.
    breakthrough: Option<u32>,
}

/// Bins of a digest, and what is expected of energy over feed before any cycle was seen.
pub(crate) fn relation_config() -> Option<RelationConfig> {
    RelationConfig::new(RelationParams::energy(DIGEST_DEPTH_MM)).ok()
}

/// The digest of a friction cycle with `joules` at each sample; `None` where depth was not sampled, where the tool went
/// back and forth or deeper than [`DIGEST_DEPTH_MM`], and for every other process.
pub(super) fn of(
    samples: &Samples,
    clock: &SampleClock,
    cycle: &Cycle,
    context: Context<'_>,
    (joules, flags): (&[f64], Flags),
) -> Option<DepthDigest> {
    let process = cycle.process.or_else(|| context.operation.map(|operation| operation.process));
    // Not registered yet: its operation may turn out to be friction drilling.
    if process.is_some_and(|process| process != Process::Friction) || flags.contains(Flag::DepthReversal) {
        return None;
    }
    let depth = samples.column(Channel::DepthMm)?;
    let (contact, end) = way_in_contact(depth).filter(|(_, end)| depth[*end] <= DIGEST_DEPTH_MM)?;
    let config = relation_config()?;
    let mut profile = DepthProfile::new(&config);
    if contact == 0 && depth[0] > STANDING_MM {
        // The recording begins in the work: its first sample stands for the period before it. One at the surface is where the
        // way begins, whatever was recorded before it.
        profile.add(&config, depth[0], depth[0], clock.width_s(0), joules[0]);
    }
    profile.add_way(&config, &depth[contact..=end], |step| {
        (clock.width_s(contact + step), joules[contact + step])
    });
    Some(DepthDigest::of(&profile)?.with_breakthrough(breakthrough_mm(samples, end)))
}

/// Where the thrust falls off because the sheet opens, mm: it tells the sheet's thickness, and no wear moves it. `None`
/// where the feed drive's load was not sampled, or does not show it.
fn breakthrough_mm(samples: &Samples, end: usize) -> Option<f64> {
    let (depth, thrust) = (samples.column(Channel::DepthMm)?, samples.column(Channel::FeedDriveLoadPercent)?);
    let found = StageDetector::opening(&StageConfig::default(), &depth[..=end], thrust);
    let (contact, opened) = (found.contact?.depth_mm, found.breakthrough?.depth_mm);
    // Where the loads show no contact near the surface, as in a thin sheet among noise, what falls off later is another
    // stage's load.
    (contact <= LATEST_CONTACT_MM && contact <= LATEST_CONTACT * opened).then_some(opened)
}

/// The last sample at the surface and the first one at the end of the way, of a depth that was sampled, mm; `None` where
/// the tool never went in. Where the recording begins in the work its first sample stands for the surface.
///
/// What comes before is the approach, where the spindle spins up, and what comes after is dwelling and retracting: how
/// much of either is recorded says nothing of the tool.
pub fn way_in_contact(depth: &[f64]) -> Option<(usize, usize)> {
    let deepest = scan::largest(depth);
    if deepest <= 0.0 {
        return None;
    }
    let end = scan::first(depth, |z| z >= deepest - STANDING_MM)?;
    let contact = scan::last(&depth[..end], |z| z <= STANDING_MM).unwrap_or(0);
    Some((contact, end))
}

/// Whether the first sample is the last one at the surface.
pub(super) fn begins_at_the_surface(depth: &[f64]) -> bool {
    depth.first().is_some_and(|first| (0.0..=STANDING_MM).contains(first))
        && way_in_contact(depth).is_some_and(|(contact, _)| contact == 0)
}

impl DepthDigest {
    /// Quantises a profile whose bins are a millimetre each; `None` where it is empty or its numbers are absurd.
    pub fn of(profile: &DepthProfile) -> Option<Self> {
        let used = profile.bins().iter().rposition(|bin| bin.way_mm > 0.0)? + 1;
        let bins = profile.bins()[..used].iter().map(quantised).collect::<Option<Vec<_>>>()?;
        let is_one = used <= MOST_DIGEST_BINS && bins.iter().any(|bin| bin.time > 0);
        is_one.then_some(Self { bins, breakthrough: None })
    }

    /// The same with the depth at which the sheet opened, mm.
    #[must_use]
    pub fn with_breakthrough(mut self, depth_mm: Option<f64>) -> Self {
        let fits =
            |depth: &f64| *depth > 0.0 && *depth <= DIGEST_DEPTH_MM && self.bins.len() < MOST_DIGEST_BINS;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked to fit")]
        let quantised = |depth: f64| (depth / WAY_MM).round() as u32;
        self.breakthrough = depth_mm.filter(fits).map(quantised);
        self
    }

    /// Depth at which the sheet opened, mm, where the feed drive's load showed it.
    pub fn breakthrough_mm(&self) -> Option<f64> {
        self.breakthrough.map(|depth| f64::from(depth) * WAY_MM)
    }

    /// The same as a profile.
    pub fn profile(&self) -> Option<DepthProfile> {
        #[expect(clippy::cast_precision_loss, reason = "energies were checked to be below 2^53 mJ")]
        let bins = self.bins.iter().map(|bin| DepthBin {
            way_mm: f64::from(bin.way) * WAY_MM,
            time_s: f64::from(bin.time) * TIME_S,
            total: bin.energy as f64 * ENERGY_J,
        });
        Some(DepthProfile::of_bins(&relation_config()?, bins))
    }

    /// Energy from contact to the end of the way, J.
    pub fn joules(&self) -> f64 {
        let total: i64 = self.bins.iter().fold(0, |sum, bin| sum.saturating_add(bin.energy));
        #[expect(
            clippy::cast_precision_loss,
            reason = "64 energies, each below 2^53 mJ: rounding is far below 1 mJ of J"
        )]
        let total = total as f64;
        total * ENERGY_J
    }

    /// Time from contact to the end of the way, ms.
    pub fn duration_ms(&self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "64 times below 2^32 are below 2^38")]
        let total = self.bins.iter().map(|bin| u64::from(bin.time)).sum::<u64>() as f64;
        total * TIME_S * 1e3
    }

    /// Whether one feed was run from end to end: its first and last millimetre, where drives speed up and brake, are
    /// not looked at.
    pub fn is_constant_feed(&self) -> bool {
        let inner = self.bins.get(1..self.bins.len().saturating_sub(1)).unwrap_or_default();
        let feed = |bin: &DigestBin| f64::from(bin.way) / f64::from(bin.time);
        let feeds: Vec<f64> = inner.iter().filter(|bin| bin.way > 0 && bin.time > 0).map(feed).collect();
        let highest = feeds.iter().copied().fold(0.0, f64::max);
        let lowest = feeds.iter().copied().fold(f64::INFINITY, f64::min);
        feeds.len() >= 3 && highest <= CONSTANT_WITHIN * lowest
    }

    /// Way (µm), time (10 µs) and energy (mJ) of each millimetre.
    pub fn bins(&self) -> impl ExactSizeIterator<Item = [i64; 3]> + '_ {
        self.bins.iter().map(|bin| [i64::from(bin.way), i64::from(bin.time), bin.energy])
    }

    /// Depth at which the sheet opened, µm.
    pub const fn breakthrough_um(&self) -> Option<u32> {
        self.breakthrough
    }

    /// The digest of [`DepthDigest::bins`] and [`DepthDigest::breakthrough_um`]; `None` where there can be none of them.
    pub fn of_bins(bins: &[[i64; 3]], breakthrough_um: Option<u32>) -> Option<Self> {
        if bins.is_empty() || bins.len() > MOST_DIGEST_BINS {
            return None;
        }
        let bin = |&[way, time, energy]: &[i64; 3]| {
            Some(DigestBin { way: u32::try_from(way).ok()?, time: u32::try_from(time).ok()?, energy })
        };
        let bins = bins.iter().map(bin).collect::<Option<Vec<_>>>()?;
        Some(Self { bins, breakthrough: breakthrough_um })
    }

    /// The stored form.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(2 + 8 * self.bins.len());
        out.push(FORMATS[usize::from(self.breakthrough.is_some())]);
        out.push(u8::try_from(self.bins.len()).unwrap_or(u8::MAX));
        for bin in &self.bins {
            put(&mut out, u64::from(bin.way));
            put(&mut out, u64::from(bin.time));
            // Zig-zag: small energies of either sign stay short.
            put(&mut out, ((bin.energy << 1) ^ (bin.energy >> 63)).cast_unsigned());
        }
        if let Some(depth) = self.breakthrough {
            put(&mut out, u64::from(depth));
        }
        out
    }

    /// The digest of that stored form; `None` where it is damaged.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (&[format, count], mut rest) = bytes.split_first_chunk::<2>()?;
        let count = usize::from(count);
        let opens = FORMATS.iter().position(|known| *known == format)? == 1;
        if count == 0 || count > MOST_DIGEST_BINS {
            return None;
        }
        let mut bins = Vec::with_capacity(count);
        for _ in 0..count {
            let way = u32::try_from(take(&mut rest)?).ok()?;
            let time = u32::try_from(take(&mut rest)?).ok()?;
            let zigzag = take(&mut rest)?;
            let energy = (zigzag >> 1).cast_signed() ^ -((zigzag & 1).cast_signed());
            bins.push(DigestBin { way, time, energy });
        }
        let breakthrough = if opens { Some(u32::try_from(take(&mut rest)?).ok()?) } else { None };
        rest.is_empty().then_some(Self { bins, breakthrough })
    }
}

fn quantised(bin: &DepthBin) -> Option<DigestBin> {
    const MOST: f64 = 4_294_967_295.0;
    const MOST_ENERGY: f64 = 9_007_199_254_740_992.0;
    let (way, time) = ((bin.way_mm / WAY_MM).round(), (bin.time_s / TIME_S).round());
    let energy = (bin.total / ENERGY_J).round();
    let fits = (0.0..=MOST).contains(&way) && (0.0..=MOST).contains(&time) && energy.abs() < MOST_ENERGY;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked to fit")]
    let bin = DigestBin { way: way as u32, time: time as u32, energy: energy as i64 };
    fits.then_some(bin)
}

fn put(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push((value & 0x7f) as u8 | 0x80);
        value >>= 7;
    }
    out.push((value & 0x7f) as u8);
}

fn take(input: &mut &[u8]) -> Option<u64> {
    let mut value = 0_u64;
    for shift in (0..64).step_by(7) {
        let (&byte, rest) = input.split_first()?;
        *input = rest;
        if shift == 63 && byte > 1 {
            return None;
        }
        value |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return Some(value);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_stored_comes_back_and_damage_is_seen(
            bins in proptest::collection::vec((0_u32.., 0_u32.., -(1_i64 << 53)..(1_i64 << 53)), 1..=64),
            opened in proptest::option::of(-1.0..70.0_f64),
            cut in any::<prop::sample::Index>(),
        ) {
            let bins = bins.into_iter().map(|(way, time, energy)| DigestBin { way, time, energy }).collect();
            let digest = DepthDigest { bins, breakthrough: None }.with_breakthrough(opened);
            let bytes = digest.to_bytes();
            prop_assert!(bytes.len() <= MOST_DIGEST_BYTES);
            let columns: Vec<_> = digest.bins().collect();
            prop_assert_eq!(DepthDigest::of_bins(&columns, digest.breakthrough_um()), Some(digest.clone()));
            prop_assert_eq!(DepthDigest::from_bytes(&bytes), Some(digest));
            prop_assert_eq!(DepthDigest::from_bytes(&bytes[..cut.index(bytes.len())]), None);
        }

        #[test]
        fn any_bytes_are_a_digest_or_none(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            if let Some(digest) = DepthDigest::from_bytes(&bytes) {
                prop_assert!(digest.profile().is_some());
                let _ = digest.is_constant_feed();
            }
        }
    }
}
