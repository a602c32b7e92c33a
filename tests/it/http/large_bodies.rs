//! Large bodies that share their room, of which some do not tell their length.

use super::app::{Answer, App, machine};
use axum::body::{Body, Bytes};
use feedwright_store::Role;
use futures_util::future::join_all;
use futures_util::stream::{self, StreamExt};
use http::Request;
use serde_json::json;
use std::convert::Infallible;
use std::sync::Arc;
use tokio::sync::{Barrier, watch};

crate::engines::on_both!(
    bodies_that_do_not_tell_their_length_are_all_taken_in_as_those_that_do,
    slow_bodies_keep_no_others,
);

const KIB: usize = 1024;

/// Room for 2 MiB, and bodies of 1 MiB at the most.
async fn open() -> App {
    let app = App::with(&[
        ("limits.body_bytes", "1048576"),
        ("limits.decoded_bytes", "1048576"),
        ("limits.large_bodies_bytes", "2097152"),
    ])
    .await;
    assert_eq!(app.put("/v1/machines/M1", machine()).await.status, 201);
    app
}

/// A batch of one cycle, of so many bytes.
fn batch(id: usize, bytes: usize) -> Vec<u8> {
    let cycle = json!({
        "cycle_id": format!("c{id}"), "tool": "T1", "operation": "O1", "started_at": "2026-05-04T05:00:00Z",
        "reported": {"energy_joules": 1000},
    });
    let mut lines = cycle.to_string().into_bytes();
    lines.resize(bytes, b' ');
    lines
}

async fn send(app: &App, body: Body) -> Answer {
    let request = Request::post("/v1/machines/M1/cycles/batch")
        .header("authorization", format!("Bearer {}", app.token(Role::Machine)))
        .header("content-type", "application/x-ndjson");
    app.send(request.body(body).unwrap()).await
}

/// A body without a length, a part of which comes in each turn.
fn in_turn(bytes: &[u8]) -> Body {
    let parts: Vec<_> = bytes.chunks(32 * KIB).map(Bytes::copy_from_slice).collect();
    Body::from_stream(stream::iter(parts).then(|part| async {
        tokio::task::yield_now().await;
        Ok::<_, Infallible>(part)
    }))
}

async fn bodies_that_do_not_tell_their_length_are_all_taken_in_as_those_that_do() {
    let app = open().await;
    let answers = join_all((0..24).map(async |id| {
        let bytes = batch(id, if id % 3 == 0 { 1024 * KIB } else { 700 * KIB });
        // They wait for those that were taken in and for nothing else: nobody's patience ends.
        send(&app, if id % 4 == 3 { Body::from(bytes) } else { in_turn(&bytes) }).await
    }))
    .await;
    for answer in answers {
        assert_eq!(answer.status, 200, "{answer:?}");
        assert!(String::from_utf8_lossy(&answer.body).contains("\"stored\""), "{answer:?}");
    }
    let larger = send(&app, in_turn(&batch(99, 1024 * KIB + 1))).await;
    assert_eq!((larger.status.as_u16(), larger.code().as_str()), (413, "body_too_large"));
}

async fn slow_bodies_keep_no_others() {
    let app = open().await;
    let (tell, told) = watch::channel(());
    let begun = Arc::new(Barrier::new(3));
    let slow = |id| {
        let (mut told, begun) = (told.clone(), Arc::clone(&begun));
        let whole = batch(id, 300 * KIB);
        let (begin, rest) =
            (Bytes::copy_from_slice(&whole[..299 * KIB]), Bytes::copy_from_slice(&whole[299 * KIB..]));
        let rest = stream::once(async move {
            begun.wait().await;
            told.changed().await.unwrap();
            Ok(rest)
        });
        Body::from_stream(stream::iter([Ok::<_, Infallible>(begin)]).chain(rest))
    };
    let slow_ones = join_all((0..2).map(|id| send(&app, slow(id))));
    let others = async {
        // What came of the slow ones has its place by then.
        begun.wait().await;
        let told = send(&app, batch(10, 300 * KIB).into()).await;
        let untold = send(&app, in_turn(&batch(11, 600 * KIB))).await;
        let whole = send(&app, in_turn(&batch(12, 1024 * KIB))).await;
        tell.send(()).unwrap();
        [told, untold, whole]
    };
    let (slow_ones, others) = tokio::join!(slow_ones, others);
    for answer in slow_ones.iter().chain(&others) {
        assert_eq!(answer.status, 200, "{answer:?}");
    }
}
