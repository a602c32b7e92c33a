//! Tables as answers: streamed piece by piece, so many at a time.

use super::problem::Problem;
use crate::state::AppState;
use crate::table::{Field, Format, Row, TableError, writer};
use axum::body::Body;
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures_util::stream::{self, Stream, StreamExt};
use http::{HeaderValue, header};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Tables and whole recordings that are held in memory at a time: each may be a cycle of the largest size.
const MAX_EXPORTS: usize = 16;
/// A client waits so long for its turn.
const PATIENCE: Duration = Duration::from_secs(10);
/// Rows of samples that are written at a time.
pub const PIECE: usize = 8192;

/// How many are under way.
#[derive(Debug, Clone)]
pub struct Exports(Arc<Semaphore>);

impl Default for Exports {
    fn default() -> Self {
        Self(Arc::new(Semaphore::new(MAX_EXPORTS)))
    }
}

impl Exports {
    /// A turn; 503 where too many others have one for too long.
    pub async fn turn(&self) -> Result<OwnedSemaphorePermit, Problem> {
        let turn = tokio::time::timeout(PATIENCE, self.0.clone().acquire_owned()).await;
        turn.ok().and_then(Result::ok).ok_or_else(|| {
            let detail = format!("{MAX_EXPORTS} large answers are under way already");
            Problem::unavailable("too_many_exports", detail, 5)
        })
    }
}

impl From<TableError> for Problem {
    fn from(error: TableError) -> Self {
        match error {
            TableError::Store(error) => error.into(),
            TableError::Form(error) => Self::internal(error.to_string()),
        }
    }
}

/// Answers with a table of that name. What fails before the first piece is a problem document; what fails later breaks
/// the body off, which every client sees.
pub async fn table<S>(
    state: &AppState,
    format: Format,
    name: &str,
    fields: Vec<Field>,
    pieces: S,
) -> Result<Response, Problem>
where
    S: Stream<Item = Result<Vec<Row>, TableError>> + Send + 'static,
{
    let turn = state.exports.turn().await?;
    let fields: Arc<[Field]> = fields.into();
    let mut writer = writer(format, &fields)?;
    // Asked once more after its end, where there is no piece at all.
    let mut pieces = Box::pin(pieces.fuse());
    let first = match pieces.next().await {
        Some(rows) => writer.rows(&rows?)?,
        None => Vec::new(),
    };
    let rest = stream::try_unfold((Some(writer), pieces, turn), |(writer, mut pieces, turn)| async move {
        let Some(mut writer) = writer else { return Ok(None) };
        // Some forms keep several pieces together.
        while let Some(rows) = pieces.next().await {
            let bytes = writer.rows(&rows?)?;
            if !bytes.is_empty() {
                return Ok(Some((Bytes::from(bytes), (Some(writer), pieces, turn))));
            }
        }
        Ok::<_, TableError>(Some((Bytes::from(writer.finish()?), (None, pieces, turn))))
    });
    let body = Body::from_stream(stream::iter([Ok(Bytes::from(first))]).chain(rest));
    let headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static(format.content_type())),
        (header::VARY, HeaderValue::from_static("accept")),
    ];
    let mut response = (headers, body).into_response();
    if format != Format::Json
        && let Ok(named) =
            HeaderValue::try_from(format!("attachment; filename=\"{name}.{}\"", format.extension()))
    {
        response.headers_mut().insert(header::CONTENT_DISPOSITION, named);
    }
    Ok(response)
}
