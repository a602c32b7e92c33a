//! A PostgreSQL whose host vanishes: connections to it are never closed and lead nowhere, and another one takes over its
//! address.

use super::given::{Run, commit, shop, stored};
use super::operations::Cluster;
use feedwright_store::{Committed, CycleFilter, Page, PostgresOptions, PostgresStore, Repair, Store};
use sqlx::{Connection, Executor, PgConnection};
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

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn groups_go_on_with_the_one_that_took_over() {
    let Some(cluster) = Cluster::new() else {
        return;
    };
    let line = Line::to(cluster.port()).await;
    let options = PostgresOptions {
        patience: Duration::from_secs(2),
        lost_after: Duration::from_secs(2),
        ..PostgresOptions::default()
    };
    let url = cluster.url().replace(&cluster.port().to_string(), &line.port.to_string());
    let store = PostgresStore::open(&url, options).await.unwrap();
    shop(&store).await;
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
