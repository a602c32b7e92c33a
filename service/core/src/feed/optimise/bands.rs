//! Profiles per wear band, where wear shifts the load.

use super::profile::Knots;
use super::propose::{Proposal, optimise};
use super::recording::RecordedCycle;
use super::settings::{Settings, SettingsParams};
use crate::friction::error::{Invalid, InvalidCode};
use crate::shown::Shown;

/// Most bands.
pub const MOST_BANDS: usize = 8;

/// Gain in time below which a band is not worth a profile of its own, relative.
const WORTH_A_BAND: f64 = 0.01;

/// A profile for a range of wear.
#[derive(Debug, Clone, PartialEq)]
pub struct WearBand {
    /// Wear from which it is meant, as energy over that of the new tool.
    pub from: f64,
    /// Wear up to which it is planned to hold.
    pub to: f64,
    /// The profile, planned at `to`.
    pub proposal: Proposal,
}

/// Checks edges of bands before anything is computed: 2 to 9 of them, increasing, within 0.5 to 3.
///
/// # Errors
/// With the field `edges`, or one of them.
pub fn check_edges(edges: &[f64]) -> Result<(), Invalid> {
    if !(2..=MOST_BANDS + 1).contains(&edges.len()) {
        let text = format!("2 to {} edges, not {}", MOST_BANDS + 1, edges.len());
        return Err(Invalid::new("edges", InvalidCode::OutOfRange, text));
    }
    for (at, edge) in edges.iter().enumerate() {
        if !(0.5..=3.0).contains(edge) {
            let text = format!("must be within 0.5 to 3, is {}", Shown(*edge));
            return Err(Invalid::new(format!("edges[{at}]"), InvalidCode::OutOfRange, text));
        }
        if at > 0 && *edge <= edges[at - 1] {
            let text = "must be greater than the edge before";
            return Err(Invalid::new(format!("edges[{at}]"), InvalidCode::NotIncreasing, text));
        }
    }
    Ok(())
}

/// A proposal for each band between `edges` (wear, increasing, 2 to 9 of them), planned at the band's upper edge; a band
/// whose own profile gains less than 1 % over the next worn one's is joined to it.
///
/// # Errors
/// When edges are out of range or do not increase, when no cycle tells its wear, or as [`optimise`].
pub fn wear_bands(
    cycles: &[RecordedCycle],
    settings: &Settings,
    last: Option<&Knots>,
    edges: &[f64],
) -> Result<Vec<WearBand>, Invalid> {
    check_edges(edges)?;
    if cycles.iter().all(|cycle| cycle.wear_ratio.is_none()) {
        let text = "no cycle tells the wear at which it ran";
        return Err(Invalid::new("cycles", InvalidCode::NotIdentifiable, text));
    }
    let mut bands: Vec<WearBand> = Vec::new();
    for pair in edges.windows(2).rev() {
        let params = SettingsParams { wear_ratio: Some(pair[1]), ..SettingsParams::clone(settings) };
        let proposal = optimise(cycles, &Settings::new(params)?, last)?;
        let next = bands.last_mut().filter(|next| {
            let (own, worn) = (&proposal.prediction.time_s, &next.proposal.prediction.time_s);
            own.expected > worn.expected * (1.0 - WORTH_A_BAND)
        });
        match next {
            Some(next) => next.from = pair[0],
            None => bands.push(WearBand { from: pair[0], to: pair[1], proposal }),
        }
    }
    bands.reverse();
    Ok(bands)
}
