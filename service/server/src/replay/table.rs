//! A recording's rows: only the columns that the mapping names, with the line of each for messages.

use super::ReplayError;
use std::collections::{BTreeMap, BTreeSet};

/// Rows that one file may hold; more than a week at 10 Hz is a mistake, and memory is bounded by it.
pub const MAX_ROWS: usize = 10_000_000;

/// Columns of one file.
#[derive(Debug)]
pub struct Table {
    file: String,
    columns: BTreeMap<String, Vec<String>>,
    rows: usize,
    /// Where each row begins.
    lines: Vec<u64>,
}

impl Table {
    /// Reads the named columns of a CSV file; a missing or doubled column and a ragged row are refused.
    pub fn read(
        file: &str,
        bytes: &[u8],
        delimiter: u8,
        wanted: &BTreeSet<String>,
    ) -> Result<Self, ReplayError> {
        let refuse = |message: String| ReplayError::Recording { file: file.to_owned(), message };
        let mut reader = csv::ReaderBuilder::new().delimiter(delimiter).from_reader(bytes);
        let headers = reader.headers().map_err(|error| refuse(error.to_string()))?.clone();
        let mut places = Vec::new();
        for name in wanted {
            let mut found = headers.iter().enumerate().filter(|(_, header)| header.trim() == name.as_str());
            match (found.next(), found.next()) {
                (Some((place, _)), None) => places.push((name.clone(), place, Vec::new())),
                (None, _) => return Err(refuse(format!("has no column {name:?}"))),
                (Some(_), Some(_)) => return Err(refuse(format!("has the column {name:?} twice"))),
            }
        }
        // The reader counts line feeds, and takes a file for lines that has none of them. Looked for once: it is the whole file.
        let has_feeds = bytes.contains(&b'\n');
        let (mut rows, mut lines) = (0, Vec::new());
        for record in reader.records() {
            let record = record.map_err(|error| refuse(error.to_string()))?;
            rows += 1;
            lines.push(record.position().map_or(0, |begins| line_of(bytes, has_feeds, begins)));
            if rows > MAX_ROWS {
                return Err(refuse(format!("has more than {MAX_ROWS} rows")));
            }
            for (_, place, cells) in &mut places {
                cells.push(record.get(*place).unwrap_or_default().to_owned());
            }
        }
        let columns = places.into_iter().map(|(name, _, cells)| (name, cells)).collect();
        Ok(Self { file: file.to_owned(), columns, rows, lines })
    }

    /// How many rows there are.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// The cell of `column` in `row`, as it stands there.
    pub fn cell(&self, column: &str, row: usize) -> Result<&str, ReplayError> {
        self.columns
            .get(column)
            .and_then(|cells| cells.get(row))
            .map(|cell| cell.trim())
            .ok_or_else(|| self.refuse(row, column, "is not there"))
    }

    /// The number of `column` in `row`; empty, unreadable and non-finite cells are refused by line.
    pub fn number(&self, column: &str, row: usize) -> Result<f64, ReplayError> {
        let cell = self.cell(column, row)?;
        match cell.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => Err(self.refuse(row, column, &format!("{cell:?} is not a finite number"))),
        }
    }

    /// What is wrong with a cell, by the line in which its row begins.
    pub(super) fn refuse(&self, row: usize, column: &str, message: &str) -> ReplayError {
        let line = self.lines.get(row).copied().unwrap_or_default();
        let message = format!("line {line}, column {column:?}: {message}");
        ReplayError::Recording { file: self.file.clone(), message }
    }
}

/// The line in which a record begins: the blank lines before it are the reader's, too.
fn line_of(bytes: &[u8], has_feeds: bool, begins: &csv::Position) -> u64 {
    if !has_feeds {
        return 1 + begins.record();
    }
    let from = usize::try_from(begins.byte()).unwrap_or(usize::MAX);
    let before =
        bytes.get(from..).unwrap_or_default().iter().take_while(|byte| matches!(byte, b'\r' | b'\n'));
    begins.line() + before.filter(|byte| **byte == b'\n').count() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wanted(names: &[&str]) -> BTreeSet<String> {
        names.iter().map(|&name| name.to_owned()).collect()
    }

    #[test]
    fn reads_only_what_is_wanted_and_names_the_line() {
        let table = Table::read("f.csv", b"a,b\n1,x\n2,\n", b',', &wanted(&["a", "b"])).unwrap();
        assert_eq!(table.rows(), 2);
        assert!((table.number("a", 1).unwrap() - 2.0).abs() < 1e-12);
        let said = table.number("b", 1).unwrap_err().to_string();
        assert!(said.contains("f.csv") && said.contains("line 3"), "{said}");
    }

    #[test]
    fn names_the_line_whatever_stands_before() {
        let csv = b"a,b\n\n\"two\nlines\",1\n\nx,none\n";
        let said = Table::read("f.csv", csv, b',', &wanted(&["b"])).unwrap().number("b", 1).unwrap_err();
        assert!(said.to_string().contains("line 6,"), "{said}");
    }

    #[test]
    fn lines_that_end_in_carriage_returns_are_read_in_time() {
        // Looked through anew for each row, a file of this size takes minutes.
        let rows = 200_000;
        let mut csv = b"a".to_vec();
        (0..rows).for_each(|_| csv.extend_from_slice(b"\r1.25"));
        csv.extend_from_slice(b"\rnone");
        let table = Table::read("f.csv", &csv, b',', &wanted(&["a"])).unwrap();
        assert_eq!(table.rows(), rows + 1);
        let said = table.number("a", rows).unwrap_err().to_string();
        assert!(said.contains(&format!("line {},", rows + 2)), "{said}");
    }

    #[test]
    fn refuses_missing_and_doubled_columns_and_ragged_rows() {
        assert!(Table::read("f", b"a\n1\n", b',', &wanted(&["b"])).is_err());
        assert!(Table::read("f", b"a,a\n1,2\n", b',', &wanted(&["a"])).is_err());
        assert!(Table::read("f", b"a,b\n1\n", b',', &wanted(&["a"])).is_err());
    }
}
