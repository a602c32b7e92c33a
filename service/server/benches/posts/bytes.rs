//! Where the bytes of a database go, by table and index.

use super::data::{self, Cycle};
use super::place::{Engine, Ours};
use super::{CYCLES, JSON, WHOLE, post_all};
use std::sync::Arc;

/// What a table or an index takes.
pub(crate) struct Taken {
    pub(crate) name: String,
    pub(crate) bytes: i64,
    /// What of it is empty, or held by what is there no longer.
    pub(crate) empty: i64,
}

/// Fills a server with the cycles of one round, and asks the database.
pub(crate) async fn tell(engine: Engine) {
    let mut ours = Ours::start(engine).await;
    let client = reqwest::Client::new();
    data::register(&client, &ours.server.address, &ours.server.token, data::MACHINES).await;
    let cycles = Arc::new(data::cycles(CYCLES));
    let bodies = Arc::new(cycles.iter().map(JSON.body).collect());
    post_all(&client, &ours.server, (&cycles, &bodies), (JSON.media_type, WHOLE)).await;
    ours.rest().await;
    let (blocks, taken) = ours.taken().await;
    let values: usize = cycles.iter().map(Cycle::values).sum();
    #[expect(clippy::cast_precision_loss, reason = "figures for a table")]
    let each = |bytes: i64| bytes as f64 / values as f64;
    println!("{CYCLES} cycles, {values} values; bytes per value, and how much of it is empty");
    for Taken { name, bytes, empty } in &taken {
        println!("{name:48} {:.4} {:.4}", each(*bytes), each(*empty));
    }
    let whole = |of: fn(&Taken) -> i64| each(taken.iter().map(of).sum());
    println!("{:48} {:.4} {:.4}", "whole", whole(|taken| taken.bytes), whole(|taken| taken.empty));
    println!("{:48} {:.4}", "the blocks themselves", each(blocks));
}
