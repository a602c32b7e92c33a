//! A disk that takes no more while groups are written: nothing that was acknowledged is lost, the server says why it ends,
//! and once there is room again it goes on. The disk is full where a file may not become longer (`RLIMIT_FSIZE`).

use super::caller::Caller;
use super::commands::{Served, feedwright, first_token, succeed};
use std::path::PathBuf;
use std::process::Command;
use tempfile::TempDir;
use tokio::task::JoinSet;

/// Machines that post at once, each its next cycle when the one before is answered: groups of several.
const MACHINES: usize = 12;
/// Cycles of a machine. Together they need several times the room that there is.
const CYCLES: i64 = 300;
/// How much longer than the database a file may become, bytes: another write is refused with each. Only with the last there
/// is room for a journal of groups.
const ROOMS: [u64; 3] = [400_000, 1_100_000, 2_300_000];

/// The command as on a disk with that much room for a file. A write beyond it fails, as on a full disk; left to itself it
/// would end the process.
pub(super) fn with_room(bytes: u64, command: &Command) -> Command {
    let mut limited = Command::new("sh");
    limited.args(["-c", "trap '' XFSZ; exec prlimit --fsize=\"$0\" \"$@\"", &bytes.to_string()]);
    limited.arg(command.get_program()).args(command.get_args());
    for (name, value) in command.get_envs() {
        match value {
            Some(value) => limited.env(name, value),
            None => limited.env_remove(name),
        };
    }
    limited
}

impl Caller {
    /// Posts a machine's cycles until one is not acknowledged: how many were, and what was said then.
    async fn post_until_refused(self, machine: usize) -> (usize, i64, Option<u16>) {
        for number in 1..=CYCLES {
            let status = self.post(machine, number).await;
            if status != Some(201) {
                return (machine, number - 1, status);
            }
        }
        (machine, CYCLES, Some(201))
    }
}

async fn fills_up(room: u64) {
    let dir = TempDir::new().unwrap();
    let file: PathBuf = dir.path().join("data").join("feedwright.sqlite3");
    let served = Served::start(&dir, "make others");
    let token = first_token(&served.log);
    let shop = Caller::of(&served, &token);
    shop.set_up(MACHINES).await;
    let (log, ended_well) = served.terminate();
    assert!(ended_well, "{log}");

    let limit = std::fs::metadata(&file).unwrap().len() + room;
    let served = Served::run(with_room(limit, &feedwright(&dir, &["serve"])), "listening");
    let shop = Caller::of(&served, &token);
    let mut posting = JoinSet::new();
    for machine in 0..MACHINES {
        posting.spawn(shop.clone().post_until_refused(machine));
    }
    let acknowledged = posting.join_all().await;
    for (machine, count, status) in &acknowledged {
        assert!(*count < CYCLES, "M{machine} never found the disk full");
        // Whoever was in the group that was refused is told so; whoever came later may find nobody.
        assert!(matches!(status, None | Some(503)), "M{machine} after {count}: {status:?}");
    }
    let all: i64 = acknowledged.iter().map(|(_, count, _)| count).sum();
    assert!(all > 24, "full before groups were written: {acknowledged:?}");
    let (log, ended_well) = served.ended();
    assert!(!ended_well && log.contains("does not take writes"), "{log}");
    assert!(!log.contains("panicked"), "{log}");

    // What is there is whole: every hash, and the wear is that of the cycles.
    let said = succeed(feedwright(&dir, &["check"]).output().unwrap());
    let checked = said.split(" cycles checked").next().and_then(|text| text.split_whitespace().last());
    let checked: i64 = checked.and_then(|count| count.parse().ok()).unwrap_or_else(|| panic!("{said}"));
    assert!(checked >= all, "{checked} of {all} that were acknowledged: {said}");

    let served = Served::start(&dir, "listening");
    let shop = Caller::of(&served, &token);
    for (machine, count, _) in acknowledged {
        for number in 1..=count {
            assert_eq!(shop.post(machine, number).await, Some(200), "M{machine}: cycle {number} of {count}");
        }
        // One that was refused is taken now.
        let again = shop.post(machine, count + 1).await;
        assert!(matches!(again, Some(200 | 201)), "{again:?}");
    }
    let (log, ended_well) = served.terminate();
    assert!(ended_well, "{log}");
    succeed(feedwright(&dir, &["check"]).output().unwrap());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_disk_that_is_full_loses_nothing_that_was_acknowledged() {
    feedwright_server::tls::use_ring();
    for room in ROOMS {
        fills_up(room).await;
    }
}
