//! How many cycles may be folded again in one transaction: others wait behind it, on SQLite all posts, on PostgreSQL those of its tools and
//! their group.

/// Cycles that a group, or an answer to a change, folds again at most: a twentieth to a fifth of a second.
const GROUP: u64 = 10_000;

/// Cycles of a tool that are folded again whatever was before it in the group: a state on the way comes after every 256.
const FEW: u64 = 512;

/// Cycles that are folded again at a time in the background, where posts have the writer in between.
const SLICE: u64 = 2048;

/// Cycles that may yet be folded again in a transaction.
#[derive(Debug)]
pub(in super::super::super) struct Budget {
    left: u64,
    reach: Reach,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Reach {
    /// A fold is made whole, or left to the background from the last state on the way that holds.
    AtOnce,
    /// What is begun is gone on with later.
    Slice,
    /// Nobody waits, and nobody comes later.
    Whole,
}

impl Budget {
    /// Of a group, or of an answer to a change.
    pub(in super::super::super) const fn at_once() -> Self {
        Self { left: GROUP, reach: Reach::AtOnce }
    }

    /// Of a part of the work in the background.
    pub(in super::super::super) const fn slice() -> Self {
        Self { left: SLICE, reach: Reach::Slice }
    }

    /// Of who folds all there is, however long it takes.
    pub(in super::super::super) const fn whole() -> Self {
        Self { left: u64::MAX, reach: Reach::Whole }
    }

    /// Whether so many cycles are begun with.
    pub(super) const fn begins(&self, cycles: u64) -> bool {
        match self.reach {
            Reach::AtOnce => cycles < self.left || cycles <= FEW,
            Reach::Slice => self.left > 0,
            Reach::Whole => true,
        }
    }

    /// Takes note of cycles that were folded.
    pub(super) const fn spend(&mut self, cycles: u64) {
        self.left = self.left.saturating_sub(cycles);
    }

    /// Whether nothing is left.
    pub(super) const fn is_spent(&self) -> bool {
        self.left == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_group_leaves_what_it_cannot_make_whole_and_a_slice_goes_on_until_it_is_spent() {
        let mut group = Budget::at_once();
        assert!(group.begins(GROUP - 1) && !group.begins(GROUP));
        group.spend(GROUP - 1000);
        assert!(group.begins(999) && !group.begins(1000) && !group.is_spent());
        group.spend(1000);
        assert!(group.begins(FEW) && !group.begins(FEW + 1), "a little is folded in any case");
        let mut slice = Budget::slice();
        assert!(slice.begins(u64::MAX));
        slice.spend(SLICE - 1);
        assert!(slice.begins(u64::MAX) && !slice.is_spent());
        slice.spend(1000);
        assert!(!slice.begins(1) && slice.is_spent());
        let mut whole = Budget::whole();
        whole.spend(1 << 60);
        assert!(whole.begins(u64::MAX) && !whole.is_spent());
    }
}
