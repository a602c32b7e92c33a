//! The commands that keep data: backup beside a running server, restore, check, copy.

use super::commands::{Served, feedwright, full, succeed};
use super::full_disk::with_room;
use crate::store::given::{Given, RIGHT_INDEX, Run, WRONG_INDEX, shop, stored};
use feedwright_store::{SqliteOptions, SqliteStore, Store};
use sqlx::{ConnectOptions, Connection, SqliteConnection};
use std::io::Read;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

fn file(dir: &TempDir) -> PathBuf {
    dir.path().join("data/feedwright.sqlite3")
}

async fn tables(dir: &TempDir) -> SqliteConnection {
    sqlx::sqlite::SqliteConnectOptions::new().filename(file(dir)).connect().await.unwrap()
}

#[track_caller]
fn fail(output: Output) -> (String, String) {
    assert!(!output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (text(output.stdout), text(output.stderr))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_cell_is_backed_up_restored_checked_and_copied() {
    let (cell, other, plant) = (TempDir::new().unwrap(), TempDir::new().unwrap(), TempDir::new().unwrap());
    std::fs::create_dir(cell.path().join("data")).unwrap();
    let store = SqliteStore::open(file(&cell), SqliteOptions::default()).await.unwrap();
    shop(&store).await;
    for n in 1..=30 {
        stored(&store, &Run::nth(n)).await;
    }
    store.close().await;

    let backup = cell.path().join("backup.sqlite3");
    let backup = backup.to_str().unwrap();
    let served = Served::start(&cell, "listening");
    let said = succeed(feedwright(&cell, &["backup", backup]).output().unwrap());
    assert!(said.contains("cycles: 30 rows ") && said.contains("cycle_samples: 30 rows "), "{said}");
    let (_, refused) = fail(feedwright(&cell, &["backup", backup]).output().unwrap());
    assert!(refused.contains("is there already"), "{refused}");
    let noted = |conn: SqliteConnection| async move {
        let mut conn = conn;
        let at: i64 =
            sqlx::query_scalar("SELECT made_at_us FROM last_backup").fetch_one(&mut conn).await.unwrap();
        conn.close().await.unwrap();
        at
    };
    let own = noted(tables(&cell).await).await;
    // Noted also where nobody can be told of it: it is there.
    let untold = cell.path().join("untold.backup");
    fail(feedwright(&cell, &["backup", untold.to_str().unwrap()]).stdout(full()).output().unwrap());
    let later = noted(tables(&cell).await).await;
    assert!(untold.exists() && later > own);
    assert_eq!(succeed(feedwright(&cell, &["backup", "--made-elsewhere"]).output().unwrap()), "noted\n");
    assert!(noted(tables(&cell).await).await > later, "another tool's backup counts as well");
    let (_, refused) = fail(feedwright(&cell, &["check"]).output().unwrap());
    assert!(refused.contains("checked while it is stopped, or as a backup"), "{refused}");
    let (_, refused) = fail(feedwright(&cell, &["restore", backup]).output().unwrap());
    assert!(refused.contains("stop the server first"), "{refused}");
    let said = succeed(feedwright(&cell, &["check", "--backup", backup]).output().unwrap());
    assert!(said.contains("30 cycles checked"), "{said}");
    assert!(served.terminate().1);

    let said = succeed(feedwright(&other, &["restore", backup]).output().unwrap());
    assert!(said.ends_with("every sum is that of the backup\n"), "{said}");
    let (_, refused) = fail(feedwright(&other, &["restore", backup]).output().unwrap());
    assert!(refused.contains("is there already"), "{refused}");
    succeed(feedwright(&other, &["check"]).output().unwrap());

    // A fold that is not the cycles' is named, mended, and gone.
    let mut conn = tables(&other).await;
    sqlx::query("UPDATE tool_wear SET folded = folded - 1").execute(&mut conn).await.unwrap();
    conn.close().await.unwrap();
    let (found, said) = fail(feedwright(&other, &["check"]).output().unwrap());
    assert!(found.contains("fault: wear M1/T1: ") && said.contains("1 faults are left"), "{found} {said}");
    let said = succeed(feedwright(&other, &["check", "--repair"]).output().unwrap());
    assert!(said.contains("fault: wear M1/T1: folded again"), "{said}");
    succeed(feedwright(&other, &["check"]).output().unwrap());
    // Nor is wear folded over a cycle that says something else than was taken in.
    let change = async |change: &'static str| {
        let mut conn = tables(&other).await;
        sqlx::query(change).execute(&mut conn).await.unwrap();
        conn.close().await.unwrap();
    };
    change("UPDATE cycles SET energy_scale = energy_scale + 1 WHERE cycle_id = 'c00005'").await;
    let (found, said) = fail(feedwright(&other, &["check", "--repair"]).output().unwrap());
    for part in [
        "fault: summary M1/c00005: it is not what the cycle amounts to: energy_scale is ",
        "fault: wear M1/T1: the cache is not the fold over the cycles, and is not folded again, ",
    ] {
        assert!(found.contains(part), "{found}");
    }
    assert!(said.contains("2 faults are left"), "{said}");
    change("UPDATE cycles SET energy_scale = energy_scale - 1 WHERE cycle_id = 'c00005'").await;
    succeed(feedwright(&other, &["check", "--repair"]).output().unwrap());
    // Nor over cycles that an index does not find.
    change("UPDATE tool_wear SET folded = folded - 1").await;
    change(WRONG_INDEX).await;
    let (found, said) = fail(feedwright(&other, &["check", "--repair"]).output().unwrap());
    assert!(found.contains("fault: file sqlite: row 1 missing from index cycles_by_tool\n"), "{found}");
    assert!(found.contains(" is not folded again, since the tables are at fault\n"), "{found}");
    assert!(said.contains("faults are left"), "{said}");
    change(RIGHT_INDEX).await;
    let said = succeed(feedwright(&other, &["check", "--repair"]).output().unwrap());
    assert!(said.contains("fault: wear M1/T1: folded again"), "{said}");
    succeed(feedwright(&other, &["check"]).output().unwrap());
    // A block that is damaged stays damaged, and stays named.
    let mut conn = tables(&other).await;
    let zeros = "UPDATE sample_packs SET blocks = zeroblob(length(blocks))
                 WHERE pack = (SELECT pack FROM cycle_samples WHERE cycle_id = 'c00007')";
    sqlx::query(zeros).execute(&mut conn).await.unwrap();
    conn.close().await.unwrap();
    for arguments in [&["check"][..], &["check", "--repair"]] {
        let (found, _) = fail(feedwright(&other, arguments).output().unwrap());
        assert!(found.contains("fault: samples M1/c00007: "), "{found}");
    }

    std::fs::create_dir(plant.path().join("data")).unwrap();
    let address = |dir: &TempDir| format!("sqlite://{}", file(dir).display());
    let copy = |from: &TempDir, to: &TempDir| {
        let (from, to) = (address(from), address(to));
        feedwright(&cell, &["copy", "--from", &from, "--to", &to]).output().unwrap()
    };
    let said = succeed(copy(&cell, &plant));
    assert!(said.contains("cycles: 30 rows ") && said.contains(", 30 of them written"), "{said}");
    assert!(said.ends_with("every table has the same sum on both sides\n"), "{said}");
    let said = succeed(copy(&cell, &plant));
    assert!(!said.contains("30 of them written"), "nothing is left to write: {said}");
    let (_, refused) = fail(copy(&other, &plant));
    assert!(
        refused.contains("cycle_samples") && refused.contains("is there with other content"),
        "{refused}"
    );
    // A check makes the tables of a database and nothing that keeps a cell from being copied into it (deploy/citus).
    if let Some(plant) = Given::postgres().await {
        let folder = TempDir::new().unwrap();
        let mut check = feedwright(&folder, &["check"]);
        check.env("FEEDWRIGHT__DATABASE__URL", plant.address());
        succeed(check.output().unwrap());
        let mut copy = feedwright(&folder, &["copy", "--from", &address(&cell), "--to", &plant.address()]);
        let said = succeed(copy.output().unwrap());
        assert!(said.contains("cycles: 30 rows ") && said.contains(", 30 of them written"), "{said}");
        plant.done().await;
    }
}

#[test]
fn what_is_wrong_with_an_address_is_told_without_its_password() {
    let folder = TempDir::new().unwrap();
    for (address, cause) in [
        ("postgre://fw:hunter2@db/fw", "--to must begin with sqlite:// or postgres://"),
        ("'postgres://fw:hunter2@db/fw'", "--to must begin with sqlite:// or postgres://"),
        ("postgres://db/fw?passwd=hunter2", "--to has a parameter `passwd` that is not known"),
    ] {
        let flags =
            feedwright(&folder, &["copy", "--from", "sqlite:///none", "--to", address]).output().unwrap();
        let mut variable = feedwright(&folder, &["copy", "--from", "sqlite:///none"]);
        variable.env("FEEDWRIGHT_COPY_TO", address);
        for output in [flags, variable.output().unwrap()] {
            let (told, said) = fail(output);
            assert!(said.contains(cause), "{said}");
            assert!(!format!("{told}{said}").contains("hunter2"), "{told}{said}");
        }
    }
}

/// What keeps a file from being opened is named all the same.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_page_that_cannot_be_read_is_named_by_the_check() {
    let cell = TempDir::new().unwrap();
    std::fs::create_dir(cell.path().join("data")).unwrap();
    let store = SqliteStore::open(file(&cell), SqliteOptions::default()).await.unwrap();
    shop(&store).await;
    store.close().await;
    let mut conn = tables(&cell).await;
    let root: i64 = sqlx::query_scalar("SELECT rootpage FROM sqlite_schema WHERE name = 'alarms'")
        .fetch_one(&mut conn)
        .await
        .unwrap();
    let page: i64 = sqlx::query_scalar("PRAGMA page_size").fetch_one(&mut conn).await.unwrap();
    conn.close().await.unwrap();
    let mut bytes = std::fs::read(file(&cell)).unwrap();
    bytes[usize::try_from((root - 1) * page).unwrap()] ^= 0x40;
    std::fs::write(file(&cell), bytes).unwrap();
    let (found, said) = fail(feedwright(&cell, &["check"]).output().unwrap());
    assert!(found.contains(&format!("fault: file sqlite: Tree {root} page {root}")), "{found} {said}");
}

/// Less than any database of ours needs, bytes.
const LITTLE_ROOM: u64 = 100_000;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_fails_with_a_file_is_told_of_that_file_and_leaves_nothing() {
    let cell = TempDir::new().unwrap();
    std::fs::create_dir(cell.path().join("data")).unwrap();
    let store = SqliteStore::open(file(&cell), SqliteOptions::default()).await.unwrap();
    shop(&store).await;
    for n in 1..=30 {
        stored(&store, &Run::nth(n)).await;
    }
    store.close().await;
    let folder = TempDir::new().unwrap();
    let named = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let told = |output: Output, path: &str, cause: &str| {
        let (_, said) = fail(output);
        assert!(said.contains(&format!("{path}: ")) && said.contains(cause), "{path}: {cause}: {said}");
        assert!(!said.contains("does not take writes"), "{said}");
    };
    let names = |of: &Path| {
        let mut names: Vec<_> = of.read_dir().unwrap().map(|found| found.unwrap().file_name()).collect();
        names.sort();
        names
    };

    // A disk that is full.
    let full = named("full");
    told(
        with_room(LITTLE_ROOM, &feedwright(&cell, &["backup", &full])).output().unwrap(),
        &full,
        "space left",
    );
    if let Some(plant) = Given::postgres().await {
        let mut backup = feedwright(&cell, &["backup", &full]);
        backup.env("FEEDWRIGHT__DATABASE__URL", plant.address());
        told(with_room(LITTLE_ROOM, &backup).output().unwrap(), &full, "space left");
        plant.done().await;
    }
    told(
        feedwright(&cell, &["backup", &named("none/there")]).output().unwrap(),
        &named("none/there.partial"),
        "cannot be made",
    );
    let nothing = TempDir::new().unwrap();
    let path = file(&nothing);
    told(
        feedwright(&nothing, &["backup", &full]).output().unwrap(),
        path.to_str().unwrap(),
        "cannot be opened",
    );
    assert!(names(folder.path()).is_empty(), "{:?}", names(folder.path()));

    let good = named("good");
    succeed(feedwright(&cell, &["backup", &good]).output().unwrap());
    let bytes = std::fs::read(&good).unwrap();
    std::fs::write(named("short"), &bytes[..bytes.len() / 2]).unwrap();
    std::fs::write(
        named("text"),
        "a shopping list, longer than what every file of SQLite begins with ".repeat(99),
    )
    .unwrap();
    let other = TempDir::new().unwrap();
    let restored = file(&other).to_str().unwrap().to_owned();
    let restore = |path: &str| feedwright(&other, &["restore", path]);
    told(
        with_room(LITTLE_ROOM, &restore(&good)).output().unwrap(),
        &format!("{restored}.partial"),
        "no space is left for it",
    );
    for (path, cause) in [
        (named("nowhere"), "is not there"),
        (folder.path().to_str().unwrap().to_owned(), "is no file"),
        // A file that nobody can read, not even an administrator.
        ("/proc/self/mem".to_owned(), "cannot be read"),
        (named("text"), "is no backup of this program"),
        (named("short"), "damaged"),
        (file(&cell).to_str().unwrap().to_owned(), "is no backup of this program"),
    ] {
        told(restore(&path).output().unwrap(), &path, cause);
        told(feedwright(&other, &["check", "--backup", &path]).output().unwrap(), &path, cause);
    }
    let left = names(&other.path().join("data"));
    assert!(left.iter().all(|name| !name.to_str().unwrap().contains("sqlite3")), "{left:?}");
    succeed(restore(&good).output().unwrap());
    succeed(feedwright(&other, &["check"]).output().unwrap());
}

/// A database of a cell with a few cycles.
async fn small_cell() -> TempDir {
    let cell = TempDir::new().unwrap();
    std::fs::create_dir(cell.path().join("data")).unwrap();
    let store = SqliteStore::open(file(&cell), SqliteOptions::default()).await.unwrap();
    shop(&store).await;
    for n in 1..=3 {
        stored(&store, &Run::nth(n)).await;
    }
    store.close().await;
    cell
}

/// A limit is for what comes.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_stored_is_no_less_sound_by_a_lower_limit() {
    let cell = small_cell().await;
    let lower = ["limits.samples_per_cycle=1", "stream.samples_per_cycle=1"];
    let check = ["check", "--set", lower[0], "--set", lower[1]];
    let said = succeed(feedwright(&cell, &check).output().unwrap());
    assert!(said.contains("3 cycles checked"), "{said}");
    let store = SqliteStore::open(file(&cell), SqliteOptions::default()).await.unwrap();
    let run = Run::nth(1);
    let samples =
        store.cycle_samples(&run.machine.try_into().unwrap(), &run.id.as_str().try_into().unwrap()).await;
    assert!(samples.unwrap().unwrap().len() > 1, "the limit is lower");
    store.close().await;
}

/// SQLite takes a name that begins so for an address, and nothing of it would be under that name.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn names_that_sqlite_takes_for_addresses_are_files() {
    let (cell, folder) = (small_cell().await, TempDir::new().unwrap());
    for name in ["file:night", "file:night?mode=memory"] {
        let said = succeed(feedwright(&cell, &["backup", name]).current_dir(folder.path()).output().unwrap());
        assert!(said.contains("cycles: 3 rows "), "{said}");
        let made = folder.path().join(name).metadata().unwrap();
        assert!(made.len() > 0 && said.ends_with(&format!("{name}: {} bytes\n", made.len())), "{said}");
        let mut check = feedwright(&cell, &["check", "--backup", name]);
        let said = succeed(check.current_dir(folder.path()).output().unwrap());
        assert!(said.contains("3 cycles checked"), "{said}");
    }
    let made = || folder.path().read_dir().unwrap().count();
    assert_eq!(made(), 2);
    // So is the folder of a database.
    for arguments in [&["restore", "file:night"][..], &["check"], &["backup", "again"]] {
        let mut command = Command::new(super::commands::binary());
        command.args(["--data-dir", "file:data"]).args(arguments).current_dir(folder.path());
        succeed(command.output().unwrap());
    }
    assert!(folder.path().join("file:data/feedwright.sqlite3").metadata().unwrap().len() > 0);
    assert_eq!(made(), 4);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_backup_that_is_told_to_stop_leaves_nothing() {
    let (cell, folder) = (small_cell().await, TempDir::new().unwrap());
    let (backup, making) = (folder.path().join("night"), folder.path().join("night.partial"));
    let stopped = |mut command: Command| {
        let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
        let began = Instant::now();
        while !making.exists() {
            assert!(began.elapsed() < Duration::from_secs(60), "nothing is made");
            std::thread::sleep(Duration::from_millis(5));
        }
        let sent = Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap();
        assert!(sent.success());
        let mut said = String::new();
        child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(1), "{said}");
        assert!(said.contains("it was told to stop"), "{said}");
        assert_eq!(folder.path().read_dir().unwrap().count(), 0);
    };
    let command = || feedwright(&cell, &["backup", backup.to_str().unwrap()]);
    // While somebody has the database for themselves, a backup of it waits.
    let mut conn = tables(&cell).await;
    for statement in ["PRAGMA locking_mode = EXCLUSIVE", "BEGIN EXCLUSIVE"] {
        sqlx::query(statement).execute(&mut conn).await.unwrap();
    }
    stopped(command());
    conn.close().await.unwrap();
    if let Some(plant) = Given::postgres().await {
        shop(&*plant.store()).await;
        let mut conn = sqlx::PgConnection::connect(&plant.address()).await.unwrap();
        for statement in ["BEGIN", "LOCK TABLE cycles IN ACCESS EXCLUSIVE MODE"] {
            sqlx::query(statement).execute(&mut conn).await.unwrap();
        }
        let mut backup = command();
        backup.env("FEEDWRIGHT__DATABASE__URL", plant.address());
        stopped(backup);
        conn.close().await.unwrap();
        plant.done().await;
    }
    // Nobody else's hashes of tokens: whatever stands in its way, the file is its owner's.
    std::fs::write(&making, "").unwrap();
    std::fs::set_permissions(&making, std::fs::Permissions::from_mode(0o644)).unwrap();
    succeed(command().output().unwrap());
    assert_eq!(backup.metadata().unwrap().mode() & 0o777, 0o600);
}
