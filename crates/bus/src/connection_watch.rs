//! Whether a session has a connection, and why it has none.
//!
//! A thread looks twice a second. It says once that the last connection is lost, and once that one is back. For a
//! session with keys it also looks for the reason why an endpoint has no connection.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::thread;
use std::time::Duration;

use zenoh::Wait;

use crate::tls::Identity;
use crate::tls_check::first_problem;

/// Time between two looks.
const EVERY: Duration = Duration::from_millis(500);

/// Looks in sequence without a connection after which it is lost: a process that restarts at once is no news.
const LOST_AFTER: u32 = 3;

/// Looks until the first search for a reason: Zenoh has this time for a connection.
const FIRST_SEARCH: u32 = 3;

/// Looks between two searches.
const SEARCH_EVERY: u32 = 10;

/// Watches the connections of a session until it is dropped.
pub(crate) struct ConnectionWatch {
    endpoints: Vec<String>,
    found: Arc<Mutex<Found>>,
    /// The thread keeps no session open.
    _session: Arc<zenoh::Session>,
    /// Its end ends the thread.
    _end: Sender<()>,
}

impl ConnectionWatch {
    /// Starts the thread; without one, nothing is known.
    pub fn start(session: zenoh::Session, identity: Option<Identity>, endpoints: Vec<String>) -> Self {
        let mut found = Found::default();
        found.link.note(connections(&session) > 0);
        let (found, session) = (Arc::new(Mutex::new(found)), Arc::new(session));
        let (end, ended) = channel();
        let thread = {
            let (watched, found, endpoints) = (Arc::downgrade(&session), Arc::clone(&found), endpoints.clone());
            move || watch(&watched, identity.as_ref(), &endpoints, &found, &ended)
        };
        if let Err(error) = thread::Builder::new().name("connections".into()).spawn(thread) {
            tracing::debug!("connections are not watched: {error}");
        }
        Self { endpoints, found, _session: session, _end: end }
    }

    /// The present reason why an endpoint has no connection.
    pub fn problem(&self) -> Option<String> {
        lock(&self.found).problem.clone()
    }

    /// That the last connection is lost, in words.
    pub fn lost(&self) -> Option<String> {
        lock(&self.found).link.is_lost().then(|| describe_lost(&self.endpoints))
    }
}

/// Number of processes to which a session is connected.
pub(crate) fn connections(session: &zenoh::Session) -> usize {
    let info = session.info();
    info.peers_zid().wait().count() + info.routers_zid().wait().count()
}

/// What was found so far.
#[derive(Debug, Default)]
struct Found {
    /// Why an endpoint has no connection.
    problem: Option<String>,
    link: Link,
}

/// Whether the last connection is lost.
#[derive(Debug, Default)]
struct Link {
    was_connected: bool,
    /// Looks in sequence without a connection, after one with a connection.
    missed: u32,
}

impl Link {
    /// A look finds a connection or none: whether that is news.
    fn note(&mut self, is_connected: bool) -> bool {
        let was_lost = self.is_lost();
        self.was_connected |= is_connected;
        self.missed = if is_connected { 0 } else { self.missed.saturating_add(u32::from(self.was_connected)) };
        self.is_lost() != was_lost
    }

    fn is_lost(&self) -> bool {
        self.missed >= LOST_AFTER
    }
}

fn describe_lost(endpoints: &[String]) -> String {
    format!("this process has lost its connection to {}, and connects again", endpoints.join(", "))
}

fn lock(found: &Mutex<Found>) -> MutexGuard<'_, Found> {
    // A text is replaced as a unit.
    found.lock().unwrap_or_else(PoisonError::into_inner)
}

fn watch(
    session: &Weak<zenoh::Session>,
    identity: Option<&Identity>,
    endpoints: &[String],
    found: &Mutex<Found>,
    ended: &Receiver<()>,
) {
    let mut looks_left = FIRST_SEARCH;
    while ended.recv_timeout(EVERY) == Err(RecvTimeoutError::Timeout) {
        // The close of the session is no loss.
        let Some(connections) = session.upgrade().and_then(|session| open_connections(&session)) else { return };
        note_link(connections > 0, endpoints, found);
        looks_left -= 1;
        if looks_left == 0 {
            looks_left = SEARCH_EVERY;
            let is_missing = connections < endpoints.len();
            let problem = identity.filter(|_| is_missing).and_then(|identity| first_problem(identity, endpoints));
            note_problem(problem, found);
        }
    }
}

/// Number of connections of a session that is not closed.
fn open_connections(session: &zenoh::Session) -> Option<usize> {
    let connections = connections(session);
    (!session.is_closed()).then_some(connections)
}

fn note_link(is_connected: bool, endpoints: &[String], found: &Mutex<Found>) {
    let is_news = lock(found).link.note(is_connected);
    match is_news {
        true if is_connected => tracing::info!("this process is connected to {} again", endpoints.join(", ")),
        true => tracing::warn!("{}", describe_lost(endpoints)),
        false => {}
    }
}

fn note_problem(problem: Option<String>, found: &Mutex<Found>) {
    let mut known = lock(found);
    if known.problem != problem {
        if let Some(problem) = &problem {
            tracing::warn!("{problem}");
        }
        known.problem = problem;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_connection_is_lost_once_and_back_once() {
        let mut link = Link::default();
        let news = |link: &mut Link, looks: &[bool]| looks.iter().map(|look| link.note(*look)).collect::<Vec<_>>();
        assert_eq!(news(&mut link, &[false; 5]), [false; 5], "there was none");
        assert_eq!(news(&mut link, &[true, false, false, true]), [false; 4], "a restart");
        assert_eq!(news(&mut link, &[false, false, false, false]), [false, false, true, false]);
        assert!(link.is_lost());
        assert_eq!(news(&mut link, &[true, true]), [true, false]);
        assert!(!link.is_lost());
    }
}
