//! Apache Arrow: columns of a piece, and the IPC stream of them. Units stand in the fields' metadata under `unit`.

use super::{Cell, Field, Kind, Row, TableError, Writer};
use arrow_array::{
    ArrayRef, BooleanArray, Float64Array, Int64Array, RecordBatch, StringArray, TimestampMicrosecondArray,
};
use arrow_ipc::writer::StreamWriter;
use arrow_schema::{DataType, Schema, SchemaRef, TimeUnit};
use std::collections::HashMap;
use std::sync::Arc;

pub(super) fn schema(fields: &[Field]) -> SchemaRef {
    let field = |field: &Field| {
        let kind = match field.kind {
            Kind::Time => DataType::Timestamp(TimeUnit::Microsecond, Some("UTC".into())),
            Kind::Text => DataType::Utf8,
            Kind::Float => DataType::Float64,
            Kind::Whole => DataType::Int64,
            Kind::Truth => DataType::Boolean,
        };
        let unit = field.unit.map(|unit| ("unit".to_owned(), unit.to_owned()));
        let metadata: HashMap<String, String> = unit.into_iter().collect();
        arrow_schema::Field::new(field.name.as_ref(), kind, true).with_metadata(metadata)
    };
    Arc::new(Schema::new(fields.iter().map(field).collect::<Vec<_>>()))
}

/// The rows as columns. A cell of another kind than its column's is missing.
pub(super) fn batch(schema: &SchemaRef, rows: &[Row]) -> Result<RecordBatch, TableError> {
    macro_rules! column {
        ($array:ty, $kind:path, $at:expr) => {
            Arc::new(
                rows.iter()
                    .map(|row| match row.get($at) {
                        Some($kind(value)) => Some(value.clone()),
                        _ => None,
                    })
                    .collect::<$array>(),
            ) as ArrayRef
        };
    }
    let column = |(at, field): (usize, &Arc<arrow_schema::Field>)| match field.data_type() {
        DataType::Timestamp(..) => {
            let times = rows.iter().map(|row| match row.get(at) {
                Some(Cell::Time(us)) => Some(*us),
                _ => None,
            });
            Arc::new(times.collect::<TimestampMicrosecondArray>().with_timezone("UTC")) as ArrayRef
        }
        DataType::Utf8 => column!(StringArray, Cell::Text, at),
        DataType::Float64 => column!(Float64Array, Cell::Float, at),
        DataType::Boolean => column!(BooleanArray, Cell::Truth, at),
        _ => column!(Int64Array, Cell::Whole, at),
    };
    let columns = schema.fields().iter().enumerate().map(column).collect();
    RecordBatch::try_new(schema.clone(), columns).map_err(TableError::form)
}

pub(super) struct Stream {
    schema: SchemaRef,
    writer: StreamWriter<Vec<u8>>,
}

impl Stream {
    pub(super) fn new(fields: &[Field]) -> Result<Self, TableError> {
        let schema = schema(fields);
        let writer = StreamWriter::try_new(Vec::new(), &schema).map_err(TableError::form)?;
        Ok(Self { schema, writer })
    }
}

impl Writer for Stream {
    fn rows(&mut self, rows: &[Row]) -> Result<Vec<u8>, TableError> {
        self.writer.write(&batch(&self.schema, rows)?).map_err(TableError::form)?;
        Ok(std::mem::take(self.writer.get_mut()))
    }

    fn finish(mut self: Box<Self>) -> Result<Vec<u8>, TableError> {
        self.writer.finish().map_err(TableError::form)?;
        Ok(std::mem::take(self.writer.get_mut()))
    }
}
