//! Files of feed profiles in JSON: how one is written, what one is read from.

use super::feed_profile::{ConditionsBody, ProfileLimitsBody, SectionBody, WearBandBody};
use feedwright_core::feed::import::{Hole, ListKind, gcode, list, ramped};
use feedwright_core::feed::nc::{Dialect, ExportOptions, LawInControl};
use feedwright_core::feed::profile::{KnotInput, SectionKind};
use feedwright_core::invalid::Violation;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// How a version is written.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ExportQuery {
    /// `sinumerik`, `twincat_nci`, `twincat_cnc`, `linuxcnc`, `fanuc`, `heidenhain_afc`, `csv` or `json`.
    pub dialect: String,
    /// The version; the active one where it is left out.
    #[param(minimum = 1)]
    pub version: Option<u32>,
    /// The machine that it is for: a feed outside its limits is refused, and an override keeps within them.
    pub machine: Option<String>,
    /// Height above first contact to which it rapids, mm; 1 where it is left out.
    pub clearance_mm: Option<f64>,
    /// Largest error of a stepped feed as a part of it; 0.01 where it is left out.
    pub feed_error: Option<f64>,
    /// SINUMERIK: holds the override law in the control too, fitted for this intensity b.
    pub law_intensity: Option<f64>,
    /// SINUMERIK: highest override of that law, %; 100 where it is left out, so that it only lowers; at most 200 and
    /// the profile's own.
    pub law_override_max_percent: Option<f64>,
}

impl ExportQuery {
    /// The dialect; `None` for JSON.
    pub fn dialect(&self) -> Result<Option<Dialect>, Violation> {
        if self.dialect == "json" {
            return Ok(None);
        }
        Dialect::parse(&self.dialect).map(Some).ok_or_else(|| {
            let all: Vec<_> = Dialect::ALL.into_iter().map(Dialect::as_str).collect();
            Violation::new("dialect", "unknown_dialect", format!("must be one of {}, json", all.join(", ")))
        })
    }

    /// How it is written; the machine's limits are its caller's to fill in.
    pub fn options(&self) -> Result<ExportOptions, Violation> {
        if self.law_override_max_percent.is_some() && self.law_intensity.is_none() {
            let why = "belongs to the override law: name its law_intensity too";
            return Err(Violation::new("law_override_max_percent", "without_law", why));
        }
        let usual = ExportOptions::default();
        Ok(ExportOptions {
            clearance_mm: self.clearance_mm.unwrap_or(usual.clearance_mm),
            feed_error: self.feed_error.unwrap_or(usual.feed_error),
            law: self.law_intensity.map(|intensity| LawInControl {
                intensity,
                override_max_percent: self.law_override_max_percent.unwrap_or(100.0),
            }),
            machine: None,
        })
    }

    /// A refusal of the core with the name of the query's field.
    pub fn refused(wrong: Vec<Violation>) -> Vec<Violation> {
        let named = |one: Violation| match one.path.as_str() {
            "law" | "law.intensity" => Violation { path: "law_intensity".to_owned(), ..one },
            "law.override_max_percent" => Violation { path: "law_override_max_percent".to_owned(), ..one },
            _ => one,
        };
        wrong.into_iter().map(named).collect()
    }
}

/// How a text is meant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ImportFormat {
    /// Two columns, depth in mm and feed in mm/min; the feed runs linearly from row to row.
    CsvLinear,
    /// The same; a row's feed holds to the next row, and the last row is the end.
    CsvStepped,
    /// One hole of a simple program.
    Gcode,
}

/// What a user has now, to be drafted as a version.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({
    "profile": "bushing-m8-long", "reason": "as it has run until today", "format": "gcode",
    "text": "G21 G90 G94\nG0 Z5.\nG1 Z0.5 F1000.\nG1 Z-3. F160.\nG1 Z-8. F480.\nG1 Z-20.5 F150.\nG0 Z50.\n",
    "operation": "bushing-m8", "tool_type": "friction-drill-7.3",
    "limits": {"feed_min_mm_min": 50.0, "feed_max_mm_min": 1000.0, "acceleration_mm_s2": 300.0,
               "override_min_percent": 20.0, "override_max_percent": 150.0},
    "wear": {"to_level": 1.07}
}))]
pub struct ImportBody {
    /// Name of the feed profile.
    pub profile: String,
    /// Why it is drafted.
    pub reason: String,
    /// How the text is meant.
    pub format: ImportFormat,
    /// The text, at most 256 KiB and 5000 lines.
    pub text: String,
    /// Z of first contact in a program, mm; 0 where it is left out.
    #[serde(default)]
    pub contact_z_mm: Option<f64>,
    /// What is machined.
    pub operation: String,
    /// Kind of tool.
    pub tool_type: String,
    /// Sections; one of forming over the whole depth where they are left out.
    #[serde(default)]
    pub sections: Option<Vec<SectionBody>>,
    /// Limits; their acceleration makes the ramps where a stepped feed changes.
    pub limits: ProfileLimitsBody,
    /// Tool wear.
    pub wear: WearBandBody,
    /// Conditions; those that the operation states where they are left out.
    #[serde(default)]
    pub conditions: Option<ConditionsBody>,
    /// The version that it was changed from.
    #[serde(default)]
    #[schema(minimum = 1)]
    pub based_on: Option<u32>,
}

impl ImportBody {
    /// The knots of the text, and what of a program somebody should look at.
    pub fn knots(&self) -> Result<(Vec<KnotInput>, Hole), Vec<Violation>> {
        let acceleration = self.limits.acceleration_mm_s2;
        let kind = match self.format {
            ImportFormat::CsvLinear => ListKind::Linear,
            ImportFormat::CsvStepped => ListKind::Stepped,
            ImportFormat::Gcode => {
                let hole = gcode(&self.text, self.contact_z_mm.unwrap_or(0.0))?;
                return Ok((ramped(&hole.held, acceleration)?, hole));
            }
        };
        Ok((list(&self.text, kind, acceleration)?, Hole::default()))
    }

    /// The sections, over `end_mm` where none are named.
    pub fn sections(&self, end_mm: f64) -> Vec<SectionBody> {
        let whole =
            || vec![SectionBody { kind: super::word::SectionKindWord(SectionKind::Forming), to_mm: end_mm }];
        self.sections.clone().unwrap_or_else(whole)
    }
}

/// What was read, kept with the version.
#[derive(Debug, Serialize, ToSchema)]
pub struct ImportReport {
    /// How the text was meant.
    pub format: ImportFormat,
    /// blake3 of the text as it came.
    pub text_hash: String,
    /// Words of a program that say nothing about the feed and were passed over.
    pub passed_over: Vec<String>,
    /// Depths of a program without a decimal point, as `Z-8`. They were read as mm: a control that reads them in steps of
    /// 0.001 mm, as FANUC's may be set to, goes a thousandth of the way.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    pub without_point: Vec<String>,
    /// Knots that came out of it.
    pub knots: usize,
}

/// A file to be read back.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ReadBody {
    /// The file as it is on the control.
    pub text: String,
}

/// A file that is what was exported, to the letter.
#[derive(Debug, Serialize, ToSchema)]
pub struct ReadAnswer {
    /// Its dialect.
    pub dialect: &'static str,
    /// Name of the feed profile.
    pub profile: String,
    /// Number of the version.
    pub version: u32,
    /// Hash of its content.
    pub hash: String,
    /// Whether this service knows the version, with this very content.
    pub known: bool,
    /// Where it stands, where it is known.
    pub state: Option<&'static str>,
    /// Its content.
    pub content: super::feed_profile::ProfileBody,
}
