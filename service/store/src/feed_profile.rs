//! What the store keeps of feed profiles, as values.

use feedwright_core::cycle::ProfileVersion;
use feedwright_core::feed::life_cycle::VersionState;
use feedwright_core::feed::profile::{Profile, ProfileHash};
use feedwright_core::ids::{OperationId, ProfileId};
use feedwright_core::units::Timestamp;

/// Hash of a profile's content: blake3 over its canonical text.
#[must_use]
pub fn profile_hash(profile: &Profile) -> ProfileHash {
    ProfileHash::from_bytes(*blake3::hash(profile.canonical().as_bytes()).as_bytes())
}

/// Where a version comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ProfileSource {
    /// A person set its knots.
    Drawn,
    /// Read from a list or a program.
    Imported,
    /// The optimiser found it from cycles.
    Optimised,
}

impl ProfileSource {
    /// Every source, in the order of the enum.
    pub const ALL: [Self; 3] = [Self::Drawn, Self::Imported, Self::Optimised];

    /// The word used in the API and in storage.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Drawn => "drawn",
            Self::Imported => "imported",
            Self::Optimised => "optimised",
        }
    }

    /// The source of that word.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|source| source.as_str() == text)
    }
}

/// A version that is to be drafted.
#[derive(Debug, Clone, PartialEq)]
pub struct NewProfileVersion {
    /// Its content; also names operation, tool type and wear band of the line.
    pub content: Profile,
    /// Where it comes from.
    pub source: ProfileSource,
    /// The version of the same line that it was changed from.
    pub based_on: Option<u32>,
    /// Why it was drafted.
    pub reason: String,
    /// What the optimiser or the import says of it, JSON.
    pub report: Option<String>,
}

/// What became of a draft.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Drafted {
    /// Its number within the line.
    pub version: u32,
    /// Whether it is new: the same content is kept once.
    pub is_new: bool,
}

/// A line of versions: one operation, one tool type, one wear band.
#[derive(Debug, Clone, PartialEq)]
pub struct FeedProfile {
    /// Its name in every path.
    pub id: ProfileId,
    /// What is machined.
    pub operation: OperationId,
    /// Kind of tool.
    pub tool_type: String,
    /// Level of wear from which it is meant; `None` for the new tool.
    pub wear_from_level: Option<f64>,
    /// Counts every change of the line; its ETag holds it.
    pub revision: u64,
    /// The version that is handed out.
    pub active: Option<u32>,
    /// The newest version.
    pub newest: u32,
    /// When its first version was drafted.
    pub created_at: Timestamp,
    /// When it was changed last.
    pub updated_at: Timestamp,
}

/// Who took a step, and when.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Taken {
    /// Id of the token.
    pub by: String,
    /// When.
    pub at: Timestamp,
}

/// A version as it is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredProfileVersion {
    /// Which.
    pub version: ProfileVersion,
    /// Hash of its content.
    pub hash: ProfileHash,
    /// Its content.
    pub content: Profile,
    /// Where it stands.
    pub state: VersionState,
    /// Where it comes from.
    pub source: ProfileSource,
    /// The version that it was changed from.
    pub based_on: Option<u32>,
    /// Why it was drafted.
    pub reason: String,
    /// What the optimiser or the import says of it, JSON.
    pub report: Option<String>,
    /// Who drafted it, and when.
    pub drafted: Taken,
    /// Who put it into shadow.
    pub shadowed: Option<Taken>,
    /// Who approved it.
    pub approved: Option<Taken>,
    /// Who activated it last.
    pub activated: Option<Taken>,
    /// When it stopped being active.
    pub superseded_at: Option<Timestamp>,
    /// Whether it stopped because it was rolled back.
    pub rolled_back: bool,
}

/// What is done to a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProfileMove {
    /// A step of one of its versions.
    Step(feedwright_core::feed::life_cycle::Step, u32),
    /// The active version makes way for the one before it, or for none.
    Rollback,
}

/// Which lines a list asks for.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct FeedProfileFilter {
    /// Of this operation.
    pub operation: Option<OperationId>,
    /// Of this kind of tool.
    pub tool_type: Option<String>,
}
