//! One simulated machine: its tool wears, it drills, posts, and does what it is told.

use super::fault::Fault;
use super::report::Report;
use crate::http::dto::time;
use crate::replay::client::{Answer, Client, describe};
use anyhow::{Context, bail};
use feedwright_core::friction::noise::Noise;
use feedwright_core::friction::program::Strategy;
use feedwright_core::friction::twin::{
    CycleSample, CycleSetup, PAPER_SPINDLE_RPM, Twin, TwinParams, paper_params, typical_noise,
};
use feedwright_core::units::{self, Timestamp};
use reqwest::Method;
use secrecy::SecretString;
use serde_json::{Value, json};
use std::time::Duration;

/// Wear at which the paper's tool needs 10 % more energy at constant feed, in units of the wear law.
const WORN: f64 = 1.1;
/// Wear over [`WORN`] at which a tool is changed although nobody was told so.
const OVERDUE: f64 = 1.6;
/// How much thicker the thick sheets are, and for how many cycles.
const THICKER: (f64, u32) = (1.3, 12);
/// Cycles that are kept back before they are replayed.
const HELD: usize = 5;
/// Preferred loads of the paper's law, feed drive and spindle, %: other strategies leave them behind.
const SET_LOADS: (f64, f64) = (30.0, 40.0);
/// Depth at which a tool breaks, mm.
const BREAKS_AT_MM: f64 = 3.0;

/// What the simulated operation says of wear: tools that last longer are learnt and judged from more cycles, and a
/// reference cycle in 25 cycles of a life tells its end on time.
fn wear_settings(life: u32, reference_feed_mm_min: f64) -> Value {
    json!({
        "baseline_cycles": (life / 10).clamp(5, 60), "window_cycles": (life / 25).clamp(5, 31),
        "reference_every_cycles": (life / 25).clamp(2, 50), "reference_feed_mm_min": reference_feed_mm_min,
    })
}

/// What a machine is to do.
pub(super) struct Plan {
    pub(super) number: u32,
    pub(super) cycles: u32,
    pub(super) life: u32,
    pub(super) seed: u64,
    pub(super) begin: Timestamp,
    pub(super) cadence_ms: i64,
    pub(super) word: units::Strategy,
    pub(super) strategy: Strategy,
    /// What runs when a reference cycle is asked for: one constant feed.
    pub(super) reference: Strategy,
    pub(super) faults: Vec<Fault>,
    pub(super) fault_share: f64,
    pub(super) pause: Option<Duration>,
}

impl Plan {
    /// The machine's id.
    pub(super) fn name(&self) -> String {
        format!("sim-{}", self.number)
    }
}

/// Who talks to the server: the office registers and tells events, the machine posts its own cycles.
pub(super) struct Clients {
    office: Client,
    own: Client,
    token_id: String,
}

impl Clients {
    /// Has a token made for a machine that is registered.
    pub(super) async fn enlist(office: Client, machine: &str) -> anyhow::Result<Self> {
        let body = json!({"name": format!("simulation of {machine}"), "role": "machine", "machine": machine});
        let issued = must(&office, Method::POST, "/v1/tokens", &body).await?;
        let text = |key: &str| issued[key].as_str().with_context(|| format!("the new token has no {key}"));
        let own = office.with_token(SecretString::from(text("token")?));
        let token_id = text("id")?.to_owned();
        Ok(Self { office, own, token_id })
    }

    /// Revokes the token again.
    pub(super) async fn dismiss(self) -> anyhow::Result<()> {
        let path = format!("/v1/tokens/{}", self.token_id);
        let answer = self.office.delete(&path).await?;
        if answer.status.is_success() { Ok(()) } else { bail!("{path}: {}", answer.problem()) }
    }
}

/// Sends JSON that has to be taken.
async fn must(office: &Client, method: Method, path: &str, body: &Value) -> anyhow::Result<Value> {
    let answer = office.json(method, path, body).await?;
    if answer.status.is_success() {
        return Ok(answer.json());
    }
    bail!("{path} answers {}: {}", answer.status, answer.problem())
}

/// The machine.
pub(super) struct SimulatedMachine {
    plan: Plan,
    twin: Twin,
    thick: Twin,
    noise: Noise,
    wear: f64,
    drilled: u32,
    thick_left: u32,
    is_broken: bool,
    held: Vec<String>,
    /// The last advice: its id, and whether it asks for a reference cycle.
    advice: Option<(String, bool)>,
}

impl SimulatedMachine {
    pub(super) fn new(plan: Plan) -> anyhow::Result<Self> {
        let params = TwinParams { noise: typical_noise(), ..paper_params() };
        let mut thick = params;
        thick.sheet.thickness_mm *= THICKER.0;
        let seed = plan.seed.wrapping_mul(0x9e37_79b9).wrapping_add(u64::from(plan.number));
        Ok(Self {
            twin: Twin::new(params)?,
            thick: Twin::new(thick)?,
            noise: Noise::seeded(seed),
            wear: 0.0,
            drilled: 0,
            thick_left: 0,
            is_broken: false,
            held: Vec::new(),
            advice: None,
            plan,
        })
    }

    pub(super) const fn pause(&self) -> Option<Duration> {
        self.plan.pause
    }

    pub(super) const fn has_more(&self) -> bool {
        self.drilled < self.plan.cycles
    }

    /// Wear over that at which constant feed needs 10 % more energy.
    pub(super) fn wear(&self) -> f64 {
        self.wear / WORN
    }

    /// What is said of wear follows from the life: another life is another operation.
    fn operation(&self) -> String {
        format!("sim-bushing-{}", self.plan.life)
    }

    fn tool(&self) -> String {
        format!("sim-tool-{}", self.plan.number)
    }

    fn now(&self) -> Timestamp {
        self.plan.begin.plus_millis(self.plan.cadence_ms * i64::from(self.drilled))
    }

    /// Registers the machine with its line, its tool and the operation, and mounts the tool.
    pub(super) async fn register(&self, office: &Client) -> anyhow::Result<()> {
        let name = self.plan.name();
        let ratings = self.twin.params().machine;
        let machine = json!({
            "name": format!("Simulated friction drill {}", self.plan.number), "control": "simulated",
            "ipo_period_ms": 10,
            "spindle": {"reference": "rated_torque", "rated_power_watts": ratings.spindle_rated_power_w,
                        "base_speed_rpm": ratings.spindle_rated_rpm},
            "feed_drive": {"reference": "rated_torque", "rated_thrust_newtons": ratings.feed_rated_thrust_n},
            "limits": {"feed_min_mm_min": 1, "feed_max_mm_min": 5000,
                       "override_min_percent": 5, "override_max_percent": 200},
        });
        must(office, Method::PUT, &format!("/v1/machines/{name}"), &machine).await?;
        let slope = ratings.spindle_rated_torque_nm() / 100.0;
        // Idle load is in the drive, not in the tool: without the line it would hide the wear.
        let line = json!({"torque": {
            "slope": slope, "intercept": -slope * ratings.spindle_idle_percent, "min_percent": 0,
            "max_percent": 150, "r_squared": 1, "residual_spread": 0}});
        let path = format!("/v1/machines/{name}/calibrations");
        let known = office.get(&path).await?.json();
        if known["items"].as_array().is_none_or(Vec::is_empty) {
            must(office, Method::POST, &path, &line).await?;
        }
        let tool = json!({"name": "Simulated tool", "tool_type": "fd-7.3", "diameter_mm": 7.3});
        must(office, Method::PUT, &format!("/v1/tools/{}", self.tool()), &tool).await?;
        let operation = json!({
            "name": "Simulated bushing", "process": "friction", "thickness_mm": 2, "depth_mm": 20.5,
            "spindle_speed_rpm": PAPER_SPINDLE_RPM,
            "feed_drive_load_set_percent": SET_LOADS.0, "spindle_load_set_percent": SET_LOADS.1,
            "wear": wear_settings(self.plan.life, self.plan.reference.program.feed_at(0.0)),
        });
        must(office, Method::PUT, &format!("/v1/operations/{}", self.operation()), &operation).await?;
        self.event(office, "mounted_new", "the simulation begins").await
    }

    async fn event(&self, office: &Client, kind: &str, reason: &str) -> anyhow::Result<()> {
        let event = json!({"kind": kind, "at": time::show(self.now()), "reason": reason});
        let path = format!("/v1/tools/{}/events", self.tool());
        must(office, Method::POST, &path, &event).await.map(drop)
    }

    /// Drills one hole and posts it, with whatever fault falls due.
    pub(super) async fn cycle(&mut self, shop: &Clients, report: &mut Report) -> anyhow::Result<()> {
        let fault = self.draw();
        if let Some(fault) = fault {
            *report.faults.entry(fault.as_str()).or_insert(0) += 1;
        }
        match fault {
            Some(Fault::Thickness) => self.thick_left = THICKER.1,
            Some(Fault::BrokenTool) => self.is_broken = true,
            _ => {}
        }
        if self.advice.is_none() {
            self.ask(shop).await?;
        }
        let is_reference = self.advice.as_ref().is_some_and(|(_, reference)| *reference);
        report.reference_cycles += u64::from(is_reference);
        let body = self.drill(fault, is_reference)?;
        self.drilled += 1;
        self.wear += WORN / f64::from(self.plan.life);
        report.cycles += 1;
        match fault {
            Some(Fault::LateReplay) => {
                self.held.push(body);
                if self.held.len() < HELD { Ok(()) } else { self.replay(shop, report).await }
            }
            Some(Fault::NanBody) => {
                let name = "\"spindle_load_percent\":[";
                self.post(shop, body.replace(name, &format!("{name}NaN,")), report).await.map(drop)
            }
            Some(Fault::Duplicate) => {
                self.deliver(shop, body.clone(), report).await?;
                self.deliver(shop, body, report).await.map(drop)
            }
            _ => {
                let answer = self.deliver(shop, body, report).await?.json();
                self.heed(&answer["recommendation"]);
                self.react(shop, &answer["wear"]["state"], report).await
            }
        }
    }

    /// Asks what to run next, as a machine does before its first cycle with a tool.
    async fn ask(&mut self, shop: &Clients) -> anyhow::Result<()> {
        let path = format!(
            "/v1/recommendations?machine={}&operation={}&tool={}",
            self.plan.name(),
            self.operation(),
            self.tool()
        );
        let answer = shop.own.get(&path).await?;
        if !answer.status.is_success() {
            bail!("{path}: {}", answer.problem());
        }
        self.heed(&answer.json());
        Ok(())
    }

    fn heed(&mut self, recommendation: &Value) {
        if let Some(id) = recommendation["id"].as_str() {
            self.advice = Some((id.to_owned(), recommendation["reference_cycle"].is_object()));
        }
    }

    fn draw(&mut self) -> Option<Fault> {
        let (falls_due, which) = (self.noise.uniform(), self.noise.uniform());
        if self.plan.faults.is_empty() || falls_due >= self.plan.fault_share {
            return None;
        }
        #[expect(
            clippy::cast_precision_loss,
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a share of six faults at most"
        )]
        let index = (which * self.plan.faults.len() as f64) as usize;
        self.plan.faults.get(index).copied()
    }

    /// The body of the next cycle.
    fn drill(&mut self, fault: Option<Fault>, is_reference: bool) -> anyhow::Result<String> {
        let twin = if self.thick_left > 0 { &self.thick } else { &self.twin };
        self.thick_left = self.thick_left.saturating_sub(1);
        let setup = CycleSetup::new(PAPER_SPINDLE_RPM, self.wear);
        let (strategy, word) = if is_reference {
            (&self.plan.reference, units::Strategy::FConst)
        } else {
            (&self.plan.strategy, self.plan.word)
        };
        let (samples, _) = twin.record(strategy, &setup, Some(&mut self.noise))?;
        let machine = twin.params().machine;
        let idles_from = match fault {
            Some(Fault::AirCut) => f64::NEG_INFINITY,
            _ if self.is_broken => BREAKS_AT_MM,
            _ => f64::INFINITY,
        };
        let column = |of: &dyn Fn(&CycleSample) -> f64, decimals: i32| -> Vec<f64> {
            let scale = 10_f64.powi(decimals);
            samples.iter().map(|sample| (of(sample) * scale).round() / scale).collect()
        };
        let or_idle = |sample: &CycleSample, load: f64, idle: f64| {
            if sample.depth_mm >= idles_from { idle } else { load }
        };
        Ok(json!({
            "cycle_id": format!("{}-{:06}", self.plan.begin.micros(), self.drilled + 1),
            "tool": self.tool(), "operation": self.operation(), "seq": self.drilled + 1,
            "started_at": time::show(self.now()), "strategy": word.as_str(),
            "recommendation_id": self.advice.as_ref().map(|(id, _)| id),
            "spindle_speed_rpm": PAPER_SPINDLE_RPM,
            "samples": {
                "period_ms": 10,
                "depth_mm": column(&|s| s.depth_mm, 3),
                "feed_actual_mm_min": column(&|s| s.feed_mm_min, 1),
                "override_percent": column(&|s| s.override_percent, 1),
                "feed_drive_load_percent":
                    column(&|s| or_idle(s, s.process.feed_drive_percent, machine.feed_idle_percent), 1),
                "spindle_load_percent":
                    column(&|s| or_idle(s, s.process.spindle_percent, machine.spindle_idle_percent), 1),
            },
        })
        .to_string())
    }

    /// Posts a body that is to be taken.
    async fn deliver(&self, shop: &Clients, body: String, report: &mut Report) -> anyhow::Result<Answer> {
        let answer = self.post(shop, body, report).await?;
        if !answer.status.is_success() {
            report.refusals.count(&answer.problem());
        }
        Ok(answer)
    }

    async fn post(&self, shop: &Clients, body: String, report: &mut Report) -> anyhow::Result<Answer> {
        let path = format!("/v1/machines/{}/cycles", self.plan.name());
        let answer = shop.own.text(&path, body).await?;
        let json = answer.json();
        let outcome = match json["status"].as_str() {
            Some(outcome) => outcome.to_owned(),
            None if json["quarantine_id"].is_string() => "quarantined".to_owned(),
            None => answer.status.as_u16().to_string(),
        };
        report.count(outcome);
        Ok(answer)
    }

    /// Posts what was kept back, as a batch.
    pub(super) async fn replay(&mut self, shop: &Clients, report: &mut Report) -> anyhow::Result<()> {
        if self.held.is_empty() {
            return Ok(());
        }
        let held = std::mem::take(&mut self.held);
        let path = format!("/v1/machines/{}/cycles/batch", self.plan.name());
        let answer = shop.own.lines(&path, held.join("\n")).await?;
        if !answer.status.is_success() {
            held.iter().for_each(|_| report.refuse("refused", &answer.problem()));
            return Ok(());
        }
        for line in answer.text.lines() {
            let line: Value = serde_json::from_str(line).unwrap_or(Value::Null);
            match line["outcome"].as_str() {
                Some(taken @ ("stored" | "known")) => report.count(taken),
                other => {
                    let said = line.get("problem").and_then(describe);
                    report.refuse(other.unwrap_or("refused"), &said.unwrap_or_else(|| line.to_string()));
                }
            }
        }
        Ok(())
    }

    /// Does what the server's verdict asks for.
    async fn react(&mut self, shop: &Clients, state: &Value, report: &mut Report) -> anyhow::Result<()> {
        let why = match state.as_str() {
            Some("worn") => "worn",
            Some("broken_suspected") if self.is_broken => "broken_suspected",
            Some("changed") => {
                report.conditions_confirmed += 1;
                return self.event(&shop.office, "conditions_confirmed", "sheets of another thickness").await;
            }
            _ if self.wear >= OVERDUE * WORN => "overdue",
            _ => return Ok(()),
        };
        if why == "worn" {
            report.wear_at_change.push(self.wear());
        }
        *report.tool_changes.entry(why).or_insert(0) += 1;
        self.event(&shop.office, "changed", why).await?;
        self.wear = 0.0;
        self.is_broken = false;
        self.ask(shop).await
    }
}
