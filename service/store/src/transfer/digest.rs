//! Digests of tables: equal where every value of every row is, whatever the engine.

use super::{Row, Side, Table, TransferError, Value, next_page};
use std::fmt;

/// How many rows a table has, and a digest over all their values in the order of the key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TableSum {
    /// Rows.
    pub rows: u64,
    /// blake3 over the values.
    pub digest: [u8; 32],
}

impl fmt::Display for TableSum {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digest = blake3::Hash::from_bytes(self.digest).to_hex();
        write!(f, "{} rows {}", self.rows, &digest[..16])
    }
}

pub(super) struct Summing {
    rows: u64,
    hasher: blake3::Hasher,
}

impl Summing {
    pub(super) fn new(table: &Table) -> Self {
        let mut hasher = blake3::Hasher::new();
        hasher.update(b"feedwright table v1\n");
        for (name, _) in &table.columns {
            hasher.update(name.as_bytes()).update(b"\n");
        }
        Self { rows: 0, hasher }
    }

    pub(super) fn add(&mut self, row: &Row) {
        self.rows += 1;
        for value in row {
            let mut bytes = |kind: u8, bytes: &[u8]| {
                self.hasher.update(&[kind]).update(&(bytes.len() as u64).to_le_bytes()).update(bytes);
            };
            match value {
                Value::Null => bytes(0, &[]),
                Value::Whole(value) => bytes(1, &value.to_le_bytes()),
                Value::Float(value) => bytes(2, &value.to_bits().to_le_bytes()),
                Value::Text(text) => bytes(3, text.as_bytes()),
                Value::Bytes(value) => bytes(4, value),
            }
        }
    }

    pub(super) fn sum(&self) -> TableSum {
        TableSum { rows: self.rows, digest: *self.hasher.finalize().as_bytes() }
    }
}

/// The sum of one table as it stands.
pub(super) async fn of_table(side: &mut dyn Side, table: &Table) -> Result<TableSum, TransferError> {
    let mut summing = Summing::new(table);
    let (mut after, mut limit) = (None, next_page(None));
    loop {
        let page = side.rows(table, after.as_ref(), None, limit).await?;
        page.iter().for_each(|row| summing.add(row));
        let Some(last) = page.last() else { return Ok(summing.sum()) };
        after = Some(table.key_of(last));
        limit = next_page(Some(&page));
    }
}
