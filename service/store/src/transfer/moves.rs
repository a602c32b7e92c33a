//! What may have moved on in a source since an earlier copy of it: table by table, how a row changes and whether it goes.
//!
//! A row that had no sum yet is given one, whatever table it is of.
//!
//! What happened once stands for ever: cycles, advice, what tools went through, the audit. A target may have no row of these
//! that the source has not, to the bit. As every change of what people register leaves a line in the audit, and every cycle
//! its row, a target that passes was not written by anybody else. So the other tables may follow the source, each as far as
//! its rows can change; what changed otherwise is refused.

use super::{Row, Side, Table, TransferError, Value};
use crate::error::StoreResult;
use crate::row_sum::{ROW_SUM, SUMMED_VERSION};
use std::collections::{BTreeMap, BTreeSet};

/// Why a row is refused.
const OTHER: &str = "is there with other content";
pub(super) const SURPLUS: &str = "is not in the source";
const NEWER: &str = "is newer than in the source";

/// What retention decided to drop by receipt.
const DECISIONS: &str = "sample_drops";
/// What it dropped by cycle.
const NAMES: &str = "cycle_sample_drops";

/// How the rows of a table change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// They do not, and stay.
    Never,
    /// With a column that counts up, or tells when.
    Counted(&'static str),
    /// These columns are filled in, once.
    Filled(&'static [&'static str]),
    /// These columns change, and the others do not. Something that is `Counted` tells that they did.
    Within(&'static [&'static str]),
    /// Anyhow, and they go too: made of what stands for ever, or of use for a while.
    Anyhow,
    /// They do not, and go where a decision of retention names them.
    Dropped,
}

fn kind(table: &str) -> Kind {
    match table {
        "machines" | "tools" | "operations" | "models" | "retention" => Kind::Counted("version"),
        "registry_generation" => Kind::Counted("changes"),
        "feed_profiles" => Kind::Counted("revision"),
        // A cycle that was sent again after its stream broke.
        "cycle_overrides" => Kind::Counted("stored_at_us"),
        // Not only later: what a clock that was ahead has noted is brought back.
        "machine_contacts" => Kind::Within(&["last_cycle_at_us"]),
        "feed_profile_versions" => Kind::Within(&[
            "state",
            "shadowed_by",
            "shadowed_at_us",
            "approved_by",
            "approved_at_us",
            "activated_by",
            "activated_at_us",
            "activated_revision",
            "superseded_at_us",
            "rolled_back",
        ]),
        "alarms" => Kind::Filled(&["cleared_at_us", "acknowledged_by", "acknowledged_at_us"]),
        "quarantine" => Kind::Filled(&["settled_at_us", "settled_how"]),
        "tokens" => Kind::Filled(&["revoked_at_us"]),
        "tool_events" => Kind::Filled(&["revoked_at_us", "revoked_by"]),
        // Folds are caches, leases, claims and sessions end, decisions of a day are put together.
        "tool_wear"
        | "tool_wear_checkpoints"
        | "tool_checkpoints"
        | "stream_leases"
        | "quarantine_claims"
        | "sessions"
        | "sample_drops" => Kind::Anyhow,
        "cycle_samples" => Kind::Dropped,
        _ => Kind::Never,
    }
}

/// Why the source may have no more what the target has.
pub(super) enum Goes {
    /// It changes so.
    Surely,
    /// If retention names that cycle of that machine, which has to be asked for.
    IfNamed(Name),
}

/// A machine and one of its cycles.
pub(super) type Name = (String, String);

/// How the rows of one table change.
pub(super) struct Moves<'a> {
    table: &'a Table,
    kind: Kind,
}

impl<'a> Moves<'a> {
    pub(super) fn of(table: &'a Table) -> Result<Self, TransferError> {
        let moves = Self { table, kind: kind(&table.name) };
        let named = match moves.kind {
            Kind::Counted(column) => vec![column],
            Kind::Filled(columns) | Kind::Within(columns) => columns.to_vec(),
            Kind::Dropped => vec!["machine_id", "received_at_us", "cycle_id"],
            Kind::Never | Kind::Anyhow => Vec::new(),
        };
        match named.into_iter().find(|column| table.place(column).is_none()) {
            Some(column) => Err(TransferError::Schema(format!("{} has no {column}", table.name))),
            None => Ok(moves),
        }
    }

    /// Whether a row of the target may be what this row of the source was before; why not.
    pub(super) fn follows(&self, found: &Row, row: &Row) -> Result<(), &'static str> {
        let differing = || {
            let pairs = self.table.columns.iter().zip(found.iter().zip(row));
            pairs.filter(|(_, (was, is))| was != is).map(|((name, _), (was, _))| (name.as_str(), was))
        };
        let may = match self.kind {
            // Of both sides the sum was held, or there was none yet.
            _ if differing().all(|(name, _)| matches!(name, ROW_SUM | SUMMED_VERSION)) => true,
            Kind::Never | Kind::Dropped => false,
            Kind::Anyhow => true,
            Kind::Within(columns) => differing().all(|(name, _)| columns.contains(&name)),
            Kind::Filled(columns) => {
                differing().all(|(name, was)| *was == Value::Null && columns.contains(&name))
            }
            Kind::Counted(column) => match (self.whole(found, column), self.whole(row, column)) {
                (Some(was), Some(is)) if was > is => return Err(NEWER),
                (was, is) => was < is,
            },
        };
        if may { Ok(()) } else { Err(OTHER) }
    }

    /// Whether the source may have had a row of the target before; why not.
    pub(super) fn goes(&self, found: &Row, drops: &Drops) -> Result<Goes, &'static str> {
        match self.kind {
            Kind::Anyhow => Ok(Goes::Surely),
            Kind::Dropped => match (
                self.value(found, "machine_id"),
                self.whole(found, "received_at_us"),
                self.value(found, "cycle_id"),
            ) {
                (Some(Value::Text(machine)), Some(received), Some(Value::Text(cycle))) => {
                    if drops.before.get(machine).is_some_and(|before| received < *before) {
                        Ok(Goes::Surely)
                    } else {
                        Ok(Goes::IfNamed((machine.clone(), cycle.clone())))
                    }
                }
                _ => Err(SURPLUS),
            },
            Kind::Never | Kind::Counted(_) | Kind::Filled(_) | Kind::Within(_) => Err(SURPLUS),
        }
    }

    fn value<'r>(&self, row: &'r Row, column: &str) -> Option<&'r Value> {
        row.get(self.table.place(column)?)
    }

    fn whole(&self, row: &Row, column: &str) -> Option<i64> {
        match self.value(row, column)? {
            Value::Whole(value) => Some(*value),
            _ => None,
        }
    }
}

/// Which samples of a source are dropped.
pub(super) struct Drops {
    /// All that were received before this, by machine, µs.
    before: BTreeMap<String, i64>,
    /// The table of those that are named by their cycles: as many as a clock that was ahead has dropped, which may be all of
    /// them, so that they are asked for and not kept in memory.
    names: Option<Table>,
}

impl Drops {
    pub(super) async fn of(source: &mut dyn Side, tables: &[Table]) -> Result<Self, TransferError> {
        let find = |name| tables.iter().find(|table| table.name == name);
        let mut drops = Self { before: BTreeMap::new(), names: find(NAMES).cloned() };
        let mut tell = |of: &Table, row: &Row| {
            let value = |column: &str| of.place(column).and_then(|at| row.get(at));
            let Some(Value::Text(machine)) = value("machine_id") else { return };
            if let Some(Value::Whole(until)) = value("before_us") {
                let latest = drops.before.entry(machine.clone()).or_insert(*until);
                *latest = (*latest).max(*until);
            }
        };
        if let Some(table) = find(DECISIONS) {
            let mut after = None;
            loop {
                let page = source.rows(table, after.as_ref(), None, super::PAGE_ROWS).await?;
                page.iter().for_each(|row| tell(table, row));
                let Some(last) = page.last() else { break };
                after = Some(table.key_of(last));
            }
        }
        Ok(drops)
    }

    /// Those of a page of cycles that are named in the source.
    pub(super) async fn named(&self, source: &mut dyn Side, asked: &[Name]) -> StoreResult<BTreeSet<Name>> {
        let Some(table) = self.names.as_ref().filter(|_| !asked.is_empty()) else {
            return Ok(BTreeSet::new());
        };
        let text = |text: &String| Value::Text(text.clone());
        let keys: Vec<Row> = asked.iter().map(|(machine, cycle)| vec![text(machine), text(cycle)]).collect();
        let present = source.present(table, &keys).await?.into_iter();
        let name = |key: Row| match <[Value; 2]>::try_from(key) {
            Ok([Value::Text(machine), Value::Text(cycle)]) => Some((machine, cycle)),
            _ => None,
        };
        Ok(present.filter_map(name).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transfer::sqlite::SqliteSide;

    /// A column that is renamed, or a table, would be refused as other data.
    #[tokio::test]
    async fn what_changes_is_there() {
        let mut model = SqliteSide::model().await.unwrap();
        let tables = model.tables().await.unwrap();
        for table in &tables {
            Moves::of(table).unwrap();
        }
        let changing = tables.iter().filter(|table| kind(&table.name) != Kind::Never).count();
        assert_eq!(changing, 22, "a table that is named in `kind` is gone, or has another name");
    }
}
