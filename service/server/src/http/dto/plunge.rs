//! Plunging in JSON.

use super::library::PlungeMaterialBody;
use super::mirror::{To, WarningBody, mirror, shown, violation};
use feedwright_core::ids::ModelId;
use feedwright_core::invalid::Violation;
use feedwright_core::plunge::{
    Drill, DrillInput, Hole, HoleInput, HoleSaving, LoopLatency, LoopLatencyInput, Machine, MachineInput,
    PartSaving, PlungeFeed, PlungeSetup,
};
use feedwright_core::summary::median;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

mirror! {
    /// A drill of a tool table.
    DrillBody = DrillInput {
        /// Diameter, mm.
        diameter_mm: f64,
        /// Length out of the holder, mm.
        length_mm: f64,
        /// Spindle speed, 1/min.
        spindle_rpm: f64,
        /// Young's modulus, N/mm²; left out: tool steel, 2.1·10⁵.
        #[serde(default)]
        modulus_n_mm2: Option<f64>,
        /// Shear strength, N/mm²; left out: tool steel, 640.
        #[serde(default)]
        shear_strength_n_mm2: Option<f64>,
    }

    /// Feed range of the machine.
    FeedRangeBody = MachineInput {
        /// S_min, mm/min.
        least_feed_mm_min: f64,
        /// S_max, mm/min.
        greatest_feed_mm_min: f64,
    }

    /// Delay between contact and the reaction of the axis.
    LatencyBody = LoopLatencyInput {
        /// How far the drill may bite at plunge feed, mm.
        allowed_bite_mm: f64,
        /// Samples the detector needs to be sure.
        #[schema(minimum = 1, maximum = 10_000)]
        detector_samples: u32,
        /// Time between samples, s.
        sample_period_s: f64,
        /// Age of an answer when the axis acts on it, s.
        answer_age_s: f64,
    }

    /// A kind of hole.
    HoleBody = HoleInput {
        /// How many of them the part has.
        #[schema(minimum = 1, maximum = 1_000_000)]
        holes: u32,
        /// Safe distance before the surface, mm: what the part's size error demands.
        safe_distance_mm: f64,
        /// Length of the hole, mm.
        length_mm: f64,
        /// Exit without control, mm.
        exit_without_mm: f64,
        /// Exit with control, mm.
        exit_with_mm: f64,
        /// Rapid way, mm.
        rapid_mm: f64,
        /// Rapid feed, mm/min.
        rapid_feed_mm_min: f64,
        /// Working feed, mm/min.
        working_feed_mm_min: f64,
        /// Plunge feed, mm/min.
        plunge_feed_mm_min: f64,
    }
}

shown! {
    /// Plunge feed of one drill.
    PlungeFeedBody = PlungeFeed {
        /// Advised plunge feed, mm/rev; absent when there is none.
        feed_mm_rev: Option<f64>,
        /// The same in mm/min.
        feed_mm_min: Option<f64>,
        /// What bounds it: `stability`, `torsion`, `machine_maximum`, `loop_latency`; `impossible` where the drill
        /// bears less than the machine's least feed, `loop_too_slow` where only the loop's bound lies below it.
        limit: &'static str,
        /// Feed at which the drill would buckle, mm/rev.
        stability_feed_mm_rev: f64,
        /// Feed at which the drill would twist off, mm/rev.
        torsion_feed_mm_rev: f64,
        /// Axial load the drill bears, N (Eq. 9).
        critical_thrust_n: f64,
        /// Torque the drill bears, N·mm (Eq. 10).
        critical_torque_n_mm: f64,
        /// Bite at the advised feed before the axis reacts, mm.
        bite_mm: Option<f64>,
    }

    /// Saving of one hole.
    HoleSavingBody = HoleSaving {
        /// Cycle without control, s (Eq. 3).
        without_s: f64,
        /// Cycle with control, s (Eq. 4).
        with_s: f64,
        /// Saved, s; negative when control costs time (Eq. 5 and 6).
        saved_s: f64,
        /// Saved over the time of cutting the hole; k1·(2 − k2) in the paper's case (Eq. 7 and 8).
        relative: f64,
        /// k1, size error over length of the hole.
        k1: f64,
        /// k2, working feed over plunge feed.
        k2: f64,
        /// Whether control saves time.
        pays: bool,
        /// Plunge feed from which it does, mm/min.
        pays_from_feed_mm_min: Option<f64>,
    }

    /// Saving of a part.
    PartSavingBody = PartSaving {
        /// One hole of each kind, in the order given.
        holes: Vec<HoleSavingBody>,
        /// All holes without control, s.
        without_s: f64,
        /// All holes with control, s.
        with_s: f64,
        /// Saved on the part when every hole is controlled, s.
        saved_s: f64,
        /// Saved when only the kinds that pay are controlled, s.
        best_saved_s: f64,
    }
}

/// The constants to use: a library entry by its id, or an entry in place.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PlungeMaterialChoice {
    /// Id of a library entry.
    Id(String),
    /// An entry.
    Entry(PlungeMaterialBody),
}

/// A question for plunge feeds.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({
    "material": {"id": "c45-hss"},
    "machine": {"least_feed_mm_min": 1.0, "greatest_feed_mm_min": 5000.0},
    "latency": {"allowed_bite_mm": 0.5, "detector_samples": 4, "sample_period_s": 0.01, "answer_age_s": 0.02},
    "drills": [{"diameter_mm": 3.0, "length_mm": 60.0, "spindle_rpm": 2000.0},
               {"diameter_mm": 12.0, "length_mm": 100.0, "spindle_rpm": 800.0}]
}))]
pub struct PlungeFeedQuestion {
    /// The constants of the material.
    pub material: PlungeMaterialChoice,
    /// Feed range of the machine.
    pub machine: FeedRangeBody,
    /// Delay of the loop; left out where contact is sensed in the control itself.
    #[serde(default)]
    pub latency: Option<LatencyBody>,
    /// The tool table, at most 10 000 drills.
    pub drills: Vec<DrillBody>,
}

/// What was asked for, checked, without the material.
pub struct Plunges {
    /// The feed range.
    pub machine: Machine,
    /// The delay.
    pub latency: Option<LoopLatency>,
    /// The drills.
    pub drills: Vec<Drill>,
}

impl Plunges {
    /// Checks every part.
    pub fn of(
        machine: FeedRangeBody,
        latency: Option<LatencyBody>,
        drills: Vec<DrillBody>,
    ) -> Result<Self, Violation> {
        let machine = Machine::new(machine.to()).map_err(|error| violation("machine", error))?;
        let latency = latency
            .map(|latency| LoopLatency::new(latency.to()).map_err(|error| violation("latency", error)))
            .transpose()?;
        let checked = |(index, drill): (usize, DrillBody)| {
            Drill::new(drill.to()).map_err(|error| violation(&format!("drills[{index}]"), error))
        };
        let drills = drills.into_iter().enumerate().map(checked).collect::<Result<_, _>>()?;
        Ok(Self { machine, latency, drills })
    }
}

/// Plunge feeds in the order of the tool table.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct PlungeFeedAnswer {
    /// A feed for each drill.
    pub drills: Vec<PlungeFeedBody>,
    /// What to know before using them.
    pub warnings: Vec<WarningBody>,
}

/// A question for savings.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"holes": [{"holes": 12, "safe_distance_mm": 3.0, "length_mm": 20.0, "exit_without_mm": 5.0,
    "exit_with_mm": 2.0, "rapid_mm": 100.0, "rapid_feed_mm_min": 10000.0, "working_feed_mm_min": 200.0,
    "plunge_feed_mm_min": 1000.0}]}))]
pub struct PlungeSavingQuestion {
    /// Kinds of holes of the part, at most 10 000.
    pub holes: Vec<HoleBody>,
}

impl PlungeSavingQuestion {
    /// The checked kinds.
    pub fn holes(self) -> Result<Vec<Hole>, Violation> {
        let checked = |(index, hole): (usize, HoleBody)| {
            Hole::new(hole.to()).map_err(|error| violation(&format!("holes[{index}]"), error))
        };
        self.holes.into_iter().enumerate().map(checked).collect()
    }
}

/// How an operation plunges.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PlungeSetupBody {
    /// Id of the library entry.
    pub material: String,
    /// The drill.
    pub drill: DrillBody,
    /// Delay of the loop; left out where contact is sensed in the control itself.
    #[serde(default)]
    pub latency: Option<LatencyBody>,
}

impl PlungeSetupBody {
    /// The setup; its numbers are checked with the operation.
    pub fn setup(self) -> Result<PlungeSetup, Violation> {
        Ok(PlungeSetup {
            material: ModelId::parse("plunge.material", &self.material)?,
            drill: self.drill.to(),
            latency: self.latency.to(),
        })
    }
}

impl From<PlungeSetup> for PlungeSetupBody {
    fn from(setup: PlungeSetup) -> Self {
        Self {
            material: setup.material.as_str().to_owned(),
            drill: setup.drill.to(),
            latency: setup.latency.to(),
        }
    }
}

/// Most recorded cycles that one answer looks at, and as many where no number is named: a year of one operation on one machine.
pub const MOST_RECORDED: u32 = 10_000;

/// Which operation's cycles to compare.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct RecordedQuery {
    /// The operation.
    pub operation: String,
    /// Most cycles looked at, the newest, 1 to 10 000; as many as that where it is left out.
    #[param(minimum = 1, maximum = 10_000)]
    pub most_cycles: Option<u32>,
}

impl RecordedQuery {
    /// How many cycles are looked at.
    pub fn most(&self) -> Result<u32, Violation> {
        let most = self.most_cycles.unwrap_or(MOST_RECORDED);
        if (1..=MOST_RECORDED).contains(&most) {
            return Ok(most);
        }
        let text = format!("must be within 1 to {MOST_RECORDED}, is {most}");
        Err(Violation::new("most_cycles", "out_of_range", text))
    }
}

/// Real cycle times of an operation with and without control.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct RecordedSavingBody {
    /// The operation.
    pub operation: String,
    /// Whether all cycles of the operation were looked at; the newest were where it is false.
    pub complete: bool,
    /// Cycles tagged `plunge`, which ran with control.
    pub with_control: RecordedTimesBody,
    /// Cycles tagged `drilling`, which ran without.
    pub without_control: RecordedTimesBody,
    /// Median saved per hole, s; absent where either side has no cycle with a length.
    pub saved_s: Option<f64>,
}

/// Lengths of recorded cycles.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, ToSchema)]
pub struct RecordedTimesBody {
    /// Completed cycles with a length.
    pub cycles: usize,
    /// Median length, s.
    pub median_s: Option<f64>,
}

impl RecordedTimesBody {
    /// Of those lengths in ms.
    pub fn of(lengths_ms: &[f64]) -> Self {
        let median_s = (!lengths_ms.is_empty()).then(|| median(lengths_ms) / 1000.0);
        Self { cycles: lengths_ms.len(), median_s }
    }
}
