//! A server is killed while many machines post: all that it acknowledged is there when it starts again, and counted.

use super::caller::Caller;
use super::commands::{Served, feedwright, first_token, succeed};
use std::sync::Arc;
use tempfile::TempDir;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;

/// Machines that post at once, each its next cycle when the one before is answered: groups follow each other.
const MACHINES: usize = 16;
/// How often the server is killed, and answers that are waited for before.
const KILLED: u32 = 4;
const ANSWERS: u32 = 300;

impl Caller {
    /// Posts a machine's cycles behind that one until nobody answers; the last that was acknowledged.
    async fn post_until_killed(self, machine: usize, mut last: i64, answers: Arc<Semaphore>) -> (usize, i64) {
        // What was answered by nobody the last time may be there.
        while let Some(200 | 201) = self.post(machine, last + 1).await {
            last += 1;
            answers.add_permits(1);
        }
        (machine, last)
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_server_that_is_killed_loses_nothing_that_was_acknowledged() {
    feedwright_server::tls::use_ring();
    let dir = TempDir::new().unwrap();
    let served = Served::start(&dir, "make others");
    let token = first_token(&served.log);
    Caller::of(&served, &token).set_up(MACHINES).await;
    let (log, ended_well) = served.terminate();
    assert!(ended_well, "{log}");

    let mut acknowledged = [0; MACHINES];
    let mut taken_up = 0;
    for _ in 0..KILLED {
        let served = Served::start(&dir, "listening");
        taken_up += u32::from(served.log.contains("taken up from their journal"));
        let (shop, answers) = (Caller::of(&served, &token), Arc::new(Semaphore::new(0)));
        let mut posting = JoinSet::new();
        for (machine, last) in acknowledged.iter().enumerate() {
            posting.spawn(shop.clone().post_until_killed(machine, *last, Arc::clone(&answers)));
        }
        tokio::select! {
            enough = answers.acquire_many(ANSWERS) => enough.unwrap().forget(),
            ended = posting.join_next() => panic!("machine and cycles before the server was killed: {ended:?}"),
        }
        served.kill();
        for (machine, last) in posting.join_all().await {
            acknowledged[machine] = last;
        }
    }

    let all: i64 = acknowledged.iter().sum();
    assert!(all >= i64::from(KILLED * ANSWERS));
    let said = succeed(feedwright(&dir, &["check"]).output().unwrap());
    let checked = said.split(" cycles checked").next().and_then(|text| text.split_whitespace().last());
    let checked: i64 = checked.and_then(|count| count.parse().ok()).unwrap_or_else(|| panic!("{said}"));
    assert!(checked >= all, "{checked} of {all} that were acknowledged: {said}");
    // The last of them is taken up by the check. A kill just behind a commit leaves nothing.
    assert!(taken_up > 0, "groups were acknowledged by their journal");

    let served = Served::start(&dir, "listening");
    let shop = Caller::of(&served, &token);
    for (machine, last) in acknowledged.into_iter().enumerate() {
        for number in 1..=last {
            assert_eq!(shop.post(machine, number).await, Some(200), "M{machine}: cycle {number} of {last}");
        }
    }
    let (log, ended_well) = served.terminate();
    assert!(ended_well, "{log}");
}
