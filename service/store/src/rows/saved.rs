//! Rows that a group writes many of at once.

use super::{AdviceBody, CycleRow, count, float};
use crate::codec::{pack, state};
use crate::error::{StoreError, StoreResult};
use crate::record::{AlarmKind, IssuedRecommendation};
use feedwright_core::ids::{MachineId, ToolId};
use feedwright_core::wear::{FOLD_VERSION, Level, LevelBasis, MOST_LEVEL, Remaining};
use std::borrow::Cow;
use std::sync::Arc;

/// Bytes of blake3 that name an advice: a collision within one plant is out of reach.
pub(crate) const ADVICE_HASH_BYTES: usize = 16;

/// Most advices are shorter.
const USUAL_ADVICE_BYTES: usize = 1024;

/// What stands for a fold in its row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum SavedState {
    /// The fold, as it gives itself.
    Fold(Vec<u8>),
    /// Its cycles are folded again in the background: there is none until then.
    Postponed,
}

/// Stands in place of the state of a fold that is postponed. No state is stored like this.
const POSTPONED: &[u8] = b"postponed";

impl SavedState {
    /// Version of the rules of a fold that is behind its cycles, as no rules ever were: a journal of groups was taken up, or it is postponed.
    pub(crate) const BEHIND: i64 = 0;

    /// Whether a row's version and state are those of a fold that is postponed.
    pub(crate) fn is_postponed(version: i64, stored: &[u8]) -> bool {
        version == Self::BEHIND && stored == POSTPONED
    }

    /// The version of the rules that made it.
    pub(crate) fn version(&self) -> i64 {
        match self {
            Self::Fold(_) => i64::from(FOLD_VERSION),
            Self::Postponed => Self::BEHIND,
        }
    }

    /// It as it is stored.
    pub(crate) fn stored(&self) -> Vec<u8> {
        match self {
            Self::Fold(state) => state::pack(state),
            Self::Postponed => POSTPONED.to_vec(),
        }
    }
}

/// A row of `tool_wear`.
#[derive(Debug)]
pub(crate) struct SavedWear {
    pub(crate) machine_id: MachineId,
    pub(crate) tool_id: ToolId,
    pub(crate) folded: i64,
    /// The fold's state, packed when it is written, or what stands for one that is postponed.
    pub(crate) state: SavedState,
    /// Version of the row that it follows; 0 where there is none.
    pub(crate) version: i64,
    /// Number of the last change of an operation that it has gone along with.
    pub(crate) judging_change: i64,
    /// Which operations its cycles ran, where that is known.
    pub(crate) ran: Option<Vec<u8>>,
}

/// A row of `cycle_samples`, with its block.
#[derive(Debug)]
pub(crate) struct BlockRow<'a> {
    pub(crate) machine_id: String,
    pub(crate) received_at_us: i64,
    pub(crate) cycle_id: String,
    pub(crate) block: Cow<'a, [u8]>,
}

/// Longest block that is kept, bytes. The tables are checked against the same.
pub(crate) const MOST_BLOCK_BYTES: usize = 256 << 20;

impl<'a> BlockRow<'a> {
    /// Refuses a block that is empty or too long.
    pub(crate) fn of(cycle: &CycleRow, block: &'a [u8]) -> StoreResult<Self> {
        let key = (cycle.machine_id.clone(), cycle.received_at_us, cycle.cycle_id.clone());
        Self::checked(key, block)
    }

    /// The same of a machine, a receipt and a cycle.
    pub(crate) fn checked(
        (machine_id, received_at_us, cycle_id): (String, i64, String),
        block: &'a [u8],
    ) -> StoreResult<Self> {
        if !(1..=MOST_BLOCK_BYTES).contains(&block.len()) {
            return Err(StoreError::Refused { constraint: "cycle_samples_block_length".to_owned() });
        }
        Ok(Self { machine_id, received_at_us, cycle_id, block: Cow::Borrowed(block) })
    }

    /// How long the block is, as its column has it.
    pub(crate) fn bytes(&self) -> i64 {
        i64::try_from(self.block.len()).unwrap_or(i64::MAX)
    }

    /// The pack of the blocks of some rows.
    pub(crate) fn pack(rows: &[Self]) -> Cow<'_, [u8]> {
        pack::pack(&rows.iter().map(|row| &*row.block).collect::<Vec<_>>())
    }

    /// The same with a block of its own.
    pub(crate) fn to_owned(&self) -> BlockRow<'static> {
        BlockRow {
            machine_id: self.machine_id.clone(),
            received_at_us: self.received_at_us,
            cycle_id: self.cycle_id.clone(),
            block: Cow::Owned(self.block.to_vec()),
        }
    }
}

/// A change of the table `alarms`.
#[derive(Debug)]
pub(crate) enum AlarmChange {
    /// A tool's open alarms that follow its verdict are cleared, but those of one kind.
    ClearVerdicts { tool_id: String, but: Option<&'static str> },
    /// An alarm is raised, unless one of its kind is open for the same subject.
    Raise { kind: &'static str, machine_id: Option<String>, tool_id: Option<String>, message: String },
}

impl AlarmChange {
    /// Takes the time, the tool, and the kind that stays.
    pub(crate) const CLEAR_VERDICTS: &str = "UPDATE alarms SET cleared_at_us = $1
         WHERE tool_id = $2 AND cleared_at_us IS NULL AND kind <> COALESCE(CAST($3 AS TEXT), '')
           AND kind IN ('worn', 'broken_suspected', 'conditions_changed')";
    /// Takes kind, machine, tool, message and time. Parameters of both are numbered as they stand, as one of the two ways to
    /// bind them counts them.
    pub(crate) const RAISE: &str =
        "INSERT INTO alarms (kind, machine_id, tool_id, message, raised_at_us) VALUES ($1, $2, $3, $4, $5)
         ON CONFLICT (kind, COALESCE(tool_id, ''), COALESCE(machine_id, '')) WHERE cleared_at_us IS NULL DO NOTHING";

    pub(crate) fn raise(
        kind: AlarmKind,
        machine: Option<&MachineId>,
        tool: Option<&ToolId>,
        message: String,
    ) -> Self {
        Self::Raise {
            kind: kind.as_str(),
            machine_id: machine.map(|machine| machine.as_str().to_owned()),
            tool_id: tool.map(|tool| tool.as_str().to_owned()),
            message,
        }
    }
}

/// What a group writes after its cycles, of which nothing is read back in its transaction.
#[derive(Debug)]
pub(crate) struct Rest<'a> {
    pub(crate) blocks: Vec<BlockRow<'a>>,
    pub(crate) wear: Vec<Arc<SavedWear>>,
    pub(crate) alarms: Vec<AlarmChange>,
    pub(crate) issued: Vec<IssuedRow>,
    /// Which of those refer to an advice that is not known to be stored, in ascending order of their hashes: others may
    /// be told the same at this moment, and no two may wait for each other.
    new_advices: Vec<usize>,
}

impl<'a> Rest<'a> {
    /// With what is new of the advices, each once.
    pub(crate) fn of(
        blocks: Vec<BlockRow<'a>>,
        (wear, alarms): (Vec<Arc<SavedWear>>, Vec<AlarmChange>),
        issued: Vec<IssuedRow>,
        mut is_new: impl FnMut(&IssuedRow) -> bool,
    ) -> Self {
        let mut new_advices: Vec<usize> = (0..issued.len()).filter(|at| is_new(&issued[*at])).collect();
        new_advices.sort_unstable_by_key(|at| issued[*at].advice.hash);
        Self { blocks, wear, alarms, issued, new_advices }
    }

    /// Recommendations whose advice is not known to be stored, in ascending order of its hash.
    pub(crate) fn with_new_advice(&self) -> impl Iterator<Item = &IssuedRow> {
        self.new_advices.iter().filter_map(|at| self.issued.get(*at))
    }
}

/// What repeats from one recommendation to the next, as it is stored.
#[derive(Debug, Clone)]
pub(crate) struct Advice {
    pub(crate) hash: [u8; ADVICE_HASH_BYTES],
    /// JSON of its [`AdviceBody`].
    pub(crate) body: Arc<str>,
}

impl Advice {
    pub(crate) fn of(body: &AdviceBody<'_>) -> StoreResult<Self> {
        let mut json = Vec::with_capacity(USUAL_ADVICE_BYTES);
        serde_json::to_writer(&mut json, body).map_err(|error| StoreError::Database(Box::new(error)))?;
        let json = String::from_utf8(json).map_err(|error| StoreError::Database(Box::new(error)))?;
        Ok(Self { hash: advice_hash(&json), body: json.into() })
    }
}

/// Under what a text of an advice is kept.
pub(crate) fn advice_hash(json: &str) -> [u8; ADVICE_HASH_BYTES] {
    let mut hash = [0; ADVICE_HASH_BYTES];
    hash.copy_from_slice(&blake3::hash(json.as_bytes()).as_bytes()[..ADVICE_HASH_BYTES]);
    hash
}

/// A row of `recommendations`, with the advice that it refers to.
#[derive(Debug)]
pub(crate) struct IssuedRow {
    pub(crate) recommendation_id: String,
    pub(crate) advice: Advice,
    pub(crate) issued_at_us: i64,
    pub(crate) valid_until_us: i64,
    pub(crate) level_as_run: Option<f64>,
    pub(crate) level_lowest: Option<f64>,
    pub(crate) level_highest: Option<f64>,
    pub(crate) level_n: Option<i64>,
    pub(crate) level_window: Option<i64>,
    pub(crate) remaining_cycles: Option<i64>,
    pub(crate) remaining_low: Option<i64>,
    pub(crate) remaining_high: Option<i64>,
    pub(crate) data_age_ms: Option<i64>,
    pub(crate) level_decides: Option<&'static str>,
    pub(crate) level_value: Option<f64>,
    pub(crate) level_sd: Option<f64>,
    pub(crate) machine_id: String,
    pub(crate) operation_id: String,
    pub(crate) tool_id: String,
}

/// A number of a level on its way into its column. The tables are checked against the same range.
fn level_number(column: &str, least: f64, value: f64) -> StoreResult<f64> {
    let value = float(column, value)?;
    if (least..=MOST_LEVEL).contains(&value) { Ok(value) } else { Err(out_of_range(column)) }
}

fn out_of_range(column: &str) -> StoreError {
    StoreError::Refused { constraint: format!("recommendations_{column}_range") }
}

impl IssuedRow {
    /// Takes the hash and the text of an advice.
    pub(crate) const INSERT_ADVICE: &str =
        "INSERT INTO advices (advice_hash, body) VALUES ($1, $2) ON CONFLICT (advice_hash) DO NOTHING";

    /// With the advice that the recommendation gives.
    pub(crate) fn of(issued: &IssuedRecommendation, advice: Advice) -> StoreResult<Self> {
        let recommendation = &issued.recommendation;
        let level = recommendation.level.as_ref();
        let level_float = |name, part: fn(&Level) -> f64| {
            level.map(|level| level_number(name, -MOST_LEVEL, part(level))).transpose()
        };
        let sd = level.and_then(|level| level.sd);
        let remaining = recommendation.remaining.as_ref();
        let remaining_count = |name, part: fn(&Remaining) -> u64| {
            remaining.map(|remaining| count(name, part(remaining))).transpose()
        };
        if recommendation.data_age_ms.is_some_and(|age| age < 0) {
            return Err(out_of_range("data_age_ms"));
        }
        Ok(Self {
            recommendation_id: issued.id.as_str().to_owned(),
            advice,
            issued_at_us: recommendation.issued_at.micros(),
            valid_until_us: recommendation.valid_until.micros(),
            level_as_run: level_float("level_as_run", |level| level.as_run)?,
            level_lowest: level_float("level_lowest", |level| level.lowest)?,
            level_highest: level_float("level_highest", |level| level.highest)?,
            level_n: level.map(|level| i64::from(level.n)),
            level_window: level.map(|level| i64::from(level.window)),
            remaining_cycles: remaining_count("remaining_cycles", |remaining| remaining.cycles)?,
            remaining_low: remaining_count("remaining_low", |remaining| remaining.low)?,
            remaining_high: remaining_count("remaining_high", |remaining| remaining.high)?,
            data_age_ms: recommendation.data_age_ms,
            level_decides: level.and_then(|level| level.decides).map(LevelBasis::as_str),
            level_value: level_float("level_value", |level| level.value)?,
            level_sd: sd.map(|sd| level_number("level_sd", 0.0, sd)).transpose()?,
            machine_id: recommendation.machine.as_str().to_owned(),
            operation_id: recommendation.operation.as_str().to_owned(),
            tool_id: recommendation.tool.as_str().to_owned(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_is_neither_empty_nor_too_long() {
        let cycle = CycleRow::default();
        // Zeros that nobody looks at take no memory.
        let longest = vec![0; MOST_BLOCK_BYTES + 1];
        for (block, fits) in
            [(&longest[..0], false), (&longest[..1], true), (&longest[1..], true), (&longest[..], false)]
        {
            match BlockRow::of(&cycle, block) {
                Ok(_) => assert!(fits, "{}", block.len()),
                Err(StoreError::Refused { constraint }) if !fits => {
                    assert_eq!(constraint, "cycle_samples_block_length");
                }
                Err(other) => panic!("{}: {other:?}", block.len()),
            }
        }
    }

    #[test]
    fn a_number_of_a_level_is_in_its_range() {
        for (least, value, fits) in [
            (-MOST_LEVEL, -MOST_LEVEL, true),
            (-MOST_LEVEL, MOST_LEVEL, true),
            (-MOST_LEVEL, MOST_LEVEL.next_up(), false),
            (-MOST_LEVEL, -MOST_LEVEL.next_up(), false),
            (0.0, -0.0, true),
            (0.0, -1e-9, false),
            (0.0, f64::NAN, false),
        ] {
            assert_eq!(level_number("level_sd", least, value).is_ok(), fits, "{least} {value}");
        }
    }
}
