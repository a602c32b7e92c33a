//! Feed programs and strategies as data: what differs between F_Const, F_Sec, F_Lin and F_AC is values, not code.

use super::error::{Invalid, InvalidCode, between, positive};
use super::law::LawConfig;

/// Most knots of one program; a control's program memory holds far fewer blocks per hole.
pub const MOST_KNOTS: usize = 256;

/// Highest programmed feed in mm/min.
pub const HIGHEST_FEED_MM_MIN: f64 = 30_000.0;

/// A reported programmed feed may lie this far from the program within [`PROGRAM_WINDOW_MM`].
const PROGRAM_SHARE: f64 = 0.05;
/// The same in mm/min.
const PROGRAM_MM_MIN: f64 = 1.0;
/// How far around a depth the program is looked at.
const PROGRAM_WINDOW_MM: f64 = 0.5;

/// A point of a feed program.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Knot {
    /// Tip depth below first contact in mm.
    pub depth_mm: f64,
    /// Programmed feed in mm/min.
    pub feed_mm_min: f64,
}

/// What the feed does between two knots.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Between {
    /// A knot's feed holds until the next knot (F_Const with one knot, F_Sec with several).
    Held,
    /// The feed runs linearly in depth from knot to knot (F_Lin).
    Linear,
}

/// Programmed feed F_pr over depth.
#[derive(Debug, Clone, PartialEq)]
pub struct FeedProgram {
    between: Between,
    knots: Vec<Knot>,
}

impl FeedProgram {
    /// Checks a program: 1 to 256 knots, depths strictly increasing, feeds above 0.
    ///
    /// # Errors
    /// With the path of the refused knot.
    pub fn new(between_knots: Between, knots: Vec<Knot>) -> Result<Self, Invalid> {
        if knots.is_empty() {
            return Err(Invalid::new("knots", InvalidCode::Empty, "a feed program needs at least one knot"));
        }
        if knots.len() > MOST_KNOTS {
            let text = format!("at most {MOST_KNOTS} knots, not {}", knots.len());
            return Err(Invalid::new("knots", InvalidCode::TooMany, text));
        }
        for (index, knot) in knots.iter().enumerate() {
            let here = |error: Invalid| error.within(&format!("knots[{index}]"));
            between("depth_mm", knot.depth_mm, -1000.0, 1000.0).map_err(here)?;
            positive("feed_mm_min", knot.feed_mm_min, HIGHEST_FEED_MM_MIN).map_err(here)?;
            if index > 0 && knot.depth_mm <= knots[index - 1].depth_mm {
                let error = Invalid::new(
                    "depth_mm",
                    InvalidCode::NotIncreasing,
                    "must be greater than the depth of the knot before",
                );
                return Err(here(error));
            }
        }
        Ok(Self { between: between_knots, knots })
    }

    /// A program of one feed.
    ///
    /// # Errors
    /// When the feed is not in `(0, 30 000]` mm/min.
    pub fn constant(feed_mm_min: f64) -> Result<Self, Invalid> {
        Self::new(Between::Held, vec![Knot { depth_mm: 0.0, feed_mm_min }])
    }

    /// A program from (depth mm, feed mm/min) pairs.
    ///
    /// # Errors
    /// As [`FeedProgram::new`].
    pub fn from_pairs(between_knots: Between, pairs: &[(f64, f64)]) -> Result<Self, Invalid> {
        let knots = pairs.iter().map(|&(depth_mm, feed_mm_min)| Knot { depth_mm, feed_mm_min }).collect();
        Self::new(between_knots, knots)
    }

    /// The same program with every feed multiplied by `factor`, for cycles that explore the feed.
    ///
    /// # Errors
    /// When a feed leaves its range.
    pub fn scaled(&self, factor: f64) -> Result<Self, Invalid> {
        let scale = |knot: &Knot| Knot { feed_mm_min: knot.feed_mm_min * factor, ..*knot };
        Self::new(self.between, self.knots.iter().map(scale).collect())
    }

    /// The knots in order of depth.
    #[must_use]
    pub fn knots(&self) -> &[Knot] {
        &self.knots
    }

    /// What happens between knots.
    #[must_use]
    pub const fn between(&self) -> Between {
        self.between
    }

    /// Programmed feed in mm/min at a depth in mm; before the first knot its feed, after the last one that one's.
    #[must_use]
    pub fn feed_at(&self, depth_mm: f64) -> f64 {
        let after = self.knots.partition_point(|knot| knot.depth_mm <= depth_mm);
        if after == 0 {
            return self.knots[0].feed_mm_min;
        }
        let left = self.knots[after - 1];
        match (self.between, self.knots.get(after)) {
            (Between::Linear, Some(right)) => {
                let part = (depth_mm - left.depth_mm) / (right.depth_mm - left.depth_mm);
                left.feed_mm_min + part * (right.feed_mm_min - left.feed_mm_min)
            }
            _ => left.feed_mm_min,
        }
    }

    /// Whether a feed reported at a depth is another program's: off by more than 5 % and 1 mm/min from every feed that
    /// this one has within 0.5 mm of it. Controls round feeds, step linear ones in short blocks, and interpolate ahead
    /// of the tip that they report.
    #[must_use]
    pub fn strays(&self, depth_mm: f64, feed_mm_min: f64) -> bool {
        let (from, to) = (depth_mm - PROGRAM_WINDOW_MM, depth_mm + PROGRAM_WINDOW_MM);
        let inside = self.knots.iter().filter(|knot| (from..=to).contains(&knot.depth_mm));
        let feeds = inside.map(|knot| knot.feed_mm_min).chain([self.feed_at(from), self.feed_at(to)]);
        let (least, greatest) =
            feeds.fold((f64::MAX, f64::MIN), |(least, greatest), feed| (least.min(feed), greatest.max(feed)));
        feed_mm_min < least * (1.0 - PROGRAM_SHARE) - PROGRAM_MM_MIN
            || feed_mm_min > greatest * (1.0 + PROGRAM_SHARE) + PROGRAM_MM_MIN
    }
}

/// One way to drill a hole: a feed program to a depth, with or without the adaptive law on top.
#[derive(Debug, Clone, PartialEq)]
pub struct Strategy {
    /// Name for people and reports, such as `F_Lin`.
    pub name: String,
    /// Programmed feed over depth.
    pub program: FeedProgram,
    /// The adaptive law; `None` runs the program as it is.
    pub law: Option<LawConfig>,
    end_depth_mm: f64,
}

impl Strategy {
    /// A strategy that ends at `end_depth_mm` below first contact.
    ///
    /// # Errors
    /// When the depth is not in `(0, 1000]` mm.
    pub fn new(
        name: impl Into<String>,
        program: FeedProgram,
        end_depth_mm: f64,
        law: Option<LawConfig>,
    ) -> Result<Self, Invalid> {
        positive("end_depth_mm", end_depth_mm, 1000.0)?;
        Ok(Self { name: name.into(), program, law, end_depth_mm })
    }

    /// Where the programmed path ends, mm below first contact.
    #[must_use]
    pub const fn end_depth_mm(&self) -> f64 {
        self.end_depth_mm
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn held_and_linear_differ_only_between_knots() {
        let pairs = [(0.0, 100.0), (2.0, 300.0), (10.0, 700.0)];
        let held = FeedProgram::from_pairs(Between::Held, &pairs).unwrap();
        let linear = FeedProgram::from_pairs(Between::Linear, &pairs).unwrap();
        for (depth, on_held, on_linear) in [
            (-1.0, 100.0, 100.0),
            (1.0, 100.0, 200.0),
            (2.0, 300.0, 300.0),
            (6.0, 300.0, 500.0),
            (99.0, 700.0, 700.0),
        ] {
            assert!((held.feed_at(depth) - on_held).abs() < 1e-12);
            assert!((linear.feed_at(depth) - on_linear).abs() < 1e-12);
        }
        assert!((linear.scaled(0.5).unwrap().feed_at(6.0) - 250.0).abs() < 1e-12);
    }

    #[test]
    fn a_refused_knot_is_named() {
        let refused = |pairs: &[(f64, f64)]| {
            let error = FeedProgram::from_pairs(Between::Linear, pairs).unwrap_err();
            (error.field().to_owned(), error.code())
        };
        assert_eq!(refused(&[]), ("knots".into(), InvalidCode::Empty));
        assert_eq!(
            refused(&[(0.0, 1.0), (0.0, 2.0)]),
            ("knots[1].depth_mm".into(), InvalidCode::NotIncreasing)
        );
        assert_eq!(refused(&[(0.0, 0.0)]), ("knots[0].feed_mm_min".into(), InvalidCode::OutOfRange));
        assert_eq!(refused(&[(f64::NAN, 1.0)]), ("knots[0].depth_mm".into(), InvalidCode::NotFinite));
        assert_eq!(refused(&vec![(0.0, 1.0); 257]), ("knots".into(), InvalidCode::TooMany));
    }
}
