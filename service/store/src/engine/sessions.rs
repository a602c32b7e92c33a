//! Sessions of browsers: begun with a token, found by the hash of their secret, ended with their time.

use super::{Conn, Db, audit};
use crate::error::StoreResult;
use crate::record::{Actor, SessionRecord, TokenRecord};
use crate::rows::TokenRow;
use feedwright_core::units::Timestamp;
use serde_json::json;

/// Keeps a session; forgets what is over, and the token's oldest beyond `most`.
pub(super) async fn begin(
    conn: &mut Conn,
    session: &SessionRecord,
    most: u32,
    actor: &Actor,
) -> StoreResult<()> {
    sqlx::query::<Db>("DELETE FROM sessions WHERE expires_at_us <= $1")
        .bind(session.created_at.micros())
        .execute(&mut *conn)
        .await?;
    sqlx::query::<Db>(
        "INSERT INTO sessions (session_hash, token_id, created_at_us, expires_at_us) VALUES ($1, $2, $3, $4)",
    )
    .bind(session.hash.as_slice())
    .bind(&session.token)
    .bind(session.created_at.micros())
    .bind(session.expires_at.micros())
    .execute(&mut *conn)
    .await?;
    sqlx::query::<Db>(
        "DELETE FROM sessions WHERE token_id = $1 AND session_hash NOT IN (
             SELECT session_hash FROM sessions WHERE token_id = $1
             ORDER BY created_at_us DESC, session_hash DESC LIMIT $2)",
    )
    .bind(&session.token)
    .bind(i64::from(most))
    .execute(&mut *conn)
    .await?;
    let subject = format!("token/{}", session.token);
    audit::add(conn, actor, session.created_at, "session.begin", subject, &json!({})).await
}

#[derive(sqlx::FromRow)]
struct Times {
    token_id: String,
    created_at_us: i64,
    expires_at_us: i64,
}

/// The session of that hash with its token, however old and revoked.
pub(super) async fn by_hash(
    conn: &mut Conn,
    hash: &[u8; 32],
) -> StoreResult<Option<(SessionRecord, TokenRecord)>> {
    let times: Option<Times> = sqlx::query_as::<Db, _>(
        "SELECT token_id, created_at_us, expires_at_us FROM sessions WHERE session_hash = $1",
    )
    .bind(hash.as_slice())
    .fetch_optional(&mut *conn)
    .await?;
    let Some(Times { token_id, created_at_us, expires_at_us }) = times else {
        return Ok(None);
    };
    let token: Option<TokenRow> = sqlx::query_as::<Db, _>(
        "SELECT token_id, name, secret_hash, role, machine_id, created_at_us, revoked_at_us FROM tokens
         WHERE token_id = $1",
    )
    .bind(&token_id)
    .fetch_optional(&mut *conn)
    .await?;
    let session = SessionRecord {
        hash: *hash,
        token: token_id,
        created_at: Timestamp::from_micros(created_at_us),
        expires_at: Timestamp::from_micros(expires_at_us),
    };
    token.map(|token| Ok((session, token.token()?))).transpose()
}

/// Ends a session; `false` where there is none of that hash.
pub(super) async fn end(
    conn: &mut Conn,
    hash: &[u8; 32],
    actor: &Actor,
    now: Timestamp,
) -> StoreResult<bool> {
    let done = sqlx::query::<Db>("DELETE FROM sessions WHERE session_hash = $1")
        .bind(hash.as_slice())
        .execute(&mut *conn)
        .await?;
    let ended = done.rows_affected() == 1;
    if ended {
        let subject = format!("token/{}", actor.token);
        audit::add(conn, actor, now, "session.end", subject, &json!({})).await?;
    }
    Ok(ended)
}
