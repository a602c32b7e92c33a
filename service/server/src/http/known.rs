//! Whether what a question of cycles names is known: a name that was mistyped is no empty answer.

use super::problem::Problem;
use feedwright_store::{CycleFilter, PointColumns, Store};

/// 404 where a tool or an operation is neither registered nor met in any cycle. Asked where there was nothing to answer.
pub(super) async fn known(store: &dyn Store, filter: &CycleFilter) -> Result<(), Problem> {
    if let Some(tool) = &filter.tool
        && store.tool(tool).await?.is_none()
        && !is_met(store, CycleFilter { tool: Some(tool.clone()), ..CycleFilter::default() }).await?
    {
        return Err(Problem::not_found("tool", tool.as_str()));
    }
    if let Some(operation) = &filter.operation
        && store.operation(operation).await?.is_none()
        && !is_met(store, CycleFilter { operation: Some(operation.clone()), ..CycleFilter::default() })
            .await?
    {
        return Err(Problem::not_found("operation", operation.as_str()));
    }
    Ok(())
}

async fn is_met(store: &dyn Store, filter: CycleFilter) -> Result<bool, Problem> {
    Ok(!store.last_points(&filter, PointColumns::Energy, 1).await?.is_empty())
}
