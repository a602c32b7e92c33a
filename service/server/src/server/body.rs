//! A request's body that has to keep moving.

use bytes::Bytes;
use hyper::body::{Body, Frame, Incoming, SizeHint};
use std::error::Error;
use std::future::Future;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::time::{Instant, Sleep, sleep_until};

/// The body stood still for too long, or took too long in all.
#[derive(Debug, thiserror::Error)]
#[error("the body did not arrive in time")]
pub struct BodyTooSlow;

/// Ends with [`BodyTooSlow`] where nothing came for `stall`, or not everything within `total`.
pub(super) struct TimedBody {
    inner: Incoming,
    stall: Duration,
    total: Duration,
    // Made with the first wait: most bodies come with their head and never wait.
    waits: Option<Waits>,
}

struct Waits {
    all: Instant,
    next: Pin<Box<Sleep>>,
    waiting: bool,
}

impl TimedBody {
    pub(super) const fn new(inner: Incoming, stall: Duration, total: Duration) -> Self {
        Self { inner, stall, total, waits: None }
    }
}

impl Body for TimedBody {
    type Data = Bytes;
    type Error = Box<dyn Error + Send + Sync>;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Self::Error>>> {
        let this = &mut *self;
        if let Poll::Ready(frame) = Pin::new(&mut this.inner).poll_frame(cx) {
            if let Some(waits) = &mut this.waits {
                waits.waiting = false;
            }
            return Poll::Ready(frame.map(|frame| frame.map_err(Into::into)));
        }
        let now = Instant::now();
        let (stall, total) = (this.stall, this.total);
        let waits = this.waits.get_or_insert_with(|| Waits {
            all: now + total,
            next: Box::pin(sleep_until(now + stall.min(total))),
            waiting: true,
        });
        if !waits.waiting {
            waits.waiting = true;
            waits.next.as_mut().reset(waits.all.min(now + stall));
        }
        waits.next.as_mut().poll(cx).map(|()| Some(Err(BodyTooSlow.into())))
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}
