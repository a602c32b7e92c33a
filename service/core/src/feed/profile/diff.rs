//! Two profiles beside each other: settings that differ, knots that moved, and what each stretch gains in time.

use super::{KnotInput, Profile, SectionKind, Thousandths, whole};

/// A setting that differs, by the name that it has in the canonical text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Setting {
    /// Name.
    pub name: &'static str,
    /// Before; empty where it was not there.
    pub before: String,
    /// After; empty where it is gone.
    pub after: String,
}

/// What happened to a knot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Change {
    /// Only the later profile has a knot at this depth; the earlier one's feed there is interpolated.
    Added {
        /// Feed of the later profile, mm/min.
        after_mm_min: f64,
        /// Feed of the earlier profile at that depth, mm/min.
        before_mm_min: f64,
    },
    /// Only the earlier profile has one.
    Removed {
        /// Feed of the earlier profile, mm/min.
        before_mm_min: f64,
        /// Feed of the later profile at that depth, mm/min.
        after_mm_min: f64,
    },
    /// Both have one, with other feeds.
    Changed {
        /// Feed of the earlier profile, mm/min.
        before_mm_min: f64,
        /// Feed of the later profile, mm/min.
        after_mm_min: f64,
    },
}

/// A knot that is not the same in both.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnotChange {
    /// Its depth, mm.
    pub depth_mm: f64,
    /// What happened.
    pub change: Change,
}

/// A section of the later profile, and the time each takes over its stretch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SectionDiff {
    /// What happens in it, in the later profile.
    pub kind: SectionKind,
    /// Where it begins, mm.
    pub from_mm: f64,
    /// Where it ends, mm.
    pub to_mm: f64,
    /// Time of the earlier profile over it, s.
    pub before_s: f64,
    /// Time of the later profile over it, s.
    pub after_s: f64,
    /// Largest rise of the feed within it, mm/min; 0 where it nowhere rises.
    pub largest_rise_mm_min: f64,
    /// Largest fall of the feed within it, mm/min; 0 where it nowhere falls.
    pub largest_fall_mm_min: f64,
}

/// What differs between two profiles.
#[derive(Debug, Clone, PartialEq)]
pub struct ProfileDiff {
    /// Settings that differ.
    pub settings: Vec<Setting>,
    /// Knots that are not the same in both, by depth.
    pub knots: Vec<KnotChange>,
    /// The later profile's sections.
    pub sections: Vec<SectionDiff>,
    /// Time of the earlier profile, s.
    pub before_s: f64,
    /// Time of the later profile, s.
    pub after_s: f64,
}

impl ProfileDiff {
    /// Whether the contents are the same.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.settings.is_empty() && self.knots.is_empty()
    }
}

/// What differs between an earlier and a later profile.
#[must_use]
pub fn diff(before: &Profile, after: &Profile) -> ProfileDiff {
    ProfileDiff {
        settings: settings(before, after),
        knots: knots(before, after),
        sections: sections(before, after),
        before_s: before.time_s(),
        after_s: after.time_s(),
    }
}

fn settings(before: &Profile, after: &Profile) -> Vec<Setting> {
    let join = |profile: &Profile| {
        let mut lines: Vec<(&'static str, String)> = Vec::new();
        for (name, value) in profile.header() {
            match lines.last_mut() {
                // Sections are one setting: their borders only mean something together.
                Some((last, text)) if *last == name => {
                    text.push_str(", ");
                    text.push_str(&value);
                }
                _ => lines.push((name, value)),
            }
        }
        lines
    };
    let pairs = join(before).into_iter().zip(join(after));
    pairs
        .filter(|(left, right)| left.1 != right.1)
        .map(|(left, right)| Setting { name: left.0, before: left.1, after: right.1 })
        .collect()
}

fn knots(before: &Profile, after: &Profile) -> Vec<KnotChange> {
    let feed = |profile: &Profile, depth: Thousandths| {
        profile.knots.iter().find(|knot| knot.depth == depth).map(|knot| knot.feed)
    };
    depths(before, after)
        .into_iter()
        .filter_map(|depth| {
            let depth_mm = whole(depth);
            let change = match (feed(before, depth), feed(after, depth)) {
                (Some(left), Some(right)) if left == right => return None,
                (Some(left), Some(right)) => {
                    Change::Changed { before_mm_min: whole(left), after_mm_min: whole(right) }
                }
                (Some(left), None) => {
                    Change::Removed { before_mm_min: whole(left), after_mm_min: after.feed_at(depth_mm) }
                }
                (None, Some(right)) => {
                    Change::Added { after_mm_min: whole(right), before_mm_min: before.feed_at(depth_mm) }
                }
                (None, None) => return None,
            };
            Some(KnotChange { depth_mm, change })
        })
        .collect()
}

/// Depths at which either has a knot, ascending.
fn depths(before: &Profile, after: &Profile) -> Vec<Thousandths> {
    let mut depths: Vec<Thousandths> =
        before.knots.iter().chain(&after.knots).map(|knot| knot.depth).collect();
    depths.sort_unstable();
    depths.dedup();
    depths
}

fn sections(before: &Profile, after: &Profile) -> Vec<SectionDiff> {
    let bends: Vec<f64> = depths(before, after).into_iter().map(whole).collect();
    let mut from_mm = 0.0;
    after
        .sections()
        .map(|section| {
            let (start, to_mm) = (from_mm, section.to_mm);
            from_mm = to_mm;
            let inside = bends.iter().copied().filter(|depth| (start..=to_mm).contains(depth));
            // Both are linear between bends and borders, so the largest difference lies on one of them.
            let (mut rise, mut fall) = (0.0_f64, 0.0_f64);
            for depth in inside.chain([start, to_mm]) {
                let change = after.feed_at(depth) - before.feed_at(depth);
                rise = rise.max(change);
                fall = fall.max(-change);
            }
            SectionDiff {
                kind: section.kind,
                from_mm: start,
                to_mm,
                before_s: before.time_between_s(start, to_mm),
                after_s: after.time_between_s(start, to_mm),
                largest_rise_mm_min: rise,
                largest_fall_mm_min: fall,
            }
        })
        .collect()
}

impl From<(f64, f64)> for KnotInput {
    fn from((depth_mm, feed_mm_min): (f64, f64)) -> Self {
        Self { depth_mm, feed_mm_min }
    }
}
