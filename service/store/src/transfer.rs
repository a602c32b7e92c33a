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
use crate::record::StoreFault;
use crate::row_sum::{ROW_SUM, SUMMED_VERSION, Standing, VERSION, Writers};
use crate::rows::SUMMED;
use crate::stored_text::StoredText;
use async_trait::async_trait;

/// Of each engine, for the check.
pub(crate) mod damaged_rows {
    pub(crate) use super::postgres::damaged_rows as of_postgres;
    pub(crate) use super::sqlite::damaged_rows as of_sqlite;
}

/// The table whose being there says that a transfer into the database has not come to its end. It is made by who begins one, and no
/// migration's: no complete database has it.
macro_rules! unfinished {
    () => {
        "unfinished_transfer"
    };
}
pub(crate) use unfinished;

/// Tables that belong to the program and not to the data.
const LEFT_OUT: [&str; 11] = [
    "_sqlx_migrations",
    unfinished!(),
    "write_probe",
    "last_backup",
    "retention_clock",
    "quarantine_fill",
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
/// A page is asked for so many times the rows of the one before at the most: what follows small rows may be large.
const PAGE_GROWTH: usize = 4;
/// Rows of the first page of a table: how large they are is not known yet.
const FIRST_PAGE_ROWS: usize = 32;
/// What is told of a row whose sum is another.
const NOT_AS_WRITTEN: &str = "it is not what was written, as its sum says";
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
    #[error("the target is not empty and holds something else: {table} {key} {what}")]
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
    /// The same, which began while it was written.
    #[error(
        "a server was started on the target while it was written (its session there is called `feedwright live`): stop it, and copy once more into an empty database"
    )]
    ServedMeanwhile,
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

    /// The same table without what is bytes: whatever those are they are read, and they are most of a database.
    fn without_bytes(&self) -> Result<Self, TransferError> {
        let key: Vec<String> = self.key.iter().map(|&at| self.columns[at].0.clone()).collect();
        let columns = self.columns.iter().filter(|(name, kind)| *kind != Kind::Bytes || key.contains(name));
        Self::checked(self.name.clone(), columns.cloned().collect(), &key)
    }

    /// The key of a row, as it is told where the row itself does not decode.
    fn key_beside<R: sqlx::Row>(&self, row: &R) -> String
    where
        usize: sqlx::ColumnIndex<R>,
        for<'r> StoredText: sqlx::Decode<'r, R::Database> + sqlx::Type<R::Database>,
        for<'r> i64: sqlx::Decode<'r, R::Database> + sqlx::Type<R::Database>,
        for<'r> Vec<u8>: sqlx::Decode<'r, R::Database> + sqlx::Type<R::Database>,
    {
        let part = |&at: &usize| match row.try_get::<i64, _>(at) {
            Ok(number) => number.to_string(),
            Err(_) => match row.try_get::<StoredText, _>(at) {
                Ok(text) => text.to_string(),
                Err(_) => row.try_get(at).map_or_else(|_| "?".to_owned(), |bytes| Value::Bytes(bytes).show()),
            },
        };
        self.key.iter().map(part).collect::<Vec<_>>().join("/")
    }

    /// Why a row is not read, with the row that it is.
    fn unread(&self, key: &str, Unread { column, error }: Unread) -> StoreError {
        let StoreError::Damaged { .. } = error else { return error };
        StoreError::Damaged {
            what: format!("{} {key}: its {} does not decode", self.name, self.columns[column].0),
        }
    }

    /// The same as a fault: no backup takes such a row.
    fn fault(&self, key: &str, Unread { column, error }: Unread) -> StoreResult<StoreFault> {
        let StoreError::Damaged { .. } = error else { return Err(error) };
        let column = self.columns[column].0.clone();
        let detail = format!("its {column} does not decode, so that no backup or copy takes it");
        Ok(StoreFault { kind: "row", key: format!("{} {key}", self.name), detail, column: Some(column) })
    }

    /// What the sum of a row says of it; `None` where the table has no sums, as one of a database of before.
    fn standing(&self, row: &Row, writers: Writers) -> Option<Standing> {
        let summed = SUMMED.iter().find(|summed| summed.table == self.name)?;
        let value = |column: &str| self.place(column).and_then(|at| row.get(at));
        let whole = |column: &str| match value(column) {
            Some(Value::Whole(value)) => Some(*value),
            _ => None,
        };
        self.place(ROW_SUM)?;
        let again = || summed.over(summed.columns.iter().map(|column| value(column).unwrap_or(&Value::Null)));
        Some(Standing::of((whole(ROW_SUM), whole(SUMMED_VERSION)), whole(VERSION)?, writers, again))
    }

    /// A row that may be taken: it is refused where it is not what was written, and a sum that says nothing of it is left behind.
    fn held(&self, mut row: Row, writers: Writers) -> StoreResult<Row> {
        match self.standing(&row, writers) {
            None | Some(Standing::Sound) => {}
            Some(Standing::Unsummed) => {
                for at in [ROW_SUM, SUMMED_VERSION].into_iter().filter_map(|column| self.place(column)) {
                    row[at] = Value::Null;
                }
            }
            Some(Standing::Damaged) => {
                let what = format!("{} {}: {NOT_AS_WRITTEN}", self.name, self.show_key(&row));
                return Err(StoreError::Damaged { what });
            }
        }
        Ok(row)
    }

    /// A row that is not what was written, as a fault: no backup takes it.
    fn sum_fault(&self, row: &Row, writers: Writers) -> Option<StoreFault> {
        let is_damaged = self.standing(row, writers) == Some(Standing::Damaged);
        is_damaged.then(|| StoreFault {
            kind: "row",
            key: format!("{} {}", self.name, self.show_key(row)),
            detail: format!("{NOT_AS_WRITTEN}, so that no backup or copy takes it"),
            column: None,
        })
    }

    fn show_key(&self, row: &Row) -> String {
        self.key_of(row).iter().map(Value::show).collect::<Vec<_>>().join("/")
    }
}

/// Which column of a row is not read, and why.
struct Unread {
    column: usize,
    error: StoreError,
}

/// What is damaged of the rows of a table: so much of it is told at the most, and the first that may mislead wear in any case.
struct DamagedRows<'a> {
    table: &'a Table,
    most: usize,
    faults: &'a mut Vec<StoreFault>,
    told: usize,
    mislead: bool,
}

impl<'a> DamagedRows<'a> {
    const fn of(table: &'a Table, most: usize, faults: &'a mut Vec<StoreFault>) -> Self {
        Self { table, most, faults, told: 0, mislead: false }
    }

    /// Looks at the values of a row, all of them, and at what its sum says where each can be read.
    fn look(
        &mut self,
        values: impl Iterator<Item = Result<Value, Unread>>,
        key: impl Fn() -> String,
        writers: Writers,
    ) -> StoreResult<()> {
        let (mut row, mut is_read) = (Row::new(), true);
        for value in values {
            match value {
                Ok(value) => row.push(value),
                Err(unread) => {
                    is_read = false;
                    self.add(self.table.fault(&key(), unread)?);
                }
            }
        }
        if is_read && let Some(fault) = self.table.sum_fault(&row, writers) {
            self.add(fault);
        }
        Ok(())
    }

    fn add(&mut self, fault: StoreFault) {
        let misleads = fault.may_mislead_wear();
        if self.told < self.most || (misleads && !self.mislead) {
            self.told += 1;
            self.mislead |= misleads;
            self.faults.push(fault);
        }
    }

    const fn are_told(&self) -> bool {
        self.told >= self.most && self.mislead
    }
}

/// A page as its rows come: it ends with as many of them as were asked for, or with as many bytes as one is large.
#[derive(Default)]
struct Filling {
    rows: Vec<Row>,
    bytes: usize,
}

impl Filling {
    fn add(&mut self, row: Row) {
        self.bytes += size(&row);
        self.rows.push(row);
    }

    const fn is_full(&self) -> bool {
        self.bytes >= PAGE_BYTES
    }
}

fn size(row: &Row) -> usize {
    row.iter().map(Value::size).sum()
}

/// Rows to ask for after that page; `None` stands for the first one.
fn next_page(before: Option<&[Row]>) -> usize {
    let Some(before) = before else { return FIRST_PAGE_ROWS };
    let bytes: usize = before.iter().map(size).sum();
    let row = bytes.checked_div(before.len()).unwrap_or(0).max(1);
    (PAGE_BYTES / row).min(before.len().saturating_mul(PAGE_GROWTH)).clamp(1, PAGE_ROWS)
}

/// One side of a transfer: a connection of its own.
#[async_trait]
pub(crate) trait Side: Send {
    /// Every table of the data, by name.
    async fn tables(&mut self) -> Result<Vec<Table>, TransferError>;

    /// From here on reads see one state, and nothing is written.
    async fn begin_snapshot(&mut self) -> StoreResult<()>;

    /// At most `limit` rows in the order of the key, after `after` and not beyond `until`; fewer where they fill a page before. Only
    /// none says that there are no more.
    async fn rows(
        &mut self,
        table: &Table,
        after: Option<&Row>,
        until: Option<&Row>,
        limit: usize,
    ) -> StoreResult<Vec<Row>>;

    /// Which of these keys are there, in any order: no more of them than rows of a page, and one.
    async fn present(&mut self, table: &Table, keys: &[Row]) -> StoreResult<Vec<Row>>;

    /// Whether a transfer into it has not come to its end.
    async fn is_unfinished(&mut self) -> StoreResult<bool>;

    /// Marks it as a database of which a part is missing, before a row is written or removed: whoever is not a copy refuses it until
    /// [`Side::unmark`], however the copy ends. Where it is marked already nothing happens.
    async fn mark(&mut self) -> StoreResult<()> {
        if self.is_unfinished().await? {
            return Ok(());
        }
        self.execute(concat!("CREATE TABLE ", unfinished!(), " (begun BIGINT)")).await
    }

    /// Takes the mark away, when all has arrived, where there is one.
    async fn unmark(&mut self) -> StoreResult<()> {
        if !self.is_unfinished().await? {
            return Ok(());
        }
        self.execute(concat!("DROP TABLE ", unfinished!())).await
    }

    /// Runs a statement that both engines take.
    async fn execute(&mut self, statement: &'static str) -> StoreResult<()>;

    /// Gets ready to take samples of these receipts, µs.
    async fn prepare(&mut self, received_us: &[i64]) -> StoreResult<()>;

    /// Adds rows, all or none of them.
    async fn insert(&mut self, table: &Table, rows: &[&Row]) -> StoreResult<()>;

    /// Removes the rows of these keys, all or none of them.
    async fn remove(&mut self, table: &Table, keys: &[Row]) -> StoreResult<()>;

    /// Removes all rows.
    async fn clear(&mut self, table: &Table) -> StoreResult<()>;

    /// The first and the last receipt of each day (UTC) on which samples were received, µs.
    async fn receipts(&mut self) -> StoreResult<Vec<i64>>;

    /// After the last row: numbers that are given out go on after those that came.
    /// Where nobody else may have written meanwhile, that is looked at once more.
    async fn finish(&mut self, tables: &[Table]) -> Result<(), TransferError>;

    /// Closes the connection.
    async fn close(self: Box<Self>);
}

/// Half a database is nobody's source.
async fn assert_finished(side: &mut dyn Side) -> StoreResult<()> {
    if side.is_unfinished().await? { Err(StoreError::of_unfinished_transfer()) } else { Ok(()) }
}

/// What [`Side::receipts`] asks of both engines. The two days around the beginning of 1970 count as one, of which the ends are told.
const RECEIPTS: &str = "SELECT MIN(received_at_us), MAX(received_at_us) FROM cycle_samples
     GROUP BY received_at_us / 86400000000 ORDER BY 1";

/// What an engine's text of a statement is made of: quoted names, separated.
fn quoted<'a>(names: impl IntoIterator<Item = &'a str>, suffix: &str) -> String {
    let names: Vec<_> = names.into_iter().map(|name| format!("\"{name}\"{suffix}")).collect();
    names.join(", ")
}

#[cfg(test)]
mod tests {
    use super::sqlite::SqliteSide;
    use super::*;

    const BLOCK_BYTES: usize = 1 << 20;

    fn sized(rows: usize, bytes: usize) -> Vec<Row> {
        vec![vec![Value::Bytes(vec![0; bytes - 24])]; rows]
    }

    #[test]
    fn a_page_is_as_many_rows_as_fill_it_and_four_times_those_before_at_the_most() {
        let after = |rows, bytes| next_page(Some(&sized(rows, bytes)));
        assert_eq!(next_page(None), FIRST_PAGE_ROWS);
        assert_eq!([after(32, 100), after(128, 100), after(512, 100)], [128, 512, PAGE_ROWS]);
        assert_eq!(
            [after(32, PAGE_BYTES / 40), after(4, PAGE_BYTES / 4), after(1, 2 * PAGE_BYTES)],
            [40, 4, 1]
        );
        assert_eq!(next_page(Some(&[])), 1);
    }

    /// A column that is added is summed too, unless it is written behind the row's back.
    #[tokio::test]
    async fn every_column_of_what_is_registered_is_in_its_sum() {
        let mut model = SqliteSide::model().await.unwrap();
        let tables = model.tables().await.unwrap();
        for summed in SUMMED {
            let table = tables.iter().find(|table| table.name == summed.table).unwrap();
            let behind = [ROW_SUM, SUMMED_VERSION, "judging_change"];
            let mut columns: Vec<&str> = table.columns.iter().map(|(name, _)| name.as_str()).collect();
            columns.retain(|name| !behind.contains(name));
            let mut in_sum = summed.columns.to_vec();
            in_sum.sort_unstable();
            assert_eq!(in_sum, columns, "{}", summed.table);
        }
        Box::new(model).close().await;
    }

    /// The size of the rows before says nothing of those that follow.
    #[tokio::test]
    async fn a_page_of_large_blocks_behind_small_ones_ends_at_its_bytes() {
        let mut side = SqliteSide::model().await.unwrap();
        let table = side.tables().await.unwrap().into_iter().find(|table| table.name == SAMPLES).unwrap();
        let row = |n: i64, bytes| -> Row {
            let value = |(name, _): &(String, Kind)| match name.as_str() {
                "machine_id" => Value::Text("M1".to_owned()),
                "received_at_us" => Value::Whole(n),
                "block" => Value::Bytes(vec![7; bytes]),
                _ => Value::Text(format!("c{n}")),
            };
            table.columns.iter().map(value).collect()
        };
        let small = (0..170).map(|n| row(n, 100));
        let rows: Vec<Row> = small.chain((170..190).map(|n| row(n, BLOCK_BYTES))).collect();
        side.insert(&table, &rows.iter().collect::<Vec<_>>()).await.unwrap();

        let (mut read, mut after, mut limit) = (Vec::new(), None, next_page(None));
        loop {
            let page = side.rows(&table, after.as_ref(), None, limit).await.unwrap();
            let Some(last) = page.last() else { break };
            assert!(page[..page.len() - 1].iter().map(size).sum::<usize>() < PAGE_BYTES);
            (after, limit) = (Some(table.key_of(last)), next_page(Some(&page)));
            read.extend(page);
        }
        assert!(read == rows, "each row once, in their order");
        Box::new(side).close().await;
    }
}
