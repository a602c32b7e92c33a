//! What other columns of a block say of a column: what is stored is how far it is off that.
//!
//! An actual feed follows the *command*, programmed feed × override. A depth follows what feeds amount to, the actual one or the
//! command, whichever it keeps to. What a drive does (its load, power, current, the torque of its motor) follows the force or torque
//! that it works against, by a line, whose slope is that of their changes over some values. All of them are known to less than a
//! unit of the column, and so is how far it has been off of late: what is rounded away is predicted too.

use super::column::{Column, Columns, Time};
use super::frame::Way;
use super::habit::Usual;
use super::predict::{Predictor, Residuals, tried};
use feedwright_core::cycle::Channel;
use std::ops::Range;

/// Bits of the fraction of what a guide says.
const BITS: u32 = 16;
const HALF: i64 = 1 << (BITS - 1);
/// Bits of the fraction of a [`Guide::Travel`]'s factor; a [`Guide::Line`]'s has [`BITS`].
const TRAVEL_BITS: u32 = 24;
/// Bits of the fraction that a power of ten is taken by.
const POWER_BITS: u32 = 48;
/// An actual feed has at most so many decimals more, or fewer, than the product of programmed feed and override.
const MOST_FINER: i32 = 3;
const COARSEST: i32 = -9;
/// Largest factor that is written.
const MOST_FACTOR: f64 = (1_u64 << 40) as f64;
/// Fewer values do not pay for a guide.
const FEWEST: usize = 33;
/// A column that follows is below, and so is what is said of it: then no sum of a prediction leaves 64 bits with its fraction, and
/// a writer's are a reader's.
const LIMIT: u64 = 1 << 44;
/// Longest memory, as a power of two.
pub(super) const MOST_MEMORY: u8 = 7;

/// Columns of one drive; the first that is there guides the others: forces and torques that are measured are known better than
/// loads.
const DRIVES: [[Channel; 5]; 2] = [
    [
        Channel::TorqueNewtonMetres,
        Channel::SpindleTorqueNewtonMetres,
        Channel::SpindlePowerWatts,
        Channel::SpindleCurrentAmperes,
        Channel::SpindleLoadPercent,
    ],
    [
        Channel::ThrustNewtons,
        Channel::FeedDriveTorqueNewtonMetres,
        Channel::FeedDrivePowerWatts,
        Channel::FeedDriveCurrentAmperes,
        Channel::FeedDriveLoadPercent,
    ],
];

/// The code of the command, where that of a channel could stand.
const COMMAND: u8 = 0;

/// What a column follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Guide {
    /// Programmed feed × override.
    Command,
    /// `factor / 2^24` of all that a feed, or the command, has been since the first value.
    Travel { feed: Option<Channel>, factor: i64 },
    /// `factor / 2^16` of another column.
    Line { of: Channel, factor: i64 },
}

/// A guide, with how long it is remembered how far the column was off it: a value counts 1/2^`memory`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Following {
    pub(super) guide: Guide,
    pub(super) memory: u8,
}

impl Guide {
    /// The guide of a channel by the code that stands in its block; `None` where it can have none of it.
    pub(super) fn of_code(channel: Channel, code: u8, factor: impl FnOnce() -> Option<i64>) -> Option<Self> {
        match (channel, Channel::from_code(code)) {
            (Channel::FeedActualMmMin, None) if code == COMMAND => Some(Self::Command),
            (Channel::DepthMm, None) if code == COMMAND => {
                Some(Self::Travel { feed: None, factor: factor()? })
            }
            (Channel::DepthMm, feed @ Some(Channel::FeedActualMmMin)) => {
                Some(Self::Travel { feed, factor: factor()? })
            }
            (_, Some(of)) if leads(of, channel) => Some(Self::Line { of, factor: factor()? }),
            _ => None,
        }
    }

    /// What stands in a block: a code, and a factor where there is one.
    pub(super) const fn code(self) -> (u8, Option<i64>) {
        match self {
            Self::Command => (COMMAND, None),
            Self::Travel { feed: None, factor } => (COMMAND, Some(factor)),
            Self::Travel { feed: Some(channel), factor } | Self::Line { of: channel, factor } => {
                (channel as u8, Some(factor))
            }
        }
    }

    /// Whether both are of the same, by whatever factor.
    pub(super) fn is_like(self, other: Self) -> bool {
        self.code().0 == other.code().0
    }

    /// Columns are read in ascending order: what a column follows is there by then.
    pub(super) const fn order(guide: Option<Self>) -> u8 {
        match guide {
            None => 0,
            Some(Self::Command) => 1,
            Some(Self::Travel { .. } | Self::Line { .. }) => 2,
        }
    }

    /// What it says of each value of a column of that scale, in 1/2^16 of its unit; `None` where there is nothing to say it
    /// by. Values of a damaged block may wrap; those of machines do not come near.
    pub(super) fn says<'c>(
        self,
        column: impl Fn(Channel) -> Option<&'c Column>,
        scale: u8,
    ) -> Option<Vec<i64>> {
        let decimals = |channel| column(channel)?.decimals();
        match self {
            Self::Command => Command::of(decimals)?.in_units_of(scale),
            Self::Travel { feed: None, factor } => Some(travel(Command::of(decimals)?.products(), factor)),
            Self::Travel { feed: Some(channel), factor } => {
                Some(travel(decimals(channel)?.0.iter().copied(), factor))
            }
            Self::Line { of, factor } => {
                Some(decimals(of)?.0.iter().map(|value| value.wrapping_mul(factor)).collect())
            }
        }
    }
}

/// Whether a column of a drive may guide another one of it.
fn leads(first: Channel, channel: Channel) -> bool {
    let place = |drive: &[Channel], wanted| drive.iter().position(|channel| *channel == wanted);
    DRIVES.iter().any(|drive| place(drive, first).zip(place(drive, channel)).is_some_and(|(a, b)| a < b))
}

/// Programmed feed × override, in units of 10^−`scale` mm/min.
struct Command<'c> {
    feed: &'c [i64],
    percent: &'c [i64],
    scale: i32,
}

impl<'c> Command<'c> {
    fn of(decimals: impl Fn(Channel) -> Option<(&'c [i64], u8)>) -> Option<Self> {
        let (feed, feed_scale) = decimals(Channel::FeedProgrammedMmMin)?;
        let (percent, percent_scale) = decimals(Channel::OverridePercent)?;
        Some(Self { feed, percent, scale: i32::from(feed_scale) + i32::from(percent_scale) + 2 })
    }

    fn products(self) -> impl Iterator<Item = i64> + 'c {
        self.feed.iter().zip(self.percent).map(|(feed, percent)| feed.wrapping_mul(*percent))
    }

    /// In 1/2^16 of 10^−`scale` mm/min; `None` where that is too fine or too coarse.
    fn in_units_of(self, scale: u8) -> Option<Vec<i64>> {
        let finer = i32::from(scale) - self.scale;
        let whole = 1_i64 << POWER_BITS;
        let factor = match finer {
            0..=MOST_FINER => whole * 10_i64.pow(finer.unsigned_abs()),
            COARSEST..0 => {
                let over = 10_i64.pow(finer.unsigned_abs());
                (whole + over / 2) / over
            }
            _ => return None,
        };
        #[expect(clippy::cast_possible_truncation, reason = "values of a damaged block may wrap")]
        let scaled =
            |product: i64| ((i128::from(product) * i128::from(factor)) >> (POWER_BITS - BITS)) as i64;
        Some(self.products().map(scaled).collect())
    }
}

/// Where a feed has come to at each value, being at 0 at the first.
fn travel(feed: impl Iterator<Item = i64>, factor: i64) -> Vec<i64> {
    let mut way = 0_i64;
    let ways = feed.enumerate().map(|(at, feed)| {
        if at > 0 {
            way = way.wrapping_add(feed.wrapping_mul(factor));
        }
        way >> (TRAVEL_BITS - BITS)
    });
    ways.collect()
}

/// How far a column has been off its guide of late, in 1/2^16.
#[derive(Clone, Copy)]
struct Off(i64);

impl Off {
    /// The value that is expected.
    #[inline(always)]
    const fn next(self, said: i64) -> i64 {
        said.wrapping_add(self.0).wrapping_add(HALF) >> BITS
    }

    /// How far a value that is so far off the guide is off what is expected.
    #[inline(always)]
    const fn residual(self, off: i64) -> i64 {
        // A value is whole, so that it can be left out of both sides.
        (self.0.wrapping_add(HALF).wrapping_sub(off) >> BITS).wrapping_neg()
    }

    /// With one more value, which counts 1/2^`memory`.
    #[inline(always)]
    const fn follow(&mut self, off: i64, memory: u32) {
        self.0 = self.0.wrapping_add(off.wrapping_sub(self.0) >> memory);
    }
}

/// How far a value is off what a guide says.
#[inline(always)]
const fn off(said: i64, value: i64) -> i64 {
    (value << BITS).wrapping_sub(said)
}

impl Following {
    /// The places after the first up to `len`, with what their values count: as long as there are few, about as much as each of them.
    fn counts(self, len: usize) -> impl Iterator<Item = (Range<usize>, u32)> {
        let (most, begins) = (u32::from(self.memory), move |memory: u32| ((1 << memory) - 1).max(1).min(len));
        (0..=most).map(move |memory| {
            (begins(memory)..if memory == most { len } else { begins(memory + 1) }, memory)
        })
    }

    /// How far each value after the first is off what is expected, of how far each is off its guide.
    fn residuals(self, mut offs: Vec<i64>) -> Vec<i64> {
        let Some(&first) = offs.first() else { return offs };
        let mut before = Off(first);
        for (places, memory) in self.counts(offs.len()) {
            for place in &mut offs[places] {
                let off = *place;
                *place = before.residual(off);
                before.follow(off, memory);
            }
        }
        offs.remove(0);
        offs
    }

    /// Puts values back together behind the first; `None` where a residual is missing.
    pub(super) fn restore<R: Residuals>(self, said: &[i64], values: &mut [i64], mut reader: R) -> Option<R> {
        let (first, residuals) = values.split_first_mut()?;
        let mut before = Off(off(*said.first()?, *first));
        reader.read(residuals)?;
        for (places, memory) in self.counts(values.len()) {
            for (value, &said) in values[places.clone()].iter_mut().zip(&said[places]) {
                *value = before.next(said).wrapping_add(*value);
                before.follow(off(said, *value), memory);
            }
        }
        Some(reader)
    }
}

/// A column that follows a guide, with how far it is off.
#[derive(Debug)]
pub(super) struct Guided {
    pub(super) following: Following,
    pub(super) residuals: Vec<i64>,
}

/// Guides of a block's channels, in their order; as `usual`, where that is known of a channel.
pub(super) fn choose(columns: &Columns, usual: impl Fn(Channel) -> Option<Usual>) -> Vec<Option<Guided>> {
    let column =
        |wanted| columns.channels.iter().find_map(|(channel, column)| (*channel == wanted).then_some(column));
    let one = |(channel, followed): &(Channel, Column)| {
        let usual = usual(*channel);
        if let Some(Usual { way: Way::Alone(_), .. }) = usual {
            return None;
        }
        let (values, scale) = followed.decimals().filter(|_| columns.len >= FEWEST)?;
        let may = || guides(*channel, (values, scale), &columns.time, column).into_iter().flatten();
        if let Some(Usual { way: Way::Guided(before), is_settled, .. }) = usual {
            // A way's factor is of this block's period and direction.
            if is_settled && !matches!(before.guide, Guide::Travel { .. }) {
                let offs = offs(before.guide.says(column, scale)?, values)?;
                return Some(Guided { following: before, residuals: before.residuals(offs) });
            }
            let guide = may().find(|guide| guide.is_like(before.guide))?;
            let offs = offs(guide.says(column, scale)?, values)?;
            let following = Following { guide, memory: Walk::of(&offs).memory() };
            return Some(Guided { following, residuals: following.residuals(offs) });
        }
        let known = may().filter_map(|guide| {
            let offs = offs(guide.says(column, scale)?, values)?;
            let walk = Walk::of(&offs);
            Some((guide, offs, walk))
        });
        let (guide, offs, walk) = known.min_by(|(_, _, a), (_, _, b)| a.far.total_cmp(&b.far))?;
        let following = Following { guide, memory: walk.memory() };
        let guided = Guided { following, residuals: following.residuals(offs) };
        guided.pays(values).then_some(guided)
    };
    columns.channels.iter().map(one).collect()
}

/// What a column may follow.
fn guides<'c>(
    channel: Channel,
    (values, scale): (&[i64], u8),
    time: &Time,
    column: impl Fn(Channel) -> Option<&'c Column>,
) -> [Option<Guide>; 2] {
    let decimals = |channel| column(channel)?.decimals();
    match (channel, time) {
        (Channel::FeedActualMmMin, _) => [Some(Guide::Command), None],
        (Channel::DepthMm, Time::Period(period_ms)) => {
            let travel = |feed, feed_scale| {
                // Of a mm/min in a period.
                let way = f64::from_bits(*period_ms) / 60_000.0 * 10_f64.powi(i32::from(scale) - feed_scale);
                let factor = whole(way * f64::from(1_u32 << TRAVEL_BITS))?;
                let goes_up = values.last() >= values.first();
                Some(Guide::Travel { feed, factor: if goes_up { factor } else { -factor } })
            };
            let actual = Channel::FeedActualMmMin;
            [
                Command::of(decimals).and_then(|command| travel(None, command.scale)),
                decimals(actual).and_then(|(_, scale)| travel(Some(actual), scale.into())),
            ]
        }
        (Channel::DepthMm, Time::Stamps(_)) => [None; 2],
        (channel, _) => {
            let line = |drive: &[Channel]| {
                let (of, leader) = drive.iter().find_map(|one| Some((*one, decimals(*one)?.0)))?;
                let factor = leads(of, channel).then(|| shared_slope(leader, values)).flatten()?;
                Some(Guide::Line { of, factor })
            };
            [DRIVES.iter().find(|drive| drive.contains(&channel)).and_then(|drive| line(drive)), None]
        }
    }
}

/// The slope by which what changes in one column over some values changes in the other.
#[expect(clippy::cast_precision_loss, reason = "a slope")]
fn shared_slope(of: &[i64], values: &[i64]) -> Option<i64> {
    const OVER: usize = 8;
    let (mut both, mut alone) = (0.0, 0.0);
    for (of, value) in of.windows(OVER + 1).zip(values.windows(OVER + 1)).step_by(STEP) {
        let change = |w: &[i64]| w[OVER].wrapping_sub(w[0]) as f64;
        let (of, value) = (change(of), change(value));
        both += of * value;
        alone += of * of;
    }
    whole(both / alone * f64::from(1_u32 << BITS))
}

/// `None` where it is nothing, or too large to be written.
#[expect(clippy::cast_possible_truncation, reason = "below 2^40")]
fn whole(factor: f64) -> Option<i64> {
    let factor = factor.round();
    (factor.abs() >= 1.0 && factor.abs() <= MOST_FACTOR).then_some(factor as i64)
}

impl Guided {
    /// Whether the column is not predicted as well by itself. Some bytes are written for a guide: a sixteenth of the size of
    /// residuals is a tenth of a bit of each. What never surprises needs none.
    fn pays(&self, values: &[i64]) -> bool {
        let (_, alone) = Predictor::best(values, tried(values.len()));
        // Of the same values, so that what nobody could foretell weighs the same on both sides.
        let sizes = |places: Range<usize>| self.residuals[places.start - 1..places.end - 1].iter();
        let guided: u64 = tried(values.len()).flat_map(sizes).map(|residual| residual.unsigned_abs()).sum();
        u128::from(guided) * 16 < u128::from(alone) * 15
    }
}

/// Not 0 where a value, or what is said of it, is not below [`LIMIT`].
#[inline(always)]
const fn beyond(said: i64, value: i64) -> i64 {
    const fn bits(value: i64, limit: u64) -> i64 {
        value.wrapping_add(limit.cast_signed()) & !(2 * limit - 1).cast_signed()
    }
    bits(value, LIMIT) | bits(said, LIMIT << BITS)
}

/// How far values are off what is said of them; `None` where either is not below [`LIMIT`].
fn offs(mut said: Vec<i64>, values: &[i64]) -> Option<Vec<i64>> {
    let mut all = 0;
    for (said, value) in said.iter_mut().zip(values) {
        all |= beyond(*said, *value);
        *said = off(*said, *value);
    }
    (all == 0 && said.len() == values.len()).then_some(said)
}

/// How far a column is off its guide: by noise around what walks.
#[derive(Clone, Copy)]
struct Walk {
    /// Mean squares of how much more it is off than one value before, and than [`Walk::over`] before.
    near: f64,
    far: f64,
    over: usize,
}

/// The longer the way, the better a walk is told from noise, and the fewer there are of it in a short column.
const FAR: [usize; 2] = [16, 64];
/// Every so many values are looked at.
const STEP: usize = 2;

impl Walk {
    #[expect(clippy::cast_precision_loss, reason = "a choice")]
    fn of(offs: &[i64]) -> Self {
        let over = FAR[usize::from(offs.len() > 4 * FAR[1])];
        let (mut near, mut far) = (0.0, 0.0);
        let mut places = 0.0;
        for offs in offs.windows(over + 1).step_by(STEP) {
            near += (offs[over].wrapping_sub(offs[over - 1]) as f64).powi(2);
            far += (offs[over].wrapping_sub(offs[0]) as f64).powi(2);
            places += 1.0;
        }
        Self { near: near / places, far: far / places, over }
    }

    /// How long to remember how far the column was off: where a step of the walk is q times the noise in its variance, the best
    /// share of the newest value is (√(q² + 4q) − q) / 2 (Muth, 1960).
    #[expect(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "0 to 7"
    )]
    fn memory(self) -> u8 {
        // near = 2 noise + walk, far = 2 noise + over · walk
        let walk = ((self.far - self.near) / (self.over - 1) as f64).max(0.0);
        let noise = (self.near - walk) / 2.0;
        if noise <= 0.0 {
            return 0;
        }
        let q = walk / noise;
        let share = ((q * q + 4.0 * q).sqrt() - q) / 2.0;
        (-share.log2()).round().clamp(0.0, f64::from(MOST_MEMORY)) as u8
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::predict::tests::Listed;
    use super::*;
    use proptest::prelude::*;

    /// Noise that is the same in every run, from −`size` to `size`.
    fn noise(state: &mut u64, size: i64) -> i64 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        ((i64::try_from(*state >> 40).unwrap() * (2 * size + 1)) >> 24) - size
    }

    fn decimal(scale: u8, values: Vec<i64>) -> Column {
        Column::Decimal { scale, values }
    }

    /// A drilled hole at 100 Hz: the depth in µm follows programmed feed × override, loads follow thrust and torque.
    pub(in super::super) fn drilled(len: i64, seed: u64) -> Columns {
        let mut state = seed;
        let (mut programmed, mut percent, mut actual) = (Vec::new(), Vec::new(), Vec::new());
        let (mut depth, mut way) = (Vec::new(), -3_000_000);
        let [mut thrust, mut torque, mut feed_load, mut spindle_load] = [const { Vec::new() }; 4];
        for k in 0..len {
            programmed.push(100 + k / 2);
            percent.push(100 + k % 40);
            let fed = (100 + k / 2) * (100 + k % 40);
            actual.push((fed + 50) / 100 + noise(&mut state, 1));
            way += fed;
            depth.push((way + 300).div_euclid(600));
            thrust.push(k * (len - k) / 40 + noise(&mut state, 6));
            torque.push(500 + k * 3 + noise(&mut state, 9));
            feed_load.push(thrust[thrust.len() - 1] / 4 + noise(&mut state, 1));
            spindle_load.push(torque[torque.len() - 1] / 3 + noise(&mut state, 1));
        }
        let channels = vec![
            (Channel::DepthMm, decimal(3, depth)),
            (Channel::FeedProgrammedMmMin, decimal(0, programmed)),
            (Channel::FeedActualMmMin, decimal(0, actual)),
            (Channel::OverridePercent, decimal(0, percent)),
            (Channel::FeedDriveLoadPercent, decimal(1, feed_load)),
            (Channel::SpindleLoadPercent, decimal(1, spindle_load)),
            (Channel::ThrustNewtons, decimal(0, thrust)),
            (Channel::TorqueNewtonMetres, decimal(2, torque)),
        ];
        Columns { len: channels[0].1.len(), time: Time::Period(10.0_f64.to_bits()), channels }
    }

    impl Column {
        fn len(&self) -> usize {
            match self {
                Self::Decimal { values, .. } => values.len(),
                Self::Exact(bits) => bits.len(),
            }
        }
    }

    fn guides_of(columns: &Columns) -> Vec<(Channel, Guide)> {
        let chosen = choose(columns, |_| None);
        let pairs = columns.channels.iter().zip(&chosen);
        pairs
            .filter_map(|((channel, _), guided)| Some((*channel, guided.as_ref()?.following.guide)))
            .collect()
    }

    #[test]
    fn what_follows_is_told_from_its_numbers() {
        let columns = drilled(400, 7);
        let guides = guides_of(&columns);
        let [
            (Channel::DepthMm, Guide::Travel { feed: None, factor: 27_962 }),
            (Channel::FeedActualMmMin, Guide::Command),
            (Channel::FeedDriveLoadPercent, Guide::Line { of: Channel::ThrustNewtons, factor: quarter }),
            (Channel::SpindleLoadPercent, Guide::Line { of: Channel::TorqueNewtonMetres, factor: third }),
        ] = guides[..]
        else {
            panic!("{guides:?}")
        };
        assert!((quarter - (1 << BITS) / 4).abs() < 1000, "{quarter}");
        assert!((third - (1 << BITS) / 3).abs() < 1000, "{third}");
        // Where the command is not there a depth follows the actual feed; upwards too.
        let mut upwards = columns;
        upwards.channels.retain(|(channel, _)| *channel != Channel::OverridePercent);
        for (channel, column) in &mut upwards.channels {
            if let (Channel::DepthMm, Column::Decimal { values, .. }) = (channel, column) {
                values.iter_mut().for_each(|value| *value = -*value);
            }
        }
        let guides = guides_of(&upwards);
        let feed = Some(Channel::FeedActualMmMin);
        assert_eq!(guides[0], (Channel::DepthMm, Guide::Travel { feed, factor: -2_796_203 }));
    }

    /// What is rounded away of a depth is known from the feed: it hardly surprises, where its steps alone would take a bit.
    #[test]
    fn fractions_are_followed() {
        let columns = drilled(400, 7);
        let chosen = choose(&columns, |_| None);
        let surprises = |at: usize| {
            let residuals = &chosen[at].as_ref().unwrap().residuals;
            residuals.iter().filter(|residual| **residual != 0).count()
        };
        assert!(surprises(0) < 40, "depth: {}", surprises(0));
        // Its noise is one of three values.
        assert!((200..300).contains(&surprises(2)), "actual feed: {}", surprises(2));
    }

    #[test]
    fn nobody_follows_what_says_nothing_of_it() {
        let mut state = 3;
        let noisy = |state: &mut u64, size| (0..200).map(|_| noise(state, size)).collect::<Vec<_>>();
        // Around nothing, the memory of a guide that says nothing foretells more than any predictor does; a walk goes on from
        // where it is.
        let walk = |state: &mut u64| {
            let steps = noisy(state, 50).into_iter();
            steps
                .scan(0, |at, step| {
                    *at += step;
                    Some(*at)
                })
                .collect::<Vec<i64>>()
        };
        let channels = vec![
            (Channel::DepthMm, decimal(3, noisy(&mut state, 5))),
            (Channel::FeedProgrammedMmMin, decimal(0, vec![100; 200])),
            (Channel::FeedActualMmMin, decimal(0, (0..200).map(|k| k * k).collect())),
            (Channel::OverridePercent, Column::Exact(vec![0.1_f64.to_bits(); 200])),
            (Channel::FeedDriveLoadPercent, decimal(1, walk(&mut state))),
            (Channel::ThrustNewtons, decimal(0, walk(&mut state))),
        ];
        let mut columns = Columns { len: 200, time: Time::Period(10.0_f64.to_bits()), channels };
        assert_eq!(guides_of(&columns), []);
        // Nor where nothing surprises: what is steady by itself needs nobody.
        let steady = [
            (Channel::FeedProgrammedMmMin, decimal(0, vec![100; 200])),
            (Channel::FeedActualMmMin, decimal(0, vec![100; 200])),
            (Channel::OverridePercent, decimal(0, vec![100; 200])),
        ];
        let steady = Columns { len: 200, time: Time::Period(10.0_f64.to_bits()), channels: steady.to_vec() };
        assert_eq!(guides_of(&steady), []);
        // Nor by times, nor where there are few values, nor where they are too large to be multiplied.
        columns = drilled(400, 7);
        columns.time = Time::Stamps(decimal(0, (0..400).collect()));
        assert!(guides_of(&columns).iter().all(|(channel, _)| *channel != Channel::DepthMm));
        assert_eq!(guides_of(&drilled(32, 7)), []);
        columns = drilled(400, 7);
        for (_, column) in &mut columns.channels {
            let Column::Decimal { values, .. } = column else { continue };
            values[200] = (1 << 53) - 1;
        }
        assert_eq!(guides_of(&columns), []);
    }

    #[test]
    fn a_longer_memory_is_for_less_of_a_walk() {
        let mut state = 5;
        let mut memory = |step: i64, size: i64| {
            let mut at = 0;
            let offs: Vec<i64> = (0..4000)
                .map(|_| {
                    at += noise(&mut state, step);
                    at + noise(&mut state, size)
                })
                .collect();
            Walk::of(&offs).memory()
        };
        assert_eq!(memory(1000, 0), 0);
        assert!(memory(0, 1000) >= 5);
        // The walk's variance a quarter of the noise's, and a hundredth: shares of 0.39 and 0.095.
        assert_eq!(memory(500, 1000), 1);
        assert!((3..=4).contains(&memory(100, 1000)));
        assert_eq!(Walk::of(&[0; 100]).memory(), 0);
    }

    const MOST: i64 = LIMIT.cast_signed() - 1;
    const MOST_SAID: i64 = (LIMIT << BITS).cast_signed() - 1;

    fn any_value() -> impl Strategy<Value = i64> {
        prop_oneof![-50_i64..50, -1_000_000_i64..1_000_000, -MOST..=MOST, Just(MOST), Just(-MOST - 1)]
    }

    fn any_said() -> impl Strategy<Value = i64> {
        prop_oneof![
            -50_i64..50,
            -1_000_000_i64..1_000_000,
            -MOST_SAID..=MOST_SAID,
            Just(MOST_SAID),
            Just(-MOST_SAID - 1)
        ]
    }

    #[test]
    fn what_is_too_large_is_not_followed() {
        assert!(offs(vec![MOST_SAID, -MOST_SAID - 1], &[-MOST - 1, MOST]).is_some());
        assert!(offs(vec![0], &[MOST + 1]).is_none() && offs(vec![0], &[-MOST - 2]).is_none());
        assert!(offs(vec![MOST_SAID + 1], &[0]).is_none() && offs(vec![-MOST_SAID - 2], &[0]).is_none());
        assert!(offs(vec![0], &[0, 0]).is_none());
    }

    proptest! {
        /// Up to the largest numbers that are let through; those beyond, as of a damaged block, do no harm.
        #[test]
        fn whatever_the_guide_says_values_come_back(
            pairs in prop_oneof![
                prop::collection::vec((any_said(), any_value()), 1..300),
                prop::collection::vec((any::<i64>(), any::<i64>()), 1..20),
            ],
            memory in 0..=MOST_MEMORY,
        ) {
            let (said, values): (Vec<i64>, Vec<i64>) = pairs.into_iter().unzip();
            let following = Following { guide: Guide::Command, memory };
            let offs = offs(said.clone(), &values);
            let residuals = offs.clone().map_or_else(|| vec![1; values.len() - 1], |offs| following.residuals(offs));
            prop_assert_eq!(residuals.len(), values.len() - 1);
            let mut back = vec![0; values.len()];
            back[0] = values[0];
            let rest = following.restore(&said, &mut back, Listed(&residuals));
            prop_assert!(rest.is_some_and(|rest| rest.0.is_empty()));
            if offs.is_some() {
                prop_assert_eq!(&back, &values);
            }
            let short = &residuals[..residuals.len().saturating_sub(1)];
            prop_assert_eq!(following.restore(&said, &mut back, Listed(short)).is_none(), values.len() > 1);
        }

        #[test]
        fn a_guide_is_known_by_its_code(
            channel in prop::sample::select(Channel::ALL),
            code in any::<u8>(),
            factor in any::<i64>(),
        ) {
            if let Some(guide) = Guide::of_code(channel, code, || Some(factor)) {
                let (again, with) = guide.code();
                prop_assert_eq!(again, code);
                prop_assert_eq!(with.is_some(), guide != Guide::Command);
                prop_assert!(with.is_none_or(|with| with == factor));
            }
        }
    }
}
