//! A group asks first, under locks that other servers may hold: nothing is assumed here, and there is no value of an
//! assumption.

use crate::error::StoreResult;
use crate::postgres::Conn;
use crate::postgres::engine::Heads;
use crate::rows::{CycleRow, Rest};
use crate::work::Written;
use feedwright_core::ids::ToolId;
use feedwright_core::units::Timestamp;
use std::collections::BTreeSet;
use std::convert::Infallible;
use std::sync::Arc;

pub(in crate::postgres) const MAY_ASSUME: bool = false;

/// There is none.
pub(in crate::postgres) type Assumption<'h> = (Infallible, &'h Heads);

pub(in crate::postgres) const fn assume<'h>(
    _heads: &'h Heads,
    _tools: &'h BTreeSet<&'h ToolId>,
) -> Option<Assumption<'h>> {
    None
}

pub(in crate::postgres) async fn begin_assumed(
    _conn: &mut Conn,
    (never, _): Assumption<'_>,
    _cycles: &[Arc<CycleRow>],
) -> StoreResult<bool> {
    match never {}
}

pub(in crate::postgres) fn write_assumed(
    _conn: &mut Conn,
    (never, _): Assumption<'_>,
    _cycles: &[Arc<CycleRow>],
    _rest: &Rest<'_>,
    _now: Timestamp,
) -> StoreResult<Option<Written>> {
    match never {}
}

/// Whoever began the transaction ends it.
pub(in crate::postgres) async fn undo(_conn: &mut Conn) {}
