//! The fold's state as bytes, for the store's cache: bit for bit, versioned, and refused when damaged.

use super::basis::{CompensatedRatio, FeedMemory, KEPT_RATIOS};
use super::facts::OrderKey;
use super::fold::{FOLD_VERSION, LAST_EXCLUDED, MAX_KEYS, ToolFold, UNPLACED_CYCLES};
use super::key::{Baseline, Change, KeyState, Measured, Usual};
use super::trend::{Told, TrendPoints};
use super::verdict::{BaselineKey, Earlier, Exclusion};
use crate::cycle::ProfileVersion;
use crate::friction::relation::Relation;
use crate::ids::{CycleId, MachineId, OperationId, ProfileId};
use crate::operation::WINDOW_CYCLES;
use crate::summary::{DepthDigest, EnergyBasis, relation_config};
use crate::units::{Strategy, Timestamp};

/// Longest list that a state can hold; a longer one is damage.
const MAX_LIST: u64 = 4096;

/// What can be written and read back to the bit.
trait Field: Sized {
    fn put(&self, out: &mut Vec<u8>);
    /// Takes the value off the front of `input`.
    fn take(input: &mut &[u8]) -> Option<Self>;
}

macro_rules! numbers {
    ($($type:ty),*) => {$(
        impl Field for $type {
            fn put(&self, out: &mut Vec<u8>) {
                out.extend_from_slice(&self.to_le_bytes());
            }
            fn take(input: &mut &[u8]) -> Option<Self> {
                let (head, rest) = input.split_first_chunk()?;
                *input = rest;
                Some(Self::from_le_bytes(*head))
            }
        }
    )*};
}
numbers!(u8, u16, u32, u64, i64, f64);

macro_rules! fields {
    ($type:ident { $($field:ident),* $(,)? }) => {
        impl Field for $type {
            fn put(&self, out: &mut Vec<u8>) {
                $(self.$field.put(out);)*
            }
            fn take(input: &mut &[u8]) -> Option<Self> {
                // Struct fields are evaluated in the order written, which is the order of the bytes.
                Some(Self { $($field: Field::take(input)?),* })
            }
        }
    };
}

macro_rules! words {
    ($($type:ty: $put:expr, $take:expr;)*) => {$(
        impl Field for $type {
            fn put(&self, out: &mut Vec<u8>) {
                let text: fn(&$type) -> &str = $put;
                put_text(text(self), out);
            }
            fn take(input: &mut &[u8]) -> Option<Self> {
                let text = String::take(input)?;
                let take: fn(&str) -> Option<$type> = $take;
                take(&text)
            }
        }
    )*};
}

words! {
    MachineId: |id| id.as_str(), |text| MachineId::try_from(text).ok();
    CycleId: |id| id.as_str(), |text| CycleId::try_from(text).ok();
    OperationId: |id| id.as_str(), |text| OperationId::try_from(text).ok();
    ProfileId: |id| id.as_str(), |text| ProfileId::try_from(text).ok();
    EnergyBasis: |basis| basis.as_str(), EnergyBasis::parse;
    Strategy: |strategy| strategy.as_str(), Strategy::parse;
}

impl Field for usize {
    fn put(&self, out: &mut Vec<u8>) {
        (*self as u64).put(out);
    }
    fn take(input: &mut &[u8]) -> Option<Self> {
        Self::try_from(u64::take(input)?).ok()
    }
}

impl Field for bool {
    fn put(&self, out: &mut Vec<u8>) {
        u8::from(*self).put(out);
    }
    fn take(input: &mut &[u8]) -> Option<Self> {
        match u8::take(input)? {
            0 => Some(false),
            1 => Some(true),
            _ => None,
        }
    }
}

fn put_text(text: &str, out: &mut Vec<u8>) {
    (text.len() as u64).put(out);
    out.extend_from_slice(text.as_bytes());
}

impl Field for String {
    fn put(&self, out: &mut Vec<u8>) {
        put_text(self, out);
    }
    fn take(input: &mut &[u8]) -> Option<Self> {
        let len = usize::try_from(u64::take(input)?).ok()?;
        let (head, rest) = input.split_at_checked(len)?;
        *input = rest;
        Self::from_utf8(head.to_vec()).ok()
    }
}

impl<T: Field> Field for Option<T> {
    fn put(&self, out: &mut Vec<u8>) {
        self.is_some().put(out);
        if let Some(value) = self {
            value.put(out);
        }
    }
    fn take(input: &mut &[u8]) -> Option<Self> {
        if bool::take(input)? { Some(Some(T::take(input)?)) } else { Some(None) }
    }
}

impl<T: Field> Field for Vec<T> {
    fn put(&self, out: &mut Vec<u8>) {
        (self.len() as u64).put(out);
        self.iter().for_each(|value| value.put(out));
    }
    fn take(input: &mut &[u8]) -> Option<Self> {
        let len = u64::take(input)?;
        if len > MAX_LIST {
            return None;
        }
        (0..len).map(|_| T::take(input)).collect()
    }
}

impl<A: Field, B: Field> Field for (A, B) {
    fn put(&self, out: &mut Vec<u8>) {
        self.0.put(out);
        self.1.put(out);
    }
    fn take(input: &mut &[u8]) -> Option<Self> {
        Some((A::take(input)?, B::take(input)?))
    }
}

impl<A: Field, B: Field, C: Field> Field for (A, B, C) {
    fn put(&self, out: &mut Vec<u8>) {
        self.0.put(out);
        self.1.put(out);
        self.2.put(out);
    }
    fn take(input: &mut &[u8]) -> Option<Self> {
        Some((A::take(input)?, B::take(input)?, C::take(input)?))
    }
}

impl Field for Timestamp {
    fn put(&self, out: &mut Vec<u8>) {
        self.micros().put(out);
    }
    fn take(input: &mut &[u8]) -> Option<Self> {
        i64::take(input).map(Self::from_micros)
    }
}

impl Field for Exclusion {
    fn put(&self, out: &mut Vec<u8>) {
        (*self as u8).put(out);
    }
    fn take(input: &mut &[u8]) -> Option<Self> {
        Self::from_code(u8::take(input)?)
    }
}

impl Field for [u64; Exclusion::ALL.len()] {
    fn put(&self, out: &mut Vec<u8>) {
        self.iter().for_each(|count| count.put(out));
    }
    fn take(input: &mut &[u8]) -> Option<Self> {
        let mut counts = [0; Exclusion::ALL.len()];
        for count in &mut counts {
            *count = u64::take(input)?;
        }
        Some(counts)
    }
}

impl<const N: usize> Field for [f64; N] {
    fn put(&self, out: &mut Vec<u8>) {
        self.iter().for_each(|value| value.put(out));
    }
    fn take(input: &mut &[u8]) -> Option<Self> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = f64::take(input)?;
        }
        Some(values)
    }
}

impl Field for Relation {
    fn put(&self, out: &mut Vec<u8>) {
        self.to_parts().put(out);
    }
    fn take(input: &mut &[u8]) -> Option<Self> {
        Self::of_parts(relation_config()?, Field::take(input)?)
    }
}

impl Field for DepthDigest {
    fn put(&self, out: &mut Vec<u8>) {
        self.to_bytes().put(out);
    }
    fn take(input: &mut &[u8]) -> Option<Self> {
        Self::from_bytes(&Vec::take(input)?)
    }
}

fields!(CompensatedRatio { worked, own, reference, sd_at_limit });
fields!(FeedMemory {
    varied,
    ever_varied,
    every,
    reference_feed_mm_min,
    references,
    reference_trend,
    last_reference,
    reference_count,
    compensated,
    compensated_trend,
    masked,
});
fields!(OrderKey { started_at, machine, seq, cycle });
fields!(ProfileVersion { profile, version });
fields!(BaselineKey {
    machine,
    operation,
    spindle_speed_rpm,
    basis,
    idle_subtracted,
    in_contact,
    energy_scale,
    strategy,
    law_version,
    profile,
});
fields!(Measured {
    number,
    worked,
    level,
    order,
    joules,
    duration_ms,
    depth_mm,
    fall_depth_mm,
    breakthrough_mm,
    operator_percent,
    digest,
});
fields!(Baseline {
    joules,
    duration_ms,
    depth_mm,
    fall_depth_mm,
    breakthrough_mm,
    operator_percent,
    learnt_from
});
fields!(Usual { joules, duration_ms, depth_mm, breakthrough_mm });
fields!(Change { before, back });
fields!(Earlier { until, joules });
/// Found anew of what was read.
impl Field for Told {
    fn put(&self, _: &mut Vec<u8>) {}
    fn take(_: &mut &[u8]) -> Option<Self> {
        Some(Self::default())
    }
}
fields!(TrendPoints { per_point, points, filling, count, told });
fields!(KeyState {
    key,
    needed,
    window,
    level_at_entry,
    unconfirmed,
    after_gap,
    stepped,
    knows_since,
    last_usual,
    before,
    earlier,
    learning,
    baseline,
    recent,
    energy_noise,
    time_noise,
    sheet_noise,
    off,
    seen,
    flips,
    change,
    relation,
    reference_feed_mm_min,
    used,
});

fields!(ToolFold {
    last,
    life,
    unworn,
    awaiting_mount,
    known_at_us,
    unplaced_us,
    announced_until,
    answered_at,
    cycles,
    worked,
    known_worked,
    since_gap,
    gap_ended,
    counted,
    taught,
    last_counted,
    last_counted_us,
    unmeasured,
    excluded,
    last_excluded,
    keys,
    evicted,
    current,
    ratios,
    window,
    warned,
    worn,
    suspects,
    suspected_since,
    trend,
    feeds,
});

/// Most states are shorter once a baseline is learnt: they are written without asking for more room on the way.
const USUAL_BYTES: usize = 6 * 1024;

impl ToolFold {
    /// The state as bytes, for the store's cache.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(USUAL_BYTES);
        FOLD_VERSION.put(&mut out);
        self.put(&mut out);
        out
    }

    /// The state of those bytes; `None` where they are of another version or damaged, so that it is refolded.
    pub fn from_bytes(mut bytes: &[u8]) -> Option<Self> {
        let input = &mut bytes;
        if u16::take(input)? != FOLD_VERSION {
            return None;
        }
        let fold: Self = Field::take(input)?;
        let sound = fold.keys.len() <= MAX_KEYS
            && fold.last_excluded.len() <= LAST_EXCLUDED
            && fold.unplaced_us.len() <= UNPLACED_CYCLES + 1
            && fold.current.is_none_or(|at| at < fold.keys.len())
            && fold.last_counted <= fold.cycles
            && fold.worked <= fold.cycles
            && fold.known_worked <= fold.cycles
            && fold.since_gap.as_ref().is_none_or(|since| since.len() <= *WINDOW_CYCLES.end() as usize)
            && fold.gap_ended <= fold.cycles
            && fold.feeds.last_reference.is_none_or(|number| number <= fold.cycles)
            && fold.feeds.references.len() <= KEPT_RATIOS
            && fold.feeds.compensated.len() <= KEPT_RATIOS;
        (sound && input.is_empty()).then_some(fold)
    }
}
