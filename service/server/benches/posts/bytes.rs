//! Where the bytes of a SQLite file go, by table and index.

use super::data::{self, Cycle};
use super::process::Running;
use super::{CYCLES, JSON, WHOLE, post_all};
use sqlx::ConnectOptions;
use sqlx::sqlite::SqliteConnectOptions;
use std::sync::Arc;

/// Fills a server with the cycles of one round, and asks `dbstat`.
pub(crate) async fn tell() {
    let dir = tempfile::tempdir().expect("a directory");
    let server = Running::feedwright(dir.path(), None).await;
    let client = reqwest::Client::new();
    data::register(&client, &server.address, &server.token, data::MACHINES).await;
    let cycles = Arc::new(data::cycles(CYCLES));
    let bodies = Arc::new(cycles.iter().map(JSON.body).collect());
    post_all(&client, &server, (&cycles, &bodies), (JSON.media_type, WHOLE)).await;
    server.stop().await;
    let file = SqliteConnectOptions::new().filename(dir.path().join("feedwright.sqlite3")).read_only(true);
    let mut conn = file.connect().await.expect("the file");
    let rows: Vec<(String, i64, i64)> = sqlx::query_as(
        "SELECT name, SUM(pgsize), SUM(unused) FROM dbstat GROUP BY name ORDER BY SUM(pgsize) DESC",
    )
    .fetch_all(&mut conn)
    .await
    .expect("pages by table");
    let blocks: i64 = sqlx::query_scalar("SELECT SUM(bytes) FROM cycle_samples")
        .fetch_one(&mut conn)
        .await
        .expect("blocks");
    let values: usize = cycles.iter().map(Cycle::values).sum();
    #[expect(clippy::cast_precision_loss, reason = "figures for a table")]
    let each = |bytes: i64| bytes as f64 / values as f64;
    println!("{CYCLES} cycles, {values} values; bytes per value, and how much of it is empty");
    for (name, bytes, unused) in &rows {
        println!("{name:40} {:.4} {:.4}", each(*bytes), each(*unused));
    }
    println!("{:40} {:.4}", "whole", each(rows.iter().map(|(_, bytes, _)| bytes).sum()));
    println!("{:40} {:.4}", "the blocks themselves", each(blocks));
}
