//! The data: cycles of a drilling shop, quantised as a control gives them, with noise.

use feedwright_core::units::Timestamp;
use feedwright_server::ingest::body;
use feedwright_store::wire;
use std::fmt::Write;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Machines of the shop; each has its own tool.
pub(crate) const MACHINES: usize = 40;
/// 2026-05-04T06:00:00Z in milliseconds.
pub(crate) const MORNING_MS: u64 = 1_777_874_400_000;

/// One cycle, as columns of text that already has the control's digits.
pub(crate) struct Cycle {
    pub(crate) machine: String,
    pub(crate) id: String,
    pub(crate) started_ms: u64,
    pub(crate) columns: [(&'static str, Vec<f64>); 8],
}

impl Cycle {
    /// Values in all its columns.
    pub(crate) fn values(&self) -> usize {
        self.columns.len() * self.samples()
    }

    /// Samples in each column.
    pub(crate) fn samples(&self) -> usize {
        self.columns[0].1.len()
    }

    /// The body of a post in the binary form.
    pub(crate) fn frame(&self) -> Vec<u8> {
        let now = Timestamp::from_micros(i64::MAX / 2);
        let machine = self.machine.as_str().try_into().expect("an id");
        let cycle = body::decode(&machine, self.json().as_bytes(), 10_000, now).expect("a cycle");
        wire::encode(&cycle)
    }

    /// The same cycle at another machine, under another id, at another time.
    pub(crate) fn again(&self, machine: &str, id: String, started_ms: u64) -> Self {
        Self { machine: machine.to_owned(), id, started_ms, columns: self.columns.clone() }
    }

    /// The body of a post.
    pub(crate) fn json(&self) -> String {
        let mut out = String::with_capacity(self.values() * 7);
        let seconds = self.started_ms / 1000;
        // The shift begins at six on the fourth and lasts minutes: no month ends in between.
        let (day, rest) = (4 + (seconds - MORNING_MS / 1000 + 6 * 3600) / 86_400, seconds % 86_400);
        let _ = write!(
            out,
            r#"{{"cycle_id":"{}","tool":"T-{}","operation":"bush","started_at":"2026-05-{day:02}T{:02}:{:02}:{:02}.{:03}Z","strategy":"f_lin","spindle_speed_rpm":2500,"samples":{{"period_ms":10"#,
            self.id,
            self.machine,
            rest / 3600,
            rest / 60 % 60,
            rest % 60,
            self.started_ms % 1000,
        );
        for (name, values) in &self.columns {
            let _ = write!(out, r#","{name}":["#);
            for (index, value) in values.iter().enumerate() {
                let _ = write!(out, "{}{value}", if index == 0 { "" } else { "," });
            }
            out.push(']');
        }
        out.push_str("}}");
        out
    }
}

/// A xorshift generator: the same shop in every run.
struct Noise(u64);

impl Noise {
    /// Even in −1 to 1.
    #[expect(clippy::cast_precision_loss, reason = "noise")]
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

fn quantised(value: f64, decimals: i32) -> f64 {
    let scale = 10_f64.powi(decimals);
    // Adding zero: a control prints no negative zero.
    (value * scale).round() / scale + 0.0
}

/// `count` cycles, the machines taking turns, 208 to 640 samples of 8 channels at 100 Hz.
#[expect(clippy::cast_precision_loss, reason = "small counts")]
pub(crate) fn cycles(count: usize) -> Vec<Cycle> {
    let mut noise = Noise(0x9E37_79B9_7F4A_7C15);
    (0..count)
        .map(|index| {
            let machine = index % MACHINES;
            let samples = 208 + (machine * 97 + index / MACHINES * 31) % 433;
            let mut columns: [(&'static str, Vec<f64>); 8] = [
                "depth_mm",
                "feed_programmed_mm_min",
                "feed_actual_mm_min",
                "override_percent",
                "feed_drive_load_percent",
                "spindle_load_percent",
                "thrust_newtons",
                "torque_newton_metres",
            ]
            .map(|name| (name, Vec::with_capacity(samples)));
            let wear = 1.0 + 0.05 * index as f64 / count as f64;
            let mut depth = -0.5;
            for k in 0..samples {
                let x = k as f64 / samples as f64;
                let programmed = 100.0 + 250.0 * x;
                let over = (100.0 + 20.0 * (6.0 * x).sin()).round();
                let actual = programmed * over / 100.0;
                depth += actual / 6000.0;
                let bell = |at: f64, width: f64| (-((x - at) / width).powi(2)).exp();
                let thrust = wear * (900.0 * bell(0.3, 0.15) + 250.0 * bell(0.85, 0.08)) + 4.0 * noise.next();
                let torque = wear * (9.0 * bell(0.55, 0.2) + 3.0 * bell(0.85, 0.08)) + 0.06 * noise.next();
                let row = [
                    quantised(depth, 3),
                    quantised(programmed, 0),
                    quantised(actual + noise.next(), 0),
                    over,
                    quantised(thrust / 40.0 + 0.2 * noise.next(), 1),
                    quantised(torque * 3.5 + 4.0 + 0.2 * noise.next(), 1),
                    quantised(thrust, 0),
                    quantised(torque, 2),
                ];
                for ((_, values), value) in columns.iter_mut().zip(row) {
                    values.push(value);
                }
            }
            Cycle {
                machine: format!("M{machine}"),
                id: format!("boot1-{index:06}"),
                started_ms: MORNING_MS + (index as u64) * 250,
                columns,
            }
        })
        .collect()
}

/// Registers machines, tools and the operation, so that wear and recommendations are computed in earnest.
pub(crate) async fn register(client: &reqwest::Client, address: &str, token: &str, machines: usize) {
    let put = |path: String, body: serde_json::Value| {
        let request = client.put(format!("{address}{path}")).bearer_auth(token).json(&body);
        async move {
            let answer = request.send().await.expect("an answer");
            assert_eq!(answer.status().as_u16(), 201, "{:?}", answer.text().await);
        }
    };
    for machine in 0..machines {
        let body = serde_json::json!({
            "name": format!("machine {machine}"), "control": "sinumerik-840d", "ipo_period_ms": 10,
            "spindle": {"reference": "rated_power", "rated_power_watts": 7000},
            "feed_drive": {"reference": "rated_torque", "rated_thrust_newtons": 5000},
            "limits": {"feed_min_mm_min": 1, "feed_max_mm_min": 5000, "override_min_percent": 5, "override_max_percent": 200}
        });
        put(format!("/v1/machines/M{machine}"), body).await;
        put(format!("/v1/tools/T-M{machine}"), serde_json::json!({"name": "drill", "tool_type": "fd"})).await;
    }
    let operation = serde_json::json!({"name": "bush", "process": "friction", "programmed_feed_mm_min": 140});
    put("/v1/operations/bush".to_owned(), operation).await;
}

/// Bytes of a block, as the system counts them.
const BLOCK: u64 = 512;

/// Bytes that all files below a directory take on disk. A file may be longer: InfluxDB sets 4 MiB aside for each of eight, of
/// which next to nothing is written.
pub(crate) fn size_of(dir: &Path) -> u64 {
    let Ok(entries) = std::fs::read_dir(dir) else { return 0 };
    let sizes = entries.flatten().map(|entry| match entry.metadata() {
        Ok(meta) if meta.is_dir() => size_of(&entry.path()),
        Ok(meta) => BLOCK * meta.blocks(),
        Err(_) => 0,
    });
    sizes.sum()
}
