//! Lists: pages that neither skip nor repeat, and cursors that nobody can bend.

use super::app::{App, tool};
use http::StatusCode;

crate::engines::on_both!(
    pages_hold_every_row_once,
    limits_and_cursors_are_checked,
    a_cursor_goes_with_its_filters,
);

async fn pages_hold_every_row_once() {
    let app = App::new().await;
    for number in 0..7 {
        assert_eq!(app.put(&format!("/v1/tools/T{number}"), tool()).await.status, StatusCode::CREATED);
    }
    for limit in [1, 3, 7, 8] {
        let mut found = Vec::new();
        let mut path = format!("/v1/tools?limit={limit}");
        loop {
            let page = app.get(&path).await.json();
            let items = page["items"].as_array().unwrap();
            assert!(items.len() <= limit && !items.is_empty());
            found.extend(items.iter().map(|item| item["id"].as_str().unwrap().to_owned()));
            let Some(cursor) = page["next_cursor"].as_str() else { break };
            path = format!("/v1/tools?limit={limit}&cursor={cursor}");
        }
        assert_eq!(found, (0..7).map(|number| format!("T{number}")).collect::<Vec<_>>(), "{limit}");
    }
}

async fn limits_and_cursors_are_checked() {
    let app = App::new().await;
    for number in 0..3 {
        app.put(&format!("/v1/tools/T{number}"), tool()).await;
    }
    for limit in ["0", "1001", "4294967296", "-1", "x"] {
        let answer = app.get(&format!("/v1/tools?limit={limit}")).await;
        assert_eq!(answer.status, StatusCode::BAD_REQUEST, "{limit}");
        assert!(matches!(answer.code().as_str(), "invalid_limit" | "invalid_query"));
        assert_eq!(answer.errors()[0].0, "limit");
    }
    let page = app.get("/v1/tools?limit=1").await.json();
    let cursor = page["next_cursor"].as_str().unwrap();
    for (list, cursor) in [
        ("tools", "AAAA".to_owned()),
        ("tools", format!("{cursor}A")),
        ("tools", cursor[..cursor.len() - 3].to_owned()),
        ("machines", cursor.to_owned()),
        ("operations", cursor.to_owned()),
    ] {
        let answer = app.get(&format!("/v1/{list}?cursor={cursor}")).await;
        assert_eq!(
            (answer.status, answer.code().as_str()),
            (StatusCode::BAD_REQUEST, "invalid_cursor"),
            "{list}"
        );
    }
    // A page's size may change on the way.
    let rest = app.get(&format!("/v1/tools?limit=1000&cursor={cursor}")).await.json();
    assert_eq!(rest["items"].as_array().unwrap().len(), 2);
    assert!(rest.get("next_cursor").is_none());
}

async fn a_cursor_goes_with_its_filters() {
    let app = App::registered().await;
    for kind in ["mounted_new", "changed", "reground"] {
        app.post("/v1/tools/T1/events", serde_json::json!({ "kind": kind })).await;
    }
    let page = app.get("/v1/tools/T1/events?limit=1").await.json();
    let cursor = page["next_cursor"].as_str().unwrap();
    assert_eq!(app.get(&format!("/v1/tools/T1/events?cursor={cursor}")).await.status, StatusCode::OK);
    app.put("/v1/tools/T2", tool()).await;
    assert_eq!(app.get(&format!("/v1/tools/T2/events?cursor={cursor}")).await.code(), "invalid_cursor");
    let audit = app.get("/v1/audit?limit=1").await.json();
    let cursor = audit["next_cursor"].as_str().unwrap();
    assert_eq!(app.get(&format!("/v1/alarms?cursor={cursor}")).await.code(), "invalid_cursor");
    let turned = app.get(&format!("/v1/audit?order=newest&cursor={cursor}")).await;
    assert_eq!(turned.code(), "invalid_cursor", "a cursor leads one way");
    let newest = app.get("/v1/audit?order=newest&limit=1").await.json();
    let cursor = newest["next_cursor"].as_str().unwrap();
    let before = app.get(&format!("/v1/audit?order=newest&limit=1&cursor={cursor}")).await.json();
    let id = |list: &serde_json::Value| list["items"][0]["id"].as_i64().unwrap();
    assert!(
        id(&newest) == id(&before) + 1 && newest["items"][0]["subject"] == "tool/T2",
        "{newest} {before}"
    );
}
