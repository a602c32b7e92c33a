use super::{Cell, Field, Format, Kind, Row, writer};
use ::parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use arrow_array::cast::AsArray;
use arrow_array::types::{Float64Type, Int64Type, TimestampMicrosecondType};
use arrow_array::{Array, RecordBatch};
use arrow_ipc::reader::StreamReader;
use std::sync::Arc;

fn fields() -> Arc<[Field]> {
    [
        Field::new("time", Kind::Time),
        Field::new("machine", Kind::Text),
        Field::float("energy_joules", "J"),
        Field::new("count", Kind::Whole),
        Field::new("has_samples", Kind::Truth),
    ]
    .into()
}

/// Two pieces, with what each form could spoil: a fraction of a second, separators, quotes, a gap, 0.1 + 0.2.
fn pieces() -> [Vec<Row>; 2] {
    let text = |text: &str| Cell::from(text.to_owned());
    let row = |us, machine: &str, joules: Option<f64>, count| {
        vec![Cell::Time(us), text(machine), joules.into(), Cell::Whole(count), Cell::Truth(count > 0)]
    };
    [
        vec![row(1_777_874_400_250_000, "M,1", Some(0.1 + 0.2), 1), row(-1, "say \"M2\"", None, 0)],
        vec![row(1_777_874_460_000_000, "Fräse\r\n3", Some(-1e-7), i64::MIN)],
    ]
}

fn written(format: Format) -> Vec<u8> {
    let mut writer = writer(format, &fields()).unwrap();
    let mut bytes = Vec::new();
    for rows in pieces() {
        bytes.extend(writer.rows(&rows).unwrap());
    }
    bytes.extend(writer.finish().unwrap());
    bytes
}

#[test]
fn csv_is_rfc_4180() {
    let text = String::from_utf8(written(Format::Csv)).unwrap();
    assert_eq!(
        text,
        "time,machine,energy_joules,count,has_samples\r\n\
         2026-05-04T06:00:00.250000Z,\"M,1\",0.30000000000000004,1,true\r\n\
         1969-12-31T23:59:59.999999Z,\"say \"\"M2\"\"\",,0,false\r\n\
         2026-05-04T06:01:00.000000Z,\"Fräse\r\n3\",-0.0000001,-9223372036854775808,false\r\n"
    );
}

#[test]
fn json_holds_the_same_numbers() {
    let json: serde_json::Value = serde_json::from_slice(&written(Format::Json)).unwrap();
    let items = json["items"].as_array().unwrap();
    assert_eq!(items.len(), 3);
    assert_eq!(items[0]["energy_joules"].as_f64(), Some(0.1 + 0.2));
    assert_eq!(items[0]["time"], "2026-05-04T06:00:00.250000Z");
    assert_eq!(
        (items[1]["machine"].as_str(), items[1]["energy_joules"].is_null()),
        (Some("say \"M2\""), true)
    );
    let empty = writer(Format::Json, &fields()).unwrap().finish().unwrap();
    assert_eq!(
        serde_json::from_slice::<serde_json::Value>(&empty).unwrap(),
        serde_json::json!({"items": []})
    );
}

fn same(batches: &[RecordBatch]) {
    assert_eq!(batches.iter().map(RecordBatch::num_rows).sum::<usize>(), 3);
    let schema = batches[0].schema();
    assert_eq!(schema.field(2).metadata().get("unit").map(String::as_str), Some("J"));
    assert_eq!(schema.field(0).data_type().to_string(), "Timestamp(µs, \"UTC\")");
    let first = &batches[0];
    assert_eq!(first.column(0).as_primitive::<TimestampMicrosecondType>().value(1), -1);
    assert_eq!(first.column(1).as_string::<i32>().value(1), "say \"M2\"");
    assert_eq!(first.column(2).as_primitive::<Float64Type>().value(0).to_bits(), (0.1_f64 + 0.2).to_bits());
    assert!(first.column(2).is_null(1), "a gap is no zero");
    assert_eq!(first.column(3).as_primitive::<Int64Type>().value(0), 1);
    assert!(first.column(4).as_boolean().value(0));
}

#[test]
fn arrow_and_parquet_come_back_to_the_bit() {
    let bytes = written(Format::Arrow);
    let batches: Result<Vec<_>, _> = StreamReader::try_new(bytes.as_slice(), None).unwrap().collect();
    same(&batches.unwrap());

    let bytes = bytes::Bytes::from(written(Format::Parquet));
    let reader = ParquetRecordBatchReaderBuilder::try_new(bytes).unwrap();
    assert_eq!(reader.metadata().num_row_groups(), 1, "pieces are put together");
    let batches: Result<Vec<_>, _> = reader.with_batch_size(2).build().unwrap().collect();
    same(&batches.unwrap());
    // A table without rows is a table all the same.
    for format in [Format::Arrow, Format::Parquet] {
        let empty = writer(format, &fields()).unwrap().finish().unwrap();
        if format == Format::Arrow {
            assert_eq!(StreamReader::try_new(empty.as_slice(), None).unwrap().count(), 0);
        } else {
            let reader = ParquetRecordBatchReaderBuilder::try_new(bytes::Bytes::from(empty)).unwrap();
            assert_eq!(reader.metadata().file_metadata().num_rows(), 0);
        }
    }
}

#[test]
fn a_long_parquet_file_keeps_neither_many_groups_nor_a_large_one() {
    /// Rows of 60 pieces; the text of each is long and its own, so that a row group is full before it has all its rows.
    const PIECES: i64 = 60;
    const PIECE: i64 = 500;
    let mut file = writer(Format::Parquet, &fields()).unwrap();
    let mut taken: Vec<usize> = Vec::new();
    let mut bytes = Vec::new();
    for piece in 0..PIECES {
        let row = |at: i64| {
            let number = piece * PIECE + at;
            let text = format!("{number:0>128}");
            vec![Cell::Time(number), Cell::from(text), Cell::Missing, Cell::Whole(number), Cell::Truth(true)]
        };
        let more = file.rows(&(0..PIECE).map(row).collect::<Vec<Row>>()).unwrap();
        taken.push(more.len());
        bytes.extend(more);
    }
    bytes.extend(file.finish().unwrap());
    assert!(taken.iter().filter(|bytes| **bytes > 0).count() >= 2, "it leaves as it is made: {taken:?}");
    let reader = ParquetRecordBatchReaderBuilder::try_new(bytes::Bytes::from(bytes)).unwrap();
    let groups: Vec<i64> = reader.metadata().row_groups().iter().map(|group| group.num_rows()).collect();
    assert_eq!(groups.iter().sum::<i64>(), PIECES * PIECE);
    assert!(groups.len() <= 5 && groups.iter().all(|rows| *rows < 16_384), "{groups:?}");
    let numbers = reader
        .build()
        .unwrap()
        .flat_map(|batch| batch.unwrap().column(3).as_primitive::<Int64Type>().values().to_vec());
    assert!(numbers.eq(0..PIECES * PIECE), "every row once, in order");
}
