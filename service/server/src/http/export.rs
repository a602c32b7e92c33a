//! Tables as answers: streamed piece by piece, so many at a time.

use super::problem::Problem;
use crate::table::{Field, Format, Row, TableError, writer};
use axum::body::Body;
use axum::response::{IntoResponse, Response};
use bytes::{Buf, Bytes};
use futures_util::stream::{self, Stream, StreamExt};
use http::{HeaderValue, header};
use hyper::body::{Body as HttpBody, Frame, SizeHint};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use utoipa::ToSchema;

/// The table as a file.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
#[expect(dead_code, reason = "the schema of what is written piece by piece")]
pub struct File(Vec<u8>);

/// Tables and whole recordings that are held in memory at a time: each may be a cycle of the largest size.
const MAX_LARGE: usize = 16;
/// Small ones besides, so that they do not wait for clients that read large ones slowly.
const MAX_SMALL: usize = 32;
/// A client waits so long for its turn.
const PATIENCE: Duration = Duration::from_secs(10);
/// Values of an answer that is small: 2 MiB as doubles.
const MOST_SMALL_VALUES: usize = 1 << 18;
/// Bytes of a text for which no turn is kept while it is sent.
const MOST_SMALL_BYTES: u64 = 256 << 10;
/// Rows of samples that are written at a time.
pub const PIECE: usize = 8192;

/// How many are under way.
#[derive(Debug, Clone)]
pub struct Exports {
    large: Arc<Semaphore>,
    small: Arc<Semaphore>,
}

impl Default for Exports {
    fn default() -> Self {
        Self { large: Arc::new(Semaphore::new(MAX_LARGE)), small: Arc::new(Semaphore::new(MAX_SMALL)) }
    }
}

/// The right to hold an answer in memory. It goes along with the answer until that is read, or nobody reads it any more.
#[derive(Debug)]
pub struct Turn {
    _permit: OwnedSemaphorePermit,
}

/// What an answer takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Size {
    /// Some 2 MiB.
    Small,
    /// As much as the largest cycle, or as all cycles of the fleet amount to.
    Large,
}

impl Size {
    /// Of so many values.
    pub const fn of(values: usize) -> Self {
        if values > MOST_SMALL_VALUES { Self::Large } else { Self::Small }
    }
}

impl Exports {
    /// A turn of any size, where nobody has to be waited for.
    pub fn at_once(&self) -> Option<Turn> {
        self.large.clone().try_acquire_owned().ok().map(|permit| Turn { _permit: permit })
    }

    /// A turn for what turned out to be of that size: who holds little does not keep others from holding much.
    pub fn suited(&self, turn: Turn, size: Size) -> Turn {
        let small = (size == Size::Small).then(|| self.small.clone().try_acquire_owned().ok()).flatten();
        small.map_or(turn, |permit| Turn { _permit: permit })
    }

    /// A turn; 503 where too many others have one for too long.
    pub async fn turn(&self, size: Size) -> Result<Turn, Problem> {
        let (turns, most) = match size {
            Size::Small => (&self.small, MAX_SMALL),
            Size::Large => (&self.large, MAX_LARGE),
        };
        let permit = tokio::time::timeout(PATIENCE, turns.clone().acquire_owned()).await;
        permit.ok().and_then(Result::ok).map(|permit| Turn { _permit: permit }).ok_or_else(|| {
            let detail = format!("{most} answers of that size are under way already");
            Problem::unavailable("too_many_exports", detail, 5)
        })
    }
}

/// Bytes of a long text that are handed over to be sent at a time.
const SLICE: usize = 64 << 10;

/// An answer that keeps its turn until it is read, where it is long.
pub fn held(response: Response, turn: Turn) -> Response {
    if response.body().size_hint().exact().is_some_and(|bytes| bytes <= MOST_SMALL_BYTES) {
        return response;
    }
    response.map(|body| Body::new(Held { body, rest: Bytes::new(), _turn: turn }))
}

/// A body in slices: a connection takes one when it has sent those before, and would else take the whole text, and leave what
/// goes along with it.
struct Held {
    body: Body,
    /// What was taken of the body, and is not sent yet.
    rest: Bytes,
    _turn: Turn,
}

impl HttpBody for Held {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Self::Error>>> {
        if self.rest.is_empty() {
            match ready!(Pin::new(&mut self.body).poll_frame(cx)).transpose()?.map(Frame::into_data) {
                None => return Poll::Ready(None),
                Some(Err(other)) => return Poll::Ready(Some(Ok(other))),
                Some(Ok(data)) => self.rest = data,
            }
        }
        // A copy: what is not sent yet of a part of the text would keep all of it.
        let most = self.rest.len().min(SLICE);
        let slice = Bytes::copy_from_slice(&self.rest[..most]);
        self.rest.advance(most);
        Poll::Ready(Some(Ok(Frame::data(slice))))
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_empty() && self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        let (mut hint, rest) = (self.body.size_hint(), self.rest.len() as u64);
        if let Some(upper) = hint.upper() {
            hint.set_upper(upper + rest);
        }
        hint.set_lower(hint.lower() + rest);
        hint
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
    turn: Turn,
    format: Format,
    name: &str,
    fields: Vec<Field>,
    pieces: S,
) -> Result<Response, Problem>
where
    S: Stream<Item = Result<Vec<Row>, TableError>> + Send + 'static,
{
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
