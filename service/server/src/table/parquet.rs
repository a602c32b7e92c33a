//! Apache Parquet: a row group per piece, compressed with zstd; the footer comes last, so that nothing is kept but it.

use super::{Field, Row, TableError, Writer, arrow};
use ::parquet::arrow::ArrowWriter;
use ::parquet::basic::{Compression, ZstdLevel};
use ::parquet::file::properties::WriterProperties;
use arrow_schema::SchemaRef;
use std::io::Write;
use std::sync::{Arc, Mutex, PoisonError};

/// What was written and not yet taken; the writer counts for itself how much came before.
#[derive(Debug, Clone, Default)]
struct Taken(Arc<Mutex<Vec<u8>>>);

impl Taken {
    fn take(&self) -> Vec<u8> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Write for Taken {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

pub(super) struct File {
    schema: SchemaRef,
    writer: ArrowWriter<Taken>,
    taken: Taken,
}

impl File {
    pub(super) fn new(fields: &[Field]) -> Result<Self, TableError> {
        let schema = arrow::schema(fields);
        let properties = WriterProperties::builder()
            .set_compression(Compression::ZSTD(ZstdLevel::try_new(1).map_err(TableError::form)?))
            .build();
        let taken = Taken::default();
        let writer = ArrowWriter::try_new(taken.clone(), schema.clone(), Some(properties));
        Ok(Self { schema, writer: writer.map_err(TableError::form)?, taken })
    }
}

impl Writer for File {
    fn rows(&mut self, rows: &[Row]) -> Result<Vec<u8>, TableError> {
        self.writer.write(&arrow::batch(&self.schema, rows)?).map_err(TableError::form)?;
        self.writer.flush().map_err(TableError::form)?;
        Ok(self.taken.take())
    }

    fn finish(mut self: Box<Self>) -> Result<Vec<u8>, TableError> {
        self.writer.finish().map_err(TableError::form)?;
        Ok(self.taken.take())
    }
}
