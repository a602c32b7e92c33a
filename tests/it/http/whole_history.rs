//! A whole history leaves the server piece by piece, in every form: what the server holds of it does not grow with it.

use super::commands::{Served, first_token};
use crate::shop;
use serde_json::json;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, PgConnection};
use tempfile::TempDir;

crate::engines::on_both!(a_history_is_read_in_every_form_and_the_server_does_not_grow);

/// Cycles of the history: as JSON some 25 megabytes.
const CYCLES: u64 = 24_000;
/// What the server may hold beyond what it held before the history was read, bytes: a few pieces of 500 rows on their
/// way, and a row group of Parquet that is being filled.
const MOST_BYTES: u64 = 6 << 20;
const FORMS: [&str; 4] =
    ["application/json", "text/csv", "application/vnd.apache.arrow.stream", "application/vnd.apache.parquet"];

/// The statement that writes the one cycle that is there again and again, each a second after the one before.
fn again_and_again(columns: &[String]) -> String {
    let value = |column: &String| match column.as_str() {
        "cycle_id" => "cycle_id || '-' || n".to_owned(),
        "started_at_us" | "received_at_us" => format!("{column} + CAST(1000000 AS BIGINT) * n"),
        _ => column.clone(),
    };
    let values: Vec<String> = columns.iter().map(value).collect();
    let (columns, values) = (columns.join(", "), values.join(", "));
    let numbers = "SELECT 1 UNION ALL SELECT n + 1 FROM numbers WHERE n <";
    format!(
        "WITH RECURSIVE numbers(n) AS ({numbers} {}) INSERT INTO cycles ({columns}) SELECT {values} FROM cycles, numbers",
        CYCLES - 1
    )
}

async fn fill(dir: &TempDir, database: Option<&str>) {
    let written = match database {
        None => {
            let file = dir.path().join("data").join("feedwright.sqlite3");
            let mut tables =
                sqlx::sqlite::SqliteConnectOptions::new().filename(file).connect().await.unwrap();
            let columns = sqlx::query_scalar("SELECT name FROM pragma_table_info('cycles')");
            let columns = columns.fetch_all(&mut tables).await.unwrap();
            let many = AssertSqlSafe(again_and_again(&columns));
            sqlx::query(many).execute(&mut tables).await.unwrap().rows_affected()
        }
        Some(address) => {
            let mut tables = PgConnection::connect(address).await.unwrap();
            let columns = sqlx::query_scalar(
                "SELECT column_name::text FROM information_schema.columns
                 WHERE table_schema = current_schema() AND table_name = 'cycles'",
            );
            let columns = columns.fetch_all(&mut tables).await.unwrap();
            let many = AssertSqlSafe(again_and_again(&columns));
            let written = sqlx::query(many).execute(&mut tables).await.unwrap().rows_affected();
            // As the server's own housekeeping does sooner or later: so many rows at once are news to its planner.
            sqlx::query("ANALYZE cycles").execute(&mut tables).await.unwrap();
            written
        }
    };
    assert_eq!(written, CYCLES - 1);
}

/// Reads an answer to its end as a client that keeps nothing of it; its bytes, its line ends, and the most that the
/// server held meanwhile.
async fn read(served: &Served, request: reqwest::RequestBuilder) -> (u64, u64, u64) {
    let mut answer = request.send().await.unwrap();
    assert_eq!(answer.status(), 200);
    let (mut bytes, mut lines, mut most) = (0, 0, 0);
    while let Some(chunk) = answer.chunk().await.unwrap() {
        bytes += chunk.len() as u64;
        lines += chunk.iter().filter(|byte| **byte == b'\n').count() as u64;
        most = most.max(served.resident_bytes());
    }
    (bytes, lines, most)
}

async fn a_history_is_read_in_every_form_and_the_server_does_not_grow() {
    feedwright_server::tls::use_ring();
    let dir = TempDir::new().unwrap();
    let database = crate::engines::next_database().await;
    let client = reqwest::Client::builder().no_proxy().build().unwrap();
    let server = Served::start_on(&dir, database.as_deref(), "make others");
    let admin = first_token(&server.log);
    let address = server.address();
    let call =
        |method, path: &str| client.request(method, format!("http://{address}{path}")).bearer_auth(&admin);
    let machine = call(reqwest::Method::PUT, "/v1/machines/M1").json(&shop::machine());
    assert_eq!(machine.send().await.unwrap().status(), 201);
    // Of no registered tool: this is about reading, not about wear.
    let mut cycle = shop::reported(1, 1234.5);
    cycle["tool"] = json!("T-unregistered");
    let posted = call(reqwest::Method::POST, "/v1/machines/M1/cycles").json(&cycle);
    assert_eq!(posted.send().await.unwrap().status(), 201);
    let (log, ended_well) = server.terminate();
    assert!(ended_well, "{log}");
    fill(&dir, database.as_deref()).await;

    let server = Served::start_on(&dir, database.as_deref(), "listening");
    let address = server.address();
    let summaries = |query: &str, form: &str| {
        let request = client.get(format!("http://{address}/v1/summaries{query}"));
        request.bearer_auth(&admin).header("accept", form)
    };
    // Once through everything with little, so that what is compared with has its code and its buffers in memory.
    for form in FORMS {
        read(&server, summaries("?last=1500", form)).await;
    }
    let before = server.resident_bytes();
    for form in FORMS {
        let (bytes, lines, most) = read(&server, summaries("", form)).await;
        match form {
            "text/csv" => assert_eq!(lines, CYCLES + 1, "a line for each cycle and the header"),
            "application/json" => {
                assert_eq!(lines, CYCLES + 1, "a line for each cycle and the end");
                assert!(bytes > 2 * MOST_BYTES, "{bytes} bytes would fit");
            }
            _ => assert!(bytes > CYCLES, "{bytes}"),
        }
        let grown = most.saturating_sub(before);
        assert!(grown < MOST_BYTES, "{form}: {grown} bytes more than {before} for an answer of {bytes}");
    }
    let (log, ended_well) = server.terminate();
    assert!(ended_well, "{log}");
}
