//! `feedwright twin --stdio` as a process of its own.

use super::number;
use crate::http::commands::binary;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

struct Driven {
    child: Child,
    to: Option<ChildStdin>,
    from: BufReader<ChildStdout>,
}

impl Driven {
    fn start(arguments: &[&str]) -> Self {
        let mut command = Command::new(binary());
        command.args(["twin", "--stdio"]).args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let (to, from) = (child.stdin.take(), BufReader::new(child.stdout.take().unwrap()));
        Self { child, to, from }
    }

    /// One line in, one line out, before the next: in step.
    fn ask(&mut self, line: &str) -> Value {
        writeln!(self.to.as_mut().unwrap(), "{line}").unwrap();
        let mut answer = String::new();
        self.from.read_line(&mut answer).unwrap();
        serde_json::from_str(&answer).unwrap()
    }

    fn step(&mut self, depth_mm: f64) -> Value {
        let line = json!({"depth_mm": depth_mm, "feed_mm_min": 120, "spindle_rpm": 2800, "dt_s": 0.01});
        self.ask(&line.to_string())
    }

    fn end(mut self) {
        self.to = None;
        assert!(self.child.wait().unwrap().success());
    }
}

#[test]
fn another_program_is_driven_in_step_and_a_bad_line_changes_nothing() {
    let mut twin = Driven::start(&[]);
    let mut energy = 0.0;
    let first = twin.step(1.0);
    assert_eq!(first["line"], 1);
    for k in 2..=100 {
        let answer = twin.step(f64::from(k) * 0.02);
        assert_eq!(answer["line"], k);
        energy += number(&answer["energy_j"]);
    }
    assert!(energy > 0.0);
    for (bad, code, path) in [
        ("{", "malformed_json", ""),
        ("", "malformed_json", ""),
        ("[1]", "invalid_line", ""),
        (r#"{"depth_mm": 1}"#, "missing_field", "feed_mm_min"),
        (r#"{"depth": 1}"#, "invalid_line", ""),
        (r#"{"depth_mm": 1e9, "feed_mm_min": 1, "spindle_rpm": 1, "dt_s": 1}"#, "out_of_range", "depth_mm"),
        (r#"{"depth_mm": 1, "feed_mm_min": 1, "spindle_rpm": 1, "dt_s": 0}"#, "out_of_range", "dt_s"),
        (r#"{"new_hole": {"wear": -1}}"#, "out_of_range", "new_hole.wear"),
        (r#"{"new_hole": {}, "dt_s": 1}"#, "contradictory", "new_hole"),
    ] {
        let answer = twin.ask(bad);
        assert_eq!(
            (&answer["error"]["code"], &answer["error"]["path"]),
            (&json!(code), &json!(path)),
            "{bad}"
        );
    }
    let long = format!("{{\"depth_mm\": {}}}", "1".repeat(70_000));
    assert_eq!(twin.ask(&long)["error"]["code"], "line_too_long");
    assert_eq!(twin.ask(r#"{"new_hole": {"wear": 0}}"#)["new_hole"]["wear"], 0.0);
    let again = twin.step(1.0);
    for field in ["thrust_n", "torque_nm", "spindle_percent"] {
        assert_eq!(again[field], first[field], "a new hole begins as the first did");
    }
    twin.end();
}

#[test]
fn the_same_seed_gives_the_same_lines_and_a_bad_model_is_refused() {
    let lines = || {
        let mut twin = Driven::start(&["--seed", "5", "--wear", "0.5"]);
        let lines: Vec<Value> = (1..20).map(|k| twin.step(f64::from(k) * 0.3)).collect();
        twin.end();
        lines
    };
    assert_eq!(lines(), lines());
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("model.json");
    std::fs::write(&file, r#"{"operation": {"sheet": {"thickness_mm": -1}}}"#).unwrap();
    let refused = Command::new(binary()).args(["twin", "--stdio", "--model"]).arg(&file).output().unwrap();
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(!refused.status.success() && said.contains("operation.sheet.thickness_mm"), "{said}");
}
