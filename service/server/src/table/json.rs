//! `{"items":[…]}`, an object per row, missing values as null.

use super::{Cell, Field, Row, TableError, Writer};
use crate::http::dto::time;
use feedwright_core::units::Timestamp;
use std::io::Write;
use std::sync::Arc;

pub(super) struct Json {
    /// `"name":` of each column, escaped.
    names: Vec<String>,
    begun: bool,
    any: bool,
}

impl Json {
    pub(super) fn new(fields: &Arc<[Field]>) -> Self {
        let name = |field: &Field| format!("{}:", serde_json::Value::from(field.name.as_ref()));
        Self { names: fields.iter().map(name).collect(), begun: false, any: false }
    }

    fn begin(&mut self, out: &mut Vec<u8>) {
        if !self.begun {
            out.extend_from_slice(br#"{"items":["#);
            self.begun = true;
        }
    }
}

impl Writer for Json {
    fn rows(&mut self, rows: &[Row]) -> Result<Vec<u8>, TableError> {
        let mut out = Vec::with_capacity(rows.len() * self.names.len() * 24);
        self.begin(&mut out);
        for row in rows {
            out.extend_from_slice(if self.any { b",\n{" } else { b"\n{" });
            self.any = true;
            for (at, (name, cell)) in self.names.iter().zip(row).enumerate() {
                if at > 0 {
                    out.push(b',');
                }
                out.extend_from_slice(name.as_bytes());
                match cell {
                    Cell::Missing => out.extend_from_slice(b"null"),
                    Cell::Time(us) => {
                        write!(out, "\"{}\"", time::show_even(Timestamp::from_micros(*us)))
                            .map_err(TableError::form)?;
                    }
                    Cell::Text(text) => serde_json::to_writer(&mut out, text).map_err(TableError::form)?,
                    Cell::Float(value) => serde_json::to_writer(&mut out, value).map_err(TableError::form)?,
                    Cell::Whole(value) => serde_json::to_writer(&mut out, value).map_err(TableError::form)?,
                    Cell::Truth(value) => serde_json::to_writer(&mut out, value).map_err(TableError::form)?,
                }
            }
            out.push(b'}');
        }
        Ok(out)
    }

    fn finish(mut self: Box<Self>) -> Result<Vec<u8>, TableError> {
        let mut out = Vec::new();
        self.begin(&mut out);
        out.extend_from_slice(b"]}\n");
        Ok(out)
    }
}
