//! RFC 4180: a header, lines that end in CR LF, missing values as empty fields.

use super::{Cell, Field, Row, TableError, Writer};
use crate::http::dto::time;
use csv::{Terminator, WriterBuilder};
use feedwright_core::units::Timestamp;
use std::borrow::Cow;
use std::sync::Arc;

pub(super) struct Csv {
    /// Still to be written.
    header: Option<Arc<[Field]>>,
}

impl Csv {
    pub(super) fn new(fields: &Arc<[Field]>) -> Self {
        Self { header: Some(fields.clone()) }
    }

    fn lines(&mut self, rows: &[Row]) -> Result<Vec<u8>, TableError> {
        let mut writer = WriterBuilder::new().terminator(Terminator::CRLF).from_writer(Vec::new());
        if let Some(fields) = self.header.take() {
            writer
                .write_record(fields.iter().map(|field| field.name.as_bytes()))
                .map_err(TableError::form)?;
        }
        for row in rows {
            for cell in row {
                writer.write_field(text(cell).as_bytes()).map_err(TableError::form)?;
            }
            writer.write_record(None::<&[u8]>).map_err(TableError::form)?;
        }
        writer.into_inner().map_err(|error| TableError::Form(error.to_string().into()))
    }
}

fn text(cell: &Cell) -> Cow<'_, str> {
    match cell {
        Cell::Missing => Cow::Borrowed(""),
        Cell::Time(us) => Cow::Owned(time::show_even(Timestamp::from_micros(*us))),
        Cell::Text(text) => Cow::Borrowed(text),
        Cell::Float(value) => Cow::Owned(value.to_string()),
        Cell::Whole(value) => Cow::Owned(value.to_string()),
        Cell::Truth(value) => Cow::Borrowed(if *value { "true" } else { "false" }),
    }
}

impl Writer for Csv {
    fn rows(&mut self, rows: &[Row]) -> Result<Vec<u8>, TableError> {
        self.lines(rows)
    }

    fn finish(mut self: Box<Self>) -> Result<Vec<u8>, TableError> {
        self.lines(&[])
    }
}
