//! The sums of rows that people registered: held page by page, and made of rows that have none.
//!
//! A row has none where it was written by a server of before the sums, or by hand: it is summed as it is. One whose sum is another is left as it
//! is, and told.

use super::{Conn, Db, dialect};
use crate::error::{StoreError, StoreResult};
use crate::row_sum::{Standing, SumPage, SummedTo};
use crate::rows::{CalibrationRow, MachineRow, ModelRow, OperationRow, SUMMED, ToolRow};
use crate::stored_text::StoredText;
use sqlx::{FromRow, Row};

/// Rows of a page: live posts wait for one that is summed.
const ROWS: i64 = 200;

type DbRow = <Db as sqlx::Database>::Row;

/// A table whose rows have sums.
struct Sums {
    /// The rows after a key, with the key as text, text and number behind their columns.
    select: &'static str,
    update: &'static str,
    /// Standing, sum and version of a row.
    held: fn(&DbRow) -> sqlx::Result<(Standing, i64, i64)>,
}

macro_rules! held {
    ($row:ty) => {
        |row| {
            let row = <$row>::from_row(row)?;
            Ok((row.standing(dialect::WRITERS), row.sum(), row.version))
        }
    };
}

/// In the order of [`SUMMED`]. Only a row that is still of the version that was read, and has no sum of it, is given one.
const TABLES: [Sums; SUMMED.len()] = [
    Sums {
        select: "SELECT machine_id, name, control, ipo_period_ms, spindle_reference, spindle_rated_power_watts,
                spindle_base_speed_rpm, feed_drive_reference, feed_drive_rated_thrust_newtons, feed_min_mm_min,
                feed_max_mm_min, override_min_percent, override_max_percent, version, updated_at_us, row_sum,
                summed_version, machine_id AS key_1, '' AS key_2, CAST(0 AS BIGINT) AS key_3
             FROM machines WHERE machine_id > CAST($1 AS TEXT) AND CAST($2 AS TEXT) = '' AND $3 = CAST(0 AS BIGINT)
             ORDER BY machine_id LIMIT $4 OFFSET $5",
        update: "UPDATE machines SET row_sum = $4, summed_version = $5
             WHERE machine_id = CAST($1 AS TEXT) AND CAST($2 AS TEXT) = '' AND $3 = CAST(0 AS BIGINT) AND version = $5
               AND (summed_version IS NULL OR summed_version < version)",
        held: held!(MachineRow),
    },
    Sums {
        select: "SELECT machine_id, version, fitted_at_us, thrust_slope, thrust_intercept, thrust_min_percent,
                thrust_max_percent, thrust_r_squared, thrust_residual_spread, torque_slope, torque_intercept,
                torque_min_percent, torque_max_percent, torque_r_squared, torque_residual_spread, row_sum, summed_version,
                machine_id AS key_1, '' AS key_2, version AS key_3
             FROM calibrations WHERE (machine_id, version) > (CAST($1 AS TEXT), $3) AND CAST($2 AS TEXT) = ''
             ORDER BY machine_id, version LIMIT $4 OFFSET $5",
        update: "UPDATE calibrations SET row_sum = $4, summed_version = $5
             WHERE machine_id = CAST($1 AS TEXT) AND CAST($2 AS TEXT) = '' AND version = $3 AND version = $5
               AND (summed_version IS NULL OR summed_version < version)",
        held: held!(CalibrationRow),
    },
    Sums {
        select: "SELECT tool_id, name, serial, tool_type, diameter_mm, version, updated_at_us, row_sum, summed_version,
                tool_id AS key_1, '' AS key_2, CAST(0 AS BIGINT) AS key_3
             FROM tools WHERE tool_id > CAST($1 AS TEXT) AND CAST($2 AS TEXT) = '' AND $3 = CAST(0 AS BIGINT)
             ORDER BY tool_id LIMIT $4 OFFSET $5",
        update: "UPDATE tools SET row_sum = $4, summed_version = $5
             WHERE tool_id = CAST($1 AS TEXT) AND CAST($2 AS TEXT) = '' AND $3 = CAST(0 AS BIGINT) AND version = $5
               AND (summed_version IS NULL OR summed_version < version)",
        held: held!(ToolRow),
    },
    Sums {
        select: "SELECT operation_id, name, process, program, feature, work_material, thickness_mm, depth_mm,
                spindle_speed_rpm, programmed_feed_mm_min, spindle_load_set_percent, feed_drive_load_set_percent,
                baseline_cycles, window_cycles, reference_every_cycles, reference_feed_mm_min, setup, version,
                updated_at_us, row_sum, summed_version, operation_id AS key_1, '' AS key_2, CAST(0 AS BIGINT) AS key_3
             FROM operations WHERE operation_id > CAST($1 AS TEXT) AND CAST($2 AS TEXT) = '' AND $3 = CAST(0 AS BIGINT)
             ORDER BY operation_id LIMIT $4 OFFSET $5",
        update: "UPDATE operations SET row_sum = $4, summed_version = $5
             WHERE operation_id = CAST($1 AS TEXT) AND CAST($2 AS TEXT) = '' AND $3 = CAST(0 AS BIGINT) AND version = $5
               AND (summed_version IS NULL OR summed_version < version)",
        held: held!(OperationRow),
    },
    Sums {
        select: "SELECT kind, model_id, body, version, updated_at_us, row_sum, summed_version, kind AS key_1,
                model_id AS key_2, CAST(0 AS BIGINT) AS key_3
             FROM models WHERE (kind, model_id) > (CAST($1 AS TEXT), CAST($2 AS TEXT)) AND $3 = CAST(0 AS BIGINT)
             ORDER BY kind, model_id LIMIT $4 OFFSET $5",
        update: "UPDATE models SET row_sum = $4, summed_version = $5
             WHERE kind = CAST($1 AS TEXT) AND model_id = CAST($2 AS TEXT) AND $3 = CAST(0 AS BIGINT) AND version = $5
               AND (summed_version IS NULL OR summed_version < version)",
        held: held!(ModelRow),
    },
];

/// As it is told beside its table.
fn shown(key: &(StoredText, StoredText, i64)) -> String {
    let mut shown = key.0.to_string();
    if key.1 != StoredText::default() {
        shown.push_str(&format!("/{}", key.1));
    }
    if key.2 != 0 {
        shown.push_str(&format!("/{}", key.2));
    }
    shown
}

/// A row that has no sum of its version: its key, the sum that it is to have, and its version.
type Unsummed = ((StoredText, StoredText, i64), i64, i64);

/// Looks at the next page of rows, and changes nothing.
pub(super) async fn page(conn: &mut Conn, after: Option<&SummedTo>) -> StoreResult<(SumPage, Vec<Unsummed>)> {
    dialect::read_as_stored(conn).await?;
    let from = after.cloned().unwrap_or_default();
    let (mut page, mut unsummed) = (SumPage::default(), Vec::new());
    let Some((table, summed)) = TABLES.get(from.table).zip(SUMMED.get(from.table)) else {
        return Ok((page, unsummed));
    };
    let rows = sqlx::query::<Db>(table.select)
        .bind(from.after.key.0.clone())
        .bind(from.after.key.1.clone())
        .bind(from.after.key.2)
        .bind(ROWS)
        .bind(from.after.past())
        .fetch_all(&mut *conn)
        .await?;
    let mut after = from.after.clone();
    for row in &rows {
        let key: (StoredText, StoredText, i64) =
            (row.try_get("key_1")?, row.try_get("key_2")?, row.try_get("key_3")?);
        let is_sound = key.0.is_sound() && key.1.is_sound();
        after.pass(key.clone(), is_sound);
        match (table.held)(row).map_err(StoreError::from) {
            Ok((Standing::Sound, ..)) => {}
            Ok((Standing::Unsummed, sum, version)) => unsummed.push((key, sum, version)),
            Ok((Standing::Damaged, ..)) | Err(StoreError::Damaged { .. }) => {
                page.damaged.push(format!("{} {}", summed.table, shown(&key)));
            }
            Err(error) => return Err(error),
        }
    }
    // An index that says otherwise than its table would have no end.
    page.next = if !rows.is_empty() && after > from.after {
        Some(SummedTo { table: from.table, after })
    } else if from.table + 1 < TABLES.len() {
        Some(SummedTo { table: from.table + 1, ..SummedTo::default() })
    } else {
        None
    };
    page.unsummed = unsummed.len() as u64;
    Ok((page, unsummed))
}

/// Looks at the page again, and sums what has no sum on it; how many rows.
pub(super) async fn sum(conn: &mut Conn, after: Option<&SummedTo>) -> StoreResult<u64> {
    let (_, unsummed) = page(conn, after).await?;
    let mut summed = 0;
    let Some(table) = TABLES.get(after.map_or(0, |after| after.table)) else { return Ok(summed) };
    for (key, sum, version) in unsummed {
        let outcome = sqlx::query::<Db>(table.update)
            .bind(key.0)
            .bind(key.1)
            .bind(key.2)
            .bind(sum)
            .bind(version)
            .execute(&mut *conn)
            .await?;
        summed += outcome.rows_affected();
    }
    Ok(summed)
}
