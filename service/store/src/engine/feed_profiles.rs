//! Feed profiles: drafted, moved along their way, handed out.

use super::{Conn, Db, audit, cycles, dialect};
use crate::error::{StoreError, StoreResult};
use crate::feed_profile::{
    Drafted, FeedProfile, FeedProfileFilter, NewProfileVersion, ProfileMove, StoredProfileVersion,
    profile_hash,
};
use crate::locks::Locks;
use crate::record::{ActiveProfiles, Actor, CycleFilter, CycleMeta, Page, Precondition, StoredCycle};
use crate::rows::{
    ActiveProfileRow, CycleWithSamples, FeedProfileRow, ProfileVersionRow, id, wear_from_column,
};
use feedwright_core::cycle::ProfileVersion;
use feedwright_core::feed::life_cycle::{Refusal, Step, VersionState, step};
use feedwright_core::ids::{CycleId, MachineId, OperationId, ProfileId, ToolId};
use feedwright_core::units::Timestamp;
use serde_json::json;

/// Most active lines that one question may meet: wear bands of one operation and tool type.
const MOST_ACTIVE: i64 = 32;
/// So many tools of a type are asked for their cycles one by one; one that has more is found soon among the last of all.
const FEW_TOOLS: i64 = 100;

macro_rules! select_lines {
    ($tail:literal) => {
        concat!(
            "SELECT p.profile_id, p.operation_id, p.tool_type, p.wear_from, p.revision, p.active_version,
                    (SELECT MAX(v.version) FROM feed_profile_versions v WHERE v.profile_id = p.profile_id) AS newest,
                    p.created_at_us, p.updated_at_us
             FROM feed_profiles p ",
            $tail
        )
    };
}

macro_rules! select_versions {
    ($tail:literal) => {
        concat!(
            "SELECT profile_id, version, content_hash, content, state, source, based_on, reason, report, author,
                    drafted_at_us, shadowed_by, shadowed_at_us, approved_by, approved_at_us, activated_by,
                    activated_at_us, superseded_at_us, rolled_back
             FROM feed_profile_versions ",
            $tail
        )
    };
}

pub(super) async fn get(conn: &mut Conn, id: &ProfileId) -> StoreResult<Option<FeedProfile>> {
    let row: Option<FeedProfileRow> = sqlx::query_as::<Db, _>(select_lines!("WHERE p.profile_id = $1"))
        .bind(id.as_str())
        .fetch_optional(&mut *conn)
        .await?;
    row.map(|row| row.profile()).transpose()
}

pub(super) async fn list(
    conn: &mut Conn,
    filter: &FeedProfileFilter,
    page: &Page<ProfileId>,
) -> StoreResult<Vec<FeedProfile>> {
    let rows: Vec<FeedProfileRow> = sqlx::query_as::<Db, _>(select_lines!(
        "WHERE p.profile_id > $1 AND (CAST($2 AS TEXT) IS NULL OR p.operation_id = $2)
           AND (CAST($3 AS TEXT) IS NULL OR p.tool_type = $3)
         ORDER BY p.profile_id LIMIT $4"
    ))
    .bind(page.after.as_ref().map_or("", ProfileId::as_str))
    .bind(filter.operation.as_ref().map(OperationId::as_str))
    .bind(filter.tool_type.as_deref())
    .bind(i64::from(page.limit))
    .fetch_all(&mut *conn)
    .await?;
    rows.iter().map(FeedProfileRow::profile).collect()
}

pub(super) async fn version(
    conn: &mut Conn,
    id: &ProfileId,
    version: u32,
) -> StoreResult<Option<StoredProfileVersion>> {
    let row: Option<ProfileVersionRow> =
        sqlx::query_as::<Db, _>(select_versions!("WHERE profile_id = $1 AND version = $2"))
            .bind(id.as_str())
            .bind(i64::from(version))
            .fetch_optional(&mut *conn)
            .await?;
    row.map(|row| row.stored()).transpose()
}

pub(super) async fn versions(
    conn: &mut Conn,
    id: &ProfileId,
    page: &Page<u32>,
) -> StoreResult<Vec<StoredProfileVersion>> {
    let rows: Vec<ProfileVersionRow> = sqlx::query_as::<Db, _>(select_versions!(
        "WHERE profile_id = $1 AND version > $2 ORDER BY version LIMIT $3"
    ))
    .bind(id.as_str())
    .bind(page.after.map_or(0, i64::from))
    .bind(i64::from(page.limit))
    .fetch_all(&mut *conn)
    .await?;
    rows.iter().map(ProfileVersionRow::stored).collect()
}

/// Drafts a version: of a new line, or the next one of a line for the same operation, tool type and wear band.
pub(super) async fn draft(
    conn: &mut Conn,
    id: &ProfileId,
    new: &NewProfileVersion,
    actor: &Actor,
    now: Timestamp,
) -> StoreResult<Drafted> {
    let content = &new.content;
    let (operation, tool_type) = (content.operation(), content.tool_type());
    let wear_from = wear_from_column(content.wear().from_level);
    dialect::lock(conn, &Locks::subject("feed_profile", id.as_str())).await?;
    let line = format!("{operation}/{wear_from}/{tool_type}");
    dialect::lock(conn, &Locks::subject("feed_profile_line", &line)).await?;
    let known: Option<String> = sqlx::query_scalar::<Db, _>(
        "SELECT profile_id FROM feed_profiles WHERE operation_id = $1 AND tool_type = $2 AND wear_from = $3",
    )
    .bind(operation.as_str())
    .bind(tool_type)
    .bind(wear_from)
    .fetch_optional(&mut *conn)
    .await?;
    let existing = get(conn, id).await?;
    match (&known, &existing) {
        (Some(known), _) if known != id.as_str() => {
            let why = format!("operation, tool type and wear band belong to the feed profile `{known}`");
            return Err(StoreError::Conflict { code: "other_profile", why });
        }
        (None, Some(_)) => {
            let why = "the feed profile is for another operation, tool type or wear band".to_owned();
            return Err(StoreError::Conflict { code: "other_subject", why });
        }
        _ => {}
    }
    let newest = existing.as_ref().map_or(0, |line| line.newest);
    if new.based_on.is_some_and(|based_on| based_on == 0 || based_on > newest) {
        let why = "based_on names no version of this feed profile".to_owned();
        return Err(StoreError::Conflict { code: "unknown_base", why });
    }
    let hash = profile_hash(content);
    let same: Option<i64> = sqlx::query_scalar::<Db, _>(
        "SELECT version FROM feed_profile_versions WHERE profile_id = $1 AND content_hash = $2",
    )
    .bind(id.as_str())
    .bind(hash.bytes().to_vec())
    .fetch_optional(&mut *conn)
    .await?;
    if let Some(version) = same {
        return Ok(Drafted { version: crate::rows::number("version", version)?, is_new: false });
    }
    let next = newest.checked_add(1).ok_or(StoreError::Full { what: "the feed profile" })?;
    if existing.is_none() {
        sqlx::query::<Db>(
            "INSERT INTO feed_profiles (profile_id, operation_id, tool_type, wear_from, revision, created_at_us,
                 updated_at_us)
             VALUES ($1, $2, $3, $4, 1, $5, $5)",
        )
        .bind(id.as_str())
        .bind(operation.as_str())
        .bind(tool_type)
        .bind(wear_from)
        .bind(now.micros())
        .execute(&mut *conn)
        .await?;
    } else {
        touch(conn, id, now).await?;
    }
    sqlx::query::<Db>(
        "INSERT INTO feed_profile_versions (profile_id, version, content_hash, content, state, source, based_on,
             reason, report, author, drafted_at_us)
         VALUES ($1, $2, $3, $4, 'draft', $5, $6, $7, $8, $9, $10)",
    )
    .bind(id.as_str())
    .bind(i64::from(next))
    .bind(hash.bytes().to_vec())
    .bind(content.canonical())
    .bind(new.source.as_str())
    .bind(new.based_on.map(i64::from))
    .bind(&new.reason)
    .bind(&new.report)
    .bind(&actor.token)
    .bind(now.micros())
    .execute(&mut *conn)
    .await?;
    let detail = json!({
        "hash": hash.to_string(), "source": new.source.as_str(), "based_on": new.based_on, "reason": new.reason,
    });
    let subject = format!("feed_profile/{id}/versions/{next}");
    audit::add(conn, actor, now, "feed_profile.draft", subject, &detail).await?;
    Ok(Drafted { version: next, is_new: true })
}

/// Counts a change of the line.
async fn touch(conn: &mut Conn, id: &ProfileId, now: Timestamp) -> StoreResult<()> {
    sqlx::query::<Db>(
        "UPDATE feed_profiles SET revision = revision + 1, updated_at_us = $2 WHERE profile_id = $1",
    )
    .bind(id.as_str())
    .bind(now.micros())
    .execute(&mut *conn)
    .await?;
    Ok(())
}

/// Moves a line: decided on what is in force now, under its lock, so that of two at once one finds another revision.
pub(super) async fn advance(
    conn: &mut Conn,
    id: &ProfileId,
    what: ProfileMove,
    expects: Precondition,
    actor: &Actor,
    now: Timestamp,
) -> StoreResult<Option<FeedProfile>> {
    dialect::lock(conn, &Locks::subject("feed_profile", id.as_str())).await?;
    let Some(line) = get(conn, id).await? else {
        return Ok(None);
    };
    let current = line.revision;
    match expects {
        Precondition::Version(named) if named == current => {}
        Precondition::Unstated => return Err(StoreError::VersionRequired { current }),
        Precondition::Version(_) | Precondition::Absent => {
            return Err(StoreError::VersionMismatch { current });
        }
    }
    let moved = match what {
        ProfileMove::Step(taken, number) => {
            let Some(found) = version(conn, id, number).await? else {
                return Ok(None);
            };
            take(conn, &line, &found, taken, actor, now).await?
        }
        ProfileMove::Rollback => {
            roll_back(conn, &line, actor, now).await?;
            true
        }
    };
    if moved {
        touch(conn, id, now).await?;
    }
    get(conn, id).await
}

async fn take(
    conn: &mut Conn,
    line: &FeedProfile,
    found: &StoredProfileVersion,
    taken: Step,
    actor: &Actor,
    now: Timestamp,
) -> StoreResult<bool> {
    let to = step(found.state, taken, &found.drafted.by, &actor.token).map_err(|refusal| {
        let why = match refusal {
            Refusal::OwnDraft => "whoever drafted a version does not approve it".to_owned(),
            Refusal::NotFrom(state) => {
                format!("{} is not possible for a version that is {}", taken.as_str(), state.as_str())
            }
        };
        StoreError::Conflict { code: refusal.code(), why }
    })?;
    if to == found.state {
        return Ok(false);
    }
    let (id, number) = (line.id.as_str(), i64::from(found.version.version));
    let sql = match taken {
        Step::Shadow => {
            "UPDATE feed_profile_versions SET state = 'shadow', shadowed_by = $3, shadowed_at_us = $4
             WHERE profile_id = $1 AND version = $2"
        }
        Step::Approve => {
            "UPDATE feed_profile_versions SET state = 'approved', approved_by = $3, approved_at_us = $4
             WHERE profile_id = $1 AND version = $2"
        }
        Step::Activate => {
            if line.active.is_some() {
                retire(conn, &line.id, false, now).await?;
            }
            "UPDATE feed_profile_versions SET state = 'active', activated_by = $3, activated_at_us = $4,
                 superseded_at_us = NULL, rolled_back = 0,
                 activated_revision = (SELECT revision FROM feed_profiles WHERE profile_id = $1)
             WHERE profile_id = $1 AND version = $2"
        }
    };
    sqlx::query::<Db>(sql)
        .bind(id)
        .bind(number)
        .bind(&actor.token)
        .bind(now.micros())
        .execute(&mut *conn)
        .await?;
    if to == VersionState::Active {
        put_active(conn, &line.id, Some(found.version.version)).await?;
    }
    let detail = json!({ "from": found.state.as_str(), "to": to.as_str(), "superseded": line.active });
    let action = match taken {
        Step::Shadow => "feed_profile.shadow",
        Step::Approve => "feed_profile.approve",
        Step::Activate => "feed_profile.activate",
    };
    let subject = format!("feed_profile/{id}/versions/{number}");
    audit::add(conn, actor, now, action, subject, &detail).await?;
    Ok(true)
}

/// The active version stops being active.
async fn retire(conn: &mut Conn, id: &ProfileId, rolled_back: bool, now: Timestamp) -> StoreResult<()> {
    sqlx::query::<Db>(
        "UPDATE feed_profile_versions SET state = 'superseded', superseded_at_us = $2, rolled_back = $3
         WHERE profile_id = $1 AND state = 'active'",
    )
    .bind(id.as_str())
    .bind(now.micros())
    .bind(i64::from(rolled_back))
    .execute(&mut *conn)
    .await?;
    Ok(())
}

async fn put_active(conn: &mut Conn, id: &ProfileId, version: Option<u32>) -> StoreResult<()> {
    sqlx::query::<Db>("UPDATE feed_profiles SET active_version = $2 WHERE profile_id = $1")
        .bind(id.as_str())
        .bind(version.map(i64::from))
        .execute(&mut *conn)
        .await?;
    Ok(())
}

/// Back to what was active before, never to what was rolled back itself; to none where there was nothing.
async fn roll_back(conn: &mut Conn, line: &FeedProfile, actor: &Actor, now: Timestamp) -> StoreResult<()> {
    let Some(from) = line.active else {
        let why = "no version is active: there is nothing to roll back".to_owned();
        return Err(StoreError::Conflict { code: "nothing_active", why });
    };
    let before: Option<i64> = sqlx::query_scalar::<Db, _>(
        "SELECT version FROM feed_profile_versions
         WHERE profile_id = $1 AND state = 'superseded' AND rolled_back = 0
         ORDER BY activated_revision DESC LIMIT 1",
    )
    .bind(line.id.as_str())
    .fetch_optional(&mut *conn)
    .await?;
    let to: Option<u32> = before.map(|version| crate::rows::number("version", version)).transpose()?;
    retire(conn, &line.id, true, now).await?;
    if let Some(to) = to {
        sqlx::query::<Db>(
            "UPDATE feed_profile_versions SET state = 'active', activated_by = $3, activated_at_us = $4,
                 superseded_at_us = NULL
             WHERE profile_id = $1 AND version = $2",
        )
        .bind(line.id.as_str())
        .bind(i64::from(to))
        .bind(&actor.token)
        .bind(now.micros())
        .execute(&mut *conn)
        .await?;
    }
    put_active(conn, &line.id, to).await?;
    let detail = json!({ "from": from, "to": to });
    let subject = format!("feed_profile/{}", line.id);
    audit::add(conn, actor, now, "feed_profile.rollback", subject, &detail).await
}

/// Active versions for an operation and the type of a tool, by their wear bands; none where one is damaged.
pub(super) async fn active(
    conn: &mut Conn,
    operation: &OperationId,
    tool: &ToolId,
) -> StoreResult<ActiveProfiles> {
    let rows = sqlx::query_as::<Db, ActiveProfileRow>(
        "SELECT v.profile_id, v.version, v.content_hash, v.content, p.operation_id, p.tool_type, p.wear_from
         FROM feed_profiles p
         JOIN tools t ON t.tool_type = p.tool_type
         JOIN feed_profile_versions v ON v.profile_id = p.profile_id AND v.version = p.active_version
         WHERE p.operation_id = $1 AND t.tool_id = $2 AND v.state = 'active'
         ORDER BY p.wear_from LIMIT $3",
    )
    .bind(operation.as_str())
    .bind(tool.as_str())
    .bind(MOST_ACTIVE)
    .fetch_all(&mut *conn)
    .await;
    let rows = rows.map_err(StoreError::from);
    match rows.and_then(|rows| rows.iter().map(ActiveProfileRow::active).collect()) {
        Ok(profiles) => Ok(ActiveProfiles { profiles, are_damaged: false }),
        // The others alone may have a faster one take the place of what is meant for a worn tool.
        Err(StoreError::Damaged { what }) => {
            tracing::error!(%operation, %tool, what, "an active feed profile is damaged: none is run");
            Ok(ActiveProfiles { profiles: Vec::new(), are_damaged: true })
        }
        Err(error) => Err(error),
    }
}

/// The last cycles that ran a version, oldest first.
pub(super) async fn cycles(
    conn: &mut Conn,
    ran: &ProfileVersion,
    most: u32,
) -> StoreResult<Vec<StoredCycle>> {
    let rows: Vec<CycleWithSamples> = sqlx::query_as::<Db, _>(cycles::LAST_OF_PROFILE)
        .bind(ran.profile.as_str())
        .bind(i64::from(ran.version))
        .bind(i64::from(most))
        .fetch_all(&mut *conn)
        .await?;
    rows.iter().rev().map(CycleWithSamples::stored).collect()
}

/// The last cycles of an operation with tools of a type, oldest first.
pub(super) async fn recent(
    conn: &mut Conn,
    operation: &OperationId,
    tool_type: &str,
    most: u32,
) -> StoreResult<Vec<StoredCycle>> {
    let tools: Vec<String> = sqlx::query_scalar::<Db, _>(
        "SELECT tool_id FROM tools WHERE tool_type = $1 ORDER BY tool_id LIMIT $2",
    )
    .bind(tool_type)
    .bind(FEW_TOOLS + 1)
    .fetch_all(&mut *conn)
    .await?;
    if i64::try_from(tools.len()).is_ok_and(|tools| tools <= FEW_TOOLS) {
        return recent_of_few(conn, operation, &tools, most).await;
    }
    let rows: Vec<CycleWithSamples> = sqlx::query_as::<Db, _>(cycles::LAST_WITH_TOOL_TYPE)
        .bind(operation.as_str())
        .bind(tool_type)
        .bind(i64::from(most))
        .fetch_all(&mut *conn)
        .await?;
    rows.iter().rev().map(CycleWithSamples::stored).collect()
}

/// The same, tool by tool: what a type seldom ran would be looked for among all cycles of the operation.
async fn recent_of_few(
    conn: &mut Conn,
    operation: &OperationId,
    tools: &[String],
    most: u32,
) -> StoreResult<Vec<StoredCycle>> {
    let mut filter = CycleFilter { operation: Some(operation.clone()), ..CycleFilter::default() };
    let mut found: Vec<StoredCycle> = Vec::new();
    for tool in tools {
        filter.tool = Some(id("tool_id", tool)?);
        found.extend(cycles::last(conn, &filter, most).await?);
        found.sort_unstable_by(|a, b| order(&a.cycle).cmp(&order(&b.cycle)));
        if let Some(surplus) = found.len().checked_sub(most as usize) {
            found.drain(..surplus);
            // What began before the oldest of them is not among the last.
            filter.from = found.first().map(|oldest| oldest.cycle.started_at);
        }
    }
    Ok(found)
}

/// What lists of cycles are in the order of.
const fn order(cycle: &CycleMeta) -> (Timestamp, &MachineId, Option<u64>, &CycleId) {
    (cycle.started_at, &cycle.machine, cycle.seq, &cycle.id)
}
