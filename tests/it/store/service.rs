//! Quarantine, tokens and the audit: bounded, hashed, append-only; and what the tables themselves refuse.

use super::given::{Given, Run, at, engineer, settle, shop, stored, stories};
use feedwright_store::{
    AlarmFilter, Page, QuarantineBounds, QuarantineEntry, Role, Store, StoreError, TokenRecord,
};
use std::sync::Arc;
use std::time::Duration;

stories!(
    the_quarantine_is_bounded_and_keeps_a_body_once,
    of_two_who_settle_an_entry_one_does,
    who_lists_the_quarantine_goes_on_behind_what_was_kept_last,
    a_token_is_known_by_its_hash_until_revoked,
    of_servers_that_begin_together_one_makes_the_first_token,
);

mod tables {
    super::stories!(
        with tables: the_audit_only_grows, the_tables_refuse_what_is_no_number, how_far_the_quarantine_is_filled_is_kept_whoever_changes_it
    );
    use super::{
        how_far_the_quarantine_is_filled_is_kept_whoever_changes_it, the_audit_only_grows,
        the_tables_refuse_what_is_no_number,
    };
}

fn entry(id: &str, cycle: Option<&str>) -> QuarantineEntry {
    QuarantineEntry {
        id: id.to_owned(),
        machine: "M1".try_into().unwrap(),
        cycle: cycle.map(str::to_owned),
        received_at: at(5),
        code: "out_of_range".to_owned(),
        problem: r#"{"status":422}"#.to_owned(),
        content_type: "application/json".to_owned(),
        settled: None,
        size: 0,
    }
}

async fn of_servers_that_begin_together_one_makes_the_first_token(store: Arc<dyn Store>) {
    let first = |at: u8| {
        let token = TokenRecord {
            id: format!("first {at}"),
            name: "first start".to_owned(),
            hash: [at; 32],
            role: Role::Admin,
            machine: None,
            created_at: super::given::at(1),
            revoked_at: None,
        };
        let store = Arc::clone(&store);
        tokio::spawn(async move { store.create_first_token(token, &engineer()).await.unwrap() })
    };
    let made = futures_util::future::join_all((0..8).map(first)).await;
    let made: Vec<bool> = made.into_iter().map(Result::unwrap).collect();
    assert_eq!(made.iter().filter(|made| **made).count(), 1, "{made:?}");
    assert_eq!(store.tokens(Page { after: None, limit: 9 }).await.unwrap().len(), 1);
    assert_eq!(store.audit(Page { after: None, limit: 9 }).await.unwrap().len(), 1);
}

async fn the_quarantine_is_bounded_and_keeps_a_body_once(store: Arc<dyn Store>) {
    shop(&*store).await;
    let bounds = QuarantineBounds { entries: 3, bytes: 10_000 };
    let keep =
        async |id: &str, cycle, body: &[u8]| store.quarantine(entry(id, cycle), body.to_vec(), bounds).await;
    let body = vec![b'x'; 5000];
    assert_eq!(keep("q1", Some("c1"), &body).await.unwrap(), "q1");
    assert_eq!(keep("q2", Some("c1"), &body).await.unwrap(), "q1", "the same once more");
    assert_eq!(keep("q3", Some("c2"), &body).await.unwrap(), "q3");
    assert_eq!(keep("q4", None, b"").await.unwrap(), "q4");
    let full = keep("q5", None, b"other").await;
    assert!(matches!(full, Err(StoreError::Full { .. })), "{full:?}");
    assert_eq!(keep("q6", Some("c2"), &body).await.unwrap(), "q3", "known ones are answered all the same");

    let (found, found_body) = store.quarantine_entry("q1").await.unwrap().unwrap();
    assert_eq!(found, QuarantineEntry { size: 5000, ..entry("q1", Some("c1")) });
    assert_eq!(found_body.as_deref(), Some(&body[..]), "as it came");
    assert_eq!(store.quarantine_entry("q4").await.unwrap().unwrap().1.unwrap(), b"");
    assert_eq!(store.quarantine_entry("q2").await.unwrap(), None);
    let open_alarms = AlarmFilter { open: Some(true), ..AlarmFilter::default() };
    assert_eq!(store.alarms(&open_alarms, Page { after: None, limit: 9 }).await.unwrap().len(), 1);

    let ids = async |open, after: Option<&str>| -> Vec<String> {
        let page = Page { after: after.map(str::to_owned), limit: 10 };
        let machine = "M1".try_into().unwrap();
        let found = store.quarantined(Some(&machine), open, page).await.unwrap();
        found.into_iter().map(|entry| entry.id).collect()
    };
    assert!(settle(&*store, "q1", "re-ingested", at(9)).await);
    assert!(!settle(&*store, "q1", "again", at(10)).await);
    assert!(!settle(&*store, "q9", "never there", at(10)).await);
    assert_eq!(ids(true, None).await, ["q3", "q4"]);
    assert_eq!(ids(false, Some("q1")).await, ["q3", "q4"]);
    assert_eq!(ids(false, None).await, ["q1", "q3", "q4"]);
    let settled = store.quarantine_entry("q1").await.unwrap().unwrap().0.settled;
    assert_eq!(settled, Some((at(9), "re-ingested".to_owned())));
    assert_eq!(keep("q7", None, b"other").await.unwrap(), "q7", "there is room again");
    for id in ["q3", "q4", "q7"] {
        assert!(settle(&*store, id, "discarded", at(11)).await);
    }
    assert_eq!(store.alarms(&open_alarms, Page { after: None, limit: 9 }).await.unwrap(), []);

    let bytes = QuarantineBounds { entries: 100, bytes: 4 };
    let full = store.quarantine(entry("q8", None), vec![7; 100], bytes).await;
    assert!(matches!(full, Err(StoreError::Full { .. })), "{full:?}");
}

/// Counted anew, and as it is kept.
async fn filled(given: &Given) -> [Vec<i64>; 4] {
    [
        given.numbers("SELECT COUNT(*) FROM quarantine WHERE settled_at_us IS NULL").await,
        given.numbers("SELECT entries FROM quarantine_fill").await,
        given
            .numbers(
                "SELECT CAST(COALESCE(SUM(stored_bytes), 0) AS BIGINT) FROM quarantine WHERE settled_at_us IS NULL",
            )
            .await,
        given.numbers("SELECT bytes FROM quarantine_fill").await,
    ]
}

/// Of how many entries, and that what is kept is what is counted.
async fn agrees(given: &Given, entries: i64) {
    let [counted, kept, bytes, kept_bytes] = filled(given).await;
    assert_eq!((&counted, &bytes), (&kept, &kept_bytes));
    assert_eq!(counted, [entries]);
}

async fn how_far_the_quarantine_is_filled_is_kept_whoever_changes_it(given: &Given) {
    let store = &*given.store();
    shop(store).await;
    agrees(given, 0).await;
    let bounds = QuarantineBounds { entries: 4, bytes: 10_000 };
    let keep = async |n: u8| store.quarantine(entry(&format!("q{n}"), None), vec![n; 9], bounds).await;
    for n in 1..=3 {
        keep(n).await.unwrap();
        keep(n).await.unwrap();
    }
    agrees(given, 3).await;
    assert!(settle(store, "q2", "discarded", at(9)).await);
    agrees(given, 2).await;
    // What a disk has damaged is kept anew when it comes again.
    let damaged = "UPDATE quarantine SET body = substr(body, 1, 3), stored_bytes = 3 WHERE quarantine_id IN ('q1', 'q2')";
    given.raw(damaged).await.unwrap();
    agrees(given, 2).await;
    assert_eq!((keep(1).await.unwrap(), keep(2).await.unwrap()), ("q1".to_owned(), "q2".to_owned()));
    agrees(given, 2).await;
    given.raw("UPDATE quarantine SET settled_at_us = NULL, settled_how = NULL").await.unwrap();
    agrees(given, 3).await;
    given.raw("DELETE FROM quarantine WHERE quarantine_id = 'q1'").await.unwrap();
    agrees(given, 2).await;
    // It is wrong, or is not there, as after a table was brought back by itself: the next round sets it right, and until then a line is
    // taken by what is kept.
    for wrong in ["UPDATE quarantine_fill SET entries = 4", "DELETE FROM quarantine_fill"] {
        given.raw(wrong).await.unwrap();
        store.watch(Vec::new(), &super::given::watched(), at(20)).await.unwrap();
        agrees(given, 2).await;
    }
    given.raw("DELETE FROM quarantine_fill").await.unwrap();
    keep(4).await.unwrap();
    agrees(given, 3).await;
    keep(5).await.unwrap();
    let full = keep(6).await;
    assert!(matches!(full, Err(StoreError::Full { .. })), "{full:?}");
    agrees(given, 4).await;
}

/// Of two servers that take lines at once, no more are kept than there is room for, and no fewer.
#[tokio::test]
async fn two_servers_fill_the_quarantine_to_its_bound_and_no_further() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let (one, other) = (given.store(), given.server_of_its_own().await);
    let other: Arc<dyn Store> = Arc::new(other);
    shop(&*one).await;
    let bounds = QuarantineBounds { entries: 25, bytes: 1_000_000 };
    for (round, room) in [(0_u8, 25), (1, 9)] {
        let kept = (0..40_u8).map(|n| {
            let store = Arc::clone(if n % 2 == 0 { &one } else { &other });
            tokio::spawn(async move {
                let entry = entry(&format!("r{round}-{n:02}"), None);
                match store.quarantine(entry, vec![round, n], bounds).await {
                    Ok(_) => true,
                    Err(StoreError::Full { .. }) => false,
                    Err(error) => panic!("{error}"),
                }
            })
        });
        let kept = futures_util::future::join_all(kept).await;
        assert_eq!(kept.into_iter().filter(|kept| *kept.as_ref().unwrap()).count(), room);
        agrees(&given, 25).await;
        let page = Page { after: None, limit: 9 };
        let open = one.quarantined(None, true, page).await.unwrap();
        let settling = open.iter().enumerate().map(|(n, entry)| {
            let store = Arc::clone(if n % 2 == 0 { &one } else { &other });
            let id = entry.id.clone();
            tokio::spawn(async move { settle(&*store, &id, "discarded", at(9)).await })
        });
        for settled in futures_util::future::join_all(settling).await {
            assert!(settled.unwrap());
        }
        agrees(&given, 16).await;
    }
    other.close().await;
    given.done().await;
}

/// A line that cannot be accepted costs what it costs, however many wait and have waited.
#[tokio::test]
async fn a_line_reads_none_of_the_entries_that_wait() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let store = &*given.store();
    shop(store).await;
    let others = "INSERT INTO quarantine (quarantine_id, machine_id, cycle_id, received_at_us, code, problem, content_type, size,
                      stored_bytes, body, body_hash, settled_at_us, settled_how)
                  SELECT 'a' || n, CASE WHEN n % 2 = 0 THEN 'M1' ELSE 'M2' END, NULL, 0, 'c', '{}', 't', 1, 1, '',
                      decode(lpad(to_hex(n), 64, '0'), 'hex'), CASE WHEN n % 2 = 0 THEN 1 END, CASE WHEN n % 2 = 0 THEN 'x' END
                  FROM generate_series(1, 6000) AS n";
    assert_eq!(given.raw(others).await.unwrap(), 6000);
    given.raw("ANALYZE quarantine").await.unwrap();
    let bounds = QuarantineBounds { entries: 10_000, bytes: 1_000_000 };
    for n in 1..=5 {
        store.quarantine(entry(&format!("b{n}"), None), vec![n], bounds).await.unwrap();
    }
    let machine = "M1".try_into().unwrap();
    let page = |limit| Page { after: None, limit };
    assert_eq!(store.quarantined(Some(&machine), true, page(9)).await.unwrap().len(), 5);
    for n in 1..=5 {
        assert!(settle(store, &format!("b{n}"), "discarded", at(9)).await);
    }
    assert_eq!(store.quarantined(Some(&machine), true, page(9)).await.unwrap().len(), 0);
    assert_eq!(store.quarantined(Some(&machine), false, page(9)).await.unwrap().len(), 9);
    assert_eq!(store.quarantined(None, true, page(9)).await.unwrap().len(), 9);
    let read = given.read_of("quarantine").await;
    // They were 3,000 for each line, and 6,000 for each list of a machine.
    assert!(read < 150, "{read}");
    given.done().await;
}

async fn of_two_who_settle_an_entry_one_does(store: Arc<dyn Store>) {
    shop(&*store).await;
    let bounds = QuarantineBounds { entries: 9, bytes: 10_000 };
    store.quarantine(entry("q1", Some("c1")), vec![1], bounds).await.unwrap();
    let now = at(9);
    let claim = async |holder: &str| {
        store.claim_quarantine("q1", holder, Duration::from_secs(60), now).await.unwrap()
    };
    let settle =
        async |holder: &str| store.settle_quarantine("q1", holder, "why", &engineer(), now).await.unwrap();
    assert!(!settle("one").await, "nobody has claimed it");
    assert!(claim("one").await && claim("one").await, "one's own goes on");
    assert!(!claim("two").await && !settle("two").await);
    store.release_quarantine("q1", "two").await.unwrap();
    assert!(!claim("two").await, "it is not that one's");
    store.release_quarantine("q1", "one").await.unwrap();
    assert!(claim("two").await && !settle("one").await);
    // It ended: its claim ends by itself. A database that several servers share goes by its own clock.
    assert!(store.claim_quarantine("q1", "two", Duration::ZERO, now).await.unwrap());
    assert!(claim("three").await && !settle("two").await && settle("three").await);
    assert!(!claim("one").await && !claim("three").await && !settle("three").await, "it is settled");
    assert!(!store.claim_quarantine("q9", "one", Duration::from_secs(60), now).await.unwrap());
}

/// What was received first may be kept last.
async fn who_lists_the_quarantine_goes_on_behind_what_was_kept_last(store: Arc<dyn Store>) {
    shop(&*store).await;
    let bounds = QuarantineBounds { entries: 9, bytes: 10_000 };
    let ids = ["0192", "0193", "0191"].map(|first| format!("{first}0000-0000-7000-8000-00000000ffff"));
    let mut kept = Vec::new();
    for (n, id) in ids.iter().enumerate() {
        let entry = entry(id, Some(&format!("c{n}")));
        kept.push(store.quarantine(entry, vec![1], bounds).await.unwrap());
        let page = Page { after: kept.iter().rev().nth(1).cloned(), limit: 9 };
        let listed = store.quarantined(None, true, page).await.unwrap();
        assert_eq!(listed.iter().map(|entry| &entry.id).collect::<Vec<_>>(), [&kept[n]]);
        assert_eq!(store.quarantine_entry(&kept[n]).await.unwrap().unwrap().1, Some(vec![1]));
    }
    assert_eq!(kept[..2], ids[..2]);
    assert_eq!(kept[2], "01930000-0000-7000-8000-000000010000");
}

async fn a_token_is_known_by_its_hash_until_revoked(store: Arc<dyn Store>) {
    let token = |id: &str, hash: u8, role, machine: Option<&str>| TokenRecord {
        id: id.to_owned(),
        name: format!("token {id}"),
        hash: [hash; 32],
        role,
        machine: machine.map(|machine| machine.try_into().unwrap()),
        created_at: at(1),
        revoked_at: None,
    };
    let (first, second) = (token("a", 1, Role::Machine, Some("M1")), token("b", 2, Role::Viewer, None));
    store.create_token(first.clone(), &engineer()).await.unwrap();
    store.create_token(second.clone(), &engineer()).await.unwrap();
    for refused in [
        token("a", 3, Role::Viewer, None),
        token("c", 1, Role::Viewer, None),
        token("d", 4, Role::Machine, None),
        token("e", 5, Role::Admin, Some("M1")),
    ] {
        let outcome = store.create_token(refused, &engineer()).await;
        assert!(matches!(outcome, Err(StoreError::Refused { .. })), "{outcome:?}");
    }
    assert_eq!(store.token_by_hash(&[1; 32]).await.unwrap(), Some(first.clone()));
    assert_eq!(store.token_by_hash(&[9; 32]).await.unwrap(), None);
    let revoked = TokenRecord { revoked_at: Some(at(7)), ..first };
    assert_eq!(store.revoke_token("a", &engineer(), at(7)).await.unwrap(), Some(revoked.clone()));
    assert_eq!(store.revoke_token("a", &engineer(), at(8)).await.unwrap(), Some(revoked.clone()));
    assert_eq!(store.revoke_token("z", &engineer(), at(8)).await.unwrap(), None);
    assert_eq!(store.token_by_hash(&[1; 32]).await.unwrap(), Some(revoked.clone()));
    assert_eq!(store.tokens(Page { after: None, limit: 9 }).await.unwrap(), [revoked, second.clone()]);
    assert_eq!(store.tokens(Page { after: Some("a".to_owned()), limit: 9 }).await.unwrap(), [second]);
    let audit = store.audit(Page { after: None, limit: 9 }).await.unwrap();
    let actions: Vec<&str> = audit.iter().map(|line| line.action.as_str()).collect();
    assert_eq!(actions, ["token.create", "token.create", "token.revoke"]);
    assert!(audit.iter().all(|line| !line.detail.contains("0101")), "no hash in the audit");
}

async fn the_audit_only_grows(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    let before = store.audit(Page { after: None, limit: 100 }).await.unwrap();
    let attempts: [&'static str; 2] = ["UPDATE audit SET actor = 'nobody'", "DELETE FROM audit"];
    for attempt in attempts {
        let refused = given.raw(attempt).await.unwrap_err();
        assert!(refused.to_string().contains("audit is append-only"), "{refused}");
    }
    assert_eq!(store.audit(Page { after: None, limit: 100 }).await.unwrap(), before);
}

async fn the_tables_refuse_what_is_no_number(given: &Given) {
    let store = given.store();
    shop(&*store).await;
    stored(&*store, &Run::nth(1)).await;
    // 9e999 is infinity in SQLite and out of range in PostgreSQL; what SQLite makes of NaN is NULL.
    let changes = [
        "coverage = 9e999",
        "coverage = NULL",
        "max_depth_mm = 9e999",
        "max_depth_mm = NULL",
        "rated_power_joules = -9e999",
    ];
    let other = "UPDATE machines SET feed_max_mm_min = 9e999".to_owned();
    for attempt in changes.map(|change| given.change(change)).into_iter().chain([other]) {
        let refused = given.raw(sqlx::AssertSqlSafe(attempt.clone())).await;
        let Err(sqlx::Error::Database(refused)) = refused else { panic!("{attempt}: {refused:?}") };
        let refused = refused.message().to_ascii_lowercase();
        assert!(
            ["constraint", "out of range"].iter().any(|word| refused.contains(word)),
            "{attempt}: {refused}"
        );
    }
    if !given.is_postgres() {
        // Neither in words, nor beyond it as what is kept shorter.
        for attempt in ["'much'", "9000000000000000", "x'00'"]
            .map(|value| given.change(&format!("max_depth_mm = {value}")))
        {
            let refused = given.raw(sqlx::AssertSqlSafe(attempt.clone())).await.unwrap_err().to_string();
            assert!(refused.contains("cycles_max_depth_mm_range"), "{attempt}: {refused}");
        }
    }
    if given.is_postgres() {
        let nan: [&'static str; 3] = [
            "UPDATE cycles SET coverage = 'NaN'",
            "UPDATE cycles SET max_depth_mm = 'NaN'",
            "UPDATE cycles SET rated_power_joules = 'Infinity'",
        ];
        for attempt in nan {
            let refused = given.raw(attempt).await;
            assert!(matches!(refused, Err(sqlx::Error::Database(_))), "{attempt}: {refused:?}");
        }
    }
}
