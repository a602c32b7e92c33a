//! A PostgreSQL whose host vanishes: connections to it are never closed and lead nowhere, and another one takes over its
//! address.

use super::given::{Run, at, commit, engineer, shop, stored, tool};
use super::operations::Cluster;
use feedwright_store::{
    Committed, CycleFilter, Page, PostgresOptions, PostgresStore, Precondition, Repair, Store, StoreError,
};
use sqlx::postgres::PgConnectOptions;
use sqlx::{Connection, Executor, PgConnection};
use std::str::FromStr;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;

/// Times that a cycle is sent again.
const LOOKS: usize = 200;

/// What stands between a store and its server.
struct Line {
    port: u16,
    vanish: watch::Sender<()>,
}

impl Line {
    async fn to(server: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        let (vanish, vanished) = watch::channel(());
        tokio::spawn(async move {
            while let Ok((client, _)) = listener.accept().await {
                tokio::spawn(carry(client, server, vanished.clone()));
            }
        });
        Self { port, vanish }
    }

    /// Of all connections there are the server sees the end, and the client nothing.
    fn vanish(&self) {
        self.vanish.send_replace(());
    }
}

async fn carry(mut client: TcpStream, server: u16, mut vanished: watch::Receiver<()>) {
    vanished.mark_unchanged();
    let Ok(mut server) = TcpStream::connect(("127.0.0.1", server)).await else { return };
    tokio::select! {
        _ = tokio::io::copy_bidirectional(&mut client, &mut server) => {}
        gone = vanished.changed() => {
            drop(server);
            // The client's end stays open as long as the story.
            while gone.is_ok() && vanished.changed().await.is_ok() {}
        }
    }
}

/// A server, a line to it, and behind that a store with a shop.
async fn behind_a_line(connections: u32) -> Option<(Cluster, Line, PostgresStore)> {
    behind_a_line_for(connections, Duration::from_secs(2)).await
}

/// The same; a connection is lost after so long.
async fn behind_a_line_for(connections: u32, lost_after: Duration) -> Option<(Cluster, Line, PostgresStore)> {
    let cluster = Cluster::new()?;
    let line = Line::to(cluster.port()).await;
    let options = PostgresOptions {
        connections,
        patience: Duration::from_secs(2),
        lost_after,
        ..PostgresOptions::default()
    };
    let url = cluster.url().replace(&cluster.port().to_string(), &line.port.to_string());
    let store = PostgresStore::open(&url, options).await.unwrap();
    shop(&store).await;
    Some((cluster, line, store))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn groups_go_on_with_the_one_that_took_over() {
    let Some((cluster, line, store)) = behind_a_line(8).await else {
        return;
    };
    stored(&store, &Run::nth(1)).await;

    let mut holder = PgConnection::connect(&cluster.url()).await.unwrap();
    holder.execute("BEGIN; LOCK TABLE cycles IN ACCESS EXCLUSIVE MODE").await.unwrap();
    let waiting = {
        let store = store.clone();
        tokio::spawn(async move { commit(&store, &[Run::nth(2)]).await.pop().unwrap() })
    };
    cluster.one_waits_for_a_lock().await;
    line.vanish();
    holder.execute("ROLLBACK").await.unwrap();

    let answer = tokio::time::timeout(Duration::from_secs(60), waiting).await;
    let mut answer = answer.expect("the group is given up").unwrap();
    // As from a machine's buffer: what is not acknowledged is sent again.
    for _ in 0..LOOKS {
        if answer.is_ok() {
            break;
        }
        answer = commit(&store, &[Run::nth(2)]).await.pop().unwrap();
    }
    assert!(matches!(answer, Ok(Committed::Stored(_))), "{answer:?}");
    stored(&store, &Run::nth(3)).await;
    let page = Page { after: None, limit: 10 };
    assert_eq!(store.cycles(&CycleFilter::default(), page).await.unwrap().len(), 3, "each once");
    let wear = store.check_wear(Repair::No).await.unwrap();
    assert_eq!((wear.rows, wear.different), (1, vec![]));
}

/// The connection that is kept from one change to the next vanishes between them, and so do those of the pool: the next group finds
/// out, and has another one.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_group_has_another_connection_than_the_one_that_vanished_meanwhile() {
    // Far longer than it is to take, which is by half the patience and a word of the server.
    let Some((cluster, line, store)) = behind_a_line_for(8, Duration::from_secs(120)).await else {
        return;
    };
    stored(&store, &Run::nth(1)).await;
    // Meanwhile somebody else is at work for long, as a backup: that says nothing of this connection.
    let named = PgConnectOptions::from_str(&cluster.url()).unwrap().application_name("feedwright backup");
    let mut backup = PgConnection::connect_with(&named).await.unwrap();
    backup.execute("BEGIN; SELECT count(*) FROM cycles").await.unwrap();
    line.vanish();
    stored(&store, &Run::nth(2)).await;
    stored(&store, &Run::nth(3)).await;
    let wear = store.check_wear(Repair::No).await.unwrap();
    assert_eq!((wear.rows, wear.different), (1, vec![]));
}

/// Who waits for a tool longer than for a word of the server is not taken for one that leads nowhere.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_group_that_waits_for_a_tool_keeps_its_turn() {
    let Some(cluster) = Cluster::new() else {
        return;
    };
    let patience = Duration::from_secs(1);
    let options =
        PostgresOptions { patience, lost_after: Duration::from_secs(60), ..PostgresOptions::default() };
    let first = PostgresStore::open(&cluster.url(), options.clone()).await.unwrap();
    shop(&first).await;
    let second = PostgresStore::open(&cluster.url(), options).await.unwrap();
    // Each has a connection of a change before.
    stored(&first, &Run::nth(1)).await;
    stored(&second, &Run::nth(2)).await;
    let mut holder = PgConnection::connect(&cluster.url()).await.unwrap();
    holder.execute("BEGIN; LOCK TABLE cycles IN ACCESS EXCLUSIVE MODE").await.unwrap();
    let post = |store: &PostgresStore, n| {
        let store = store.clone();
        tokio::spawn(async move { commit(&store, &[Run::nth(n)]).await.pop().unwrap() })
    };
    // The one has the tool and waits for the table, the other one waits for the tool.
    let before = post(&first, 3);
    cluster.one_waits_for_a_lock().await;
    let behind = post(&second, 4);
    cluster.wait_for_a_lock(2).await;
    let pids = "SELECT array_agg(pid ORDER BY pid) FROM pg_stat_activity WHERE wait_event_type = 'Lock'";
    let waiting: Vec<i32> = sqlx::query_scalar(pids).fetch_one(&mut holder).await.unwrap();
    tokio::time::sleep(patience).await;
    let still: Vec<i32> = sqlx::query_scalar(pids).fetch_one(&mut holder).await.unwrap();
    assert_eq!(still, waiting, "nobody began anew");
    holder.execute("ROLLBACK").await.unwrap();
    for post in [before, behind] {
        assert!(matches!(post.await.unwrap(), Ok(Committed::Stored(_))));
    }
    let wear = first.check_wear(Repair::No).await.unwrap();
    assert_eq!((wear.rows, wear.different), (1, vec![]));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_place_of_the_pool_is_lost_with_it() {
    let Some((cluster, line, store)) = behind_a_line(5).await else {
        return;
    };
    stored(&store, &Run::nth(1)).await;
    // By its key: what posts wait for may take every place, as lists and long reads may not.
    let look = async |store: &PostgresStore| {
        let first = Run::nth(1).new_cycle().cycle;
        store.cycle(&first.machine, &first.id).await.map(|found| assert!(found.is_some()))
    };

    let mut holder = PgConnection::connect(&cluster.url()).await.unwrap();
    holder.execute("BEGIN; LOCK TABLE cycles IN ACCESS EXCLUSIVE MODE").await.unwrap();
    // One of each kind: a group, a read, reads in a snapshot, and two that are cut off, one of them before and one after.
    let group = tokio::spawn({
        let store = store.clone();
        async move { commit(&store, &[Run::nth(2)]).await.pop().unwrap() }
    });
    let [read, cut_off, cut_later] = std::array::from_fn(|_| {
        let store = store.clone();
        tokio::spawn(async move { look(&store).await })
    });
    let snapshot = tokio::spawn({
        let store = store.clone();
        async move { store.differences(Run::nth(1).new_cycle().cycle.as_ref().clone()).await.map(|_| ()) }
    });
    cluster.wait_for_a_lock(5).await;
    cut_off.abort();
    line.vanish();
    cut_later.abort();
    holder.execute("ROLLBACK").await.unwrap();

    let soon = Duration::from_secs(30);
    let read = tokio::time::timeout(soon, read).await.expect("a read is given up").unwrap();
    assert!(matches!(read, Err(StoreError::Unavailable(_))), "{read:?}");
    let snapshot = tokio::time::timeout(soon, snapshot).await.expect("a snapshot is given up").unwrap();
    assert!(matches!(snapshot, Err(StoreError::Unavailable(_))), "{snapshot:?}");
    let group = tokio::time::timeout(soon, group).await.expect("a group is given up").unwrap();
    assert!(
        matches!(group, Ok(_) | Err(StoreError::OutcomeUnknown(_) | StoreError::Unavailable(_))),
        "{group:?}"
    );

    // As many at once as there are places.
    holder.execute("BEGIN; LOCK TABLE cycles IN ACCESS EXCLUSIVE MODE").await.unwrap();
    let reads: Vec<_> = (0..5)
        .map(|_| {
            let store = store.clone();
            tokio::spawn(async move {
                for _ in 0..LOOKS {
                    match look(&store).await {
                        Err(StoreError::Unavailable(_)) => {}
                        read => return read,
                    }
                }
                panic!("no connection is to be had");
            })
        })
        .collect();
    cluster.wait_for_a_lock(5).await;
    holder.execute("ROLLBACK").await.unwrap();
    for read in reads {
        read.await.unwrap().unwrap();
    }
    for _ in 0..LOOKS {
        if commit(&store, &[Run::nth(2)]).await.pop().unwrap().is_ok() {
            break;
        }
    }
    let page = Page { after: None, limit: 10 };
    assert_eq!(store.cycles(&CycleFilter::default(), page).await.unwrap().len(), 2, "each once");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_listens_finds_out() {
    let Some((cluster, line, store)) = behind_a_line(2).await else {
        return;
    };
    let notices = store.notices().unwrap();
    let mut listener = notices.listen().await.unwrap();
    // That a connection is asked whether it is there does not end it, and loses nothing.
    let hearing = tokio::spawn(async move { (listener.next().await, listener) });
    cluster.shows("application_name = 'feedwright live' AND query = 'SELECT 1'").await;
    store.notify("before").await.unwrap();
    let (heard, mut listener) = hearing.await.unwrap();
    assert_eq!(heard.unwrap(), "before");
    line.vanish();
    let soon = Duration::from_secs(30);
    let heard = tokio::time::timeout(soon, listener.next()).await.expect("the silence is found out");
    assert!(matches!(heard, Err(StoreError::Unavailable(_))), "{heard:?}");
    let mut listener = notices.listen().await.unwrap();
    for _ in 0..LOOKS {
        if store.notify("after").await.is_ok() {
            break;
        }
    }
    assert_eq!(listener.next().await.unwrap(), "after");
}

/// A standby that confirms nothing keeps a commit for ever: it is not waited for by turns, and is known when it is sent again.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_commit_that_no_standby_confirms_is_waited_for_once() {
    let Some((cluster, _line, store)) = behind_a_line(8).await else {
        return;
    };
    cluster.confirms_nothing().await;
    let answer = commit(&store, &[Run::nth(1)]).await.pop().unwrap();
    assert!(matches!(answer, Err(StoreError::OutcomeUnknown(_))), "{answer:?}");
    let at_it = cluster.sessions("application_name = 'feedwright' AND state <> 'idle'").await;
    assert_eq!(at_it, 1, "it was not tried again");
    cluster.confirms_again().await;
    let mut answer = commit(&store, &[Run::nth(1)]).await.pop().unwrap();
    for _ in 0..LOOKS {
        if answer.is_ok() {
            break;
        }
        answer = commit(&store, &[Run::nth(1)]).await.pop().unwrap();
    }
    assert!(matches!(answer, Ok(Committed::Known(_) | Committed::Stored(_))), "{answer:?}");
    let page = Page { after: None, limit: 10 };
    assert_eq!(store.cycles(&CycleFilter::default(), page).await.unwrap().len(), 1, "once");
}

/// What people change is bounded as posts are, where no standby confirms it: the answer says that it is not known, and what comes
/// then does not take the connections of who reads.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_registration_that_no_standby_confirms_does_not_wait_for_ever() {
    let Some((cluster, _line, store)) = behind_a_line(5).await else {
        return;
    };
    cluster.confirms_nothing().await;
    let (soon, who) = (Duration::from_secs(30), engineer());
    // More of them at once than there are connections, of which some are left to reads.
    let registered: Vec<_> = (0..10)
        .map(|n| {
            let (store, who) = (store.clone(), who.clone());
            tokio::spawn(async move {
                store.put_tool(tool(&format!("A{n}")), Precondition::Unstated, &who, at(0)).await
            })
        })
        .collect();
    cluster.shows("application_name = 'feedwright' AND wait_event = 'SyncRep'").await;
    let read = tokio::time::timeout(soon, store.tool(&"T1".try_into().unwrap())).await;
    assert!(read.expect("reads are answered").unwrap().is_some());
    let (mut unknown, mut refused) = (Vec::new(), 0);
    for (n, registered) in registered.into_iter().enumerate() {
        match tokio::time::timeout(soon, registered).await.expect("it is answered").unwrap() {
            Err(StoreError::OutcomeUnknown(_)) => unknown.push(format!("A{n}")),
            Err(StoreError::Unavailable(_)) => refused += 1,
            other => panic!("{other:?}"),
        }
    }
    assert_eq!((unknown.len(), refused), (3, 7));
    // Nothing more is begun, and who reads is answered.
    let late = store.put_tool(tool("late"), Precondition::Unstated, &who, at(0)).await;
    assert!(matches!(late, Err(StoreError::Unavailable(_))), "{late:?}");
    let late = commit(&store, &[Run::nth(1)]).await.pop().unwrap();
    assert!(matches!(late, Err(StoreError::Unavailable(_))), "{late:?}");
    assert_eq!(cluster.sessions("application_name = 'feedwright' AND state <> 'idle'").await, 3);
    assert!(store.tool(&"late".try_into().unwrap()).await.unwrap().is_none());

    cluster.confirms_again().await;
    let taken = async { while commit(&store, &[Run::nth(1)]).await.pop().unwrap().is_err() {} };
    tokio::time::timeout(soon, taken).await.expect("changes are taken again");
    for name in unknown {
        assert!(
            store.tool(&name.as_str().try_into().unwrap()).await.unwrap().is_some(),
            "{name} was committed"
        );
    }
}

/// Behind an address that takes connections and says nothing.
#[tokio::test]
async fn a_start_finds_out_that_nobody_is_there() {
    let silent = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = silent.local_addr().unwrap().port();
    let options = PostgresOptions { lost_after: Duration::from_millis(300), ..PostgresOptions::default() };
    let url = format!("postgres://nobody@127.0.0.1:{port}/none");
    let opened = PostgresStore::open(&url, options);
    let opened = tokio::time::timeout(Duration::from_secs(30), opened).await.expect("it is found out");
    assert!(matches!(opened, Err(StoreError::Unavailable(_))), "{opened:?}");
}
