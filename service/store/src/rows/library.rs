//! Library entries and what operations say of their process, as the JSON that columns hold.
//!
//! Names in it are part of what is stored: they may be added, never renamed.

use super::{id, word};
use crate::error::{StoreError, StoreResult};
use crate::record::{Model, ModelContent, ModelKind, Versioned};
use crate::row_sum::{Writers, summed};
use feedwright_core::ids::ModelId;
use feedwright_core::plunge::{
    DrillInput, DrillingLaw, LoopLatencyInput, Material, MaterialInput, PlungeSetup,
};
use feedwright_core::turning::{
    Accumulation, Axis, DomainInput, Limits, LoadLaw, ModelInput, ModelRanges, Range, ScatterInput,
    ToolWorkMachine, TurningModel, TurningSetup, WearLaw,
};
use feedwright_core::units::Timestamp;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::Value;

macro_rules! stored {
    ($($name:ident is $remote:literal { $($(#[$attribute:meta])* $field:ident: $type:ty,)* })*) => {$(
        #[derive(Serialize, Deserialize)]
        #[serde(remote = $remote)]
        struct $name {
            $($(#[$attribute])* $field: $type,)*
        }
    )*};
}

stored! {
    RangeDef is "Range" { min: f64, max: f64, }
    AxisDef is "Axis" { min: f64, max: f64, step: f64, }
    LimitsDef is "Limits" { power_kw: f64, force_n: f64, wear_mm: f64, }
    WearLawDef is "WearLaw" {
        coefficient: f64, speed_exponent: f64, feed_exponent: f64, depth_exponent: f64, time_exponent: f64,
    }
    LoadLawDef is "LoadLaw" {
        coefficient: f64, speed_exponent: f64, feed_exponent: f64, depth_exponent: f64, wear_exponent: f64,
    }
    SetDef is "ToolWorkMachine" { tool: String, work: String, machine: String, }
    ScatterDef is "ScatterInput" { wear_log_sd: f64, power_log_sd: f64, force_log_sd: f64, }
    RangesDef is "ModelRanges" {
        #[serde(with = "RangeDef")] speed_m_min: Range,
        #[serde(with = "RangeDef")] feed_mm_rev: Range,
        #[serde(with = "RangeDef")] depth_mm: Range,
    }
    ModelDef is "ModelInput" {
        #[serde(with = "SetDef")] set: ToolWorkMachine,
        reference_depth_mm: f64,
        #[serde(with = "WearLawDef")] wear: WearLaw,
        #[serde(with = "LoadLawDef")] power: LoadLaw,
        #[serde(with = "LoadLawDef")] force: LoadLaw,
        #[serde(with = "RangesDef")] ranges: ModelRanges,
        #[serde(with = "ScatterDef")] scatter: ScatterInput,
    }
    DrillingLawDef is "DrillingLaw" {
        coefficient: f64, diameter_exponent: f64, feed_exponent: f64, correction: f64,
    }
    MaterialDef is "MaterialInput" {
        name: String,
        #[serde(with = "DrillingLawDef")] thrust: DrillingLaw,
        #[serde(with = "DrillingLawDef")] torque: DrillingLaw,
    }
    TurningSetupDef is "TurningSetup" {
        #[serde(with = "model_id")] model: ModelId,
        depth_mm: f64,
        diameter_mm: Option<f64>,
        interval_min: f64,
        #[serde(with = "LimitsDef")] limits: Limits,
        #[serde(with = "DomainDef")] domain: DomainInput,
        #[serde(with = "AccumulationDef")] accumulation: Accumulation,
        caution_sigmas: f64,
    }
    DrillDef is "DrillInput" {
        diameter_mm: f64, length_mm: f64, spindle_rpm: f64, modulus_n_mm2: Option<f64>,
        shear_strength_n_mm2: Option<f64>,
    }
    LatencyDef is "LoopLatencyInput" {
        allowed_bite_mm: f64, detector_samples: u32, sample_period_s: f64, answer_age_s: f64,
    }
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "DomainInput", rename_all = "snake_case")]
enum DomainDef {
    Grid {
        #[serde(with = "AxisDef")]
        speed_m_min: Axis,
        #[serde(with = "AxisDef")]
        feed_mm_rev: Axis,
    },
    Continuous {
        #[serde(with = "RangeDef")]
        speed_m_min: Range,
        #[serde(with = "RangeDef")]
        feed_mm_rev: Range,
    },
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Accumulation", rename_all = "snake_case")]
enum AccumulationDef {
    ElapsedTime,
    State,
}

mod model_id {
    use super::{Deserialize, Deserializer, ModelId, Serializer};

    pub(super) fn serialize<S: Serializer>(id: &ModelId, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(id.as_str())
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<ModelId, D::Error> {
        let text = String::deserialize(from)?;
        ModelId::try_from(text.as_str()).map_err(serde::de::Error::custom)
    }
}

#[derive(Serialize, Deserialize)]
struct StoredModel(#[serde(with = "ModelDef")] ModelInput);

#[derive(Serialize, Deserialize)]
struct StoredMaterial(#[serde(with = "MaterialDef")] MaterialInput);

#[derive(Serialize, Deserialize)]
struct StoredLatency(#[serde(with = "LatencyDef")] LoopLatencyInput);

#[derive(Serialize, Deserialize)]
struct StoredPlunge {
    #[serde(with = "model_id")]
    material: ModelId,
    #[serde(with = "DrillDef")]
    drill: DrillInput,
    latency: Option<StoredLatency>,
}

#[derive(Serialize, Deserialize)]
struct StoredTurning(#[serde(with = "TurningSetupDef")] TurningSetup);

/// What an operation says of its process: column `operations.setup`.
#[derive(Serialize, Deserialize)]
struct StoredSetup {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    turning: Option<StoredTurning>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    plunge: Option<StoredPlunge>,
}

fn written(value: &impl Serialize) -> StoreResult<Value> {
    serde_json::to_value(value).map_err(|error| StoreError::Database(Box::new(error)))
}

fn read<T: DeserializeOwned>(column: &str, text: &str) -> StoreResult<T> {
    serde_json::from_str(text).map_err(|error| StoreError::Damaged { what: format!("{column}: {error}") })
}

/// What an operation says of its process, as its column; none where it says nothing.
pub(crate) fn setup_json(
    turning: Option<&TurningSetup>,
    plunge: Option<&PlungeSetup>,
) -> StoreResult<Option<Value>> {
    if turning.is_none() && plunge.is_none() {
        return Ok(None);
    }
    let plunge = plunge.map(|plunge| StoredPlunge {
        material: plunge.material.clone(),
        drill: plunge.drill,
        latency: plunge.latency.map(StoredLatency),
    });
    written(&StoredSetup { turning: turning.cloned().map(StoredTurning), plunge }).map(Some)
}

/// What an operation says of its process, out of its column.
pub(crate) fn setup_of(text: Option<&str>) -> StoreResult<(Option<TurningSetup>, Option<PlungeSetup>)> {
    let Some(text) = text else {
        return Ok((None, None));
    };
    let StoredSetup { turning, plunge } = read("operations.setup", text)?;
    let plunge = plunge.map(|StoredPlunge { material, drill, latency }| PlungeSetup {
        material,
        drill,
        latency: latency.map(|latency| latency.0),
    });
    Ok((turning.map(|turning| turning.0), plunge))
}

/// The content of an entry as its column.
pub(crate) fn content_json(content: &ModelContent) -> StoreResult<Value> {
    match content {
        ModelContent::Turning(model) => written(&StoredModel(model.data().clone())),
        ModelContent::Plunge(material) => written(&StoredMaterial(material.data().clone())),
    }
}

/// A row of `models`.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct ModelRow {
    pub(crate) kind: String,
    pub(crate) model_id: String,
    pub(crate) body: String,
    pub(crate) version: i64,
    pub(crate) updated_at_us: i64,
    pub(crate) row_sum: Option<i64>,
    pub(crate) summed_version: Option<i64>,
}

summed!(ModelRow of "models": kind, model_id, body, version, updated_at_us);

impl ModelRow {
    /// As it is to be written.
    pub(crate) fn of(model: &Model, version: u64, now: Timestamp) -> StoreResult<Self> {
        let row = Self {
            kind: model.content.kind().as_str().to_owned(),
            model_id: model.id.as_str().to_owned(),
            body: content_json(&model.content)?.to_string(),
            version: super::count("version", version)?,
            updated_at_us: now.micros(),
            row_sum: None,
            summed_version: None,
        };
        Ok(row.with_sum())
    }

    pub(crate) fn versioned(&self, writers: Writers) -> StoreResult<Versioned<Model>> {
        let refused = |_| super::damaged("models.body");
        let content = match word("kind", &self.kind, ModelKind::parse)? {
            ModelKind::Turning => {
                let stored: StoredModel = read("models.body", &self.body)?;
                ModelContent::Turning(TurningModel::new(stored.0).map_err(refused)?)
            }
            ModelKind::Plunge => {
                let stored: StoredMaterial = read("models.body", &self.body)?;
                ModelContent::Plunge(Material::new(stored.0).map_err(refused)?)
            }
        };
        Ok(Versioned {
            value: Model { id: id("model_id", &self.model_id)?, content },
            version: super::number("version", self.version)?,
            updated_at: Timestamp::from_micros(self.updated_at_us),
            is_damaged: self.is_damaged(writers),
        })
    }
}
