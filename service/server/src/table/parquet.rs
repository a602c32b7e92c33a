//! Apache Parquet: row groups of many pieces, compressed with zstd; the footer comes last, so that nothing is kept but
//! it and the row group that is being filled.

use super::{Field, Row, TableError, Writer, arrow};
use ::parquet::arrow::ArrowWriter;
use ::parquet::basic::{Compression, ZstdLevel};
use ::parquet::file::properties::{EnabledStatistics, WriterProperties};
use arrow_schema::SchemaRef;
use std::io::Write;
use std::sync::{Arc, Mutex, PoisonError};

/// Rows of a row group. The footer tells of every column of every group, some hundred bytes each, and is kept to the
/// end: ten million rows are 611 groups.
const GROUP_ROWS: usize = 16_384;
/// What a row group that is being filled may take, bytes, however long its texts are.
const GROUP_BYTES: usize = 2 << 20;

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
            .set_max_row_group_row_count(Some(GROUP_ROWS))
            // Of pages they would be kept to the end too.
            .set_statistics_enabled(EnabledStatistics::Chunk)
            .build();
        let taken = Taken::default();
        let writer = ArrowWriter::try_new(taken.clone(), schema.clone(), Some(properties));
        Ok(Self { schema, writer: writer.map_err(TableError::form)?, taken })
    }
}

impl Writer for File {
    fn rows(&mut self, rows: &[Row]) -> Result<Vec<u8>, TableError> {
        self.writer.write(&arrow::batch(&self.schema, rows)?).map_err(TableError::form)?;
        if self.writer.memory_size() > GROUP_BYTES {
            self.writer.flush().map_err(TableError::form)?;
        }
        Ok(self.taken.take())
    }

    fn finish(mut self: Box<Self>) -> Result<Vec<u8>, TableError> {
        self.writer.finish().map_err(TableError::form)?;
        Ok(self.taken.take())
    }
}
