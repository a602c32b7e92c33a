//! What two contents differ in that were sent under one id.

use super::{Cycle, CycleDraft, Samples, TimeBase};

/// Paths of the fields, as in a cycle's body, in which `sent` is another content than `stored`; empty where they are
/// one content. Of a column the first value that differs is named, or the column where one of them has none or another
/// number of samples.
///
/// `samples` of the stored cycle say what is known of them: `None` where they are not kept any more, so that nothing is
/// said of them.
pub fn differences(stored: &CycleDraft, samples: Option<Option<&Samples>>, sent: &Cycle) -> Vec<String> {
    let mut paths: Vec<String> = [
        ("tool", stored.tool == sent.tool),
        ("operation", stored.operation == sent.operation),
        ("started_at", stored.started_at == sent.started_at),
        ("seq", stored.seq == sent.seq),
        ("process", stored.process == sent.process),
        ("strategy", stored.strategy == sent.strategy),
        ("law_version", stored.law_version == sent.law_version),
        ("profile", stored.profile == sent.profile),
        ("recommendation_id", stored.recommendation == sent.recommendation),
        ("reference_cycle", stored.reference == sent.reference),
        ("spindle_speed_rpm", stored.spindle_speed_rpm == sent.spindle_speed_rpm),
        ("outcome", stored.outcome == sent.outcome),
    ]
    .into_iter()
    .filter(|(_, same)| !same)
    .map(|(path, _)| path.to_owned())
    .collect();
    let (reported, other) = (&stored.reported, &sent.reported);
    let reported = reported.fields().into_iter().chain(reported.cut.fields());
    let other = other.fields().into_iter().chain(other.cut.fields());
    let differ = reported.zip(other).filter(|((_, _, stored), (_, _, sent))| stored != sent);
    paths.extend(differ.map(|((name, ..), _)| format!("reported.{name}")));
    match (samples, &sent.samples) {
        (None, _) | (Some(None), None) => {}
        (Some(Some(stored)), Some(sent)) => of_samples(stored, sent, &mut paths),
        (Some(_), _) => paths.push("samples".to_owned()),
    }
    paths
}

fn of_samples(stored: &Samples, sent: &Samples, paths: &mut Vec<String>) {
    match (stored.time(), sent.time()) {
        (TimeBase::Period { period_ms: stored }, TimeBase::Period { period_ms: sent }) => {
            if differ(*stored, *sent) {
                paths.push("samples.period_ms".to_owned());
            }
        }
        (TimeBase::Stamps { time_ms: stored }, TimeBase::Stamps { time_ms: sent }) => {
            paths.extend(of_column("time_ms", Some(stored), Some(sent)));
        }
        _ => paths.extend(["samples.period_ms".to_owned(), "samples.time_ms".to_owned()]),
    }
    for channel in super::Channel::ALL.iter().copied() {
        paths.extend(of_column(channel.as_str(), stored.column(channel), sent.column(channel)));
    }
}

fn of_column(name: &str, stored: Option<&[f64]>, sent: Option<&[f64]>) -> Option<String> {
    match (stored, sent) {
        (None, None) => None,
        (Some(stored), Some(sent)) if stored.len() == sent.len() => {
            let at = stored.iter().zip(sent).position(|(stored, sent)| differ(*stored, *sent))?;
            Some(format!("samples.{name}[{at}]"))
        }
        _ => Some(format!("samples.{name}")),
    }
}

/// A content is one to the last bit, but a zero has no sign.
fn differ(stored: f64, sent: f64) -> bool {
    (stored + 0.0).to_bits() != (sent + 0.0).to_bits()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cycle::{Channel, Outcome, ProfileVersion, Reported};
    use crate::ids::{CycleId, MachineId, OperationId, ProfileId, RecommendationId, ToolId};
    use crate::units::{Process, Strategy, Timestamp};

    fn draft(change: impl FnOnce(&mut CycleDraft)) -> Cycle {
        let mut draft = CycleDraft {
            machine: MachineId::try_from("M1").unwrap(),
            id: CycleId::try_from("c1").unwrap(),
            tool: ToolId::try_from("T1").unwrap(),
            operation: OperationId::try_from("O1").unwrap(),
            started_at: Timestamp::from_micros(7),
            seq: Some(1),
            process: Some(Process::Friction),
            strategy: None,
            law_version: None,
            profile: None,
            recommendation: None,
            reference: None,
            spindle_speed_rpm: Some(2500.0),
            outcome: Outcome::Completed,
            samples: Some(samples(10.0, &[(Channel::DepthMm, vec![0.0, 0.5, 1.0])])),
            reported: Reported { energy_joules: Some(0.0), ..Reported::default() },
        };
        change(&mut draft);
        Cycle::new(draft).unwrap()
    }

    fn samples(period_ms: f64, columns: &[(Channel, Vec<f64>)]) -> Samples {
        Samples::new(TimeBase::Period { period_ms }, columns.to_vec(), 10).unwrap()
    }

    fn found(change: impl FnOnce(&mut CycleDraft)) -> Vec<String> {
        let stored = draft(|_| {});
        differences(&stored, Some(stored.samples.as_ref()), &draft(change))
    }

    #[test]
    fn one_content_differs_in_nothing() {
        assert!(found(|_| {}).is_empty());
        assert!(found(|sent| sent.reported.energy_joules = Some(-0.0)).is_empty(), "a zero has no sign");
    }

    #[test]
    fn every_field_is_named_as_it_is_sent() {
        let all = found(|sent| {
            sent.tool = ToolId::try_from("T2").unwrap();
            sent.operation = OperationId::try_from("O2").unwrap();
            sent.started_at = Timestamp::from_micros(8);
            sent.seq = None;
            sent.process = Some(Process::Drilling);
            sent.strategy = Some(Strategy::FLin);
            sent.law_version = Some("2".to_owned());
            sent.profile = Some(ProfileVersion { profile: ProfileId::try_from("P").unwrap(), version: 1 });
            sent.recommendation = Some(RecommendationId::try_from("r").unwrap());
            sent.reference = Some(false);
            sent.spindle_speed_rpm = Some(2400.0);
            sent.outcome = Outcome::Aborted;
            sent.reported.energy_joules = None;
            sent.reported.cut.feed_mm_rev = Some(0.1);
            sent.samples = None;
        });
        let expected = [
            "tool",
            "operation",
            "started_at",
            "seq",
            "process",
            "strategy",
            "law_version",
            "profile",
            "recommendation_id",
            "reference_cycle",
            "spindle_speed_rpm",
            "outcome",
            "reported.energy_joules",
            "reported.feed_mm_rev",
            "samples",
        ];
        assert_eq!(all, expected);
    }

    #[test]
    fn of_samples_the_first_value_is_named() {
        let column = |values: [f64; 3]| vec![(Channel::DepthMm, values.to_vec())];
        let sent = |samples| move |sent: &mut CycleDraft| sent.samples = Some(samples);
        assert_eq!(found(sent(samples(10.0, &column([0.0, 0.6, 1.1])))), ["samples.depth_mm[1]"]);
        assert_eq!(found(sent(samples(8.0, &column([0.0, 0.5, 1.0])))), ["samples.period_ms"]);
        let shorter = samples(10.0, &[(Channel::DepthMm, vec![0.0, 0.5])]);
        assert_eq!(found(sent(shorter)), ["samples.depth_mm"]);
        let other = samples(10.0, &[(Channel::SpindleLoadPercent, vec![1.0; 3])]);
        assert_eq!(found(sent(other)), ["samples.depth_mm", "samples.spindle_load_percent"]);
        let stamped = TimeBase::Stamps { time_ms: vec![10.0, 20.0, 30.0] };
        let stamped = Samples::new(stamped, column([0.0, 0.5, 1.0]), 10).unwrap();
        assert_eq!(found(sent(stamped)), ["samples.period_ms", "samples.time_ms"]);
    }

    #[test]
    fn nothing_is_said_of_samples_that_are_gone() {
        let (stored, sent) = (draft(|_| {}), draft(|sent| sent.samples = None));
        assert!(differences(&stored, None, &sent).is_empty());
    }
}
