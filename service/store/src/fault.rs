//! From the errors of sqlx and rusqlite to those of the store: what a caller may conclude, not what was said.

use crate::error::StoreError;
use sqlx::error::{DatabaseError, ErrorKind};

impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        match &error {
            sqlx::Error::Database(database) => match Fault::of(database.as_ref()) {
                Fault::Refused => Self::Refused { constraint: constraint(database.as_ref()) },
                Fault::NotWritable => Self::NotWritable(Box::new(error)),
                Fault::NotReadable => Self::NotReadable(Box::new(error)),
                Fault::Unavailable => Self::Unavailable(Box::new(error)),
                Fault::Other => Self::Database(Box::new(error)),
            },
            sqlx::Error::Io(_)
            | sqlx::Error::Tls(_)
            | sqlx::Error::PoolTimedOut
            | sqlx::Error::PoolClosed
            // What came is no answer to what was asked, as of a connection that a pooler had given to somebody else before.
            | sqlx::Error::Protocol(_)
            | sqlx::Error::WorkerCrashed => Self::Unavailable(Box::new(error)),
            sqlx::Error::ColumnDecode { index, .. } => {
                Self::Damaged { what: format!("column {index} does not decode") }
            }
            _ => Self::Database(Box::new(error)),
        }
    }
}

impl From<rusqlite::Error> for StoreError {
    fn from(error: rusqlite::Error) -> Self {
        let (failure, message) = match &error {
            rusqlite::Error::SqliteFailure(failure, message) => (failure, message),
            rusqlite::Error::InvalidColumnType(index, ..)
            | rusqlite::Error::FromSqlConversionFailure(index, ..) => {
                return Self::Damaged { what: format!("column {index} does not decode") };
            }
            _ => return Self::Database(Box::new(error)),
        };
        match Fault::of_sqlite(failure.extended_code.cast_unsigned()) {
            Fault::Refused => {
                Self::Refused { constraint: named_last(message.as_deref().unwrap_or_default()).to_owned() }
            }
            Fault::NotWritable => Self::NotWritable(Box::new(error)),
            Fault::NotReadable => Self::NotReadable(Box::new(error)),
            Fault::Unavailable => Self::Unavailable(Box::new(error)),
            Fault::Other => Self::Database(Box::new(error)),
        }
    }
}

enum Fault {
    Refused,
    NotWritable,
    NotReadable,
    Unavailable,
    Other,
}

/// Keys that PostgreSQL gives by itself: one that is there already is given by a sequence that was left behind, as by a move that
/// brought none along, and says nothing of what was sent.
const NUMBERED: [&str; 3] = ["alarms_pkey", "audit_pkey", "tool_events_pkey"];

/// Extended codes of SQLite for a read that the disk refuses: `IOERR_READ`, `IOERR_SHORT_READ`, and `IOERR_CORRUPTFS`, which is a read's EIO;
/// within a statement SQLite makes CORRUPT of that.
pub(crate) const REFUSED_READS: [u32; 3] = [266, 522, 8458];

impl Fault {
    fn of(error: &dyn DatabaseError) -> Self {
        match error.kind() {
            ErrorKind::UniqueViolation if is_numbered(&constraint(error)) => return Self::Other,
            ErrorKind::UniqueViolation
            | ErrorKind::ForeignKeyViolation
            | ErrorKind::NotNullViolation
            | ErrorKind::CheckViolation => return Self::Refused,
            _ => {}
        }
        let Some(code) = error.code() else {
            return Self::Other;
        };
        // SQLite gives its extended result code in decimal, PostgreSQL an SQLSTATE of five characters.
        if code.len() < 5
            && let Ok(code) = code.parse::<u32>()
        {
            return Self::of_sqlite(code);
        }
        match error.message() {
            message if is_between_nodes(&code, message) => Self::Unavailable,
            message if is_refused_read(&code, message) => Self::NotReadable,
            message if is_refused_by_a_node(&code, message) => Self::Refused,
            _ => Self::of_sqlstate(&code),
        }
    }

    /// <https://www.sqlite.org/rescode.html>: the low byte is the primary code.
    fn of_sqlite(code: u32) -> Self {
        if REFUSED_READS.contains(&code) {
            return Self::NotReadable;
        }
        match code & 0xff {
            // BUSY, LOCKED, INTERRUPT
            5 | 6 | 9 => Self::Unavailable,
            // READONLY, IOERR, FULL, CANTOPEN
            8 | 10 | 13 | 14 => Self::NotWritable,
            // CORRUPT, NOTADB
            11 | 26 => Self::NotReadable,
            // TOOBIG, CONSTRAINT, MISMATCH
            18..=20 => Self::Refused,
            _ => Self::Other,
        }
    }

    /// Appendix A of PostgreSQL's manual.
    fn of_sqlstate(code: &str) -> Self {
        match code {
            // I/O error
            "58030" => Self::NotWritable,
            // data or index corrupted
            "XX001" | "XX002" => Self::NotReadable,
            // read-only transaction (a demoted server: another one takes over), serialisation, deadlock, lock not
            // available, statement or session timed out; a right, or a database, that somebody has taken away, or that is closed to
            // everybody for a while
            "25006" | "40001" | "40P01" | "55P03" | "57014" | "25P03" | "42501" | "3D000" | "55000" => {
                Self::Unavailable
            }
            _ if code.starts_with("22") || code.starts_with("23") => Self::Refused,
            // connection, login, resources (a full disk among them: the server undid the change, and goes on once there is room),
            // operator intervention (shutdown, restart)
            _ if ["08", "28", "53", "57"].iter().any(|class| code.starts_with(class)) => Self::Unavailable,
            _ => Self::Other,
        }
    }
}

/// Whether Citus tells that one of its nodes was lost, or refused, in the midst of a change. It has codes of its own for that: I/O
/// error where what it copies to another node cannot be sent (`SendCopyDataToPlacement`, `EndRemoteCopy` and `ReportCopyError`
/// of its `multi_copy.c`), which says nothing of a disk, and an internal error with the node's own message and without its code.
fn is_between_nodes(code: &str, message: &str) -> bool {
    const LOST: [&str; 3] = [
        "failed to COPY to shard ",
        "failed to complete COPY on ",
        "failure on connection marked as essential",
    ];
    // PostgreSQL's, of a server that ends, has no room, or has found a deadlock.
    const SAID_BY_THE_NODE: [&str; 7] = [
        "terminating connection due to ",
        "the database system is ",
        "server closed the connection unexpectedly",
        "could not extend file ",
        "could not write to file ",
        "deadlock detected",
        "canceling statement due to ",
    ];
    let begins = |texts: &[&str]| texts.iter().any(|text| message.starts_with(text));
    match code {
        "58030" => begins(&LOST),
        "XX000" => begins(&LOST) || begins(&SAID_BY_THE_NODE),
        _ => false,
    }
}

/// Whether a node of Citus refuses a row that is copied to it, which is told as an internal error with the node's own message
/// (`ReportCopyError` of its `multi_copy.c`).
fn is_refused_by_a_node(code: &str, message: &str) -> bool {
    const VIOLATED: [&str; 3] =
        ["violates check constraint", "violates unique constraint", "violates not-null constraint"];
    code == "XX000" && VIOLATED.iter().any(|text| message.contains(text))
}

/// Whether a key is one that PostgreSQL gives by itself; on a node of Citus a shard's number stands behind its name.
fn is_numbered(constraint: &str) -> bool {
    let of = |name| constraint.strip_prefix(name);
    NUMBERED.into_iter().filter_map(of).any(|rest| rest.is_empty() || rest.starts_with('_'))
}

/// Whether PostgreSQL tells an I/O error of what it reads.
fn is_refused_read(code: &str, message: &str) -> bool {
    code == "58030" && message.starts_with("could not read ")
}

fn constraint(error: &dyn DatabaseError) -> String {
    error.constraint().unwrap_or_else(|| named_last(error.message())).to_owned()
}

/// SQLite names a constraint in its message only: "CHECK constraint failed: `cycles_coverage_range`". So does a node of Citus:
/// "… violates check constraint "`cycles_coverage_range`"".
fn named_last(message: &str) -> &str {
    let quoted = message.strip_suffix('"').and_then(|text| text.rsplit('"').next());
    quoted.unwrap_or_else(|| message.rsplit(": ").next().unwrap_or(message))
}

impl StoreError {
    /// Whether PostgreSQL says that its disk is full.
    pub(crate) fn is_of_a_full_disk(&self) -> bool {
        let Self::Unavailable(source) = self else { return false };
        let said = source.downcast_ref::<sqlx::Error>().and_then(sqlx::Error::as_database_error);
        said.and_then(DatabaseError::code).is_some_and(|code| code == "53100")
    }

    /// The same verdict for another row of a group that failed as a whole.
    pub(crate) fn again(&self) -> Self {
        let text = || -> Box<dyn std::error::Error + Send + Sync> {
            std::error::Error::source(self).map_or_else(|| self.to_string(), ToString::to_string).into()
        };
        match self {
            Self::Unavailable(_) => Self::Unavailable(text()),
            Self::OutcomeUnknown(_) => Self::OutcomeUnknown(text()),
            Self::NotWritable(_) => Self::NotWritable(text()),
            Self::NotReadable(_) => Self::NotReadable(text()),
            Self::Refused { constraint } => Self::Refused { constraint: constraint.clone() },
            Self::Damaged { what } => Self::Damaged { what: what.clone() },
            Self::VersionMismatch { current } => Self::VersionMismatch { current: *current },
            Self::VersionRequired { current } => Self::VersionRequired { current: *current },
            Self::Conflict { code, why } => Self::Conflict { code, why: why.clone() },
            Self::Full { what } => Self::Full { what },
            Self::Database(_) => Self::Database(text()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a server of Citus says, and nothing else of the same codes: those end the service, or are the statement's own fault.
    #[test]
    fn a_node_that_is_lost_is_no_broken_disk() {
        for (code, message) in [
            ("58030", "failed to COPY to shard 102008 on worker-1:5432"),
            ("58030", "failed to complete COPY on worker-1:5432"),
            ("XX000", "failure on connection marked as essential: worker-1:5432"),
            ("XX000", "terminating connection due to administrator command"),
            ("XX000", "could not extend file \"base/5/16384\": No space left on device"),
        ] {
            assert!(is_between_nodes(code, message), "{code} {message}");
        }
        for (code, message) in [
            ("58030", "could not fsync file \"base/5/16384\": Input/output error"),
            ("XX000", "cache lookup failed for type 16384"),
            ("XX001", "failed to COPY to shard 102008 on worker-1:5432"),
        ] {
            assert!(!is_between_nodes(code, message), "{code} {message}");
        }
    }

    /// As PostgreSQL words them, and Citus hands them on.
    #[test]
    fn a_row_that_a_node_refuses_is_refused_by_its_constraint() {
        let check = r#"new row for relation "recommendations_102040" violates check constraint "recommendations_override_range""#;
        let unique = r#"duplicate key value violates unique constraint "recommendations_pkey_102040""#;
        let null = r#"null value in column "machine_id" of relation "recommendations_102040" violates not-null constraint"#;
        for message in [check, unique, null] {
            assert!(is_refused_by_a_node("XX000", message), "{message}");
            assert!(!is_refused_by_a_node("58030", message), "{message}");
        }
        assert!(!is_refused_by_a_node("XX000", "cache lookup failed for type 16384"));
        assert_eq!(named_last(check), "recommendations_override_range");
        assert_eq!(named_last(null), null);
    }

    #[test]
    fn a_number_that_the_database_gave_twice_is_nobodys_row() {
        for name in ["audit_pkey", "tool_events_pkey_102011"] {
            assert!(is_numbered(name), "{name}");
        }
        for name in ["cycles_pkey", "audit_pkeys", "tools_pkey_102011"] {
            assert!(!is_numbered(name), "{name}");
        }
    }

    #[test]
    fn a_read_that_the_disk_of_a_plant_refuses_is_no_write() {
        let of_reading = "could not read block 7 in file \"base/5/16384\": Input/output error";
        assert!(is_refused_read("58030", of_reading));
        assert!(!is_refused_read("58030", "could not fsync file \"base/5/16384\": Input/output error"));
        assert!(!is_refused_read(
            "XX001",
            "could not read block 7 in file \"base/5/16384\": read only 0 of 8192 bytes"
        ));
    }

    /// By extended result codes, as they come: what a store concludes of a refused write rests on them.
    #[test]
    fn failures_of_sqlite_are_told_apart() {
        let told = |code| {
            let message = "CHECK constraint failed: cycles_coverage_range".to_owned();
            StoreError::from(rusqlite::Error::SqliteFailure(rusqlite::ffi::Error::new(code), Some(message)))
        };
        // Full, IOERR_WRITE, IOERR_FSYNC, READONLY, CANTOPEN
        for code in [13, 778, 1034, 8, 14] {
            assert!(matches!(told(code), StoreError::NotWritable(_)), "{code}: {:?}", told(code));
        }
        // And CORRUPT, CORRUPT_INDEX, NOTADB
        for code in REFUSED_READS.map(u32::cast_signed).into_iter().chain([11, 779, 26]) {
            let told = told(code);
            assert!(matches!(told, StoreError::NotReadable(_)), "{code}: {told:?}");
            assert!(matches!(told.again(), StoreError::NotReadable(_)) && told.of_the_disk().is_some());
        }
        // BUSY, BUSY_RECOVERY, LOCKED, INTERRUPT
        for code in [5, 261, 6, 9] {
            assert!(matches!(told(code), StoreError::Unavailable(_)), "{code}: {:?}", told(code));
        }
        // CHECK, FOREIGN KEY, NOT NULL, PRIMARY KEY, UNIQUE
        for code in [275, 787, 1299, 1555, 2067] {
            let StoreError::Refused { constraint } = told(code) else { panic!("{code}: {:?}", told(code)) };
            assert_eq!(constraint, "cycles_coverage_range");
        }
        assert!(matches!(told(1), StoreError::Database(_)));
        let gone = StoreError::from(rusqlite::Error::QueryReturnedNoRows);
        assert!(matches!(gone, StoreError::Database(_)), "{gone:?}");
    }
}
