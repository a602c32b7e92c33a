//! The check of what is stored: every block decodes, every content hash is that of the content, every summary is what
//! its samples amount to, nothing stands alone.

mod context;
mod tables;

pub(super) use tables::tables;

use super::{Conn, Db, cycles, dialect, retention};
use crate::codec;
use crate::error::{StoreError, StoreResult};
use crate::record::{CheckPage, CheckedTo, EncodedCycle, NewCycle, SampleDrop, StoreFault};
use crate::rows::{CycleRow, cycle_columns, id};
use crate::stored_text::StoredText;
use context::Contexts;
use feedwright_core::cycle::{Cycle, Flag, MOST_SAMPLES};
use feedwright_core::ids::{CycleId, MachineId, ToolId};
use feedwright_core::summary::{Context, SUMMARY_VERSION, is_summarised_alike, summarise};
use feedwright_core::units::Timestamp;
use sqlx::{FromRow, Row};
use std::sync::Arc;

macro_rules! select_sql {
    ($($column:ident: $type:ty = $placeholder:literal $(in $least:literal..=$most:literal)?,)*) => {
        concat!(
            "SELECT ", $("c.", stringify!($column), ", ",)* "1 AS one FROM cycles c
             WHERE (c.machine_id, c.cycle_id) > (CAST($1 AS TEXT), CAST($2 AS TEXT))
             ORDER BY c.machine_id, c.cycle_id LIMIT $3 OFFSET $4"
        )
    };
}

/// The cycles after that key, each with its samples: what is wrong with them.
pub(super) async fn page(conn: &mut Conn, after: Option<&CheckedTo>, limit: u32) -> StoreResult<CheckPage> {
    dialect::read_as_stored(conn).await?;
    dialect::keep_partitions(conn).await?;
    let after = after.cloned().unwrap_or_default();
    let rows = sqlx::query::<Db>(cycle_columns!(select_sql))
        .bind(after.key.0.clone())
        .bind(after.key.1.clone())
        .bind(i64::from(limit))
        .bind(after.past())
        .fetch_all(&mut *conn)
        .await?;
    let mut page = CheckPage { checked: rows.len() as u64, ..CheckPage::default() };
    // Neither hash nor samples tell of what was cut off.
    page.doubt.cut_short = true;
    let (mut contexts, mut decisions) = (Contexts::default(), Decisions::default());
    let mut last = after.clone();
    for row in &rows {
        let (machine, cycle): (StoredText, StoredText) =
            (row.try_get("machine_id")?, row.try_get("cycle_id")?);
        let key = format!("{machine}/{cycle}");
        let is_sound = machine.is_sound() && cycle.is_sound();
        last.pass((machine, cycle), is_sound);
        let mut row = match CycleRow::from_row(row).map_err(StoreError::from) {
            Err(StoreError::Damaged { what }) => {
                let tool: Option<StoredText> = row.try_get("tool_id").ok();
                let tool = tool.as_ref().and_then(StoredText::as_str);
                page.doubt.tools.extend(tool.and_then(|tool| ToolId::try_from(tool).ok()));
                page.faults.push(StoreFault { kind: "cycle", key, detail: what, column: None });
                continue;
            }
            row => row?,
        };
        let tool = row.tool_id.clone();
        let of = (row.machine_id.clone(), row.tool_id.clone());
        let of = move || {
            Ok::<_, StoreError>((id::<MachineId>("machine_id", &of.0)?, id::<ToolId>("tool_id", &of.1)?))
        };
        if row.rests_on_cut_short() {
            page.doubt.unproven.extend(of());
        }
        let mut fault = |kind, detail: String| {
            // Lost samples leave what was made of them, and nothing that it could be held against.
            if kind == "samples" {
                page.doubt.unproven.extend(of());
            } else {
                page.doubt.tools.extend(id::<ToolId>("tool_id", &tool));
            }
            page.faults.push(StoreFault { kind, key: key.clone(), detail, column: None });
        };
        let (Ok(machine), Ok(cycle)) =
            (id::<MachineId>("machine_id", &row.machine_id), id::<CycleId>("cycle_id", &row.cycle_id))
        else {
            fault("cycle", "its key is no identifier".to_owned());
            continue;
        };
        if row.is_flagged(Flag::CutShort) && !row.is_flagged(Flag::Incomplete) {
            fault(
                "summary",
                "it is flagged cut_short, and not incomplete, as what was cut short is".to_owned(),
            );
        }
        let block = match dialect::block_as_told(conn, &machine, &cycle).await {
            Err(StoreError::Damaged { what }) => {
                fault("samples", what);
                continue;
            }
            block => block?,
        };
        if let Some((block, Some(told))) = &block
            && usize::try_from(*told).ok() != Some(block.len())
        {
            fault("samples", format!("they are told to take {told} bytes, and take {}", block.len()));
        }
        let dropped = block.is_none() && row.sample_count > 0;
        if dropped {
            let received = Timestamp::from_micros(row.received_at_us);
            match decisions.name(conn, &machine, (&cycle, received)).await {
                Ok(true) => {
                    page.dropped += 1;
                    page.doubt.unproven.extend(of());
                }
                Ok(false) => fault("samples", "they are missing, and no retention dropped them".to_owned()),
                Err(StoreError::Damaged { what }) => {
                    fault(
                        "samples",
                        format!("they are missing, and what retention dropped cannot be read: {what}"),
                    );
                }
                Err(error) => return Err(error),
            }
            continue;
        }
        let samples = match block.map(|(block, _)| codec::decode_samples(&block, MOST_SAMPLES)).transpose() {
            Ok(samples) => samples,
            Err(error) => {
                fault("samples", error.to_string());
                continue;
            }
        };
        let found = samples.as_ref().map_or(0, |samples| samples.len() as u64);
        if i64::try_from(found).ok() != Some(row.sample_count) {
            fault(
                "samples",
                format!("the summary counts {} samples, the block holds {found}", row.sample_count),
            );
        }
        let cut = match cycles::cut(conn, &machine, &cycle).await {
            Err(error @ StoreError::Damaged { .. }) => {
                fault("cut", error.to_string());
                continue;
            }
            cut => cut?,
        };
        let cycle = match row.cycle(samples, cut) {
            Ok(cycle) => cycle,
            Err(error) => {
                fault("cycle", error.to_string());
                continue;
            }
        };
        let hash = match row.hash() {
            Ok(hash) if codec::is_hash_of(&hash, &cycle) => hash,
            _ => {
                fault("hash", "the content hash is not that of the content".to_owned());
                continue;
            }
        };
        match summary(conn, &mut contexts, &mut row, (cycle, hash)).await {
            Ok(Summary::Holds) => {}
            Ok(Summary::Unproven) => page.doubt.unproven.extend(of()),
            Ok(Summary::Unverified) => {
                page.unverified += 1;
                page.doubt.unproven.extend(of());
            }
            Ok(Summary::Differs(what)) => fault("summary", what),
            Err(StoreError::Damaged { what }) => fault("summary", what),
            Err(error) => return Err(error),
        }
    }
    if rows.len() == limit as usize {
        if last > after {
            page.next = Some(last);
        } else {
            // Its index says otherwise than the table: there would be no end.
            let (key, detail) =
                ("cycles".to_owned(), "its rows cannot be gone through by their key".to_owned());
            page.faults.push(StoreFault { kind: "table", key, detail, column: None });
        }
    }
    Ok(page)
}

/// What retention decided on the samples of the machine that was asked for last: on a page stand the cycles of one behind those of another.
#[derive(Default)]
struct Decisions(Option<(MachineId, Vec<SampleDrop>)>);

impl Decisions {
    /// Whether samples of a cycle of that receipt are gone by one of them, or by its name.
    async fn name(
        &mut self,
        conn: &mut Conn,
        machine: &MachineId,
        (cycle, received): (&CycleId, Timestamp),
    ) -> StoreResult<bool> {
        let decisions = match self.0.take() {
            Some((of, known)) if of == *machine => known,
            _ => retention::drops(conn, machine).await?,
        };
        let (_, decisions) = self.0.insert((machine.clone(), decisions));
        let gone = retention::gone::by(conn, machine, decisions, &[(cycle.clone(), received)]).await?;
        Ok(gone.contains_key(cycle))
    }
}

/// What a stored summary is beside one made again.
enum Summary {
    Holds,
    /// Other rules, or another machine or operation, than when it was made: only what rests on the samples alone was held.
    Unverified,
    /// It is, but for a flag that nothing says anything of.
    Unproven,
    Differs(String),
}

/// Makes the summary of a cycle again, and holds the stored one against it.
async fn summary(
    conn: &mut Conn,
    contexts: &mut Contexts,
    row: &mut CycleRow,
    (cycle, hash): (Cycle, [u8; 32]),
) -> StoreResult<Summary> {
    row.readable()?;
    if row.summary_version > i64::from(SUMMARY_VERSION) {
        let what = format!("its summary is of version {}, later than this program's", row.summary_version);
        return Ok(Summary::Differs(what));
    }
    if !u32::try_from(row.summary_version).is_ok_and(|version| is_summarised_alike(version, &cycle)) {
        return Ok(Summary::Unverified);
    }
    let known = contexts.of(conn, row, &cycle).await?;
    let (machine, calibration, operation) = (known.machine(), known.calibration(), known.operation());
    let summary = summarise(&cycle, Context { machine, calibration, operation });
    let same = known.same;
    let received_at = Timestamp::from_micros(row.received_at_us);
    let again = NewCycle {
        cycle: Arc::new(cycle),
        received_at,
        encoded: EncodedCycle { hash, samples: None },
        summary,
        generation: None,
        cut_short: false,
    };
    let mut again = CycleRow::of(&again, &again.summary)?;
    let differing = row.differing(&mut again, same);
    if !differing.is_empty() {
        let told =
            differing.iter().map(|it| format!("{} is {} instead of {}", it.column, it.stored, it.again));
        let told = told.collect::<Vec<_>>().join(", ");
        return Ok(Summary::Differs(format!("it is not what the cycle amounts to: {told}")));
    }
    let is_unproven = row.may_be_cut_unsaid() && !again.is_flagged(Flag::Incomplete);
    Ok(match () {
        () if !same => Summary::Unverified,
        () if is_unproven => Summary::Unproven,
        () => Summary::Holds,
    })
}
