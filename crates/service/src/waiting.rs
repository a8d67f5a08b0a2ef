//! Which connections of a server wait for their clients, and how many reads are answered.
//!
//! A connection waits until the request with its body has arrived, and again after the answer. When
//! all places are taken, the one that has waited longest makes room: clients that hold half-sent
//! requests delay no other client. A read beyond the limit is refused at once, and its connection ends: clients that read
//! slowly leave places for orders.

use std::pin::Pin;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll};

use axum::body::{Body, Bytes, HttpBody};
use axum::extract::{Request, State};
use axum::http::StatusCode;
use axum::http::header::CONNECTION;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use hyper::body::{Frame, SizeHint};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::AbortHandle;

use crate::locks::lock;

/// The requests of a connection that are being answered.
#[derive(Clone, Debug, Default)]
pub(crate) struct Answers(Arc<AtomicUsize>);

impl Answers {
    fn begin(&self) -> Answering {
        self.0.fetch_add(1, Ordering::SeqCst);
        Answering(self.clone())
    }

    fn is_waiting(&self) -> bool {
        self.0.load(Ordering::SeqCst) == 0
    }
}

/// A request that is being answered.
#[derive(Debug)]
struct Answering(Answers);

impl Drop for Answering {
    fn drop(&mut self) {
        self.0.0.fetch_sub(1, Ordering::SeqCst);
    }
}

/// The open connections, the oldest first.
#[derive(Debug, Default)]
pub(crate) struct Connections(Vec<(Answers, AbortHandle)>);

impl Connections {
    /// Adds a connection, and forgets those that have ended.
    pub fn add(&mut self, answers: Answers, connection: AbortHandle) {
        self.0.retain(|(_, connection)| !connection.is_finished());
        self.0.push((answers, connection));
    }

    /// Ends the oldest connection that waits for its client, if there is one.
    pub fn end_waiting(&mut self) {
        self.0.retain(|(_, connection)| !connection.is_finished());
        if let Some(index) = self.0.iter().position(|(answers, _)| answers.is_waiting()) {
            self.0.remove(index).1.abort();
        }
    }
}

type Slot = Arc<Mutex<Option<Answering>>>;

/// The answer to a read beyond the limit.
const TOO_MANY_READS: &str = "too many requests at once: expected fewer; close other pages, or send this one again\n";

/// Notes that a request has arrived with its body, until its answer is sent. A read takes one of the places of `reads`
/// meanwhile.
pub(crate) async fn note(State(reads): State<Arc<Semaphore>>, request: Request, next: Next) -> Response {
    let Some(answers) = request.extensions().get::<Answers>().cloned() else { return next.run(request).await };
    let place = request.method().is_safe().then(|| reads.try_acquire_owned());
    let Ok(place) = place.transpose() else {
        return (StatusCode::SERVICE_UNAVAILABLE, [(CONNECTION, "close")], TOO_MANY_READS).into_response();
    };
    let slot = Slot::default();
    let request = if request.body().is_end_stream() {
        *lock(&slot) = Some(answers.begin());
        request
    } else {
        let arriving = Some((answers, Arc::clone(&slot)));
        request.map(|body| Body::new(Noted { body, arriving, _answering: None, _place: None }))
    };
    let response = next.run(request).await;
    response.map(|body| Body::new(Noted { body, arriving: None, _answering: Some(slot), _place: place }))
}

/// A body whose end is noted.
struct Noted {
    body: Body,
    /// Of a request: where its end is noted.
    arriving: Option<(Answers, Slot)>,
    /// Of an answer: until it is sent.
    _answering: Option<Slot>,
    /// Of the answer to a read.
    _place: Option<OwnedSemaphorePermit>,
}

impl HttpBody for Noted {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let polled = Pin::new(&mut self.body).poll_frame(context);
        let is_over = matches!(polled, Poll::Ready(None)) || (polled.is_ready() && self.body.is_end_stream());
        if is_over && let Some((answers, slot)) = self.arriving.take() {
            *lock(&slot) = Some(answers.begin());
        }
        polled
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
