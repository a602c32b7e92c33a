//! Sections of a proposal in words: which limit binds, what was gained, how sure.

use super::plan::{Binding, Envelope, Planner};
use super::predict::Expected;
use super::profile::feed_at;
use crate::feed::profile::SectionKind;
use crate::friction::program::Knot;

/// Both loads over idle below this share of what is allowed over idle: the tool forms nothing.
const IDLE_SHARE: f64 = 0.12;

/// Way below which a section is no section, mm.
const SHORTEST_MM: f64 = 0.3;

/// How far below the envelope a feed is held by its knots and by nothing else.
const UNDER_ENVELOPE: f64 = 0.03;

/// One section of a proposal.
#[derive(Debug, Clone, PartialEq)]
pub struct Section {
    /// What happens in it.
    pub kind: SectionKind,
    /// Where it begins, mm.
    pub from_mm: f64,
    /// Where it ends, mm.
    pub to_mm: f64,
    /// Expected time in it, s.
    pub time_s: f64,
    /// Time gained over the last tried profile, s; negative where it became slower.
    pub gained_s: f64,
    /// What bounds the feed, with the share of the section's time, largest share first.
    pub bindings: Vec<(Binding, f64)>,
    /// Largest expected feed-drive load, percent; `None` where nothing is known.
    pub peak_feed_drive_percent: Option<f64>,
    /// Largest expected spindle load, percent.
    pub peak_spindle_percent: Option<f64>,
    /// Smallest probability in it that an expected load is at or below L_set.
    pub confidence: f64,
    /// The same in a sentence for a person.
    pub text: String,
}

pub(super) fn sections(
    planner: &Planner<'_>,
    envelope: &Envelope,
    nodes: &[Expected],
    last: &[Knot],
) -> Vec<Section> {
    let kinds = kinds(planner, nodes);
    let mut sections = Vec::new();
    let mut from = 0;
    for node in 1..=kinds.len() {
        if node == kinds.len() || kinds[node] != kinds[from] {
            sections.push(section(planner, envelope, nodes, last, kinds[from], from, node));
            from = node;
        }
    }
    sections
}

fn kinds(planner: &Planner<'_>, nodes: &[Expected]) -> Vec<SectionKind> {
    let grid = &planner.relation.grid;
    let shortest = super::grid::whole(SHORTEST_MM / grid.step_mm()).max(1);
    let set = planner.settings.set_percent();
    let idle = planner.relation.idle;
    let travels = |node: &Expected| {
        node.load.is_some_and(|load| {
            (0..2).all(|drive| load[drive] - idle[drive] < IDLE_SHARE * (set[drive] - idle[drive]))
        })
    };
    let heating =
        nodes.iter().enumerate().position(|(node, _)| grid.depth_mm(node) > planner.heating_until_mm);
    let heating = if planner.heating_until_mm > 0.0 { heating.unwrap_or(nodes.len()) } else { 0 };
    let mut kinds = vec![SectionKind::Forming; nodes.len()];
    kinds[..heating].fill(SectionKind::Heating);
    // The tool travels idly only after it has formed something; what comes after that is the flange.
    let formed = (heating..nodes.len()).find(|&node| !travels(&nodes[node])).unwrap_or(nodes.len());
    let mut at = formed;
    let mut travelled = false;
    while at < nodes.len() {
        let mut end = at;
        while end < nodes.len() && travels(&nodes[end]) {
            end += 1;
        }
        if end >= at + shortest {
            kinds[at..end].fill(SectionKind::IdleTravel);
            travelled = true;
        } else if travelled {
            end = end.max(at + 1);
            kinds[at..end].fill(SectionKind::Flange);
        }
        at = end.max(at + 1);
    }
    kinds
}

fn section(
    planner: &Planner<'_>,
    envelope: &Envelope,
    nodes: &[Expected],
    last: &[Knot],
    kind: SectionKind,
    from: usize,
    to: usize,
) -> Section {
    let grid = &planner.relation.grid;
    let mut shares: Vec<(Binding, f64)> = Vec::new();
    let (mut time_s, mut before_s, mut confidence) = (0.0, 0.0, 1.0_f64);
    let (mut feed_peak, mut spindle_peak): (Option<f64>, Option<f64>) = (None, None);
    for (node, expected) in nodes.iter().enumerate().take(to).skip(from) {
        time_s += expected.time_s;
        if node > 0 {
            let (a, b) = (feed_at(last, grid.depth_mm(node - 1)), feed_at(last, grid.depth_mm(node)));
            before_s += grid.step_mm() * 120.0 / (a + b);
        }
        let held = expected.feed < envelope.feed[node] * (1.0 - UNDER_ENVELOPE);
        let binding = if held { Binding::Knots } else { envelope.binding[node] };
        match shares.iter_mut().find(|(other, _)| *other == binding) {
            Some((_, share)) => *share += expected.time_s,
            None => shares.push((binding, expected.time_s)),
        }
        if let Some(load) = expected.load {
            feed_peak = Some(feed_peak.map_or(load[0], |peak| peak.max(load[0])));
            spindle_peak = Some(spindle_peak.map_or(load[1], |peak| peak.max(load[1])));
        }
        confidence = confidence.min(planner.confidence(expected));
    }
    for (_, share) in &mut shares {
        *share = if time_s > 0.0 { *share / time_s } else { 0.0 };
    }
    shares.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    let (from_mm, to_mm) = (grid.depth_mm(from.saturating_sub(1)), grid.depth_mm(to - 1));
    let mut section = Section {
        kind,
        from_mm,
        to_mm,
        time_s,
        gained_s: before_s - time_s,
        bindings: shares,
        peak_feed_drive_percent: feed_peak,
        peak_spindle_percent: spindle_peak,
        confidence,
        text: String::new(),
    };
    section.text = text(planner, &section);
    section
}

fn text(planner: &Planner<'_>, section: &Section) -> String {
    let settings = planner.settings;
    let binding = section.bindings.first().map_or(Binding::Unknown, |first| first.0);
    let limit = match binding {
        Binding::Heating => "the tool maker's feed while heating".to_owned(),
        Binding::Bushing => "the moderate feed in the last part of the bushing".to_owned(),
        Binding::LargestFeed => format!("the largest feed of {:.0} mm/min", settings.feed_max_mm_min),
        Binding::SmallestFeed => "the smallest feed; the load would ask for less".to_owned(),
        Binding::FeedDriveLoad => {
            format!("the feed drive's set load of {} %", settings.set_feed_drive_percent)
        }
        Binding::SpindleLoad => format!("the spindle's set load of {} %", settings.set_spindle_percent),
        Binding::Acceleration => "the axis' acceleration".to_owned(),
        Binding::SeenOverload => "a load above its set load that the last tried cycle showed".to_owned(),
        Binding::Step => "the step from the last tried profile".to_owned(),
        Binding::Unknown => "nothing known at this depth, so the last feed stays".to_owned(),
        Binding::Objective => "the cost: faster would take more energy than the time is worth".to_owned(),
        Binding::Knots => "the number of knots".to_owned(),
    };
    let change = if section.gained_s >= 0.005 {
        format!("{:.2} s gained", section.gained_s)
    } else if section.gained_s <= -0.005 {
        format!("{:.2} s slower", -section.gained_s)
    } else {
        "no change in time".to_owned()
    };
    format!(
        "{:.1} to {:.1} mm: bound by {limit}; {change}; {:.0} % sure that the loads stay at or below L_set",
        section.from_mm,
        section.to_mm,
        (section.confidence * 100.0).floor()
    )
}
