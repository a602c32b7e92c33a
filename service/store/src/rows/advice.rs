//! What a process or a feed profile adds to a recommendation, as the JSON that is kept beside the rest of the advice.

use super::{damaged, id, word};
use crate::error::StoreResult;
use feedwright_core::cycle::ProfileVersion;
use feedwright_core::feed::choose::ProfileAdvice;
use feedwright_core::feed::profile::ProfileHash;
use feedwright_core::plunge::PlungeLimit;
use feedwright_core::recommend::{PlungeAdvice, ProcessAdvice, TurningAdvice, TurningNext};
use feedwright_core::turning::{Binding, Correction, Corrections, Limit, Readings};
use serde::{Deserialize, Serialize};

/// The feed profile that a recommendation hands out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct ProfileAdviceBody {
    profile: String,
    version: u32,
    hash: String,
    time_s: f64,
    wear_to_level: f64,
}

impl From<&ProfileAdvice> for ProfileAdviceBody {
    fn from(advice: &ProfileAdvice) -> Self {
        Self {
            profile: advice.version.profile.as_str().to_owned(),
            version: advice.version.version,
            hash: advice.hash.to_string(),
            time_s: advice.time_s,
            wear_to_level: advice.wear_to_level,
        }
    }
}

impl ProfileAdviceBody {
    pub(crate) fn advice(&self) -> StoreResult<ProfileAdvice> {
        Ok(ProfileAdvice {
            version: ProfileVersion { profile: id("profile", &self.profile)?, version: self.version },
            hash: word("hash", &self.hash, ProfileHash::parse)?,
            time_s: self.time_s,
            wear_to_level: self.wear_to_level,
        })
    }
}

/// One of both.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum ProcessAdviceBody {
    Turning(Box<TurningBody>),
    Plunge(PlungeBody),
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct TurningBody {
    law_version: String,
    model: String,
    elapsed_min: f64,
    /// Value, low and high of wear, and of the factors of wear, power and force.
    corrections: [[f64; 3]; 4],
    gated: bool,
    at_bound: bool,
    /// Intervals, and readings of power, force and wear.
    readings: [u32; 4],
    next: Option<NextBody>,
    ended_by: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct NextBody {
    speed_m_min: f64,
    feed_mm_rev: f64,
    spindle_rpm: Option<f64>,
    feed_mm_min: Option<f64>,
    interval_min: f64,
    wear_mm: f64,
    power_kw: f64,
    force_n: f64,
    removal_mm3_min: f64,
    binding: String,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct PlungeBody {
    law_version: String,
    material: String,
    feed_mm_min: Option<f64>,
    limit: String,
    bite_mm: Option<f64>,
}

impl From<&TurningNext> for NextBody {
    fn from(next: &TurningNext) -> Self {
        Self {
            speed_m_min: next.speed_m_min,
            feed_mm_rev: next.feed_mm_rev,
            spindle_rpm: next.spindle_rpm,
            feed_mm_min: next.feed_mm_min,
            interval_min: next.interval_min,
            wear_mm: next.wear_mm,
            power_kw: next.power_kw,
            force_n: next.force_n,
            removal_mm3_min: next.removal_mm3_min,
            binding: next.binding.as_str().to_owned(),
        }
    }
}

impl NextBody {
    fn next(&self) -> StoreResult<TurningNext> {
        Ok(TurningNext {
            speed_m_min: self.speed_m_min,
            feed_mm_rev: self.feed_mm_rev,
            spindle_rpm: self.spindle_rpm,
            feed_mm_min: self.feed_mm_min,
            interval_min: self.interval_min,
            wear_mm: self.wear_mm,
            power_kw: self.power_kw,
            force_n: self.force_n,
            removal_mm3_min: self.removal_mm3_min,
            binding: word("binding", &self.binding, Binding::parse)?,
        })
    }
}

impl From<&ProcessAdvice> for ProcessAdviceBody {
    fn from(advice: &ProcessAdvice) -> Self {
        match advice {
            ProcessAdvice::Turning(advice) => {
                let Corrections { wear_mm, wear_factor, power_factor, force_factor, gated, at_bound } =
                    advice.corrections;
                let part = |of: Correction| [of.value, of.low, of.high];
                let Readings { intervals, power, force, wear } = advice.readings;
                Self::Turning(Box::new(TurningBody {
                    law_version: advice.law_version.clone(),
                    model: advice.model.as_str().to_owned(),
                    elapsed_min: advice.elapsed_min,
                    corrections: [part(wear_mm), part(wear_factor), part(power_factor), part(force_factor)],
                    gated,
                    at_bound,
                    readings: [intervals, power, force, wear],
                    next: advice.next.as_ref().map(Into::into),
                    ended_by: advice.ended_by.map(|limit| limit.as_str().to_owned()),
                }))
            }
            ProcessAdvice::Plunge(advice) => Self::Plunge(PlungeBody {
                law_version: advice.law_version.clone(),
                material: advice.material.as_str().to_owned(),
                feed_mm_min: advice.feed_mm_min,
                limit: advice.limit.as_str().to_owned(),
                bite_mm: advice.bite_mm,
            }),
        }
    }
}

impl ProcessAdviceBody {
    pub(crate) fn advice(&self) -> StoreResult<ProcessAdvice> {
        Ok(match self {
            Self::Turning(body) => {
                let part = |[value, low, high]: [f64; 3]| Correction { value, low, high };
                let [wear_mm, wear_factor, power_factor, force_factor] = body.corrections.map(part);
                let [intervals, power, force, wear] = body.readings;
                let limit = |text: &String| Limit::parse(text).ok_or_else(|| damaged("ended_by"));
                ProcessAdvice::Turning(TurningAdvice {
                    law_version: body.law_version.clone(),
                    model: id("model", &body.model)?,
                    elapsed_min: body.elapsed_min,
                    corrections: Corrections {
                        wear_mm,
                        wear_factor,
                        power_factor,
                        force_factor,
                        gated: body.gated,
                        at_bound: body.at_bound,
                    },
                    readings: Readings { intervals, power, force, wear },
                    next: body.next.as_ref().map(NextBody::next).transpose()?,
                    ended_by: body.ended_by.as_ref().map(limit).transpose()?,
                })
            }
            Self::Plunge(body) => ProcessAdvice::Plunge(PlungeAdvice {
                law_version: body.law_version.clone(),
                material: id("material", &body.material)?,
                feed_mm_min: body.feed_mm_min,
                limit: word("limit", &body.limit, PlungeLimit::parse)?,
                bite_mm: body.bite_mm,
            }),
        })
    }
}
