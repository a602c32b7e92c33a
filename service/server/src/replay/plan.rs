//! What a recording and its mapping come to: registrations and cycles, the same every time they are read.

use super::ReplayError;
use super::cut::{Piece, cut};
use super::mapping::{Mapping, Take, ValueRule};
use super::quantity::{Dimension, quantity};
use super::registration::{Registration, Registrations};
use super::table::Table;
use super::template::{Template, Values, tidy};
use super::timing::{Placed, Timeline};
use feedwright_core::cycle::Channel;
use feedwright_core::ids::{CycleId, MachineId, OperationId, ToolId};
use feedwright_core::summary::median;
use serde_json::{Map, Value, json};
use std::collections::{BTreeMap, BTreeSet};

/// Everything that a replay will tell the service, in the order of time.
#[derive(Debug)]
pub struct Plan {
    /// What the recording is called.
    pub name: String,
    /// Machines, tools and operations to register.
    pub registrations: Registrations,
    /// The cycles by the time they began.
    pub cycles: Vec<RecordedCycle>,
    /// Rows that belong to a run but fill no cycle.
    pub dropped_rows: usize,
    /// Hash over the mapping and the files: the same plan, the same ids and times.
    pub fingerprint: String,
    /// What the reference column is called and its unit, where the mapping names one.
    pub reference: Option<(String, String)>,
}

/// One cycle as it was recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedCycle {
    /// Its id.
    pub id: CycleId,
    /// The machine that ran it.
    pub machine: MachineId,
    /// The tool.
    pub tool: ToolId,
    /// The operation.
    pub operation: OperationId,
    /// When it began, µs since 1970, as recorded.
    pub started_us: i64,
    /// How long it took, µs.
    pub duration_us: i64,
    /// Commanded spindle speed, rpm.
    pub spindle_speed_rpm: Option<f64>,
    /// Whether the recording shows that it was stopped before its end.
    pub aborted: bool,
    /// When its samples were taken.
    pub time: SampleTime,
    /// Its channels.
    pub channels: Vec<(Channel, Vec<f64>)>,
    /// The reference at its end.
    pub reference: Option<f64>,
}

/// When samples were taken.
#[derive(Debug, Clone, PartialEq)]
pub enum SampleTime {
    /// One per period, ms.
    Period(f64),
    /// At these times since the start of the cycle, ms.
    Stamps(Vec<f64>),
}

impl RecordedCycle {
    /// The body of its post, with its time moved by `shift_us`.
    pub fn body(&self, shift_us: i64) -> Result<Value, ReplayError> {
        let mut samples = Map::new();
        match &self.time {
            SampleTime::Period(period_ms) => samples.insert("period_ms".to_owned(), json!(period_ms)),
            SampleTime::Stamps(times) => samples.insert("time_ms".to_owned(), json!(times)),
        };
        for (channel, values) in &self.channels {
            samples.insert(channel.as_str().to_owned(), json!(values));
        }
        let mut body = json!({
            "cycle_id": self.id.as_str(),
            "tool": self.tool.as_str(),
            "operation": self.operation.as_str(),
            "started_at": rfc3339(self.started_us.saturating_add(shift_us))?,
            "samples": samples,
        });
        if let Some(speed) = self.spindle_speed_rpm {
            body["spindle_speed_rpm"] = json!(speed);
        }
        if self.aborted {
            body["outcome"] = json!("aborted");
        }
        Ok(body)
    }
}

/// A time of day as the API writes it.
pub fn rfc3339(micros: i64) -> Result<String, ReplayError> {
    jiff::Timestamp::from_microsecond(micros)
        .map(|time| time.to_string())
        .map_err(|error| ReplayError::Mapping(format!("a time leaves the calendar: {error}")))
}

impl Plan {
    /// Reads `files` (name and content) by `mapping_text`. Files whose name has another shape are not part of it; their
    /// ending may be written in capitals, as controls and old file systems do.
    pub fn read(mapping_text: &str, files: &[(String, Vec<u8>)]) -> Result<Self, ReplayError> {
        let mapping = Mapping::parse(mapping_text)?;
        let wanted = mapping.columns();
        let delimiter = u8::try_from(mapping.delimiter).unwrap_or(b',');
        let mut named: Vec<_> =
            files.iter().filter_map(|file| Some((file, read_name(&mapping.files, &file.0)?))).collect();
        named.sort_by(|a, b| a.0.0.cmp(&b.0.0));
        if named.is_empty() {
            let message = format!("no file is named like {:?}", mapping.files.as_str());
            return Err(ReplayError::Mapping(message));
        }
        let mut hash = blake3::Hasher::new();
        hash.update(mapping_text.as_bytes());
        let mut reader = Reader {
            timeline: Timeline::new(&mapping.time).map_err(ReplayError::Mapping)?,
            mapping: &mapping,
            registrations: Registration::new(&mapping),
            cycles: Vec::new(),
            dropped_rows: 0,
        };
        for ((name, bytes), values) in named {
            hash.update(name.as_bytes())
                .update(&[0])
                .update(&(bytes.len() as u64).to_le_bytes())
                .update(bytes);
            let table = Table::read(name, bytes, delimiter, &wanted)?;
            reader.file(name, &table, &values)?;
        }
        let Reader { registrations, mut cycles, dropped_rows, .. } = reader;
        refuse_doubled_ids(&cycles)?;
        if cycles.is_empty() {
            return Err(ReplayError::Mapping("no cycle was found in the recording".to_owned()));
        }
        cycles.sort_by(|a, b| (a.started_us, &a.machine, &a.id).cmp(&(b.started_us, &b.machine, &b.id)));
        Ok(Self {
            name: mapping.name.clone(),
            registrations: registrations.finish(&cycles),
            cycles,
            dropped_rows,
            fingerprint: hash.finalize().to_hex().to_string(),
            reference: mapping.reference.map(|rule| (rule.name, rule.unit)),
        })
    }

    /// When the last cycle ends, µs since 1970, as recorded.
    pub fn end_us(&self) -> i64 {
        self.cycles.iter().map(|cycle| cycle.started_us + cycle.duration_us).max().unwrap_or_default()
    }
}

/// What the holes of `shape` hold in a file's name.
fn read_name(shape: &Template, name: &str) -> Option<Values> {
    shape.read(name).or_else(|| {
        let (stem, ending) = name.rsplit_once('.')?;
        shape.read(&format!("{stem}.{}", ending.to_ascii_lowercase()))
    })
}

fn refuse_doubled_ids(cycles: &[RecordedCycle]) -> Result<(), ReplayError> {
    let mut seen = BTreeSet::new();
    match cycles.iter().find(|cycle| !seen.insert((&cycle.machine, &cycle.id))) {
        None => Ok(()),
        Some(twice) => Err(ReplayError::Mapping(format!(
            "cycle.id: {} comes twice on machine {}; let it hold {{index}} and the file",
            twice.id, twice.machine
        ))),
    }
}

struct Reader<'a> {
    mapping: &'a Mapping,
    timeline: Timeline,
    registrations: Registration<'a>,
    cycles: Vec<RecordedCycle>,
    dropped_rows: usize,
}

impl Reader<'_> {
    fn file(&mut self, name: &str, table: &Table, values: &Values) -> Result<(), ReplayError> {
        let pieces = cut(table, &self.mapping.cut)?;
        self.dropped_rows += pieces.dropped_rows;
        let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
        for (index, piece) in pieces.pieces.iter().enumerate() {
            let mut values = values.clone();
            values.insert("file".to_owned(), stem.to_owned());
            values.insert("index".to_owned(), index.to_string());
            let cycle = self.cycle(name, table, piece, values)?;
            self.cycles.push(cycle);
        }
        self.timeline.end_file(table)
    }

    fn cycle(
        &mut self,
        file: &str,
        table: &Table,
        piece: &Piece,
        mut values: Values,
    ) -> Result<RecordedCycle, ReplayError> {
        let refuse = |message: String| ReplayError::Recording { file: file.to_owned(), message };
        values.extend(piece.label.clone());
        for (name, rule) in &self.mapping.values {
            values.insert(name.clone(), pick(table, piece, rule)?);
        }
        let rule = &self.mapping.cycle;
        let text = |template: &Template| template.fill(&values).map_err(ReplayError::Mapping);
        let id = |error: feedwright_core::invalid::Violation| refuse(error.to_string());
        let (machine, tool, operation) = (text(&rule.machine)?, text(&rule.tool)?, text(&rule.operation)?);
        self.registrations.meet(&machine, &tool, &operation).map_err(ReplayError::Mapping)?;
        let spindle_speed_rpm = match &rule.spindle_speed {
            None => None,
            Some(rule) => {
                let speeds = numbers(table, &rule.column, piece, |cell| rule.value(cell))?;
                Some(median(&speeds))
            }
        };
        let mut channels = Vec::new();
        for (name, rule) in &self.mapping.channels {
            let Some(channel) = Channel::parse(name) else { continue };
            channels.push((channel, numbers(table, &rule.column, piece, |cell| rule.value(cell))?));
        }
        let reference = match &self.mapping.reference {
            None => None,
            Some(rule) => Some(table.number(&rule.column, piece.rows.end - 1)?),
        };
        let Placed { started_us, duration_us, time } = self.timeline.place(table, &piece.rows)?;
        Ok(RecordedCycle {
            id: CycleId::parse("cycle.id", &text(&rule.id)?).map_err(id)?,
            machine: MachineId::parse("cycle.machine", &machine).map_err(id)?,
            tool: ToolId::parse("cycle.tool", &tool).map_err(id)?,
            operation: OperationId::parse("cycle.operation", &operation).map_err(id)?,
            started_us,
            duration_us,
            spindle_speed_rpm,
            aborted: piece.aborted,
            time,
            channels,
            reference,
        })
    }
}

fn numbers(
    table: &Table,
    column: &str,
    piece: &Piece,
    convert: impl Fn(f64) -> f64,
) -> Result<Vec<f64>, ReplayError> {
    piece.rows.clone().map(|row| Ok(convert(table.number(column, row)?))).collect()
}

fn pick(table: &Table, piece: &Piece, rule: &ValueRule) -> Result<String, ReplayError> {
    let mut cells = Vec::new();
    for row in piece.rows.clone() {
        let cell = tidy(table.cell(&rule.column, row)?);
        if !rule.ignore.iter().any(|ignored| tidy(ignored) == cell) {
            cells.push(cell);
        }
    }
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for cell in &cells {
        *counts.entry(cell).or_default() += 1;
    }
    let most = counts.values().copied().max();
    let taken = match rule.take {
        Take::First => cells.first(),
        Take::Last => cells.last(),
        Take::MostFrequent => cells.iter().find(|cell| counts.get(cell.as_str()).copied() == most),
    };
    // A cycle of ignored cells only takes the first of them: the file says nothing better, and the id shows it.
    match taken {
        Some(cell) => Ok(cell.clone()),
        None => Ok(tidy(table.cell(&rule.column, piece.rows.start)?)),
    }
}

/// A quantity of a registration whose holes are filled first.
pub(super) fn filled_quantity(
    template: Option<&Template>,
    values: &Values,
    dimension: Dimension,
) -> Result<Option<f64>, String> {
    template.map(|template| quantity(&template.fill(values)?, dimension)).transpose()
}

#[cfg(test)]
mod tests;
