//! The energies of a tool's newest cycles, of what is kept in memory ([`Recent`]) as far as that is still what is stored.

use super::{Engine, series};
use crate::error::StoreResult;
use crate::lanes::Lane;
use crate::point::{CyclePoint, LastPoints, PointColumns};
use crate::recent::{Kept, Recent};
use crate::record::CycleFilter;
use feedwright_core::ids::ToolId;
use std::sync::Arc;

/// Cycles that came since a tool was asked for, beyond which all that is wanted of it is read again.
const MOST_NEW: i64 = 128;
/// Cycles that may come between two statements, and the one before them, which has to be known.
const SPARE: i64 = 8;

impl Engine {
    /// The energies of a tool's newest cycles, of what is kept where nothing else is stored by now.
    pub(super) async fn last_energies(
        &self,
        recent: &Recent,
        tool: &ToolId,
        limit: u32,
    ) -> StoreResult<LastPoints> {
        let (kept, groups) = (recent.get(tool), recent.groups());
        if let Some(kept) = &kept {
            if let Some(points) =
                (kept.fresh && self.is_alone()).then(|| kept.answer(limit as usize)).flatten()
            {
                return Ok(points);
            }
            let mut lent = self.reader(Lane::Usual).await?;
            let cycles = self.in_time(series::cycles_of_tool(&mut lent, tool)).await?;
            lent.settle();
            let new = cycles.map_or(i64::MAX, |cycles| cycles.saturating_sub(kept.cycles));
            if let Some(points) = (new == 0).then(|| kept.answer(limit as usize)).flatten() {
                recent.confirm(tool, kept.cycles, groups);
                return Ok(points);
            }
            if (1..=MOST_NEW).contains(&new)
                && let Some(kept) = self.with_newest(tool, kept, new + SPARE).await?
                && let Some(points) = kept.answer(limit as usize)
            {
                recent.keep(tool, kept, groups);
                return Ok(points);
            }
        }
        let wanted = kept.map_or(limit, |kept| limit.max(u32::try_from(kept.asked).unwrap_or(limit)));
        let (cycles, points) = self.counted_points(tool, wanted).await?;
        let Some(cycles) = cycles else {
            return Ok(LastPoints::newest(Arc::new(points), limit as usize));
        };
        // What is counted is a cache too: where it is damaged, nothing rests on it.
        let agree = i64::try_from(points.len()) == Ok(cycles.min(i64::from(wanted)));
        let kept = Kept::new(cycles, points, wanted as usize);
        let points = kept.newest(limit as usize);
        if agree {
            recent.keep(tool, kept, groups);
        }
        Ok(points)
    }

    /// What is kept of a tool with the cycles that came since, where they are few and newer than it.
    async fn with_newest(&self, tool: &ToolId, kept: &Kept, most: i64) -> StoreResult<Option<Kept>> {
        let (cycles, mut points) = self.counted_points(tool, u32::try_from(most).unwrap_or(0)).await?;
        let new = cycles.and_then(|cycles| usize::try_from(cycles.saturating_sub(kept.cycles)).ok());
        points.reverse();
        Ok(new.and_then(|new| kept.and(new, points)))
    }

    /// How many cycles of a tool are stored, where that is known, and the newest of them, of one moment.
    async fn counted_points(&self, tool: &ToolId, limit: u32) -> StoreResult<(Option<i64>, Vec<CyclePoint>)> {
        let of_tool = CycleFilter { tool: Some(tool.clone()), ..CycleFilter::default() };
        let tool = tool.clone();
        let read = self.snapshot(Lane::Usual, move |conn| {
            Box::pin(async move {
                let cycles = series::cycles_of_tool(conn, &tool).await?;
                Ok((cycles, series::last_points(conn, &of_tool, PointColumns::Energy, limit).await?))
            })
        });
        read.await
    }
}
