//! Tokens: only the hash of a secret is ever here.

use super::{Conn, Db, audit, dialect};
use crate::error::StoreResult;
use crate::locks::Locks;
use crate::record::{Actor, Page, TokenRecord};
use crate::rows::TokenRow;
use feedwright_core::ids::MachineId;
use feedwright_core::units::Timestamp;
use serde_json::json;

macro_rules! select {
    ($tail:literal) => {
        concat!(
            "SELECT token_id, name, secret_hash, role, machine_id, created_at_us, revoked_at_us FROM tokens ",
            $tail
        )
    };
}

pub(super) async fn create(conn: &mut Conn, token: &TokenRecord, actor: &Actor) -> StoreResult<()> {
    sqlx::query::<Db>(
        "INSERT INTO tokens (token_id, name, secret_hash, role, machine_id, created_at_us, revoked_at_us)
         VALUES ($1, $2, $3, $4, $5, $6, $7)",
    )
    .bind(&token.id)
    .bind(&token.name)
    .bind(token.hash.as_slice())
    .bind(token.role.as_str())
    .bind(token.machine.as_ref().map(MachineId::as_str))
    .bind(token.created_at.micros())
    .bind(token.revoked_at.map(Timestamp::micros))
    .execute(&mut *conn)
    .await?;
    let machine = token.machine.as_ref().map(MachineId::as_str);
    let detail = json!({ "name": token.name, "role": token.role.as_str(), "machine": machine });
    audit::add(conn, actor, token.created_at, "token.create", format!("token/{}", token.id), &detail).await
}

/// The same where there is no token at all; whether there was none. Of servers that begin together one makes the first.
pub(super) async fn create_first(conn: &mut Conn, token: &TokenRecord, actor: &Actor) -> StoreResult<bool> {
    dialect::lock(conn, &Locks::subject("first token", "")).await?;
    // Whatever they are: one that is damaged keeps no server from starting.
    let there: bool =
        sqlx::query_scalar::<Db, _>("SELECT EXISTS (SELECT 1 FROM tokens)").fetch_one(&mut *conn).await?;
    let is_first = !there;
    if is_first {
        create(conn, token, actor).await?;
    }
    Ok(is_first)
}

pub(super) async fn by_hash(conn: &mut Conn, hash: &[u8; 32]) -> StoreResult<Option<TokenRecord>> {
    let row: Option<TokenRow> = sqlx::query_as::<Db, _>(select!("WHERE secret_hash = $1"))
        .bind(hash.as_slice())
        .fetch_optional(&mut *conn)
        .await?;
    row.map(TokenRow::token).transpose()
}

async fn get(conn: &mut Conn, id: &str) -> StoreResult<Option<TokenRecord>> {
    let row: Option<TokenRow> =
        sqlx::query_as::<Db, _>(select!("WHERE token_id = $1")).bind(id).fetch_optional(&mut *conn).await?;
    row.map(TokenRow::token).transpose()
}

pub(super) async fn list(conn: &mut Conn, page: &Page<String>) -> StoreResult<Vec<TokenRecord>> {
    let rows: Vec<TokenRow> =
        sqlx::query_as::<Db, _>(select!("WHERE token_id > $1 ORDER BY token_id LIMIT $2"))
            .bind(page.after.as_deref().unwrap_or(""))
            .bind(i64::from(page.limit))
            .fetch_all(&mut *conn)
            .await?;
    rows.into_iter().map(TokenRow::token).collect()
}

/// Revokes a token once: a second time leaves the first date.
pub(super) async fn revoke(
    conn: &mut Conn,
    id: &str,
    actor: &Actor,
    now: Timestamp,
) -> StoreResult<Option<TokenRecord>> {
    let done = sqlx::query::<Db>(
        "UPDATE tokens SET revoked_at_us = $2 WHERE token_id = $1 AND revoked_at_us IS NULL",
    )
    .bind(id)
    .bind(now.micros())
    .execute(&mut *conn)
    .await?;
    if done.rows_affected() == 1 {
        audit::add(conn, actor, now, "token.revoke", format!("token/{id}"), &json!({})).await?;
    }
    get(conn, id).await
}
