//! Where cycles begin and end in the rows of one file.

use super::ReplayError;
use super::mapping::{ChangeRule, CutRule, LabelRule, Short, ThresholdRule};
use super::table::Table;
use super::template::Values;
use std::ops::Range;

/// One cycle's rows, with what its label's holes held.
#[derive(Debug, Clone, PartialEq)]
pub struct Piece {
    /// The rows.
    pub rows: Range<usize>,
    /// Values of the label's holes; empty without a label.
    pub label: Values,
    /// Whether it lacks the label that a finished cycle has.
    pub aborted: bool,
}

/// What a cut gave.
#[derive(Debug, Default)]
pub struct Pieces {
    /// The cycles, in order.
    pub pieces: Vec<Piece>,
    /// Rows dropped at the end of runs because they do not fill a cycle.
    pub dropped_rows: usize,
}

/// Cuts the rows of `table` into cycles.
pub fn cut(table: &Table, rule: &CutRule) -> Result<Pieces, ReplayError> {
    let mut pieces = vec![Piece { rows: 0..table.rows(), label: Values::new(), aborted: false }];
    if let Some(label) = &rule.label {
        pieces = by_label(table, label)?;
    }
    if let Some(threshold) = &rule.threshold {
        pieces = refine(pieces, |rows| above(table, threshold, rows))?;
    }
    for change in &rule.change {
        pieces = refine(pieces, |rows| unchanged(table, change, rows))?;
    }
    let mut dropped_rows = 0;
    if let Some(size) = rule.rows {
        pieces = refine(pieces, |rows| {
            let mut parts: Vec<Range<usize>> =
                rows.clone().step_by(size).map(|start| start..rows.end.min(start + size)).collect();
            if rule.short == Short::Drop
                && let Some(last) = parts.pop_if(|last| last.len() < size)
            {
                dropped_rows += last.len();
            }
            Ok(parts)
        })?;
    }
    pieces.retain(|piece| !piece.rows.is_empty());
    Ok(Pieces { pieces, dropped_rows })
}

fn refine(
    pieces: Vec<Piece>,
    mut split: impl FnMut(Range<usize>) -> Result<Vec<Range<usize>>, ReplayError>,
) -> Result<Vec<Piece>, ReplayError> {
    let mut finer = Vec::new();
    for Piece { rows, label, aborted } in pieces {
        finer.extend(split(rows)?.into_iter().map(|rows| Piece { rows, label: label.clone(), aborted }));
    }
    Ok(finer)
}

fn by_label(table: &Table, rule: &LabelRule) -> Result<Vec<Piece>, ReplayError> {
    let mut pieces: Vec<Piece> = Vec::new();
    let mut open = false;
    for row in 0..table.rows() {
        let cell = table.cell(&rule.column, row)?;
        let Some(label) = rule.is.iter().find_map(|shape| shape.read(cell)) else {
            open = false;
            continue;
        };
        let unfinished =
            !rule.finished.is_empty() && !rule.finished.iter().any(|shape| shape.read(cell).is_some());
        match pieces.last_mut() {
            Some(last) if open && last.label == label => {
                last.rows.end = row + 1;
                last.aborted &= unfinished;
            }
            _ => pieces.push(Piece { rows: row..row + 1, label, aborted: unfinished }),
        }
        open = true;
    }
    Ok(pieces)
}

fn above(table: &Table, rule: &ThresholdRule, rows: Range<usize>) -> Result<Vec<Range<usize>>, ReplayError> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for row in rows {
        if table.number(&rule.column, row)? > rule.above {
            match runs.last_mut() {
                Some(last) if last.end == row => last.end = row + 1,
                _ => runs.push(row..row + 1),
            }
        }
    }
    runs.retain(|run| run.len() >= rule.min_rows);
    Ok(runs)
}

fn unchanged(table: &Table, rule: &ChangeRule, rows: Range<usize>) -> Result<Vec<Range<usize>>, ReplayError> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for row in rows {
        let same = match runs.last() {
            None => false,
            Some(last) => match rule.tolerance_percent {
                None => table.cell(&rule.column, row)? == table.cell(&rule.column, last.start)?,
                Some(percent) => {
                    let first = table.number(&rule.column, last.start)?;
                    (table.number(&rule.column, row)? - first).abs() <= percent / 100.0 * first.abs()
                }
            },
        };
        match runs.last_mut() {
            Some(last) if same => last.end = row + 1,
            _ => runs.push(row..row + 1),
        }
    }
    Ok(runs)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::replay::template::Template;
    use std::collections::BTreeSet;

    fn table() -> Table {
        let text = "l,s,n\nPrep,100,0\nLayer 1 Up,100,5\nLayer 1 Down,101,6\nMove,101,0\nLayer 1 Up,101,7\n\
                    Layer 2 Up,110,8\nLayer 2 Up,110,9\nLayer 2 Up,110,0\n";
        let wanted: BTreeSet<String> = ["l", "s", "n"].iter().map(|&name| name.to_owned()).collect();
        Table::read("t.csv", text.as_bytes(), b',', &wanted).unwrap()
    }

    fn rule() -> CutRule {
        CutRule { label: None, threshold: None, change: Vec::new(), rows: None, short: Short::Keep }
    }

    fn rows(rule: &CutRule) -> (Vec<Range<usize>>, usize) {
        let cut = cut(&table(), rule).unwrap();
        (cut.pieces.into_iter().map(|piece| piece.rows).collect(), cut.dropped_rows)
    }

    #[test]
    fn a_label_run_ends_at_another_label_even_when_it_comes_back() {
        let template = |text| Template::parse(text).unwrap();
        let label = LabelRule {
            column: "l".to_owned(),
            is: vec![template("Layer {layer} Up"), template("Layer {layer} Down")],
            finished: vec![template("Layer {layer} Down")],
        };
        let cut = cut(&table(), &CutRule { label: Some(label), ..rule() }).unwrap();
        let found: Vec<_> = cut.pieces.iter().map(|p| (p.rows.clone(), p.label["layer"].as_str())).collect();
        assert_eq!(found, [(1..3, "1"), (4..5, "1"), (5..8, "2")]);
        assert_eq!(cut.pieces.iter().map(|piece| piece.aborted).collect::<Vec<_>>(), [false, true, true]);
    }

    #[test]
    fn fixed_rows_start_again_at_a_change_and_leftovers_are_counted() {
        let change = vec![ChangeRule { column: "s".to_owned(), tolerance_percent: Some(2.0) }];
        let keep = CutRule { change, rows: Some(2), ..rule() };
        assert_eq!(rows(&keep), (vec![0..2, 2..4, 4..5, 5..7, 7..8], 0));
        assert_eq!(rows(&CutRule { short: Short::Drop, ..keep }), (vec![0..2, 2..4, 5..7], 2));
    }

    #[test]
    fn a_change_without_tolerance_is_any_other_text() {
        let change = vec![ChangeRule { column: "s".to_owned(), tolerance_percent: None }];
        assert_eq!(rows(&CutRule { change, ..rule() }).0, [0..2, 2..5, 5..8]);
    }

    #[test]
    fn a_threshold_keeps_what_is_long_enough() {
        let threshold = ThresholdRule { column: "n".to_owned(), above: 4.5, min_rows: 3 };
        let (found, _) = rows(&CutRule { threshold: Some(threshold), ..rule() });
        assert_eq!(found.first(), Some(&(4..7)));
        assert_eq!(found.len(), 1);
    }
}
