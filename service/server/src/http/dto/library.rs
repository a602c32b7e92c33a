//! Entries of the model library in JSON.

use super::Registered;
use super::mirror::{To, mirror, violation};
use feedwright_core::ids::ModelId;
use feedwright_core::invalid::Violation;
use feedwright_core::plunge::{DrillingLaw, Material, MaterialInput};
use feedwright_core::turning::{
    LoadLaw, ModelInput, ModelRanges, Range, ScatterInput, ToolWorkMachine, TurningModel, WearLaw,
};
use feedwright_store::{Model, ModelContent, Versioned};

mirror! {
    /// A closed range.
    RangeBody = Range {
        /// Lower end.
        min: f64,
        /// Upper end.
        max: f64,
    }

    /// What an entry was fitted for.
    ToolWorkMachineBody = ToolWorkMachine {
        /// Insert or tool.
        tool: String,
        /// Work material.
        work: String,
        /// Machine.
        machine: String,
    }

    /// AW = C·V^a·f^b·(d/d₀)^c·t^e, mm (Alaskari & Oraby 2017, Eq. 1; the exponent of V printed there is a misprint).
    WearLawBody = WearLaw {
        /// C at the reference depth, mm.
        coefficient: f64,
        /// Exponent of the cutting speed in m/min.
        speed_exponent: f64,
        /// Exponent of the feed in mm/rev.
        feed_exponent: f64,
        /// Exponent of the depth over the reference depth.
        depth_exponent: f64,
        /// Exponent of the cutting time in min.
        time_exponent: f64,
    }

    /// Y = C·V^a·f^b·(d/d₀)^c·AW^e, kW or N (Alaskari & Oraby 2017, Eq. 6 and 7).
    LoadLawBody = LoadLaw {
        /// C at the reference depth, kW or N.
        coefficient: f64,
        /// Exponent of the cutting speed in m/min.
        speed_exponent: f64,
        /// Exponent of the feed in mm/rev.
        feed_exponent: f64,
        /// Exponent of the depth over the reference depth.
        depth_exponent: f64,
        /// Exponent of the wear in mm.
        wear_exponent: f64,
    }

    /// Where the fit of an entry holds; outside, an answer says that it extrapolates.
    ModelRangesBody = ModelRanges {
        /// Cutting speed, m/min.
        speed_m_min: RangeBody,
        /// Feed, mm/rev.
        feed_mm_rev: RangeBody,
        /// Depth of cut, mm.
        depth_mm: RangeBody,
    }

    /// Standard errors of the fits, natural logarithms of the ratio measured to predicted.
    ScatterBody = ScatterInput {
        /// Of the wear law.
        wear_log_sd: f64,
        /// Of the power law.
        power_log_sd: f64,
        /// Of the force law.
        force_log_sd: f64,
    }

    /// Coefficients of one tool–work–machine set for rough turning.
    #[schema(example = json!({
        "set": {"tool": "Sandvik GC435", "work": "709M40 (En 19) steel", "machine": "Colchester Mascot"},
        "reference_depth_mm": 1.0,
        "wear": {"coefficient": 7.62e-3, "speed_exponent": 0.577, "feed_exponent": 0.168, "depth_exponent": 0.248,
                 "time_exponent": 0.245},
        "power": {"coefficient": 0.14, "speed_exponent": 0.82, "feed_exponent": 0.627, "depth_exponent": 0.844,
                  "wear_exponent": 0.342},
        "force": {"coefficient": 55354.0, "speed_exponent": -0.484, "feed_exponent": 0.236, "depth_exponent": 0.715,
                  "wear_exponent": 1.1},
        "ranges": {"speed_m_min": {"min": 50.0, "max": 200.0}, "feed_mm_rev": {"min": 0.06, "max": 0.6},
                   "depth_mm": {"min": 1.5, "max": 3.0}},
        "scatter": {"wear_log_sd": 0.1, "power_log_sd": 0.062, "force_log_sd": 0.12}
    }))]
    TurningModelBody = ModelInput {
        /// What it was fitted for.
        set: ToolWorkMachineBody,
        /// Depth d₀ at which the coefficients are given, mm.
        reference_depth_mm: f64,
        /// Average edge wear.
        wear: WearLawBody,
        /// Consumed power, kW.
        power: LoadLawBody,
        /// Thrust force, N.
        force: LoadLawBody,
        /// Where the fit holds.
        ranges: ModelRangesBody,
        /// How well it fits.
        scatter: ScatterBody,
    }

    /// Y = C·d^q·S^y·K, d in mm, S in mm/rev.
    DrillingLawBody = DrillingLaw {
        /// C, for N (thrust) or N·mm (torque).
        coefficient: f64,
        /// q.
        diameter_exponent: f64,
        /// y.
        feed_exponent: f64,
        /// K, correction for the conditions.
        correction: f64,
    }

    /// Constants of a work material with a kind of drill. Lengerov prints none: they come from a handbook or a trial.
    #[schema(example = json!({
        "name": "C45, HSS twist drill (your handbook's constants go here)",
        "thrust": {"coefficient": 680.0, "diameter_exponent": 1.0, "feed_exponent": 0.7, "correction": 1.0},
        "torque": {"coefficient": 345.0, "diameter_exponent": 2.0, "feed_exponent": 0.8, "correction": 1.0}
    }))]
    PlungeMaterialBody = MaterialInput {
        /// What it stands for.
        name: String,
        /// Thrust, N.
        thrust: DrillingLawBody,
        /// Torque, N·mm.
        torque: DrillingLawBody,
    }
}

impl TurningModelBody {
    /// The checked entry; `parent` is the path of this body.
    pub fn model(self, parent: &str) -> Result<TurningModel, Violation> {
        TurningModel::new(self.to()).map_err(|error| violation(parent, error))
    }

    /// The library entry of that id.
    pub fn into_model(self, id: ModelId) -> Result<Model, Violation> {
        Ok(Model { id, content: ModelContent::Turning(self.model("")?) })
    }
}

impl PlungeMaterialBody {
    /// The checked entry; `parent` is the path of this body.
    pub fn material(self, parent: &str) -> Result<Material, Violation> {
        Material::new(self.to()).map_err(|error| violation(parent, error))
    }

    /// The library entry of that id.
    pub fn into_model(self, id: ModelId) -> Result<Model, Violation> {
        Ok(Model { id, content: ModelContent::Plunge(self.material("")?) })
    }
}

fn registered<T>(stored: &Versioned<Model>, body: T) -> Registered<T> {
    let stood = (stored.version, stored.updated_at, stored.is_damaged);
    Registered::of(stored.value.id.as_str(), stood, body)
}

/// An entry as it is answered; none where it is of the other kind.
pub fn turning_entry(stored: &Versioned<Model>) -> Option<Registered<TurningModelBody>> {
    match &stored.value.content {
        ModelContent::Turning(model) => Some(registered(stored, model.data().clone().to())),
        ModelContent::Plunge(_) => None,
    }
}

/// An entry as it is answered; none where it is of the other kind.
pub fn plunge_entry(stored: &Versioned<Model>) -> Option<Registered<PlungeMaterialBody>> {
    match &stored.value.content {
        ModelContent::Plunge(material) => Some(registered(stored, material.data().clone().to())),
        ModelContent::Turning(_) => None,
    }
}
