//! From one database into another.

use super::backup::damage_of;
use super::digest::{Summing, of_table};
use super::failure::{file, of_source};
use super::moves::{Drops, Goes, Moves, SURPLUS};
use super::postgres::PostgresSide;
use super::sqlite::SqliteSide;
use super::{MOST_PARAMETERS, Row, Side, Table, TableSum, TransferError, assert_finished, next_page};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Rows of one statement that take longer are told of.
const LONG: Duration = Duration::from_secs(1);

/// Where a database is.
#[derive(Debug, Clone)]
pub enum Address {
    /// SQLite, in this file.
    Sqlite(PathBuf),
    /// PostgreSQL, at this address: the server itself, not a pooler.
    Postgres(String),
}

impl Address {
    /// Reads `sqlite:///path/to/file` or `postgres://…`; `None` where it is neither.
    pub fn parse(text: &str) -> Option<Self> {
        if text.starts_with("postgres://") || text.starts_with("postgresql://") {
            return Some(Self::Postgres(text.to_owned()));
        }
        let path = text.strip_prefix("sqlite://")?;
        (!path.is_empty()).then(|| Self::Sqlite(path.into()))
    }

    async fn source(&self) -> Result<Box<dyn Side>, TransferError> {
        Ok(match self {
            Self::Sqlite(path) => {
                Box::new(SqliteSide::read(path).await.map_err(|error| of_source(path, error))?)
            }
            Self::Postgres(url) => Box::new(PostgresSide::read(url).await?),
        })
    }

    /// Rows of SQLite are read by their indexes: one that is damaged leaves some out, and both sums are without them.
    async fn is_sound(&self) -> Result<(), TransferError> {
        let Self::Sqlite(path) = self else { return Ok(()) };
        let mut side = SqliteSide::read(path).await.map_err(|error| of_source(path, error))?;
        let damage = damage_of(&mut side).await.map_err(|error| of_source(path, error));
        Box::new(side).close().await;
        match damage? {
            None => Ok(()),
            Some(damage) => Err(file(path, format!("is damaged: {damage}; nothing was copied"))),
        }
    }

    /// Opened by the store itself, and so migrated, before anything is written.
    async fn target(&self) -> Result<Box<dyn Side>, TransferError> {
        use crate::store::Store;
        Ok(match self {
            Self::Sqlite(path) => {
                let options = crate::SqliteOptions { for_a_copy: true, ..crate::SqliteOptions::default() };
                let store = crate::SqliteStore::open(path, options).await?;
                store.close().await;
                Box::new(SqliteSide::write(path).await?)
            }
            Self::Postgres(url) => {
                let options = crate::PostgresOptions {
                    connections: 1,
                    for_a_copy: true,
                    ..crate::PostgresOptions::default()
                };
                let store = crate::PostgresStore::open(url, options).await?;
                store.close().await;
                Box::new(PostgresSide::connect_alone(url).await?)
            }
        })
    }
}

/// Copies everything, and compares digests of both sides afterwards.
///
/// The target must be fresh, or hold what an earlier copy of the same source left there: then the rest is added, and rows
/// that moved on in the source since follow it (see [`super::moves`]). `told` hears of each table when it is done. Returns
/// each table with its sum.
pub async fn copy(
    from: &Address,
    to: &Address,
    told: &mut (dyn FnMut(&str, TableSum, u64) + Send),
) -> Result<Vec<(String, TableSum)>, TransferError> {
    from.is_sound().await?;
    copy_sound(from, to, told).await
}

/// As [`copy`], of a source in which no damage was found.
pub(super) async fn copy_sound(
    from: &Address,
    to: &Address,
    told: &mut (dyn FnMut(&str, TableSum, u64) + Send),
) -> Result<Vec<(String, TableSum)>, TransferError> {
    let mut source = from.source().await?;
    let mut target = to.target().await?;
    let outcome = transfer(&mut *source, &mut *target, told).await;
    source.close().await;
    target.close().await;
    outcome
}

/// The same between sides that are open.
pub(super) async fn transfer(
    source: &mut dyn Side,
    target: &mut dyn Side,
    told: &mut (dyn FnMut(&str, TableSum, u64) + Send),
) -> Result<Vec<(String, TableSum)>, TransferError> {
    source.begin_snapshot().await?;
    // As the snapshot has it: a copy may have begun since the source was opened.
    assert_finished(source).await?;
    let tables = source.tables().await?;
    same_schema(&tables, &target.tables().await?)?;
    let drops = Drops::of(source, &tables).await?;
    let fresh = is_fresh(target, &tables).await?;
    if fresh {
        target.mark().await?;
    }
    let mut behind = Vec::new();
    // What people would look for first is told first.
    let mut compared: Vec<&Table> = tables.iter().collect();
    compared.sort_by_key(|table| FIRST.iter().position(|first| table.name == *first).unwrap_or(FIRST.len()));
    for table in compared {
        if fresh {
            target.clear(table).await?;
        } else if walk(source, target, (table, &drops), Writing::Refused).await?.obsolete > 0 {
            behind.push(table);
        }
    }
    // All of a table that goes before anything that comes: no two rows may stand for the same open alarm, say.
    for table in behind {
        walk(source, target, (table, &drops), Writing::Removed).await?;
    }
    target.prepare(&source.receipts().await?).await?;
    let mut sums = Vec::with_capacity(tables.len());
    for table in &tables {
        let Walked { sum, written, .. } = walk(source, target, (table, &drops), Writing::Missing).await?;
        let arrived = of_table(target, table).await?;
        if arrived != sum {
            return Err(TransferError::Differs { table: table.name.clone(), from: sum, to: arrived });
        }
        told(&table.name, sum, written);
        sums.push((table.name.clone(), sum));
    }
    target.finish(&tables).await?;
    target.unmark().await?;
    Ok(sums)
}

fn same_schema(from: &[Table], to: &[Table]) -> Result<(), TransferError> {
    for table in from {
        match to.iter().find(|other| other.name == table.name) {
            Some(other) if other.same_as(table) => {}
            Some(_) => return Err(TransferError::Schema(format!("{} has other columns", table.name))),
            None => return Err(TransferError::Schema(format!("the target has no {}", table.name))),
        }
    }
    match to.iter().find(|other| from.iter().all(|table| table.name != other.name)) {
        Some(more) => Err(TransferError::Schema(format!("the source has no {}", more.name))),
        None => Ok(()),
    }
}

impl Table {
    /// Alike but for how an engine keeps a truth value.
    fn same_as(&self, other: &Self) -> bool {
        use super::Kind::{Truth, Whole};
        let kinds = |(a, b): (&(String, super::Kind), &(String, super::Kind))| {
            a.0 == b.0 && (a.1 == b.1 || matches!((a.1, b.1), (Whole, Truth) | (Truth, Whole)))
        };
        self.key == other.key
            && self.columns.len() == other.columns.len()
            && self.columns.iter().zip(&other.columns).all(kinds)
    }
}

/// Whether a database holds nothing, or nothing but what the migrations themselves put there.
async fn is_fresh(target: &mut dyn Side, tables: &[Table]) -> Result<bool, TransferError> {
    let mut model = SqliteSide::model().await?;
    let mut fresh = true;
    for table in tables {
        let there = target.rows(table, None, None, 1).await?;
        if !there.is_empty() && of_table(target, table).await? != of_table(&mut model, table).await? {
            fresh = false;
            break;
        }
    }
    Box::new(model).close().await;
    Ok(fresh)
}

/// Tables that are compared before all others.
const FIRST: [&str; 2] = ["cycles", "audit"];

#[derive(Clone, Copy, PartialEq, Eq)]
enum Writing {
    /// Only compared: what the target has must be the source's, now or before.
    Refused,
    /// What the source had before, and has no more, is removed.
    Removed,
    /// What the target lacks is added.
    Missing,
}

/// What was found on the way through a table.
struct Walked {
    sum: TableSum,
    /// Rows of the target that the source has no more, or otherwise by now.
    obsolete: u64,
    /// Rows that were added.
    written: u64,
}

fn other_data(table: &Table, found: &Row, what: &'static str) -> TransferError {
    TransferError::OtherData { table: table.name.clone(), key: table.show_key(found), what }
}

/// Walks both sides of a table in the order of its key.
async fn walk(
    source: &mut dyn Side,
    target: &mut dyn Side,
    (table, drops): (&Table, &Drops),
    writing: Writing,
) -> Result<Walked, TransferError> {
    let moves = Moves::of(table)?;
    let (mut summing, mut obsolete, mut written) = (Summing::new(table), 0, 0);
    let (mut after, mut limit) = (None, next_page(None));
    loop {
        let page = source.rows(table, after.as_ref(), None, limit).await?;
        page.iter().for_each(|row| summing.add(row));
        // Up to the last key of the page, or, after the last page, all the rest.
        let until = page.last().map(|last| table.key_of(last));
        let (mut missing, mut gone, mut next) = (Vec::new(), Vec::new(), 0);
        let mut at = after.clone();
        loop {
            // One row more than the page shows a surplus.
            let there = target.rows(table, at.as_ref(), until.as_ref(), page.len() + 1).await?;
            let mut asked = Vec::new();
            for found in &there {
                let key = table.key_of(found);
                let beside = page[next..].iter().position(|row| table.key_of(row) == key);
                let verdict = match beside.map(|beside| next + beside) {
                    Some(place) => {
                        missing.extend(&page[next..place]);
                        next = place + 1;
                        if *found == page[place] {
                            Ok(false)
                        } else {
                            moves.follows(found, &page[place]).map(|()| true)
                        }
                    }
                    None => match moves.goes(found, drops) {
                        Ok(Goes::Surely) => Ok(true),
                        Ok(Goes::IfNamed(name)) => {
                            asked.push((name, found));
                            Ok(false)
                        }
                        Err(what) => Err(what),
                    },
                };
                match verdict {
                    Ok(true) => gone.push(key),
                    Ok(false) => {}
                    Err(what) => return Err(other_data(table, found, what)),
                }
            }
            let (names, surplus): (Vec<_>, Vec<_>) = asked.into_iter().unzip();
            let named = drops.named(source, &names).await?;
            for (name, found) in names.iter().zip(surplus) {
                if !named.contains(name) {
                    return Err(other_data(table, found, SURPLUS));
                }
                gone.push(table.key_of(found));
            }
            match there.last().map(|last| table.key_of(last)) {
                Some(last) if until.as_ref() != Some(&last) => at = Some(last),
                _ => break,
            }
        }
        missing.extend(&page[next..]);
        obsolete += gone.len() as u64;
        match writing {
            Writing::Refused => {}
            Writing::Removed => {
                if !gone.is_empty() {
                    target.mark().await?;
                }
                for keys in gone.chunks((MOST_PARAMETERS / table.key.len()).max(1)) {
                    target.remove(table, keys).await?;
                }
            }
            Writing::Missing => {
                if !missing.is_empty() {
                    target.mark().await?;
                }
                for rows in missing.chunks((MOST_PARAMETERS / table.columns.len()).max(1)) {
                    let begun = Instant::now();
                    target.insert(table, rows).await?;
                    let took = begun.elapsed();
                    if took >= LONG {
                        tracing::warn!(
                            table = table.name,
                            rows = rows.len(),
                            ?took,
                            "rows took long to be written"
                        );
                    }
                    written += rows.len() as u64;
                }
            }
        }
        let Some(until) = until else { return Ok(Walked { sum: summing.sum(), obsolete, written }) };
        after = Some(until);
        limit = next_page(Some(&page));
    }
}
