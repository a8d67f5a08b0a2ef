//! A request that a process ends, and what waits for it.

use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::Duration;

use tokio_util::sync::CancellationToken;

use crate::locks::{lock, unpoisoned};

/// A request to end, shared between those that may make it and the loops that obey it.
///
/// Once made, it stays.
///
/// ```
/// use heliostat_service::Stop;
/// use std::time::Duration;
///
/// let stop = Stop::default();
/// let of_another_thread = stop.clone();
/// assert!(!stop.wait_for(Duration::from_millis(1)));
/// of_another_thread.request();
/// assert!(stop.is_requested() && stop.wait_for(Duration::from_secs(3600)));
/// ```
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<Inner>);

#[derive(Debug, Default)]
struct Inner {
    requested: Mutex<bool>,
    changed: Condvar,
    /// For tasks of an asynchronous runtime, which must not block.
    token: CancellationToken,
}

impl Stop {
    /// Requests the end.
    pub fn request(&self) {
        *self.lock() = true;
        self.0.changed.notify_all();
        self.0.token.cancel();
    }

    /// Whether the end has been requested.
    pub fn is_requested(&self) -> bool {
        *self.lock()
    }

    /// Waits until the end is requested, at most for `limit`; whether it has been.
    pub fn wait_for(&self, limit: Duration) -> bool {
        let waited = self.0.changed.wait_timeout_while(self.lock(), limit, |requested| !*requested);
        *unpoisoned(waited).0
    }

    /// Waits until the end is requested.
    pub fn wait(&self) {
        drop(unpoisoned(self.0.changed.wait_while(self.lock(), |requested| !*requested)));
    }

    /// Completes when the end is requested.
    pub async fn requested(&self) {
        self.0.token.cancelled().await;
    }

    fn lock(&self) -> MutexGuard<'_, bool> {
        lock(&self.0.requested)
    }
}
