//! The binary itself: first start, the one token, tokens beside and through a running server, signals.

use std::io::{BufRead, BufReader, Read};
use std::net::{SocketAddr, TcpListener};
use std::os::unix::ffi::OsStringExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// The binary, built from this very tree: another package's binary is not built for these tests by itself.
pub(crate) fn binary() -> &'static Path {
    static BUILT: OnceLock<PathBuf> = OnceLock::new();
    BUILT.get_or_init(|| {
        let built = Command::new(env!("CARGO"))
            // Together with the tests, so that its dependencies have the features they were already built with.
            .args(["build", "--quiet", "--locked", "--workspace", "--test", "it", "--bin", "feedwright"])
            .args(["--message-format", "json"])
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .output()
            .unwrap();
        assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
        let messages = serde_json::Deserializer::from_slice(&built.stdout).into_iter::<serde_json::Value>();
        // The tests themselves are among what was built, in whatever order cargo finished.
        let binaries =
            messages.filter_map(Result::ok).filter(|message| message["target"]["name"] == "feedwright");
        let executable =
            binaries.filter_map(|message| Some(message["executable"].as_str()?.to_owned())).last();
        executable.expect("cargo names what it built").into()
    })
}

pub(super) fn feedwright(dir: &TempDir, arguments: &[&str]) -> Command {
    let mut command = Command::new(binary());
    command.args(["--data-dir", dir.path().join("data").to_str().unwrap()]).args(arguments);
    command.args(["--set", "server.listen=127.0.0.1:0"]);
    command.env_remove("FEEDWRIGHT_TOKEN").env_remove("FEEDWRIGHT_CONFIG");
    // What is freed goes back to the system at once and not within a second: what is then resident is what is held.
    command.env("MIMALLOC_PURGE_DELAY", "0");
    command
}

/// What nothing can be written to, as a disk without room.
pub(super) fn full() -> std::fs::File {
    std::fs::File::options().write(true).open("/dev/full").unwrap()
}

#[track_caller]
pub(super) fn succeed(output: Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

pub(crate) struct Served {
    child: Child,
    /// What it says later, to its end. It is read all the while: a server whose log nobody reads waits.
    rest: Option<JoinHandle<String>>,
    pub(crate) log: String,
}

impl Served {
    /// Starts the service and reads its output up to the line that holds `until`.
    pub(crate) fn start(dir: &TempDir, until: &str) -> Self {
        Self::start_on(dir, None, until)
    }

    /// The same on the database at that address; on a file of the folder where there is none.
    pub(super) fn start_on(dir: &TempDir, database: Option<&str>, until: &str) -> Self {
        let mut command = feedwright(dir, &["serve"]);
        if let Some(address) = database {
            command.env("FEEDWRIGHT__DATABASE__URL", address);
        }
        Self::run(command, until)
    }

    /// The same with that command.
    pub(super) fn run(mut command: Command, until: &str) -> Self {
        let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
        let mut stderr = BufReader::new(child.stderr.take().unwrap());
        let mut served = Self { child, rest: None, log: String::new() };
        while !served.log.contains(until) {
            assert!(stderr.read_line(&mut served.log).unwrap() > 0, "it ended: {}", served.log);
        }
        served.rest = Some(std::thread::spawn(move || {
            let mut rest = String::new();
            stderr.read_to_string(&mut rest).unwrap();
            rest
        }));
        served
    }

    /// Where it listens, of what it has said so far.
    pub(crate) fn address(&self) -> SocketAddr {
        let line = self.log.lines().find(|line| line.contains("listening")).unwrap();
        let address = line.split("address=").nth(1);
        let address = address.and_then(|rest| rest.split_whitespace().next()?.parse().ok());
        address.unwrap_or_else(|| panic!("no address in {line}"))
    }

    /// What it holds in memory now, bytes.
    pub(super) fn resident_bytes(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
        line.trim().strip_suffix(" kB").and_then(|kib| kib.parse::<u64>().ok()).unwrap() * 1024
    }

    /// Sends SIGTERM; the whole output, and whether it ended well.
    pub(super) fn terminate(self) -> (String, bool) {
        let sent = Command::new("kill").args(["-TERM", &self.child.id().to_string()]).status().unwrap();
        assert!(sent.success());
        self.ended()
    }

    /// Waits until it has ended; the whole output, and whether it ended well.
    pub(super) fn ended(mut self) -> (String, bool) {
        self.log += &self.rest.take().unwrap().join().unwrap();
        (std::mem::take(&mut self.log), self.child.wait().unwrap().success())
    }
}

impl Served {
    /// Kills it without a word of warning: SIGKILL.
    pub(crate) fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        // Only where a test failed half-way.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A token that nobody gets to know would be the only one for ever.
#[test]
fn a_first_start_whose_token_has_no_place_does_not_begin() {
    let dir = TempDir::new().unwrap();
    let file = dir.path().join("first-token");
    let serve = || feedwright(&dir, &["serve", "--first-token-file", file.to_str().unwrap()]);
    std::fs::write(&file, "of before").unwrap();
    for _ in 0..2 {
        let refused = serve().output().unwrap();
        let said = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(!refused.status.success() && said.contains("first-token is there already"), "{said}");
    }
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "of before");
    std::fs::remove_file(&file).unwrap();
    let served = Served::run(serve(), "token is in this file");
    let token = std::fs::read_to_string(&file).unwrap();
    assert!(token.starts_with("fwt_") && token.ends_with('\n'), "{token}");
    assert!(served.terminate().1);
    // From then on it is of no concern.
    let served = Served::run(serve(), "listening");
    assert_eq!(std::fs::read_to_string(&file).unwrap(), token);
    assert!(served.terminate().1);
    let left: Vec<_> =
        std::fs::read_dir(dir.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left.len(), 2, "{left:?}");
}

pub(crate) fn first_token(log: &str) -> String {
    let lines: Vec<_> = log.lines().filter(|line| line.contains("fwt_")).collect();
    assert_eq!(lines.len(), 1, "shown once: {log}");
    lines[0].trim().to_owned()
}

#[test]
fn the_first_start_shows_a_token_and_tokens_go_through_the_server_while_it_runs() {
    let dir = TempDir::new().unwrap();
    let served = Served::start(&dir, "make others");
    let admin = first_token(&served.log);
    let second = feedwright(&dir, &["serve"]).output().unwrap();
    let said = String::from_utf8_lossy(&second.stderr).into_owned();
    assert!(
        !second.status.success() && said.contains("in use by a server that listens on 127.0.0.1:"),
        "{said}"
    );

    let create = ["token", "create", "--name", "MES", "--role", "viewer"];
    let refused = feedwright(&dir, &create).output().unwrap();
    assert!(String::from_utf8_lossy(&refused.stderr).contains("FEEDWRIGHT_TOKEN"));
    let made = succeed(feedwright(&dir, &create).env("FEEDWRIGHT_TOKEN", &admin).output().unwrap());
    let id = made.trim().split('_').nth(1).unwrap().to_owned();
    let file = dir.path().join("token");
    std::fs::write(&file, format!("{admin}\n")).unwrap();
    let file = file.to_str().unwrap();
    let list = succeed(feedwright(&dir, &["token", "list", "--token-file", file]).output().unwrap());
    assert!(list.contains(&id) && list.contains("MES") && !list.contains(made.trim()), "{list}");
    // The flag goes before the environment, and the secret is not repeated.
    let revoke = ["token", "revoke", made.trim(), "--token-file", file];
    let told = succeed(feedwright(&dir, &revoke).env("FEEDWRIGHT_TOKEN", made.trim()).output().unwrap());
    assert_eq!(told, format!("revoked {id}\n"));
    // A token that nobody could read is of no use to anybody but a thief.
    let unread = feedwright(&dir, &["token", "create", "--name", "unread", "--role", "admin"])
        .env("FEEDWRIGHT_TOKEN", &admin)
        .stdout(full())
        .output()
        .unwrap();
    let said_of_it = String::from_utf8_lossy(&unread.stderr).into_owned();
    assert!(!unread.status.success() && said_of_it.contains("and is revoked"), "{said_of_it}");
    let denied = feedwright(&dir, &["token", "list"]).env("FEEDWRIGHT_TOKEN", made.trim()).output().unwrap();
    assert!(String::from_utf8_lossy(&denied.stderr).contains("token_revoked"));

    let address = said.split("listens on ").nth(1).unwrap().trim().to_owned();
    let healthcheck = ["healthcheck", "--server", &format!("http://{address}")];
    assert_eq!(succeed(feedwright(&dir, &healthcheck).output().unwrap()), "ready\n");
    let (log, ended_well) = served.terminate();
    assert!(ended_well, "{log}");
    first_token(&log);
    assert!(!feedwright(&dir, &healthcheck).output().unwrap().status.success());

    // No server runs: straight in the database, without a token.
    let unread = feedwright(&dir, &["token", "create", "--name", "unread", "--role", "admin"])
        .stdout(full())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&unread.stderr).into_owned();
    assert!(!unread.status.success() && said.contains("and is revoked"), "{said}");
    let list = succeed(feedwright(&dir, &["token", "list"]).output().unwrap());
    let unread: Vec<_> = list.lines().filter(|line| line.ends_with("unread")).collect();
    assert!(unread.len() == 2 && unread.iter().all(|line| line.contains("revoked")), "{list}");
    let told = feedwright(&dir, &["token", "revoke", &format!("fwt_{id}")]).output().unwrap();
    assert_eq!(succeed(told), format!("revoked {id}\n"));
    let secret = made.trim().rsplit_once('_').unwrap().0.rsplit_once('_').unwrap().1;
    let told = feedwright(&dir, &["token", "revoke", secret]).output().unwrap();
    let said = String::from_utf8_lossy(&told.stderr).into_owned();
    assert!(!told.status.success() && said.contains("no token's id") && !said.contains(secret), "{said}");
    let again = Served::start(&dir, "listening");
    let (log, ended_well) = again.terminate();
    assert!(ended_well && !log.contains("fwt_"), "{log}");
}

#[test]
fn the_settings_in_force_are_printed_without_secrets() {
    let dir = TempDir::new().unwrap();
    let mut command = feedwright(&dir, &["config"]);
    command.env("FEEDWRIGHT__DATABASE__URL", "postgres://fw:hunter2@db/fw");
    let printed = succeed(command.output().unwrap());
    assert!(
        printed.contains("database.url = \"postgres://(hidden)@db/fw\"  # FEEDWRIGHT__DATABASE__URL"),
        "{printed}"
    );
    assert!(!printed.contains("hunter2"));
    let refused = feedwright(&dir, &["serve", "--listen", "0.0.0.0:0"]).output().unwrap();
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(said.contains("allow_plain_http_on_public_address"), "{said}");
    assert_eq!(refused.status.code(), Some(78), "what the unit does not try again");
    let mistyped = feedwright(&dir, &["serve", "--set", "limits.group_sizes=3"]).output().unwrap();
    assert_eq!(mistyped.status.code(), Some(78), "{}", String::from_utf8_lossy(&mistyped.stderr));
    let file = dir.path().join("feedwright.toml");
    for text in [None, Some("limits = [")] {
        if let Some(text) = text {
            std::fs::write(&file, text).unwrap();
        }
        let unread = feedwright(&dir, &["serve", "--config", file.to_str().unwrap()]).output().unwrap();
        assert_eq!(unread.status.code(), Some(78), "{}", String::from_utf8_lossy(&unread.stderr));
    }
    for threads in ["0", "abc", ""] {
        let refused = feedwright(&dir, &["config"]).env("TOKIO_WORKER_THREADS", threads).output().unwrap();
        let said = String::from_utf8_lossy(&refused.stderr);
        assert_eq!(refused.status.code(), Some(78), "{said}");
        assert!(said.contains("TOKIO_WORKER_THREADS: must be"), "{said}");
    }
    succeed(feedwright(&dir, &["config"]).env("TOKIO_WORKER_THREADS", "1").output().unwrap());
    let mut command = feedwright(&dir, &["serve"]);
    let url = std::ffi::OsString::from_vec(b"postgres://fw:hunter\xff@db/fw".to_vec());
    let refused = command.env("FEEDWRIGHT__DATABASE__URL", url).output().unwrap();
    let said = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(78), "it would be another database: {said}");
    assert!(said.contains("FEEDWRIGHT__DATABASE__URL") && !said.contains("hunter"), "{said}");
    assert!(!dir.path().join("data").exists(), "nothing was made");
}

#[test]
fn the_description_of_the_api_is_printed() {
    let dir = TempDir::new().unwrap();
    let printed = succeed(feedwright(&dir, &["openapi"]).output().unwrap());
    assert_eq!(printed, feedwright_server::http::openapi::json().unwrap());
}

#[test]
fn a_demo_that_ends_fails_where_its_cycles_were_refused() {
    let dir = TempDir::new().unwrap();
    let data = dir.path().join("demo");
    let demo = || {
        let mut command = Command::new(binary());
        command.args(["demo", "--exit", "--port", "0", "--recording", "michigan-smart", "--dir"]).arg(&data);
        command.output().unwrap()
    };
    succeed(demo());
    // Without its shift the recording is another one under the same ids.
    std::fs::remove_file(data.join("replay-michigan-smart.json")).unwrap();
    let refused = demo();
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(!refused.status.success(), "{said}");
    assert!(said.contains("47 of 47 cycles were refused") && said.contains("cycle_conflict"), "{said}");
}

/// A database may be there and say nothing: a supervisor kills what it told to stop half a minute ago.
#[test]
fn a_signal_ends_a_start_whose_database_says_nothing() {
    let dir = TempDir::new().unwrap();
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("postgres://fw@{}/fw", silent.local_addr().unwrap());
    let mut command = feedwright(&dir, &["serve"]);
    let mut child = command.env("FEEDWRIGHT__DATABASE__URL", url).stderr(Stdio::null()).spawn().unwrap();
    // It listens to signals before it connects.
    let connected = silent.accept().unwrap();
    let begun = Instant::now();
    let sent = Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
    let ended = child.wait().unwrap();
    assert!(begun.elapsed() < Duration::from_secs(25), "{:?}", begun.elapsed());
    assert!(ended.success(), "{ended}");
    drop(connected);
}

#[test]
fn check_tells_why_it_cannot_look_for_the_database() {
    let dir = TempDir::new().unwrap();
    // A file where the folder would be: nobody may enter it, not even root.
    std::fs::write(dir.path().join("data"), "").unwrap();
    let refused = feedwright(&dir, &["check"]).output().unwrap();
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(!refused.status.success() && said.contains("cannot look for the database"), "{said}");
}
