//! Tables on their way out: rows in pieces, in whatever form a client reads best, never whole in memory.
//!
//! A new form is a [`Writer`] in a file of its own and a word in [`Format`]. Where rows come from does not belong here.

mod arrow;
mod csv;
mod json;
mod parquet;

use std::borrow::Cow;
use std::sync::Arc;

/// In which form a table is answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// A JSON object with its rows as `items`.
    Json,
    /// RFC 4180, with a header.
    Csv,
    /// An Apache Arrow IPC stream.
    Arrow,
    /// An Apache Parquet file.
    Parquet,
}

impl Format {
    /// Every form; where a client likes several equally, the first of them.
    pub const ALL: [Self; 4] = [Self::Json, Self::Csv, Self::Arrow, Self::Parquet];

    /// The media type without parameters.
    pub const fn media_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Csv => "text/csv",
            Self::Arrow => "application/vnd.apache.arrow.stream",
            Self::Parquet => "application/vnd.apache.parquet",
        }
    }

    /// What `Content-Type` says.
    pub const fn content_type(self) -> &'static str {
        match self {
            Self::Csv => "text/csv; charset=utf-8; header=present",
            other => other.media_type(),
        }
    }

    /// How a file of it ends.
    pub const fn extension(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Csv => "csv",
            Self::Arrow => "arrows",
            Self::Parquet => "parquet",
        }
    }
}

/// What a column holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Microseconds since 1970 UTC; in text RFC 3339 with six digits, so that every row looks alike.
    Time,
    /// Text.
    Text,
    /// A finite number.
    Float,
    /// A whole number.
    Whole,
    /// True or false.
    Truth,
}

/// A column: the name ends in the unit where there is one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Field {
    /// Its name.
    pub name: Cow<'static, str>,
    /// What it holds.
    pub kind: Kind,
    /// Its unit in symbols, for those forms that can say it.
    pub unit: Option<&'static str>,
}

impl Field {
    /// A column without a unit.
    pub const fn new(name: &'static str, kind: Kind) -> Self {
        Self { name: Cow::Borrowed(name), kind, unit: None }
    }

    /// A number with its unit.
    pub const fn float(name: &'static str, unit: &'static str) -> Self {
        Self { name: Cow::Borrowed(name), kind: Kind::Float, unit: Some(unit) }
    }
}

/// One value; its kind is that of its column, or it is missing.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    /// Not there: null, an empty field.
    Missing,
    /// Microseconds since 1970 UTC.
    Time(i64),
    /// Text.
    Text(Cow<'static, str>),
    /// A finite number.
    Float(f64),
    /// A whole number.
    Whole(i64),
    /// True or false.
    Truth(bool),
}

impl From<Option<f64>> for Cell {
    fn from(value: Option<f64>) -> Self {
        value.map_or(Self::Missing, Self::Float)
    }
}

impl From<String> for Cell {
    fn from(text: String) -> Self {
        Self::Text(Cow::Owned(text))
    }
}

impl From<Option<&'static str>> for Cell {
    fn from(text: Option<&'static str>) -> Self {
        text.map_or(Self::Missing, |text| Self::Text(Cow::Borrowed(text)))
    }
}

/// One row, a cell per field.
pub type Row = Vec<Cell>;

/// Why a table broke off. The client sees a body without its end.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// The rows could not be read.
    #[error("the rows cannot be read")]
    Store(#[from] feedwright_store::StoreError),
    /// The rows could not be written in that form.
    #[error("the table cannot be written: {0}")]
    Form(Box<dyn std::error::Error + Send + Sync>),
}

impl TableError {
    fn form(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::Form(Box::new(error))
    }
}

/// Writes a table piece by piece.
pub trait Writer: Send {
    /// The bytes that these rows add.
    fn rows(&mut self, rows: &[Row]) -> Result<Vec<u8>, TableError>;

    /// The bytes of the end.
    fn finish(self: Box<Self>) -> Result<Vec<u8>, TableError>;
}

/// Begins a table.
pub fn writer(format: Format, fields: &Arc<[Field]>) -> Result<Box<dyn Writer>, TableError> {
    Ok(match format {
        Format::Json => Box::new(json::Json::new(fields)),
        Format::Csv => Box::new(csv::Csv::new(fields)),
        Format::Arrow => Box::new(arrow::Stream::new(fields)?),
        Format::Parquet => Box::new(parquet::File::new(fields)?),
    })
}

#[cfg(test)]
mod tests;
