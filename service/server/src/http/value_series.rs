//! JSON of the last cycles' values, cycle by cycle.
//!
//! Ids have no character that JSON escapes, and neither have times: they are copied as they are. The text is that of
//! [`SeriesBody`](super::dto::series::SeriesBody) to the byte.

use super::decimal;
use super::dto::series::SeriesName;
use super::dto::time::Shower;
use super::series::group;
use crate::series::{GroupBy, Series, Value};
use serde::Serialize;
use std::io::Result;

/// What a cycle's value, time and ids take in the mean, bytes; more is asked for where ids are longer.
const USUAL_BYTES: usize = 56;

/// What stands before the columns of a series.
#[derive(Serialize)]
struct Head<'a> {
    #[serde(flatten)]
    key: SeriesName,
    #[serde(skip_serializing_if = "Option::is_none")]
    group: Option<&'a str>,
}

/// The series as `SeriesBody` would write them.
pub(super) fn json(by: GroupBy, series: &Series<Vec<Value<'_>>>) -> Result<Vec<u8>> {
    let values: usize = series.values().map(Vec::len).sum();
    let mut out = Vec::with_capacity(512 + values * USUAL_BYTES);
    out.extend_from_slice(b"{\"by\":\"");
    out.extend_from_slice(by.as_str().as_bytes());
    out.extend_from_slice(b"\",\"series\":[");
    for (at, (key, values)) in series.iter().enumerate() {
        if at > 0 {
            out.push(b',');
        }
        serde_json::to_writer(&mut out, &Head { key: key.into(), group: group(key) })?;
        // The brace that ends it comes after the columns.
        out.pop();
        let mut shower = Shower::default();
        texts(&mut out, "time", values, |out, value| {
            out.extend_from_slice(shower.show(value.point.key.0).as_bytes());
        });
        texts(&mut out, "machine", values, |out, value| {
            out.extend_from_slice(value.point.key.1.as_str().as_bytes());
        });
        texts(&mut out, "cycle_id", values, |out, value| {
            out.extend_from_slice(value.point.key.2.as_str().as_bytes());
        });
        out.extend_from_slice(b",\"value\":");
        decimal::write(&mut out, values.iter().map(|value| value.value))?;
        out.push(b'}');
    }
    out.extend_from_slice(b"]}");
    Ok(out)
}

/// A column of texts that need no escape.
fn texts<'a, 'p>(
    out: &mut Vec<u8>,
    name: &str,
    values: &'a [Value<'p>],
    mut write: impl FnMut(&mut Vec<u8>, &'a Value<'p>),
) {
    out.extend_from_slice(b",\"");
    out.extend_from_slice(name.as_bytes());
    out.extend_from_slice(b"\":[");
    let mut separator: &[u8] = b"\"";
    for value in values {
        out.extend_from_slice(separator);
        write(out, value);
        separator = b"\",\"";
    }
    out.extend_from_slice(if values.is_empty() { b"]" } else { b"\"]" });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::dto::series::{OneSeriesBody, SeriesBody, ValueSeriesBody};
    use crate::series::{Measure, SeriesKey};
    use feedwright_core::units::Timestamp;
    use feedwright_store::CyclePoint;
    use proptest::prelude::*;

    /// The body that the API describes.
    fn described(by: GroupBy, series: &Series<Vec<Value<'_>>>) -> String {
        let series = series.iter().map(|(key, values)| {
            OneSeriesBody::Cycles(ValueSeriesBody {
                key: key.into(),
                group: group(key),
                time: values,
                machine: values,
                cycle_id: values,
                value: values,
            })
        });
        let body = SeriesBody { by: by.as_str(), series: series.collect() };
        String::from_utf8(decimal::json(&body, 0).unwrap()).unwrap()
    }

    fn point() -> impl Strategy<Value = CyclePoint> {
        let id = "[A-Za-z0-9][A-Za-z0-9._:-]{0,63}";
        (any::<i64>(), 1_777_000_000_000_000_i64..1_778_000_000_000_000, any::<bool>(), id, id).prop_map(
            |(any, usual, is_usual, machine, cycle)| CyclePoint {
                key: (
                    Timestamp::from_micros(if is_usual { usual } else { any }),
                    machine.as_str().try_into().unwrap(),
                    cycle.as_str().try_into().unwrap(),
                ),
                tool: "T1".try_into().unwrap(),
                operation: "O1".try_into().unwrap(),
                energy: Vec::new(),
                peaks: None,
            },
        )
    }

    proptest! {
        #[test]
        fn the_text_is_that_of_the_body(
            points in prop::collection::vec(point(), 0..7),
            values in prop::collection::vec(prop_oneof![any::<f64>(), (0..99_999_i64).prop_map(|n| n as f64 / 10.0)], 7),
            by in prop::sample::select(GroupBy::ALL.to_vec()),
            groups in prop::collection::btree_set("[a-z]{0,4}", 0..3),
        ) {
            let values: Vec<_> =
                points.iter().zip(values).map(|(point, value)| Value { point, value }).collect();
            let bases = [None, Some(("rated_power", "included"))];
            let series: Series<_> = groups
                .into_iter()
                .flat_map(|group| bases.map(|basis| SeriesKey { measure: Measure::Energy, basis, group: group.clone() }))
                .enumerate()
                .map(|(at, key)| (key, values[at.min(values.len())..].to_vec()))
                .collect();
            let text = String::from_utf8(json(by, &series).unwrap()).unwrap();
            prop_assert_eq!(text, described(by, &series));
        }
    }
}
