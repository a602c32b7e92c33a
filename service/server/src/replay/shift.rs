//! `--start`: by how much recorded times are moved.
//!
//! A cycle's time is part of its content. A restart that moved times by another amount would post other content
//! under the same ids, and every one of them would be a conflict. So the shift towards "now" is chosen once and
//! kept in a small file; the restart finds it there and repeats the same content, which the service knows.

use super::{Plan, ReplayError};
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::Path;
use std::str::FromStr;

/// Where recorded times are moved to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Start {
    /// They stay.
    #[default]
    Recorded,
    /// The last cycle ends now; distances stay.
    Now,
    /// The first cycle begins at this time, µs since 1970; distances stay.
    At(i64),
}

impl FromStr for Start {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "recorded" => Ok(Self::Recorded),
            "now" => Ok(Self::Now),
            time => time
                .parse::<jiff::Timestamp>()
                .map(|time| Self::At(time.as_microsecond()))
                .map_err(|error| format!("needs recorded, now or an RFC 3339 time: {error}")),
        }
    }
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Kept {
    /// Which recording and mapping it was chosen for.
    fingerprint: String,
    /// Which service it was chosen for.
    server: String,
    /// The shift.
    shift_us: i64,
}

/// Chooses the shift, µs; for [`Start::Now`] durably keeps it in `state` before anything is posted.
pub fn choose(
    start: Start,
    plan: &Plan,
    server: &str,
    now_us: i64,
    state: &Path,
) -> Result<i64, ReplayError> {
    match start {
        Start::Recorded => Ok(0),
        Start::At(at_us) => Ok(at_us - plan.cycles.first().map_or(at_us, |cycle| cycle.started_us)),
        Start::Now => {
            let refuse = |message: String| ReplayError::State { path: state.display().to_string(), message };
            match std::fs::read_to_string(state) {
                Ok(text) => {
                    let kept: Kept =
                        serde_json::from_str(&text).map_err(|error| refuse(error.to_string()))?;
                    if kept.fingerprint == plan.fingerprint && kept.server == server {
                        return Ok(kept.shift_us);
                    }
                    Err(refuse(
                        "was written for another recording, mapping or server; name another file with --state"
                            .to_owned(),
                    ))
                }
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                    // Whole milliseconds, so that moved times stay readable.
                    let shift_us = (now_us - plan.end_us()).div_euclid(1000) * 1000;
                    let kept =
                        Kept { fingerprint: plan.fingerprint.clone(), server: server.to_owned(), shift_us };
                    keep(state, &kept).map_err(|error| refuse(error.to_string()))?;
                    Ok(shift_us)
                }
                Err(error) => Err(refuse(error.to_string())),
            }
        }
    }
}

/// Writes beside and renames: a replay killed here leaves the whole file or none.
fn keep(path: &Path, kept: &Kept) -> std::io::Result<()> {
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder)?;
    }
    let beside = path.with_extension("new");
    let mut file = std::fs::File::create(&beside)?;
    file.write_all(&serde_json::to_vec_pretty(kept)?)?;
    file.sync_all()?;
    std::fs::rename(&beside, path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::replay::mapping::tests::SMALL;

    fn plan() -> Plan {
        Plan::read(SMALL, &[("a.csv".to_owned(), b"p\n1\n2\n3\n".to_vec())]).unwrap()
    }

    fn folder(name: &str) -> std::path::PathBuf {
        let path = std::env::temp_dir().join(format!("feedwright-shift-{name}-{}", std::process::id()));
        drop(std::fs::remove_dir_all(&path));
        path
    }

    #[test]
    fn now_is_chosen_once() {
        let folder = folder("once");
        let state = folder.join("state.json");
        let plan = plan();
        let now = plan.end_us() + 5_000_400;
        let first = choose(Start::Now, &plan, "http://s", now, &state).unwrap();
        assert_eq!(first, 5_000_000);
        let later = choose(Start::Now, &plan, "http://s", now + 99_000_000, &state).unwrap();
        assert_eq!(later, first);
        assert!(choose(Start::Now, &plan, "http://other", now, &state).is_err());
        std::fs::write(&state, "{").unwrap();
        assert!(choose(Start::Now, &plan, "http://s", now, &state).is_err());
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn other_starts_need_no_file() {
        let plan = plan();
        let state = Path::new("/nonexistent/state.json");
        assert_eq!(choose("recorded".parse().unwrap(), &plan, "s", 0, state).unwrap(), 0);
        let at = choose("2021-01-01T00:00:00Z".parse().unwrap(), &plan, "s", 0, state).unwrap();
        assert_eq!(at, 366 * 86_400 * 1_000_000);
        assert!("noon".parse::<Start>().is_err());
    }
}
