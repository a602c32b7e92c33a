//! Recommendations that were handed out: what repeats stands once, under its hash.

use super::{Conn, Db, dialect};
use crate::error::StoreResult;
use crate::record::IssuedRecommendation;
use crate::rows::{Advice, AdviceBody, IssuedRow, RecommendationRow};
use feedwright_core::ids::RecommendationId;

/// Keeps one recommendation.
pub(super) async fn issue(conn: &mut Conn, issued: &IssuedRecommendation) -> StoreResult<()> {
    let advice = Advice::of(&AdviceBody::of(&issued.recommendation))?;
    let row = IssuedRow::of(issued, advice)?;
    keep_advice(conn, &row).await?;
    dialect::insert_recommendations(conn, &[row]).await
}

/// Keeps the advice that a recommendation refers to, where it is new. Asked first: on several nodes an advice stands on
/// each of them, and writing it would keep all others from writing one until this change ends.
pub(super) async fn keep_advice(conn: &mut Conn, row: &IssuedRow) -> StoreResult<()> {
    let known: Option<i64> =
        sqlx::query_scalar::<Db, _>("SELECT CAST(1 AS BIGINT) FROM advices WHERE advice_hash = $1")
            .bind(row.advice.hash.as_slice())
            .fetch_optional(&mut *conn)
            .await?;
    if known.is_some() {
        return Ok(());
    }
    sqlx::query::<Db>(IssuedRow::INSERT_ADVICE)
        .bind(row.advice.hash.as_slice())
        .bind(&*row.advice.body)
        .execute(&mut *conn)
        .await?;
    Ok(())
}

pub(super) async fn get(conn: &mut Conn, id: &RecommendationId) -> StoreResult<Option<IssuedRecommendation>> {
    let row: Option<RecommendationRow> = sqlx::query_as::<Db, _>(
        "SELECT r.issued_at_us, r.valid_until_us, r.level_as_run, r.level_lowest,
                r.level_highest, r.level_n, r.level_window, r.remaining_cycles, r.remaining_low, r.remaining_high,
                r.data_age_ms, r.level_decides, r.level_value, r.level_sd, r.machine_id, r.operation_id, r.tool_id,
                a.advice_hash, a.body
         FROM recommendations r JOIN advices a ON a.advice_hash = r.advice_hash
         WHERE r.recommendation_id = $1",
    )
    .bind(dialect::recommendation_key(id.as_str()))
    .fetch_optional(&mut *conn)
    .await?;
    row.map(|row| row.issued(id)).transpose()
}
