//! Whether a session has a connection, and why it has none.
//!
//! A thread looks twice a second. It says once that the last connection is lost, and once that one is back. Another
//! thread looks for the reason why an endpoint has no connection, which takes longer. Without keys, and where no process
//! answers, it names a reason only until the first connection: processes may end, and peers may start in any order.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use zenoh::Wait;

use crate::config::{BusConfig, Role};
use crate::resolve::{first_unresolved, lock};
use crate::tls::Identity;
use crate::tls_check::{first_encrypted, first_problem, unanswered};

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
    watched: Arc<Watched>,
    /// Its end ends the thread.
    _end: Sender<()>,
}

impl ConnectionWatch {
    /// Starts the thread; without one, nothing is known.
    pub fn start(session: zenoh::Session, config: &BusConfig) -> Self {
        let mut found = Found::default();
        found.note(connections(&session));
        let watched = Arc::new(Watched {
            session: Mutex::new(Some(session)),
            identity: config.identity.clone(),
            endpoints: config.connect.clone(),
            role: config.role,
            found: Mutex::new(found),
        });
        let (end, ended) = channel();
        let (of_search, of_looks) = (Arc::clone(&watched), Arc::clone(&watched));
        // Without a buffer: a search that still runs is enough, and none is queued behind it.
        let (search, searches) = sync_channel(0);
        spawn("endpoints", move || searches.iter().for_each(|()| of_search.search()));
        spawn("connections", move || watch(&of_looks, &search, &ended));
        Self { watched, _end: end }
    }

    /// The present reason why an endpoint has no connection.
    pub fn problem(&self) -> Option<String> {
        lock(&self.watched.found).problem.clone()
    }

    /// That the last connection is lost, in words.
    pub fn lost(&self) -> Option<String> {
        let Watched { role, endpoints, found, .. } = &*self.watched;
        lock(found).link.is_lost().then(|| describe_lost(*role, endpoints))
    }

    /// The router of a client while the connection to it is lost, by its endpoints.
    pub fn lost_router(&self) -> Option<String> {
        self.watched.lost_router()
    }
}

impl Drop for ConnectionWatch {
    /// The thread holds the session during a look only, and this waits for it: the drop of the last other
    /// clone of the session closes it.
    fn drop(&mut self) {
        *lock(&self.watched.session) = None;
    }
}

fn spawn(name: &str, work: impl FnOnce() + Send + 'static) {
    if let Err(error) = thread::Builder::new().name(name.into()).spawn(work) {
        tracing::debug!("connections are not watched: {error}");
    }
}

/// A session, and what was found of it.
struct Watched {
    /// `None` after the end of the watch.
    session: Mutex<Option<zenoh::Session>>,
    identity: Option<Identity>,
    endpoints: Vec<String>,
    role: Role,
    found: Mutex<Found>,
}

impl Watched {
    /// Whether an endpoint may have no connection. A client has one at a time. A peer's may also come from others.
    fn misses_endpoint(&self, connections: usize) -> bool {
        match self.role {
            Role::Client => connections == 0,
            Role::Peer => connections < self.endpoints.len(),
        }
    }

    /// The endpoints of a client that has lost its connection. A peer may have lost a process that connected to it.
    fn lost_router(&self) -> Option<String> {
        (self.role == Role::Client && lock(&self.found).link.is_lost()).then(|| self.endpoints.join(", "))
    }

    /// Looks for the reason why an endpoint has no connection.
    fn search(&self) {
        self.note_found(|| {
            let problem = self.identity.as_ref().and_then(|identity| first_problem(identity, &self.endpoints));
            problem.or_else(|| self.never_connected())
        });
    }

    /// Notes what a search finds, unless the connections change meanwhile: a search takes long, and the next one finds
    /// what is still wrong.
    fn note_found(&self, search: impl FnOnce() -> Option<String>) {
        let before = lock(&self.found).connections;
        let problem = search();
        let open = lock(&self.session).as_ref().map(connections);
        if open.unwrap_or_else(|| lock(&self.found).connections) == before {
            self.note_problem(problem);
        }
    }

    /// Why a session that has never had a connection has none.
    fn never_connected(&self) -> Option<String> {
        if lock(&self.found).link.was_connected {
            return None;
        }
        if let Some(unresolved) = first_unresolved(&self.endpoints) {
            return Some(unresolved);
        }
        if let Some(found) = unanswered(&self.endpoints) {
            return Some(format!("{found}: start the process that listens there, or correct --connect"));
        }
        if self.identity.is_some() { None } else { first_encrypted(&self.endpoints) }
    }

    /// Sets the problem, or none where no endpoint misses a connection any more.
    fn note_problem(&self, problem: Option<String>) {
        let mut known = lock(&self.found);
        let problem = problem.filter(|_| self.misses_endpoint(known.connections));
        if known.problem != problem {
            if let Some(problem) = &problem {
                tracing::warn!("{problem}");
            }
            known.problem = problem;
        }
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
    /// Number of connections at the last look.
    connections: usize,
    link: Link,
}

impl Found {
    /// Notes the connections of a look: whether one is lost or back.
    fn note(&mut self, connections: usize) -> bool {
        self.connections = connections;
        if connections > 0 && !self.link.was_connected {
            // The first connection ends a reason why there is none; a search finds that of another endpoint again.
            self.problem = None;
        }
        self.link.note(connections > 0)
    }
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

/// A peer may have lost a process that connected to it, and not one of its endpoints.
fn describe_lost(role: Role, endpoints: &[String]) -> String {
    let connection = match role {
        Role::Client => format!("its connection to {}", endpoints.join(", ")),
        Role::Peer => "its last connection".to_owned(),
    };
    format!("this process has lost {connection}, and connects again")
}

fn watch(watched: &Watched, search: &SyncSender<()>, ended: &Receiver<()>) {
    let mut looks_left = FIRST_SEARCH;
    while ended.recv_timeout(EVERY) == Err(RecvTimeoutError::Timeout) {
        // The close of the session is no loss.
        let Some(connections) = lock(&watched.session).as_ref().and_then(open_connections) else { return };
        note_connections(connections, watched);
        looks_left -= 1;
        if looks_left == 0 {
            looks_left = SEARCH_EVERY;
            if watched.misses_endpoint(connections) {
                // Refused while a search runs.
                let _ = search.try_send(());
            } else {
                watched.note_problem(None);
            }
        }
    }
}

/// Number of connections of a session that is not closed.
fn open_connections(session: &zenoh::Session) -> Option<usize> {
    let connections = connections(session);
    (!session.is_closed()).then_some(connections)
}

fn note_connections(connections: usize, Watched { role, endpoints, found, .. }: &Watched) {
    let is_news = lock(found).note(connections);
    match is_news {
        true if connections > 0 => tracing::info!("this process is connected again"),
        true => tracing::warn!("{}", describe_lost(*role, endpoints)),
        false => {}
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::Room;

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

    #[test]
    fn a_peer_names_no_endpoint_because_it_may_have_lost_a_process_that_connected_to_it() {
        let endpoints = ["tcp/127.0.0.1:7447".to_owned()];
        let (client, peer) = (describe_lost(Role::Client, &endpoints), describe_lost(Role::Peer, &endpoints));
        assert!(client.contains(&endpoints[0]), "{client}");
        assert!(!peer.contains(&endpoints[0]) && peer.contains("its last connection"), "{peer}");
    }

    /// A session with two endpoints.
    fn watched(role: Role) -> Watched {
        Watched {
            session: Mutex::new(None),
            identity: None,
            endpoints: vec!["tls/one:7447".into(), "tls/two:7447".into()],
            role,
            found: Mutex::default(),
        }
    }

    #[test]
    fn the_result_of_a_search_that_ends_after_the_connection_is_back_is_dropped() {
        let watched = watched(Role::Client);
        let shown = |connections| {
            note_connections(connections, &watched);
            watched.note_problem(Some("the certificate has expired".into()));
            lock(&watched.found).problem.clone()
        };
        assert!(shown(0).is_some());
        assert_eq!(shown(1), None);
    }

    #[test]
    fn the_reason_of_a_search_that_overlaps_a_connection_is_dropped() {
        let watched = watched(Role::Peer);
        let found = |connections: Option<usize>| {
            watched.note_found(|| {
                connections.into_iter().for_each(|connections| note_connections(connections, &watched));
                Some("no process answers".into())
            });
            lock(&watched.found).problem.clone()
        };
        assert_eq!(found(Some(1)), None, "of the first connection");
        assert!(found(None).is_some(), "the other endpoint has none");
    }

    #[test]
    fn a_client_alone_has_lost_its_router() {
        let lost = |role| {
            let watched = watched(role);
            [1, 0, 0, 0, 1].map(|connections| {
                note_connections(connections, &watched);
                watched.lost_router()
            })
        };
        let router = Some("tls/one:7447, tls/two:7447".to_owned());
        assert_eq!(lost(Role::Client), [None, None, None, router, None]);
        assert!(lost(Role::Peer).iter().all(Option::is_none));
    }

    #[test]
    fn a_peer_names_the_endpoints_at_which_no_process_answers_until_its_first_connection() {
        let free =
            std::net::TcpListener::bind("127.0.0.1:0").and_then(|bound| bound.local_addr()).expect("a free port");
        let watched = Watched { endpoints: vec![format!("tcp/{free}")], ..watched(Role::Peer) };
        watched.search();
        let problem = lock(&watched.found).problem.clone().unwrap_or_default();
        assert!(problem.starts_with(&format!("no process answers at tcp/{free}: start the process")), "{problem}");
        note_connections(1, &watched);
        assert_eq!(lock(&watched.found).problem, None, "the first connection ends the reason");
        note_connections(0, &watched);
        watched.search();
        assert_eq!(lock(&watched.found).problem, None, "the end of the other process is no wrong endpoint");
    }

    #[test]
    fn a_client_misses_no_endpoint_beside_the_one_that_answers() {
        let missing = |role| [0, 1, 2].map(|connections| watched(role).misses_endpoint(connections));
        assert_eq!(missing(Role::Client), [true, false, false]);
        assert_eq!(missing(Role::Peer), [true, true, false]);
    }

    #[test]
    fn the_end_of_a_watch_leaves_its_thread_no_session() {
        let endpoint = crate::private_endpoint().expect("an endpoint");
        let config = BusConfig::new(Room::new("lab").expect("a valid name")).listen_at(&endpoint);
        let session = zenoh::open(config.to_zenoh().expect("a valid configuration")).wait().expect("it opens");
        let watch = ConnectionWatch::start(session.clone(), &config);
        let watched = Arc::clone(&watch.watched);
        drop(watch);
        assert!(lock(&watched.session).is_none());
        session.close().wait().expect("it closes");
    }
}
