//! `feedwright twin --stdio`: the process model in step with another program, line by line.
//!
//! A line is one JSON object and is answered by one: loads for a step, the state for a new hole, an error for
//! whatever is neither, which changes nothing. docs/friction.md describes the lines.

use crate::http::dto::friction::model::{Model, ModelBody, located};
use crate::http::dto::friction::refused;
use anyhow::{Context, anyhow};
use clap::Args;
use feedwright_core::friction::noise::Noise;
use feedwright_core::friction::twin::{TwinInput, TwinState};
use feedwright_core::invalid::Violation;
use serde::{Deserialize, Serialize};
use std::io::{BufRead, ErrorKind, Read, Write};
use std::path::PathBuf;

/// Longest line, bytes: a step takes a hundred; what is longer was never meant for this.
const MOST_LINE_BYTES: u64 = 64 * 1024;

/// Longest model file, bytes: it holds about fifty numbers.
const MOST_FILE_BYTES: u64 = 256 * 1024;

/// Arguments of the command.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Read steps from standard input and answer on standard output; the only way there is.
    #[arg(long, required = true)]
    stdio: bool,
    /// A JSON file with machine, tool, operation and noise, as `model` of a simulation; the paper's where it is left out.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Wear of the tool, in units of the wear law; over the file's.
    #[arg(long)]
    wear: Option<f64>,
    /// Adds noise that follows this seed; without it there is none.
    #[arg(long)]
    seed: Option<u64>,
}

/// A step, or the start of a new hole.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    depth_mm: Option<f64>,
    feed_mm_min: Option<f64>,
    spindle_rpm: Option<f64>,
    dt_s: Option<f64>,
    new_hole: Option<NewHole>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct NewHole {
    wear: Option<f64>,
}

#[derive(Debug, Serialize)]
#[serde(untagged)]
enum Answer {
    Loads {
        line: u64,
        thrust_n: f64,
        torque_nm: f64,
        feed_drive_percent: f64,
        spindle_percent: f64,
        temperature_rise_k: f64,
        power_w: f64,
        energy_j: f64,
    },
    NewHole {
        line: u64,
        new_hole: Started,
    },
    Error {
        line: u64,
        error: LineError,
    },
}

#[derive(Debug, Serialize)]
struct Started {
    wear: f64,
}

#[derive(Debug, Serialize)]
struct LineError {
    code: &'static str,
    path: String,
    message: String,
}

impl From<Violation> for LineError {
    fn from(violation: Violation) -> Self {
        Self { code: violation.code, path: violation.path, message: violation.message }
    }
}

/// Runs until standard input ends.
pub async fn run(arguments: Arguments) -> anyhow::Result<()> {
    // Reading from a pipe blocks; the runtime's own threads must not.
    tokio::task::spawn_blocking(move || {
        let mut driven = Driven::new(&arguments)?;
        let (input, output) = (std::io::stdin().lock(), std::io::stdout().lock());
        match driven.serve(input, output) {
            // The other program went away: there is nobody left to tell.
            Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
            other => Ok(other?),
        }
    })
    .await?
}

fn model(arguments: &Arguments) -> anyhow::Result<Model> {
    let body = match &arguments.model {
        None => ModelBody::default(),
        Some(path) => {
            let file =
                std::fs::File::open(path).with_context(|| format!("cannot read {}", path.display()))?;
            let mut text = String::new();
            file.take(MOST_FILE_BYTES).read_to_string(&mut text)?;
            serde_json::from_str(&text).with_context(|| format!("{} is no model", path.display()))?
        }
    };
    body.into_model(arguments.seed.is_some()).map_err(|violation| anyhow!("{violation}"))
}

/// The model with the state of the hole that is drilled.
struct Driven {
    model: Model,
    noise: Option<Noise>,
    wear: f64,
    state: TwinState,
}

impl Driven {
    fn new(arguments: &Arguments) -> anyhow::Result<Self> {
        let model = model(arguments)?;
        let wear = arguments.wear.unwrap_or(model.setup.wear);
        let state = TwinState::new(wear).map_err(|error| anyhow!("--{error}"))?;
        let mut driven = Self { model, noise: arguments.seed.map(Noise::seeded), wear, state };
        driven.state = driven.piece(driven.state);
        Ok(driven)
    }

    /// The hole in a piece of material as strong as the noise makes it.
    fn piece(&mut self, state: TwinState) -> TwinState {
        let spread = self.model.twin.params().noise.cycle;
        match &mut self.noise {
            Some(noise) if spread > 0.0 => state.with_strength(1.0 + spread * noise.normal()),
            _ => state,
        }
    }

    fn serve(&mut self, mut input: impl BufRead, mut output: impl Write) -> std::io::Result<()> {
        let mut bytes = Vec::new();
        for line in 1.. {
            bytes.clear();
            if (&mut input).take(MOST_LINE_BYTES).read_until(b'\n', &mut bytes)? == 0 {
                break;
            }
            let is_cut = bytes.len() as u64 == MOST_LINE_BYTES && !bytes.ends_with(b"\n");
            let answer = if is_cut {
                skip_line(&mut input)?;
                let text = format!("a line may have at most {MOST_LINE_BYTES} bytes");
                Err(LineError { code: "line_too_long", path: String::new(), message: text })
            } else {
                self.answer(line, &bytes)
            };
            let answer = answer.unwrap_or_else(|error| Answer::Error { line, error });
            serde_json::to_writer(&mut output, &answer)?;
            output.write_all(b"\n")?;
            // Whoever drives in step waits for this very line.
            output.flush()?;
        }
        Ok(())
    }

    fn answer(&mut self, number: u64, bytes: &[u8]) -> Result<Answer, LineError> {
        let line: Line = serde_json::from_slice(bytes).map_err(|error| LineError {
            code: if error.is_data() { "invalid_line" } else { "malformed_json" },
            path: String::new(),
            message: error.to_string(),
        })?;
        if let Some(new_hole) = &line.new_hole {
            return self.new_hole(number, &line, new_hole);
        }
        let need = |field: &'static str, value: Option<f64>| {
            value.ok_or_else(|| LineError::from(Violation::new(field, "missing_field", "is required")))
        };
        let input = TwinInput {
            depth_mm: need("depth_mm", line.depth_mm)?,
            feed_mm_min: need("feed_mm_min", line.feed_mm_min)?,
            spindle_rpm: need("spindle_rpm", line.spindle_rpm)?,
            dt_s: need("dt_s", line.dt_s)?,
        };
        let stepped = self.model.twin.step(&mut self.state, &input, self.noise.as_mut());
        let loads = stepped.map_err(|error| LineError::from(refused(&error, str::to_owned)))?;
        Ok(Answer::Loads {
            line: number,
            thrust_n: loads.thrust_n,
            torque_nm: loads.torque_nm,
            feed_drive_percent: loads.feed_drive_percent,
            spindle_percent: loads.spindle_percent,
            temperature_rise_k: loads.temperature_rise_k,
            power_w: loads.power_w,
            energy_j: loads.energy_j,
        })
    }

    fn new_hole(&mut self, number: u64, line: &Line, new_hole: &NewHole) -> Result<Answer, LineError> {
        let step = [line.depth_mm, line.feed_mm_min, line.spindle_rpm, line.dt_s];
        if step.iter().any(Option::is_some) {
            let text = "a new hole and a step are two lines";
            return Err(Violation::new("new_hole", "contradictory", text).into());
        }
        let wear = new_hole.wear.unwrap_or(self.wear);
        let state = TwinState::new(wear).map_err(|error| {
            let violation = located(&error);
            LineError::from(Violation { path: "new_hole.wear".to_owned(), ..violation })
        })?;
        self.wear = wear;
        self.state = self.piece(state);
        Ok(Answer::NewHole { line: number, new_hole: Started { wear } })
    }
}

/// Reads past the end of a line without keeping it.
fn skip_line(input: &mut impl BufRead) -> std::io::Result<()> {
    loop {
        let available = input.fill_buf()?;
        if available.is_empty() {
            return Ok(());
        }
        if let Some(end) = available.iter().position(|byte| *byte == b'\n') {
            input.consume(end + 1);
            return Ok(());
        }
        let length = available.len();
        input.consume(length);
    }
}
