//! What a replay came to, in plain words, and what was said of each tool beside what was measured on it.

use super::client::Client;
use super::run::{Outcome, Seen};
use super::{Plan, ReplayError};
use reqwest::StatusCode;
use serde_json::Value;
use std::fmt::Write;

/// How posting went.
pub fn summary(plan: &Plan, outcome: &Outcome) -> String {
    let seconds = outcome.elapsed.as_secs_f64();
    #[expect(clippy::cast_precision_loss, reason = "for printing")]
    let rate = outcome.posted() as f64 / seconds.max(1e-9);
    let mut text = format!(
        "{}: {} cycles posted in {seconds:.1} s ({rate:.0} per second): {} new, {} known, {} quarantined, {} refused\n",
        plan.name,
        outcome.posted(),
        outcome.new,
        outcome.known,
        outcome.quarantined,
        outcome.refused
    );
    if plan.dropped_rows > 0 {
        let _ = writeln!(text, "{} rows fill no cycle and were left out", plan.dropped_rows);
    }
    for (cycle, said) in &outcome.problems {
        let _ = writeln!(text, "  {cycle}: {said}");
    }
    let untold = outcome.quarantined + outcome.refused - outcome.problems.len();
    if untold > 0 {
        let _ = writeln!(text, "  and {untold} more");
    }
    text
}

/// Wear and recommendation of every tool, as the service tells them now.
pub async fn tools(plan: &Plan, client: &Client) -> Result<String, ReplayError> {
    // In the order in which the tools were first used, each with what it did last.
    let mut last: Vec<(&str, &str, &str)> = Vec::new();
    for cycle in &plan.cycles {
        let now = (cycle.tool.as_str(), cycle.machine.as_str(), cycle.operation.as_str());
        match last.iter_mut().find(|(tool, _, _)| *tool == now.0) {
            Some(known) => *known = now,
            None => last.push(now),
        }
    }
    let mut text = String::new();
    for (tool, machine, operation) in last {
        let path = format!("/v1/tools/{tool}/wear");
        let wear = client.get(&path).await?;
        if wear.status == StatusCode::NOT_FOUND {
            let _ = writeln!(text, "{tool}: not registered");
            continue;
        }
        refuse_unless_ok(&path, wear.status, || wear.problem())?;
        let _ = writeln!(text, "{tool}: {}", wear_in_words(&wear.json()));
        let path = format!("/v1/recommendations?machine={machine}&operation={operation}&tool={tool}");
        let advice = client.get(&path).await?;
        refuse_unless_ok(&path, advice.status, || advice.problem())?;
        let _ = writeln!(text, "    next: {}", advice_in_words(&advice.json()));
    }
    Ok(text)
}

fn refuse_unless_ok(path: &str, status: StatusCode, said: impl Fn() -> String) -> Result<(), ReplayError> {
    if status.is_success() {
        return Ok(());
    }
    Err(ReplayError::Refused {
        method: "GET",
        path: path.to_owned(),
        status: status.as_u16(),
        detail: said(),
    })
}

/// State and reasons, with the remaining cycles where they can be told.
pub fn wear_in_words(wear: &Value) -> String {
    let mut said = wear["state"].as_str().unwrap_or("unknown").replace('_', " ");
    for reason in wear["reasons"].as_array().into_iter().flatten() {
        let _ = write!(said, "; {}", reason["message"].as_str().unwrap_or_default());
    }
    if let Some(cycles) = wear["remaining"]["cycles"].as_u64() {
        let end = |key: &str| wear["remaining"][key].as_u64().unwrap_or(cycles);
        let _ = write!(said, "; about {cycles} cycles left ({} to {})", end("low"), end("high"));
    }
    said
}

/// Action, feed and override.
pub fn advice_in_words(advice: &Value) -> String {
    let mut said = match advice["action"].as_str() {
        Some("run") => "run on".to_owned(),
        Some("change_tool") => "change the tool".to_owned(),
        Some("check_tool") => "look at the tool before the next cycle".to_owned(),
        Some("confirm_conditions") => "have an engineer confirm what changed".to_owned(),
        other => other.unwrap_or("no advice").to_owned(),
    };
    match advice["feed"]["feed_mm_min"].as_f64() {
        Some(feed) => {
            let _ = write!(said, "; feed as programmed, {feed} mm/min");
        }
        None => said.push_str("; feed as programmed"),
    }
    if let Some(percent) = advice["override_percent"].as_f64() {
        let _ = write!(said, ", override {percent} %");
    }
    said
}

/// The life of one tool as it was told, cycle by cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct Life {
    /// The tool.
    pub tool: String,
    /// Cycles that were answered.
    pub cycles: usize,
    /// The reference at its first and last cycle.
    pub reference: Option<(f64, f64)>,
    /// Each state when it was first told after another: cycle count from 1, state, level, reference.
    pub turns: Vec<(usize, String, Option<f64>, Option<f64>)>,
    /// Highest level that was told.
    pub highest: Option<f64>,
    /// The reasons that were given last.
    pub reasons: String,
}

impl Life {
    /// The reference when `state` was told first.
    pub fn first(&self, state: &str) -> Option<(usize, Option<f64>)> {
        self.turns.iter().find(|turn| turn.1 == state).map(|turn| (turn.0, turn.3))
    }

    /// The state that was told last.
    pub fn last_state(&self) -> &str {
        self.turns.last().map_or("unknown", |turn| turn.1.as_str())
    }
}

/// What was said of each tool, in the order of their first cycles.
pub fn lives(seen: &[Seen]) -> Vec<Life> {
    let mut lives: Vec<Life> = Vec::new();
    for seen in seen {
        let place = lives.iter().position(|life| life.tool == seen.tool).unwrap_or_else(|| {
            lives.push(Life {
                tool: seen.tool.clone(),
                cycles: 0,
                reference: None,
                turns: Vec::new(),
                highest: None,
                reasons: String::new(),
            });
            lives.len() - 1
        });
        let life = &mut lives[place];
        life.cycles += 1;
        life.reference = seen.reference.map(|now| (life.reference.map_or(now, |(first, _)| first), now));
        if life.turns.last().is_none_or(|turn| turn.1 != seen.state) {
            life.turns.push((life.cycles, seen.state.clone(), seen.level, seen.reference));
        }
        if seen.level.is_some_and(|level| life.highest.is_none_or(|highest| level > highest)) {
            life.highest = seen.level;
        }
        life.reasons.clone_from(&seen.reasons);
    }
    lives
}

/// The lives as a table, with the reference where warning and worn were told first.
pub fn table(plan: &Plan, outcome: &Outcome) -> String {
    let (name, unit) = plan.reference.clone().unwrap_or(("no reference".to_owned(), String::new()));
    let mut text = format!("What was said of each tool beside {name} ({unit})\n");
    if outcome.seen.len() < outcome.posted() {
        let _ = writeln!(
            text,
            "{} of {} cycles were new; only they are judged below. For the whole report use an empty service.",
            outcome.seen.len(),
            outcome.posted()
        );
    }
    let measured = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.0}"));
    let told = |first: Option<(usize, Option<f64>)>| match first {
        None => "never".to_owned(),
        Some((cycle, at)) => format!("{} (cycle {cycle})", measured(at)),
    };
    let _ = writeln!(
        text,
        "{:<16} {:>6} {:>11} {:>8}  {:<18} {:<18} states in order",
        "tool", "cycles", "from..to", "highest", "warning at", "worn at"
    );
    for life in lives(&outcome.seen) {
        let span = life.reference.map_or("-".to_owned(), |(first, last)| format!("{first:.0}..{last:.0}"));
        let highest = life.highest.map_or("-".to_owned(), |level| format!("{level:.3}"));
        let states: Vec<String> = life
            .turns
            .iter()
            .map(|(cycle, state, _, at)| format!("{state}@{cycle}/{}", measured(*at)))
            .collect();
        let _ = writeln!(
            text,
            "{:<16} {:>6} {span:>11} {highest:>8}  {:<18} {:<18} {}",
            life.tool,
            life.cycles,
            told(life.first("warning")),
            told(life.first("worn")),
            states.join(" ")
        );
        let _ = writeln!(text, "{:16} {}", "", life.reasons);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn seen(tool: &str, state: &str, level: Option<f64>, reference: f64) -> Seen {
        Seen {
            tool: tool.to_owned(),
            cycle: "c".to_owned(),
            state: state.to_owned(),
            level,
            reasons: "because".to_owned(),
            reference: Some(reference),
        }
    }

    #[test]
    fn a_life_is_its_turns() {
        let lives = lives(&[
            seen("a", "learning", None, 1.0),
            seen("a", "learning", None, 2.0),
            seen("b", "unknown", None, 40.0),
            seen("a", "warning", Some(1.08), 3.0),
            seen("a", "good", Some(1.04), 4.0),
        ]);
        assert_eq!(lives.len(), 2);
        assert_eq!(lives[0].cycles, 4);
        assert_eq!(lives[0].reference, Some((1.0, 4.0)));
        assert_eq!(lives[0].first("warning"), Some((3, Some(3.0))));
        assert_eq!(lives[0].first("worn"), None);
        assert_eq!(lives[0].last_state(), "good");
        assert_eq!(lives[0].highest, Some(1.08));
    }

    #[test]
    fn words_for_wear_and_advice() {
        let wear = json!({ "state": "broken_suspected", "reasons": [{ "message": "why" }],
            "remaining": { "cycles": 7, "low": 3, "high": 20 } });
        assert_eq!(wear_in_words(&wear), "broken suspected; why; about 7 cycles left (3 to 20)");
        let advice =
            json!({ "action": "change_tool", "feed": { "feed_mm_min": null }, "override_percent": 100.0 });
        assert_eq!(advice_in_words(&advice), "change the tool; feed as programmed, override 100 %");
    }
}
