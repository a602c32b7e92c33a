//! The way of a version: draft → shadow → approved → active → superseded, and back.
//!
//! Decided here, written by the store in the transaction that read it. A version's content never changes; only where
//! it stands does.

/// Where a version stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum VersionState {
    /// Written down; nothing uses it.
    Draft,
    /// Computed against real cycles, never handed out.
    Shadow,
    /// Released by somebody other than its author; waits to be activated.
    Approved,
    /// The one that is handed out.
    Active,
    /// It was active; another one is, or none.
    Superseded,
}

impl VersionState {
    /// Every state, in the order of the way.
    pub const ALL: [Self; 5] = [Self::Draft, Self::Shadow, Self::Approved, Self::Active, Self::Superseded];

    /// The word used in the API and in storage.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Draft => "draft",
            Self::Shadow => "shadow",
            Self::Approved => "approved",
            Self::Active => "active",
            Self::Superseded => "superseded",
        }
    }

    /// The state of that word.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.as_str() == text)
    }

    /// Whether it has been released: it may be exported and run.
    #[must_use]
    pub const fn is_released(self) -> bool {
        matches!(self, Self::Approved | Self::Active | Self::Superseded)
    }
}

/// A step of a named version. Rolling back is none: it names no version, the history does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// Compute it against real cycles.
    Shadow,
    /// Release it.
    Approve,
    /// Hand it out, in place of the one that is.
    Activate,
}

impl Step {
    /// The word used in the API and in the audit.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Shadow => "shadow",
            Self::Approve => "approve",
            Self::Activate => "activate",
        }
    }
}

/// Why a step is not taken; the codes are stable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// From where it stands the step does not lead on.
    NotFrom(VersionState),
    /// Authors do not approve their own.
    OwnDraft,
}

impl Refusal {
    /// The code as it is answered.
    #[must_use]
    pub const fn code(self) -> &'static str {
        match self {
            Self::NotFrom(_) => "wrong_state",
            Self::OwnDraft => "own_draft",
        }
    }
}

/// Where a step leads. A version that stands there already stays, so that a repeated call changes nothing.
///
/// # Errors
/// When the step does not start where the version stands, or an author would approve their own.
pub fn step(from: VersionState, step: Step, author: &str, actor: &str) -> Result<VersionState, Refusal> {
    match (step, from) {
        // Whoever wrote it does not release it, whatever roles they hold.
        (Step::Approve, VersionState::Shadow) if author == actor => Err(Refusal::OwnDraft),
        (Step::Shadow, VersionState::Draft | VersionState::Shadow) => Ok(VersionState::Shadow),
        (Step::Approve, VersionState::Shadow) => Ok(VersionState::Approved),
        // What was active before was approved before.
        (Step::Activate, VersionState::Approved | VersionState::Active | VersionState::Superseded) => {
            Ok(VersionState::Active)
        }
        (_, state) => Err(Refusal::NotFrom(state)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_becomes_active_without_a_second_person() {
        use VersionState::{Active, Approved, Draft, Shadow, Superseded};
        let go = |from, to| step(from, to, "author", "second");
        assert_eq!(go(Draft, Step::Shadow), Ok(Shadow));
        assert_eq!(go(Shadow, Step::Approve), Ok(Approved));
        assert_eq!(go(Approved, Step::Activate), Ok(Active));
        assert_eq!(go(Superseded, Step::Activate), Ok(Active));
        assert_eq!(step(Shadow, Step::Approve, "author", "author"), Err(Refusal::OwnDraft));
        for from in VersionState::ALL {
            if from < Approved {
                assert_eq!(go(from, Step::Activate), Err(Refusal::NotFrom(from)));
            }
            if from != Shadow {
                assert_eq!(go(from, Step::Approve), Err(Refusal::NotFrom(from)));
            }
            assert_eq!(VersionState::parse(from.as_str()), Some(from));
        }
        assert_eq!(go(Approved, Step::Shadow), Err(Refusal::NotFrom(Approved)));
    }
}
