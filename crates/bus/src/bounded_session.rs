//! A Zenoh session that closes within a limited time.

use std::ops::Deref;
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::thread;
use std::time::Duration;

use zenoh::Wait;

use crate::error::BusError;

/// Longest wait for the close of a session.
///
/// Zenoh first waits for every connection attempt in progress, up to its timeout of several
/// seconds, and a process that is no Zenoh peer lets each attempt last that long. The limit leaves
/// time to send what waits in the queues. The end of the process closes the connections in any case.
const CLOSE_LIMIT: Duration = Duration::from_millis(500);

/// A session; the last one of its clones that is dropped closes it.
#[derive(Clone)]
pub(crate) struct BoundedSession {
    /// `None` while it is dropped.
    session: Option<zenoh::Session>,
}

impl BoundedSession {
    pub fn new(session: zenoh::Session) -> Self {
        Self { session: Some(session) }
    }

    /// Closes the session for all clones; continues in the background after the limit.
    pub fn close(&self) -> Result<(), BusError> {
        let session = zenoh::Session::clone(self);
        let closed = within_limit(move || session.close().wait());
        closed.unwrap_or(Ok(())).map_err(|error| BusError::Close { problem: error.to_string() })
    }
}

impl Deref for BoundedSession {
    type Target = zenoh::Session;

    fn deref(&self) -> &zenoh::Session {
        self.session.as_ref().expect("only the drop takes the session")
    }
}

impl Drop for BoundedSession {
    fn drop(&mut self) {
        let session = self.session.take();
        let _ = within_limit(move || drop(session));
    }
}

/// The result of an action on a thread of its own; `None` if it takes longer than the limit.
fn within_limit<T: Send + 'static>(action: impl FnOnce() -> T + Send + 'static) -> Option<T> {
    let (sender, receiver) = sync_channel(1);
    let started = thread::Builder::new().name("close".into()).spawn(move || {
        // The receiver is gone after the limit.
        let _ = sender.send(action());
    });
    match started.map(|_| receiver.recv_timeout(CLOSE_LIMIT)) {
        Ok(Ok(result)) => Some(result),
        Ok(Err(RecvTimeoutError::Timeout)) => {
            tracing::debug!(
                "a session is not closed after {} ms: it closes in the background",
                CLOSE_LIMIT.as_millis()
            );
            None
        }
        // Without a thread, or after a panic of the action, nothing remains to wait for.
        Ok(Err(RecvTimeoutError::Disconnected)) | Err(_) => None,
    }
}
