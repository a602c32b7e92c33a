//! Rows of advice, alarms, quarantine, audit and tokens.

use super::{ProcessAdviceBody, ProfileAdviceBody, id, number, word};
use crate::error::{StoreError, StoreResult};
use crate::record::{Alarm, AlarmKind, AuditEntry, IssuedRecommendation, QuarantineEntry, Role, TokenRecord};
use crate::stored_text::StoredText;
use feedwright_core::ids::RecommendationId;
use feedwright_core::machine::FeedLimits;
use feedwright_core::recommend::{Action, DataQuality, Recommendation, ReferenceRequest};
use feedwright_core::units::{Process, Timestamp};
use feedwright_core::wear::{Level, LevelBasis, Remaining, ToolState};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// What repeats from one recommendation to the next, of whatever machine and tool; kept once, under the hash of its JSON.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct AdviceBody<'a> {
    /// Whom it was for, in advice of before that stood with each row.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    machine: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    operation: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    tool: Option<String>,
    process: Option<Cow<'a, str>>,
    action: Cow<'a, str>,
    feed_mm_min: Option<f64>,
    override_percent: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    profile: Option<ProfileAdviceBody>,
    limits: [f64; 4],
    spindle_load_set_percent: Option<f64>,
    feed_drive_load_set_percent: Option<f64>,
    tool_state: Cow<'a, str>,
    quality: Cow<'a, str>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    process_advice: Option<ProcessAdviceBody>,
    /// Cycles from one reference cycle to the next, and the feed, where this advice asks for one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    reference_cycle: Option<(u32, Option<f64>)>,
    reasons: Cow<'a, [(String, String)]>,
    law_version: Cow<'a, str>,
}

impl<'a> AdviceBody<'a> {
    /// Reads a text that is kept under a hash. Of those that say whom they were for, which are of before, not all are
    /// under their own.
    pub(crate) fn read(hash: &[u8], text: &'a str) -> StoreResult<Self> {
        let body: Self = serde_json::from_str(text)
            .map_err(|error| StoreError::Damaged { what: format!("advice: {error}") })?;
        if body.machine.is_none() && super::advice_hash(text) != hash {
            return Err(StoreError::Damaged { what: "advice: it is not what its hash says".to_owned() });
        }
        Ok(body)
    }

    pub(crate) fn of(recommendation: &'a Recommendation) -> Self {
        let limits = recommendation.limits;
        Self {
            machine: None,
            operation: None,
            tool: None,
            process: recommendation.process.map(|process| process.as_str().into()),
            action: recommendation.action.as_str().into(),
            feed_mm_min: recommendation.feed_mm_min,
            override_percent: recommendation.override_percent,
            profile: recommendation.profile.as_ref().map(Into::into),
            limits: [
                limits.min_mm_min(),
                limits.max_mm_min(),
                limits.override_min_percent(),
                limits.override_max_percent(),
            ],
            spindle_load_set_percent: recommendation.spindle_load_set_percent,
            feed_drive_load_set_percent: recommendation.feed_drive_load_set_percent,
            tool_state: recommendation.tool_state.as_str().into(),
            quality: recommendation.quality.as_str().into(),
            process_advice: recommendation.process_advice.as_ref().map(Into::into),
            reference_cycle: recommendation.reference_cycle.map(|asked| (asked.every, asked.feed_mm_min)),
            reasons: recommendation.reasons.as_slice().into(),
            law_version: recommendation.law_version.as_str().into(),
        }
    }
}

/// A row of `recommendations` with its advice.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct RecommendationRow {
    issued_at_us: i64,
    valid_until_us: i64,
    level_as_run: Option<f64>,
    level_lowest: Option<f64>,
    level_highest: Option<f64>,
    level_n: Option<i64>,
    level_window: Option<i64>,
    remaining_cycles: Option<i64>,
    remaining_low: Option<i64>,
    remaining_high: Option<i64>,
    data_age_ms: Option<i64>,
    level_decides: Option<String>,
    level_value: Option<f64>,
    level_sd: Option<f64>,
    machine_id: String,
    operation_id: Option<String>,
    tool_id: Option<String>,
    advice_hash: Vec<u8>,
    body: String,
}

impl RecommendationRow {
    fn level(&self) -> StoreResult<Option<Level>> {
        let (Some(as_run), Some(lowest), Some(highest), Some(n), Some(window)) =
            (self.level_as_run, self.level_lowest, self.level_highest, self.level_n, self.level_window)
        else {
            return Ok(None);
        };
        let judged_as_run =
            Level::as_run(as_run, (lowest, highest), number("level_n", n)?, number("level_window", window)?);
        // Advice from before there was anything else was judged as run.
        let Some(value) = self.level_value else { return Ok(Some(judged_as_run)) };
        let decides = self.level_decides.as_deref();
        let decides = decides.map(|text| word("level_decides", text, LevelBasis::parse)).transpose()?;
        Ok(Some(Level { decides, value, sd: self.level_sd, ..judged_as_run }))
    }

    /// What was handed out under that id.
    pub(crate) fn issued(&self, id_asked: &RecommendationId) -> StoreResult<IssuedRecommendation> {
        let body = AdviceBody::read(&self.advice_hash, &self.body)?;
        let [min, max, low, high] = body.limits;
        let limits =
            FeedLimits::held((min, max), (low, high)).ok_or_else(|| super::damaged("advices.body"))?;
        let level = self.level()?;
        let remaining = match (self.remaining_cycles, self.remaining_low, self.remaining_high) {
            (Some(cycles), Some(low), Some(high)) => Some(Remaining {
                cycles: number("remaining_cycles", cycles)?,
                low: number("remaining_low", low)?,
                high: number("remaining_high", high)?,
            }),
            _ => None,
        };
        let whom = |name: &'static str, of_row: &Option<String>, of_body: &Option<String>| {
            of_row.as_ref().or(of_body.as_ref()).cloned().ok_or_else(|| super::damaged(name))
        };
        let machine = body.machine.as_ref().unwrap_or(&self.machine_id);
        let operation = whom("recommendations.operation_id", &self.operation_id, &body.operation)?;
        let tool = whom("recommendations.tool_id", &self.tool_id, &body.tool)?;
        Ok(IssuedRecommendation {
            id: id_asked.clone(),
            recommendation: Recommendation {
                issued_at: Timestamp::from_micros(self.issued_at_us),
                valid_until: Timestamp::from_micros(self.valid_until_us),
                machine: id("machine", machine)?,
                operation: id("operation", &operation)?,
                tool: id("tool", &tool)?,
                process: body
                    .process
                    .as_deref()
                    .map(|text| word("process", text, Process::parse))
                    .transpose()?,
                action: word("action", &body.action, Action::parse)?,
                feed_mm_min: body.feed_mm_min,
                override_percent: body.override_percent,
                profile: body.profile.map(|profile| profile.advice()).transpose()?,
                limits,
                spindle_load_set_percent: body.spindle_load_set_percent,
                feed_drive_load_set_percent: body.feed_drive_load_set_percent,
                tool_state: word("tool_state", &body.tool_state, ToolState::parse)?,
                level,
                remaining,
                quality: word("quality", &body.quality, DataQuality::parse)?,
                data_age_ms: self.data_age_ms,
                process_advice: body.process_advice.map(|advice| advice.advice()).transpose()?,
                reference_cycle: body
                    .reference_cycle
                    .map(|(every, feed_mm_min)| ReferenceRequest { every, feed_mm_min }),
                reasons: body.reasons.into_owned(),
                law_version: body.law_version.into_owned(),
            },
        })
    }
}

/// A row of `alarms`.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct AlarmRow {
    pub(crate) alarm_id: i64,
    pub(crate) kind: String,
    machine_id: Option<String>,
    tool_id: Option<String>,
    message: StoredText,
    raised_at_us: i64,
    cleared_at_us: Option<i64>,
    acknowledged_by: Option<String>,
    acknowledged_at_us: Option<i64>,
}

impl AlarmRow {
    pub(crate) fn alarm(&self) -> StoreResult<Alarm> {
        let acknowledged = match (&self.acknowledged_by, self.acknowledged_at_us) {
            (Some(by), Some(at)) => Some((by.clone(), Timestamp::from_micros(at))),
            _ => None,
        };
        Ok(Alarm {
            id: self.alarm_id,
            kind: word("kind", &self.kind, AlarmKind::parse)?,
            machine: self.machine_id.as_deref().map(|text| id("machine_id", text)).transpose()?,
            tool: self.tool_id.as_deref().map(|text| id("tool_id", text)).transpose()?,
            message: self.message.shown(),
            raised_at: Timestamp::from_micros(self.raised_at_us),
            cleared_at: self.cleared_at_us.map(Timestamp::from_micros),
            acknowledged,
        })
    }
}

/// A row of `quarantine` without its body.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct QuarantineRow {
    pub(crate) quarantine_id: String,
    machine_id: String,
    cycle_id: Option<String>,
    received_at_us: i64,
    code: String,
    /// Says whether a part of a cycle came, and decides by that.
    problem: String,
    content_type: String,
    pub(crate) size: i64,
    settled_at_us: Option<i64>,
    settled_how: Option<StoredText>,
}

impl QuarantineRow {
    pub(crate) fn entry(&self) -> StoreResult<QuarantineEntry> {
        let settled = match (self.settled_at_us, &self.settled_how) {
            (Some(at), Some(how)) => Some((Timestamp::from_micros(at), how.shown())),
            _ => None,
        };
        Ok(QuarantineEntry {
            id: self.quarantine_id.clone(),
            machine: id("machine_id", &self.machine_id)?,
            cycle: self.cycle_id.clone(),
            received_at: Timestamp::from_micros(self.received_at_us),
            code: self.code.clone(),
            problem: self.problem.clone(),
            content_type: self.content_type.clone(),
            settled,
            size: number("size", self.size)?,
        })
    }
}

/// A row of `audit`.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct AuditRow {
    audit_id: i64,
    at_us: i64,
    actor: String,
    role: String,
    action: String,
    subject: String,
    detail: StoredText,
}

impl AuditRow {
    pub(crate) fn entry(self) -> StoreResult<AuditEntry> {
        Ok(AuditEntry {
            id: self.audit_id,
            at: Timestamp::from_micros(self.at_us),
            actor: self.actor,
            role: word("role", &self.role, Role::parse)?,
            action: self.action,
            subject: self.subject,
            detail: self.detail.shown(),
        })
    }
}

/// A row of `tokens`.
#[derive(Debug, Clone, sqlx::FromRow)]
pub(crate) struct TokenRow {
    token_id: String,
    name: StoredText,
    secret_hash: Vec<u8>,
    role: String,
    machine_id: Option<String>,
    created_at_us: i64,
    revoked_at_us: Option<i64>,
}

impl TokenRow {
    pub(crate) fn token(self) -> StoreResult<TokenRecord> {
        Ok(TokenRecord {
            id: self.token_id,
            name: self.name.shown(),
            hash: self.secret_hash.try_into().map_err(|_| super::damaged("secret_hash"))?,
            role: word("role", &self.role, Role::parse)?,
            machine: self.machine_id.as_deref().map(|text| id("machine_id", text)).transpose()?,
            created_at: Timestamp::from_micros(self.created_at_us),
            revoked_at: self.revoked_at_us.map(Timestamp::from_micros),
        })
    }
}
