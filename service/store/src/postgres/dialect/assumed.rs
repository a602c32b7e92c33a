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
use std::sync::Arc;

pub(in crate::postgres) const MAY_ASSUME: bool = false;

/// There is none.
#[derive(Debug)]
pub(in crate::postgres) enum Assumption {}

pub(in crate::postgres) const fn assume(_heads: &Heads, _tools: &BTreeSet<&ToolId>) -> Option<Assumption> {
    None
}

pub(in crate::postgres) async fn begin_assumed(
    _conn: &mut Conn,
    assumption: &Assumption,
    _cycles: &[Arc<CycleRow>],
) -> StoreResult<bool> {
    match *assumption {}
}

pub(in crate::postgres) async fn write_assumed(
    _conn: &mut Conn,
    assumption: &Assumption,
    _cycles: &[Arc<CycleRow>],
    _rest: &Rest<'_>,
    _now: Timestamp,
) -> StoreResult<Option<Written>> {
    match *assumption {}
}

/// Whoever began the transaction ends it.
pub(in crate::postgres) async fn undo(_conn: &mut Conn) {}
