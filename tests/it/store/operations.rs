//! What happens to PostgreSQL in a plant: several servers start at once, a pooler stands in front, the server restarts,
//! is demoted, and replicas get the same cycles.

use super::given::{Given, Run, at, commit, shop, stored, tool};
use feedwright_core::recommend::RecommendSettings;
use feedwright_store::transfer::back_up_postgres;
use feedwright_store::{
    Committed, CycleFilter, Page, PostgresOptions, PostgresStore, Precondition, Repair, Store, StoreError,
};
use sqlx::{Connection, Executor, PgConnection};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn is_root() -> bool {
    let id = Command::new("id").arg("-u").output().unwrap();
    id.stdout.trim_ascii() == b"0"
}

/// A command that does not run as root, which neither PostgreSQL nor its pooler does.
fn unprivileged(program: &Path) -> Command {
    if !is_root() {
        return Command::new(program);
    }
    let mut command = Command::new("runuser");
    command.args(["-u", "postgres", "--"]).arg(program);
    command
}

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::set_permissions(folder.path(), std::os::unix::fs::PermissionsExt::from_mode(0o777)).unwrap();
    folder
}

async fn answers(url: &str) {
    for _ in 0..200 {
        if PgConnection::connect(url).await.is_ok() {
            return;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    panic!("{url} does not answer");
}

/// A PostgreSQL server of a story's own, that it may stop and start.
pub(crate) struct Cluster {
    folder: tempfile::TempDir,
    binaries: PathBuf,
    port: u16,
}

impl Cluster {
    /// `None` only where a person asked to leave the stories of PostgreSQL out.
    pub(crate) fn new() -> Option<Self> {
        std::env::var_os("FEEDWRIGHT_TEST_POSTGRES").or_else(|| {
            assert!(
                std::env::var_os("FEEDWRIGHT_TEST_SKIP_POSTGRES").is_some(),
                "run it behind tests/postgres"
            );
            None
        })?;
        let mut versions: Vec<_> = std::fs::read_dir("/usr/lib/postgresql").unwrap().flatten().collect();
        versions.sort_by_key(std::fs::DirEntry::file_name);
        let binaries = versions.last().expect("a version of PostgreSQL").path().join("bin");
        let cluster = Self { folder: folder(), binaries, port: free_port() };
        let made = unprivileged(&cluster.binaries.join("initdb"))
            .args(["-U", "feedwright", "--auth=trust", "-E", "UTF8", "--locale=C", "--no-sync", "-D"])
            .arg(cluster.data())
            .stdout(Stdio::null())
            .status()
            .unwrap();
        assert!(made.success());
        cluster.control(&["start"]);
        Some(cluster)
    }

    fn data(&self) -> PathBuf {
        self.folder.path().join("data")
    }

    pub(crate) fn control(&self, arguments: &[&str]) {
        let options = format!(
            "-c listen_addresses=127.0.0.1 -c port={} -c unix_socket_directories={}",
            self.port,
            self.folder.path().display()
        );
        let mut command = unprivileged(&self.binaries.join("pg_ctl"));
        command.arg("-D").arg(self.data()).args(["-w", "-s", "-m", "fast", "-o", &options, "-l"]);
        command.arg(self.folder.path().join("log")).args(arguments);
        assert!(command.stdout(Stdio::null()).status().unwrap().success(), "pg_ctl {arguments:?}");
    }

    pub(crate) const fn port(&self) -> u16 {
        self.port
    }

    pub(crate) fn url(&self) -> String {
        format!("postgres://feedwright@127.0.0.1:{}/postgres", self.port)
    }

    /// Has every process of the server stand still, until what is returned is dropped.
    pub(crate) async fn frozen(&self) -> Frozen {
        let mut conn = PgConnection::connect(&self.url()).await.unwrap();
        let mut processes: Vec<i32> =
            sqlx::query_scalar("SELECT pid FROM pg_stat_activity").fetch_all(&mut conn).await.unwrap();
        let postmaster = std::fs::read_to_string(self.data().join("postmaster.pid")).unwrap();
        processes.push(postmaster.lines().next().unwrap().parse().unwrap());
        let frozen = Frozen(processes.iter().map(i32::to_string).collect());
        frozen.signal("-STOP");
        frozen
    }

    /// Has every commit from here on wait for a standby that there is not, until [`Cluster::confirms_again`].
    pub(crate) async fn confirms_nothing(&self) {
        self.run("ALTER SYSTEM SET synchronous_standby_names = 'nobody'").await;
        self.run("SELECT pg_reload_conf()").await;
        // The server's processes hear of it one after the other: it holds when a commit waits.
        let mut conn = PgConnection::connect(&self.url()).await.unwrap();
        let commits = tokio::spawn(async move {
            loop {
                conn.execute("COMMENT ON DATABASE postgres IS 'commits'").await.unwrap();
            }
        });
        self.shows("wait_event = 'SyncRep'").await;
        commits.abort();
    }

    pub(crate) async fn confirms_again(&self) {
        self.run("ALTER SYSTEM RESET synchronous_standby_names").await;
        self.run("SELECT pg_reload_conf()").await;
    }

    /// Returns once a single session waits for a lock.
    pub(crate) async fn one_waits_for_a_lock(&self) {
        self.wait_for_a_lock(1).await;
    }

    /// Waits until so many sessions wait for a lock.
    pub(crate) async fn wait_for_a_lock(&self, sessions: i64) {
        self.wait_for("wait_event_type = 'Lock'", |found| found == sessions).await;
    }

    /// Waits until a session is shown of which that is true.
    pub(crate) async fn shows(&self, condition: &'static str) {
        self.wait_for(condition, |found| found > 0).await;
    }

    async fn wait_for(&self, condition: &'static str, is_so: impl Fn(i64) -> bool) {
        for _ in 0..200 {
            if is_so(self.sessions(condition).await) {
                return;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        panic!("not as many sessions as are to be: {condition}");
    }

    /// Of how many sessions that is true.
    pub(crate) async fn sessions(&self, condition: &'static str) -> i64 {
        let mut conn = PgConnection::connect(&self.url()).await.unwrap();
        let sql =
            format!("SELECT count(*) FROM pg_stat_activity WHERE pid <> pg_backend_pid() AND {condition}");
        sqlx::query_scalar(sqlx::AssertSqlSafe(sql)).fetch_one(&mut conn).await.unwrap()
    }

    pub(crate) async fn run(&self, sql: &'static str) {
        PgConnection::connect(&self.url()).await.unwrap().execute(sql).await.unwrap();
    }
}

/// A server whose processes stand still.
pub(crate) struct Frozen(Vec<String>);

impl Frozen {
    fn signal(&self, signal: &str) {
        let told = Command::new("kill").arg(signal).args(&self.0).stderr(Stdio::null()).status();
        // A process that has ended since needs no signal.
        assert!(told.is_ok());
    }
}

impl Drop for Frozen {
    fn drop(&mut self) {
        self.signal("-CONT");
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        let mut stop = unprivileged(&self.binaries.join("pg_ctl"));
        let _ = stop.arg("-D").arg(self.data()).args(["-s", "-m", "immediate", "stop"]).status();
    }
}

/// pgbouncer in transaction mode in front of a server, as Debian ships it: without a memory of prepared statements.
struct Pooler {
    child: Child,
    _folder: tempfile::TempDir,
    port: u16,
}

impl Pooler {
    async fn before(server: &str, database: &str) -> Self {
        let server = server.rsplit_once('@').unwrap().1;
        let (host, port) = server.split_once('/').unwrap().0.split_once(':').unwrap();
        let (folder, own) = (folder(), free_port());
        let config = folder.path().join("pgbouncer.ini");
        // Three connections to the server for many clients: statements of one client meet every one of them.
        let text = format!(
            "[databases]\n{database} = host={host} port={port} user=feedwright\n[pgbouncer]\nlisten_addr = 127.0.0.1\n\
             listen_port = {own}\nauth_type = any\npool_mode = transaction\ndefault_pool_size = 3\n\
             server_round_robin = 1\nignore_startup_parameters = extra_float_digits\nunix_socket_dir =\n"
        );
        std::fs::write(&config, text).unwrap();
        let child = unprivileged(Path::new("/usr/sbin/pgbouncer"))
            .arg("-q")
            .arg(&config)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("pgbouncer is installed: tests/postgres does it");
        let pooler = Self { child, _folder: folder, port: own };
        answers(&pooler.url(database)).await;
        pooler
    }

    fn url(&self, database: &str) -> String {
        format!("postgres://feedwright@127.0.0.1:{}/{database}", self.port)
    }
}

impl Drop for Pooler {
    fn drop(&mut self) {
        let _ = Command::new("kill").arg(self.child.id().to_string()).status();
        let _ = self.child.wait();
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn servers_that_start_together_migrate_once() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    given.raw("DROP SCHEMA public CASCADE").await.unwrap();
    given.raw("CREATE SCHEMA public").await.unwrap();
    let address = given.address();
    let start = || async {
        let options = PostgresOptions { connections: 2, ..PostgresOptions::default() };
        let store = PostgresStore::open(&address, options).await.unwrap();
        store.make_room(at(0)).await.unwrap();
        store
    };
    let stores: [PostgresStore; 4] = tokio::join!(start(), start(), start(), start()).into();
    shop(&stores[0]).await;
    assert!(stored(&stores[3], &Run::nth(1)).await.registered);
    for store in &stores {
        store.close().await;
    }
    given.done().await;
}

#[tokio::test]
async fn a_direct_address_of_another_database_is_refused() {
    let (Some(given), Some(other)) = (Given::postgres().await, Given::postgres().await) else {
        return;
    };
    let options = |direct: &Given| PostgresOptions {
        pooled: true,
        direct: Some(direct.address()),
        ..PostgresOptions::default()
    };
    let refused = PostgresStore::open(&given.address(), options(&other)).await.unwrap_err();
    assert!(format!("{refused:?}").contains("leads to another database"), "{refused:?}");
    PostgresStore::open(&given.address(), options(&given)).await.unwrap().close().await;
    given.done().await;
    other.done().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_pooler_in_transaction_mode_is_borne() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    let database = given.address().rsplit_once('/').unwrap().1.to_owned();
    let pooler = Pooler::before(&given.address(), &database).await;
    let options = PostgresOptions {
        connections: 8,
        pooled: true,
        direct: Some(given.address()),
        patience: Duration::from_secs(30),
        ..PostgresOptions::default()
    };
    let untold = PostgresStore::open(&pooler.url(&database), PostgresOptions::default()).await.unwrap_err();
    assert!(
        format!("{untold:?}").contains("set database.pooled = true and database.direct_url"),
        "{untold:?}"
    );
    let store = PostgresStore::open(&pooler.url(&database), options).await.unwrap();
    shop(&store).await;
    store.make_room(at(0)).await.unwrap();
    // Eight connections at once on three of the server's: reads and writes, each statement on whichever is free.
    let work = (0..8_u32).map(|worker| {
        let store = store.clone();
        tokio::spawn(async move {
            for n in 0..10 {
                // A tool of its own: what is waited for here is the pooler, not a lock.
                let run = Run { tool: format!("T{worker}"), ..Run::nth(worker * 100 + n) };
                stored(&store, &run).await;
                let found =
                    store.cycle(&"M1".try_into().unwrap(), &run.id.as_str().try_into().unwrap()).await;
                assert!(found.unwrap().is_some(), "{}", run.id);
                assert!(store.verdict(&"T1".try_into().unwrap()).await.is_ok());
                assert!(!store.machines(Page { after: None, limit: 9 }).await.unwrap().is_empty());
            }
        })
    });
    for worker in work.collect::<Vec<_>>() {
        worker.await.unwrap();
    }
    let all = store.cycles(&CycleFilter::default(), Page { after: None, limit: 1000 }).await.unwrap();
    assert_eq!(all.len(), 80);
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
    store.close().await;
    drop(pooler);
    given.done().await;
}

#[tokio::test]
async fn after_a_restart_of_the_server_work_goes_on() {
    let Some(cluster) = Cluster::new() else {
        return;
    };
    let options = PostgresOptions { patience: Duration::from_secs(1), ..PostgresOptions::default() };
    let store = PostgresStore::open(&cluster.url(), options).await.unwrap();
    shop(&store).await;
    stored(&store, &Run::nth(1)).await;
    cluster.control(&["stop"]);
    let refused = commit(&store, &[Run::nth(2)]).await.pop().unwrap();
    assert!(
        matches!(refused, Err(StoreError::Unavailable(_) | StoreError::OutcomeUnknown(_))),
        "nothing is acknowledged: {refused:?}"
    );
    assert!(store.probe_write(at(1)).await.is_err());
    cluster.control(&["start"]);
    // The first question may meet a connection that the stop broke; the pool lets it go.
    stored(&store, &Run::nth(2)).await;
    stored(&store, &Run::nth(3)).await;
    assert!(store.probe_write(at(2)).await.is_ok());
    assert_eq!(store.check_wear(Repair::No).await.unwrap().different, []);
    let cycles = store.cycles(&CycleFilter::default(), Page { after: None, limit: 9 }).await.unwrap();
    assert_eq!(cycles.len(), 3, "each once");
    store.close().await;
}

/// As where others have taken every place that was free when the server came back. Waited for again and again machines would hear nothing.
#[tokio::test]
async fn a_server_without_a_free_place_is_waited_for_once() {
    let Some(cluster) = Cluster::new() else { return };
    cluster.run("CREATE ROLE plain LOGIN").await;
    cluster.run("GRANT ALL ON SCHEMA public TO plain").await;
    let url = cluster.url().replace("feedwright@", "plain@");
    let patience = Duration::from_secs(4);
    let options = PostgresOptions { patience, ..PostgresOptions::default() };
    let store = PostgresStore::open(&url, options).await.unwrap();
    shop(&store).await;
    stored(&store, &Run::nth(1)).await;
    cluster.run("ALTER ROLE plain CONNECTION LIMIT 0").await;
    cluster.run("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE usename = 'plain'").await;
    let begun = Instant::now();
    let refused = commit(&store, &[Run::nth(2)]).await.pop().unwrap();
    let waited = begun.elapsed();
    assert!(
        matches!(refused, Err(StoreError::Unavailable(_) | StoreError::OutcomeUnknown(_))),
        "nothing is acknowledged: {refused:?}"
    );
    assert!(patience <= waited && waited < 2 * patience, "{waited:?}");
    cluster.run("ALTER ROLE plain CONNECTION LIMIT -1").await;
    stored(&store, &Run::nth(2)).await;
    store.close().await;
}

/// What a policy hides from the service's role would be neither counted nor saved.
#[tokio::test]
async fn rows_that_are_hidden_are_not_left_out_in_silence() {
    let Some(cluster) = Cluster::new() else { return };
    cluster.run("CREATE ROLE plain LOGIN").await;
    cluster.run("GRANT ALL ON SCHEMA public TO plain").await;
    let url = cluster.url().replace("feedwright@", "plain@");
    let store = PostgresStore::open(&url, PostgresOptions::default()).await.unwrap();
    shop(&store).await;
    stored(&store, &Run::nth(1)).await;
    cluster.run("ALTER TABLE tools ENABLE ROW LEVEL SECURITY").await;
    store.probe_write(at(1)).await.expect("it holds for others than the owner");
    cluster.run("ALTER TABLE tools FORCE ROW LEVEL SECURITY").await;
    let read = store.tools(Page { after: None, limit: 9 }).await;
    assert!(read.is_err(), "{read:?}");
    store.close().await;
    let refused = PostgresStore::open(&url, PostgresOptions::default()).await.err().unwrap();
    assert!(format!("{refused:?}").contains("row security hides rows of tools"), "{refused:?}");
    let folder = folder();
    let file = folder.path().join("plant.backup");
    let backup = back_up_postgres(&url, &file, at(2)).await;
    assert!(backup.is_err(), "{backup:?}");
    assert!(!file.exists());
    cluster.run("ALTER TABLE tools NO FORCE ROW LEVEL SECURITY").await;
    back_up_postgres(&url, &file, at(3)).await.unwrap();
}

#[tokio::test]
async fn a_server_that_demands_tls_is_reached_and_held_against_its_certificate() {
    let Some(cluster) = Cluster::new() else { return };
    let data = cluster.data();
    let owner = std::fs::metadata(&data).unwrap();
    let (uid, gid) = {
        use std::os::unix::fs::MetadataExt;
        (owner.uid(), owner.gid())
    };
    let give = |name: &str, text: &str| {
        let path = data.join(name);
        std::fs::write(&path, text).unwrap();
        std::fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o600)).unwrap();
        std::os::unix::fs::chown(&path, Some(uid), Some(gid)).unwrap();
    };
    let certificate = |name: &str| {
        let key = rcgen::KeyPair::generate().unwrap();
        let params = rcgen::CertificateParams::new(vec![name.to_owned()]).unwrap();
        (params.self_signed(&key).unwrap().pem(), key.serialize_pem())
    };
    let ((own, key), (other, _)) = (certificate("127.0.0.1"), certificate("127.0.0.1"));
    give("server.crt", &own);
    give("server.key", &key);
    give("pg_hba.conf", "hostssl all all all trust\nhostnossl all all all reject\n");
    let config = std::fs::read_to_string(data.join("postgresql.conf")).unwrap();
    give("postgresql.conf", &format!("{config}\nssl = on\n"));
    cluster.control(&["restart"]);

    let roots = tempfile::tempdir().unwrap();
    let root = |name: &str, pem: &str| {
        std::fs::write(roots.path().join(name), pem).unwrap();
        format!("{}?sslmode=verify-full&sslrootcert={}", cluster.url(), roots.path().join(name).display())
    };
    let open = async |url: &str| PostgresStore::open(url, PostgresOptions::default()).await;
    let told = |outcome: Result<PostgresStore, StoreError>| format!("{:?}", outcome.err());
    let clear = told(open(&format!("{}?sslmode=disable", cluster.url())).await);
    assert!(clear.contains("no encryption"), "{clear}");
    let nowhere =
        told(open(&format!("{}?sslmode=verify-full&sslrootcert=/nowhere.pem", cluster.url())).await);
    assert!(nowhere.contains("`sslrootcert` names /nowhere.pem, which cannot be read"), "{nowhere}");
    let unread = told(open(&format!("{}?sslmode=disable&sslrootcert=/nowhere.pem", cluster.url())).await);
    assert!(unread.contains("no encryption"), "{unread}");
    let foreign = told(open(&root("other.pem", &other)).await);
    assert!(foreign.contains("InvalidCertificate"), "{foreign}");

    let url = root("own.pem", &own);
    let store = open(&url).await.unwrap();
    store.answers().await.unwrap();
    let mut conn = PgConnection::connect(&url).await.unwrap();
    let without: i64 = sqlx::query_scalar(
        "SELECT count(*) FROM pg_stat_ssl JOIN pg_stat_activity USING (pid)
         WHERE application_name LIKE 'feedwright%' AND NOT ssl",
    )
    .fetch_one(&mut conn)
    .await
    .unwrap();
    assert_eq!(without, 0);
}

#[tokio::test]
async fn a_demoted_server_is_neither_written_nor_believed() {
    let Some(cluster) = Cluster::new() else {
        return;
    };
    let options = PostgresOptions { patience: Duration::from_secs(1), ..PostgresOptions::default() };
    let store = PostgresStore::open(&cluster.url(), options.clone()).await.unwrap();
    shop(&store).await;
    stored(&store, &Run::nth(1)).await;
    cluster.run("ALTER SYSTEM SET default_transaction_read_only = on").await;
    cluster.run("SELECT pg_reload_conf()").await;
    // The reload reaches each session in its own time; whatever it is asked before that is still true.
    for n in 0.. {
        match store.probe_write(at(n)).await {
            Ok(()) => tokio::time::sleep(Duration::from_millis(20)).await,
            Err(error) => {
                assert!(matches!(error, StoreError::Unavailable(_)), "to be tried again: {error:?}");
                break;
            }
        }
        assert!(n < 500, "the reload never arrives");
    }
    assert!(store.answers().await.is_err(), "whoever waits for it is told at once");
    let group = vec![Run::nth(2).new_cycle(), Run::nth(3).new_cycle()];
    for outcome in store.commit_cycles(group, at(5), RecommendSettings::default()).await {
        assert!(matches!(outcome, Err(StoreError::Unavailable(_))), "{outcome:?}");
    }
    assert!(
        store.put_tool(tool("T9"), Precondition::Absent, &super::given::engineer(), at(1)).await.is_err()
    );
    let read = store.verdict(&"T1".try_into().unwrap()).await;
    assert!(matches!(read, Err(StoreError::Unavailable(_))), "decisions are the primary's: {read:?}");
    let opened = PostgresStore::open(&cluster.url(), options).await;
    assert!(matches!(opened, Err(StoreError::NotWritable(_))), "{:?}", opened.err());

    // It is promoted again, and the same store goes on.
    let mut admin = PgConnection::connect(&cluster.url()).await.unwrap();
    admin.execute("SET default_transaction_read_only = off").await.unwrap();
    admin.execute("ALTER SYSTEM RESET default_transaction_read_only").await.unwrap();
    admin.execute("SELECT pg_reload_conf()").await.unwrap();
    let mut stored_after = false;
    for _ in 0..500 {
        if let Some(Ok(Committed::Stored(_))) = commit(&store, &[Run::nth(2)]).await.pop() {
            stored_after = true;
            break;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert!(stored_after);
    store.close().await;
}
