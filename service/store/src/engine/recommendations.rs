//! Recommendations that were handed out: what repeats stands once, under its hash.

use super::{Conn, Db};
use crate::error::{StoreError, StoreResult};
use crate::record::IssuedRecommendation;
use crate::rows::{AdviceBody, RecommendationRow, count, float, optional_float};
use feedwright_core::ids::RecommendationId;
use feedwright_core::wear::{Level, LevelBasis, Remaining};

/// Bytes of blake3 that name an advice: a collision within one plant is out of reach.
const HASH_BYTES: usize = 16;

pub(super) async fn issue(conn: &mut Conn, issued: &IssuedRecommendation) -> StoreResult<()> {
    let recommendation = &issued.recommendation;
    let body = serde_json::to_string(&AdviceBody::of(recommendation))
        .map_err(|error| StoreError::Database(Box::new(error)))?;
    let hash = blake3::hash(body.as_bytes()).as_bytes()[..HASH_BYTES].to_vec();
    sqlx::query::<Db>(
        "INSERT INTO advices (advice_hash, body) VALUES ($1, $2) ON CONFLICT (advice_hash) DO NOTHING",
    )
    .bind(&hash)
    .bind(&body)
    .execute(&mut *conn)
    .await?;
    let level = recommendation.level.as_ref();
    let level_float = |name, part: fn(&Level) -> f64| level.map(|level| float(name, part(level))).transpose();
    let remaining = recommendation.remaining.as_ref();
    let remaining_count = |name, part: fn(&Remaining) -> u64| {
        remaining.map(|remaining| count(name, part(remaining))).transpose()
    };
    sqlx::query::<Db>(
        "INSERT INTO recommendations (recommendation_id, advice_hash, issued_at_us, valid_until_us, level_as_run,
             level_lowest, level_highest, level_n, level_window, remaining_cycles, remaining_low, remaining_high,
             data_age_ms, level_decides, level_value, level_sd)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16)",
    )
    .bind(issued.id.as_str())
    .bind(&hash)
    .bind(recommendation.issued_at.micros())
    .bind(recommendation.valid_until.micros())
    .bind(level_float("level_as_run", |level| level.as_run)?)
    .bind(level_float("level_lowest", |level| level.lowest)?)
    .bind(level_float("level_highest", |level| level.highest)?)
    .bind(level.map(|level| i64::from(level.n)))
    .bind(level.map(|level| i64::from(level.window)))
    .bind(remaining_count("remaining_cycles", |remaining| remaining.cycles)?)
    .bind(remaining_count("remaining_low", |remaining| remaining.low)?)
    .bind(remaining_count("remaining_high", |remaining| remaining.high)?)
    .bind(recommendation.data_age_ms)
    .bind(level.and_then(|level| level.decides).map(LevelBasis::as_str))
    .bind(level_float("level_value", |level| level.value)?)
    .bind(optional_float("level_sd", level.and_then(|level| level.sd))?)
    .execute(&mut *conn)
    .await?;
    Ok(())
}

pub(super) async fn get(conn: &mut Conn, id: &RecommendationId) -> StoreResult<Option<IssuedRecommendation>> {
    let row: Option<RecommendationRow> = sqlx::query_as::<Db, _>(
        "SELECT r.recommendation_id, r.issued_at_us, r.valid_until_us, r.level_as_run, r.level_lowest,
                r.level_highest, r.level_n, r.level_window, r.remaining_cycles, r.remaining_low, r.remaining_high,
                r.data_age_ms, r.level_decides, r.level_value, r.level_sd, a.body
         FROM recommendations r JOIN advices a ON a.advice_hash = r.advice_hash
         WHERE r.recommendation_id = $1",
    )
    .bind(id.as_str())
    .fetch_optional(&mut *conn)
    .await?;
    row.map(|row| row.issued()).transpose()
}
