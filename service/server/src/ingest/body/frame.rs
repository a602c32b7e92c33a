//! The binary body as the same fields that JSON has, so that both are checked by one code.

use super::super::number::Number;
use super::{Body, BodyError, ProfileBody, ReportedBody, SamplesBody, Started};
use feedwright_core::invalid::Violation;
use feedwright_store::wire::{self, Post, PostedSamples, WireError};

/// Reads a frame of the binary form.
pub(super) fn read(frame: &[u8], max_samples: usize) -> Result<Body, BodyError> {
    wire::read(frame, max_samples).map(Body::from).map_err(|error| match error {
        WireError::Malformed(why) => BodyError::MalformedFrame(why),
        WireError::UnknownChannel(code) => BodyError::Invalid(vec![Violation::new(
            format!("samples.channel_{code}"),
            "unknown_field",
            "is not a channel that a cycle has",
        )]),
        WireError::ChannelTwice(channel) => BodyError::Invalid(vec![Violation::new(
            format!("samples.{}", channel.as_str()),
            "duplicate_field",
            "is given twice",
        )]),
        WireError::LargeInteger(channel) => BodyError::Invalid(vec![Violation::new(
            format!("samples.{}", channel.map_or("time_ms", |channel| channel.as_str())),
            "out_of_range",
            "holds an integer that is not below 2^53",
        )]),
        WireError::TooManySamples(length) => BodyError::Invalid(vec![Violation::new(
            "samples",
            "too_many_samples",
            format!("may hold at most {max_samples} samples, has {length}"),
        )]),
    })
}

impl From<Post> for Body {
    fn from(post: Post) -> Self {
        let [
            energy_joules,
            duration_ms,
            max_depth_mm,
            max_spindle_load_percent,
            max_feed_drive_load_percent,
            mean_spindle_load_percent,
            mean_feed_drive_load_percent,
            operator_override_percent,
            cutting_speed_m_min,
            feed_mm_rev,
            spindle_power_watts,
            thrust_newtons,
            edge_wear_mm,
        ] = post.reported.map(|value| value.map(Number));
        Self {
            cycle_id: post.cycle_id,
            tool: post.tool,
            operation: post.operation,
            started_at: Started::At(post.started_at),
            seq: post.seq,
            process: post.process,
            strategy: post.strategy,
            law_version: post.law_version,
            profile: post.profile.map(|(id, version)| ProfileBody { id, version }),
            recommendation_id: post.recommendation_id,
            reference_cycle: post.reference_cycle,
            spindle_speed_rpm: post.spindle_speed_rpm.map(Number),
            outcome: post.outcome,
            samples: post.samples.map(|PostedSamples { period_ms, time_ms, columns, places }| SamplesBody {
                period_ms,
                time_ms,
                columns,
                places,
            }),
            reported: Some(ReportedBody {
                energy_joules,
                duration_ms,
                max_depth_mm,
                max_spindle_load_percent,
                max_feed_drive_load_percent,
                mean_spindle_load_percent,
                mean_feed_drive_load_percent,
                operator_override_percent,
                cutting_speed_m_min,
                feed_mm_rev,
                spindle_power_watts,
                thrust_newtons,
                edge_wear_mm,
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::decode;
    use feedwright_core::units::Timestamp;
    use feedwright_store::{codec, wire};

    const JSON: &[u8] = include_bytes!("../../../../../tests/golden/cycle.json");
    const FRAME: &[u8] = include_bytes!("../../../../../tests/golden/cycle.bin");

    #[test]
    fn both_forms_are_the_same_cycle_with_the_same_hash() {
        let now = Timestamp::from_micros(1_777_874_400_250_001);
        let machine = "M1".try_into().unwrap();
        let json = decode(&machine, JSON, 100, now).unwrap();
        let frame = decode(&machine, FRAME, 100, now).unwrap();
        assert_eq!(json, frame);
        assert_eq!(codec::content_hash(&json), codec::content_hash(&frame));
        assert_eq!(codec::encode(&json), codec::encode(&frame));
        assert_eq!(wire::encode(&json), FRAME);
    }
}
