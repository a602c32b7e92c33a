//! Whole databases: copied from one engine to the other, backed up, restored, compared by digests.
//!
//! A table is what both engines' migrations make of it: the same names, and rows in the order of their primary key. So
//! tables are read from the schema itself, and a new one needs a line in `moves` only where its rows change or go. Names come out of the schema that this
//! program's own migrations made, and are refused where they are no plain words; nothing that a client wrote becomes
//! SQL. A copy reads one snapshot, keeps a page in memory, may be repeated after it broke off, and is believed only
//! when both sides have the same digests.

mod backup;
mod copy;
mod digest;
mod failure;
mod moves;
mod postgres;
mod sqlite;

pub use backup::{
    BackupReport, back_up_postgres, back_up_sqlite, note_postgres, note_sqlite, restore_to_postgres,
    restore_to_sqlite,
};
pub use copy::{Address, copy};
pub use digest::TableSum;

use crate::error::{StoreError, StoreResult};
use async_trait::async_trait;

/// Tables that belong to the program and not to the data.
const LEFT_OUT: [&str; 9] = [
    "_sqlx_migrations",
    "write_probe",
    "last_backup",
    "retention_clock",
    "backup_sums",
    "backup_made",
    "groups_journal",
    "sample_packs",
    "sample_pack_drops",
];
/// The table that the engines have differently: with SQLite several blocks stand in one row of another.
const SAMPLES: &str = "cycle_samples";
/// A page of rows is about this large, bytes.
const PAGE_BYTES: usize = 4 << 20;
/// Most rows of a page.
const PAGE_ROWS: usize = 1_000;
/// Rows of the first page of a table: how large they are is not known yet.
const FIRST_PAGE_ROWS: usize = 32;
/// Parameters of one statement; SQLite takes 32,766.
const MOST_PARAMETERS: usize = 30_000;

/// Why data was not transferred.
#[derive(Debug, thiserror::Error)]
pub enum TransferError {
    /// A database fails.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The two databases are of different versions of the program.
    #[error(
        "the schemas differ: {0}; start this version's server on each database once, which migrates it, or use the version that made it, also for its backup"
    )]
    Schema(String),
    /// The target holds something else already.
    #[error("the target is not empty and holds something else: {table} {key} {what}; nothing was written")]
    OtherData {
        /// Which table.
        table: String,
        /// Which row.
        key: String,
        /// What about it.
        what: &'static str,
    },
    /// Two would each take the rows of the other for foreign ones.
    #[error(
        "another copy or restore is at work on the target (its session there is called `feedwright transfer`)"
    )]
    InUse,
    /// A server would go on counting meanwhile.
    #[error(
        "a server is running on the target (its session there is called `feedwright live`): stop it first; nothing was written"
    )]
    Served,
    /// What arrived is not what was sent.
    #[error("{table} differs after the transfer: {from} there, {to} here")]
    Differs {
        /// Which table.
        table: String,
        /// Rows and digest of the source.
        from: TableSum,
        /// Rows and digest of the target.
        to: TableSum,
    },
    /// A file cannot be used.
    #[error("{path}: {why}")]
    File {
        /// Which file.
        path: String,
        /// Why.
        why: String,
    },
}

impl From<sqlx::Error> for TransferError {
    fn from(error: sqlx::Error) -> Self {
        Self::Store(error.into())
    }
}

/// What a column holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Whole,
    Float,
    Text,
    Bytes,
    /// A whole number here, a truth value where the engine has such.
    Truth,
}

/// One value of one row.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Value {
    Null,
    Whole(i64),
    Float(f64),
    Text(String),
    Bytes(Vec<u8>),
}

impl Value {
    fn size(&self) -> usize {
        match self {
            Self::Null | Self::Whole(_) | Self::Float(_) => 8,
            Self::Text(text) => 24 + text.len(),
            Self::Bytes(bytes) => 24 + bytes.len(),
        }
    }

    /// As a person reads it in a key.
    fn show(&self) -> String {
        match self {
            Self::Null => "null".to_owned(),
            Self::Whole(value) => value.to_string(),
            Self::Float(value) => value.to_string(),
            Self::Text(text) => text.clone(),
            Self::Bytes(bytes) => bytes.iter().take(16).map(|byte| format!("{byte:02x}")).collect(),
        }
    }
}

pub(crate) type Row = Vec<Value>;

/// A table of the schema.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Table {
    pub(crate) name: String,
    /// Columns in the order of their names.
    pub(crate) columns: Vec<(String, Kind)>,
    /// Places of the primary key's columns, in its order.
    pub(crate) key: Vec<usize>,
}

impl Table {
    /// Checks the names: they become part of statements.
    fn checked(
        name: String,
        mut columns: Vec<(String, Kind)>,
        key: &[String],
    ) -> Result<Self, TransferError> {
        let plain = |name: &str| {
            !name.is_empty()
                && name.len() <= 63
                && name.bytes().all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'_')
        };
        let odd =
            std::iter::once(&name).chain(columns.iter().map(|(name, _)| name)).find(|name| !plain(name));
        if let Some(odd) = odd {
            return Err(TransferError::Schema(format!("`{odd}` is no name that this program gives")));
        }
        columns.sort_by(|a, b| a.0.cmp(&b.0));
        let place = |wanted: &String| columns.iter().position(|(column, _)| column == wanted);
        let key: Option<Vec<usize>> = key.iter().map(place).collect();
        match key.filter(|key| !key.is_empty()) {
            Some(key) => Ok(Self { name, columns, key }),
            None => Err(TransferError::Schema(format!("{name} has no primary key"))),
        }
    }

    pub(crate) fn key_of(&self, row: &Row) -> Row {
        self.key.iter().filter_map(|&at| row.get(at).cloned()).collect()
    }

    /// Where a column stands in a row.
    fn place(&self, column: &str) -> Option<usize> {
        self.columns.iter().position(|(name, _)| name == column)
    }

    fn show_key(&self, row: &Row) -> String {
        self.key_of(row).iter().map(Value::show).collect::<Vec<_>>().join("/")
    }

    /// Rows of the next page, after one of so many rows and bytes.
    fn next_page(rows: usize, bytes: usize) -> usize {
        let row = bytes.checked_div(rows);
        row.map_or(FIRST_PAGE_ROWS, |row| (PAGE_BYTES / row.max(1)).clamp(1, PAGE_ROWS))
    }
}

/// One side of a transfer: a connection of its own.
#[async_trait]
pub(crate) trait Side: Send {
    /// Every table of the data, by name.
    async fn tables(&mut self) -> Result<Vec<Table>, TransferError>;

    /// From here on reads see one state, and nothing is written.
    async fn begin_snapshot(&mut self) -> StoreResult<()>;

    /// At most `limit` rows in the order of the key, after `after` and not beyond `until`.
    async fn rows(
        &mut self,
        table: &Table,
        after: Option<&Row>,
        until: Option<&Row>,
        limit: usize,
    ) -> StoreResult<Vec<Row>>;

    /// Which of these keys are there, in any order: no more of them than rows of a page, and one.
    async fn present(&mut self, table: &Table, keys: &[Row]) -> StoreResult<Vec<Row>>;

    /// Gets ready to take rows, whose receipt lies within that range.
    async fn prepare(&mut self, received_us: Option<(i64, i64)>) -> StoreResult<()>;

    /// Adds rows, all or none of them.
    async fn insert(&mut self, table: &Table, rows: &[&Row]) -> StoreResult<()>;

    /// Removes the rows of these keys, all or none of them.
    async fn remove(&mut self, table: &Table, keys: &[Row]) -> StoreResult<()>;

    /// Removes all rows.
    async fn clear(&mut self, table: &Table) -> StoreResult<()>;

    /// The least and the largest whole number of a column.
    async fn range(&mut self, table: &str, column: &str) -> StoreResult<Option<(i64, i64)>>;

    /// After the last row: numbers that are given out go on after those that came.
    async fn finish(&mut self, tables: &[Table]) -> StoreResult<()>;

    /// Closes the connection.
    async fn close(self: Box<Self>);
}

/// What an engine's text of a statement is made of: quoted names, separated.
fn quoted<'a>(names: impl IntoIterator<Item = &'a str>, suffix: &str) -> String {
    let names: Vec<_> = names.into_iter().map(|name| format!("\"{name}\"{suffix}")).collect();
    names.join(", ")
}
