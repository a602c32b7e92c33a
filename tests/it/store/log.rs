//! SQLite's write-ahead log, beside the store.

use super::given::{Given, Run, shop, stored};
use std::time::Duration;

/// What stays of a log that was made longer, bytes.
const KEPT: u64 = 64 << 20;

/// Looks that are taken, and the time between them: what is waited for comes with a checkpoint.
const LOOKS: u32 = 300;
const BETWEEN: Duration = Duration::from_millis(50);

#[tokio::test]
async fn a_log_that_was_made_long_is_cut_once_it_is_in_the_file() {
    let given = Given::sqlite().await;
    let store = given.store();
    shop(&*store).await;
    let log = given.file().with_extension("sqlite3-wal");
    let length = || std::fs::metadata(&log).unwrap().len();
    given.raw("CREATE TABLE much AS SELECT zeroblob(100 << 20) AS bytes").await.unwrap();
    assert!(length() > KEPT, "the log is long");
    let mut looks = 0;
    while length() > KEPT {
        looks += 1;
        assert!(looks < LOOKS, "the log stays long: {} bytes", length());
        stored(&*store, &Run::nth(looks)).await;
        tokio::time::sleep(BETWEEN).await;
    }
    given.done().await;
}
