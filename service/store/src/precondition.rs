//! What a put does, decided before anything is written.

use crate::error::{StoreError, StoreResult};
use crate::record::{Precondition, PutOutcome};

/// Decides a put from the version in force and whether its content is the same.
pub(crate) fn decide(existing: Option<(u64, bool)>, expects: Precondition) -> StoreResult<PutOutcome> {
    let Some((current, same)) = existing else {
        return match expects {
            Precondition::Unstated | Precondition::Absent => Ok(PutOutcome::Created),
            Precondition::Version(_) => Err(StoreError::VersionMismatch { current: 0 }),
        };
    };
    match expects {
        Precondition::Absent => Err(StoreError::VersionMismatch { current }),
        Precondition::Version(version) if version != current => Err(StoreError::VersionMismatch { current }),
        Precondition::Unstated if !same => Err(StoreError::VersionRequired { current }),
        Precondition::Unstated | Precondition::Version(_) => {
            Ok(if same { PutOutcome::Unchanged(current) } else { PutOutcome::Changed(current + 1) })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_case_of_the_table() {
        use Precondition::{Absent, Unstated, Version};
        let code = |existing, expects| match decide(existing, expects) {
            Ok(PutOutcome::Created) => "created",
            Ok(PutOutcome::Changed(8)) => "changed",
            Ok(PutOutcome::Unchanged(7)) => "unchanged",
            Err(StoreError::VersionMismatch { current: 0 }) => "missing",
            Err(StoreError::VersionMismatch { current: 7 }) => "mismatch",
            Err(StoreError::VersionRequired { current: 7 }) => "required",
            other => panic!("{other:?}"),
        };
        assert_eq!(code(None, Unstated), "created");
        assert_eq!(code(None, Absent), "created");
        assert_eq!(code(None, Version(7)), "missing");
        assert_eq!(code(Some((7, true)), Unstated), "unchanged");
        assert_eq!(code(Some((7, false)), Unstated), "required");
        assert_eq!(code(Some((7, true)), Absent), "mismatch");
        assert_eq!(code(Some((7, false)), Version(6)), "mismatch");
        assert_eq!(code(Some((7, true)), Version(7)), "unchanged");
        assert_eq!(code(Some((7, false)), Version(7)), "changed");
    }
}
