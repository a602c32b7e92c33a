//! Rows of feed profiles and their versions.

use super::{damaged, id, number, word};
use crate::error::StoreResult;
use crate::feed_profile::{FeedProfile, ProfileSource, StoredProfileVersion, Taken};
use feedwright_core::cycle::ProfileVersion;
use feedwright_core::feed::choose::ActiveProfile;
use feedwright_core::feed::life_cycle::VersionState;
use feedwright_core::feed::profile::{Profile, ProfileHash};
use feedwright_core::units::Timestamp;

/// The level of the new tool, in thousandths.
const NEW_TOOL: i64 = 1000;

/// The level from which a line is meant, as its column.
pub(crate) fn wear_from_column(from_level: Option<f64>) -> i64 {
    // Levels of a checked profile are whole thousandths between 1 and 2.
    #[expect(clippy::cast_possible_truncation, reason = "a level is at most 2")]
    from_level.map_or(NEW_TOOL, |level| (level * 1000.0).round() as i64)
}

/// A row of `feed_profiles` with its newest version.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct FeedProfileRow {
    profile_id: String,
    operation_id: String,
    tool_type: String,
    wear_from: i64,
    revision: i64,
    active_version: Option<i64>,
    newest: i64,
    created_at_us: i64,
    updated_at_us: i64,
}

impl FeedProfileRow {
    pub(crate) fn profile(&self) -> StoreResult<FeedProfile> {
        let from: i32 = number("wear_from", self.wear_from)?;
        Ok(FeedProfile {
            id: id("profile_id", &self.profile_id)?,
            operation: id("operation_id", &self.operation_id)?,
            tool_type: self.tool_type.clone(),
            wear_from_level: (self.wear_from > NEW_TOOL).then(|| f64::from(from) / 1000.0),
            revision: number("revision", self.revision)?,
            active: self.active_version.map(|version| number("active_version", version)).transpose()?,
            newest: number("newest", self.newest)?,
            created_at: Timestamp::from_micros(self.created_at_us),
            updated_at: Timestamp::from_micros(self.updated_at_us),
        })
    }
}

/// The content and its hash; a content that no longer has its hash is not handed out.
fn content(text: &str, hash: &[u8]) -> StoreResult<(Profile, ProfileHash)> {
    let profile = Profile::from_canonical(text).map_err(|_| damaged("feed_profile_versions.content"))?;
    let kept: [u8; 32] = hash.try_into().map_err(|_| damaged("feed_profile_versions.content_hash"))?;
    if blake3::hash(text.as_bytes()).as_bytes() != &kept {
        return Err(damaged("feed_profile_versions.content_hash"));
    }
    Ok((profile, ProfileHash::from_bytes(kept)))
}

/// Whether a stored content can be read and has its hash.
pub(crate) fn is_content_of(text: &str, hash: &[u8]) -> bool {
    content(text, hash).is_ok()
}

/// A row of `feed_profile_versions`.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct ProfileVersionRow {
    profile_id: String,
    version: i64,
    content_hash: Vec<u8>,
    content: String,
    state: String,
    source: String,
    based_on: Option<i64>,
    reason: String,
    report: Option<String>,
    author: String,
    drafted_at_us: i64,
    shadowed_by: Option<String>,
    shadowed_at_us: Option<i64>,
    approved_by: Option<String>,
    approved_at_us: Option<i64>,
    activated_by: Option<String>,
    activated_at_us: Option<i64>,
    superseded_at_us: Option<i64>,
    rolled_back: i64,
}

impl ProfileVersionRow {
    pub(crate) fn stored(&self) -> StoreResult<StoredProfileVersion> {
        let taken = |by: &Option<String>, at: Option<i64>| {
            by.clone().zip(at).map(|(by, at)| Taken { by, at: Timestamp::from_micros(at) })
        };
        let (content, hash) = content(&self.content, &self.content_hash)?;
        Ok(StoredProfileVersion {
            version: ProfileVersion {
                profile: id("profile_id", &self.profile_id)?,
                version: number("version", self.version)?,
            },
            hash,
            content,
            state: word("state", &self.state, VersionState::parse)?,
            source: word("source", &self.source, ProfileSource::parse)?,
            based_on: self.based_on.map(|version| number("based_on", version)).transpose()?,
            reason: self.reason.clone(),
            report: self.report.clone(),
            drafted: Taken { by: self.author.clone(), at: Timestamp::from_micros(self.drafted_at_us) },
            shadowed: taken(&self.shadowed_by, self.shadowed_at_us),
            approved: taken(&self.approved_by, self.approved_at_us),
            activated: taken(&self.activated_by, self.activated_at_us),
            superseded_at: self.superseded_at_us.map(Timestamp::from_micros),
            rolled_back: self.rolled_back != 0,
        })
    }
}

/// An active version, as a recommendation needs it.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct ActiveProfileRow {
    profile_id: String,
    version: i64,
    content_hash: Vec<u8>,
    content: String,
    operation_id: String,
    tool_type: String,
    wear_from: i64,
}

impl ActiveProfileRow {
    pub(crate) fn active(&self) -> StoreResult<ActiveProfile> {
        let (profile, hash) = content(&self.content, &self.content_hash)?;
        // Whom it is for stands in its content too, which its hash is of.
        let line = (self.operation_id.as_str(), self.tool_type.as_str(), self.wear_from);
        let own =
            (profile.operation().as_str(), profile.tool_type(), wear_from_column(profile.wear().from_level));
        if line != own {
            return Err(damaged("feed_profiles.operation_id"));
        }
        Ok(ActiveProfile {
            version: ProfileVersion {
                profile: id("profile_id", &self.profile_id)?,
                version: number("version", self.version)?,
            },
            hash,
            profile,
        })
    }
}
