//! A Zenoh session in a room, and its declarations.

use std::sync::Arc;
use std::time::{Duration, Instant};

use heliostat_proto::keys::alive_in_every_room;
use heliostat_proto::{MAX_PAYLOAD, Room};
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::Queryable;
use zenoh::sample::{Sample, SampleKind};

use crate::bounded_session::BoundedSession;
use crate::config::{BusConfig, Reach, Role};
use crate::connection_watch::{ConnectionWatch, connections};
use crate::error::BusError;
use crate::resolve::first_unresolved;
use crate::tls_check::{all_refuse, first_encrypted, first_problem, unanswered};

/// Time between two looks for a connection.
const CONNECTED_EVERY: Duration = Duration::from_millis(20);

/// Longest attempt of a client at one of several routers: one that is frozen accepts a connection and does not answer.
const ATTEMPT_LIMIT: Duration = Duration::from_secs(2);

/// What Zenoh's error of a connection that fails contains.
const UNREACHED: &str = "nable to connect";

/// Zenoh must be compiled so that the close of a connection does not wait for the other side. See
/// `.cargo/config.toml`, which sets both variables to 0.
const _: () = assert!(
    is_zero(option_env!("TCP_LINGER_TIMEOUT")) && is_zero(option_env!("TLS_LINGER_TIMEOUT")),
    "Zenoh would block on closing connections: expected TCP_LINGER_TIMEOUT=0 and TLS_LINGER_TIMEOUT=0 in the \
     environment of cargo. Build inside the repository, where .cargo/config.toml sets them, or set them by hand."
);

const fn is_zero(value: Option<&str>) -> bool {
    matches!(value, Some(text) if matches!(text.as_bytes(), b"0"))
}

/// Quality of service of a message: its priority, and what happens to it under congestion.
///
/// An express message is sent at once; others may wait for a batch. Messages of one class keep
/// their order on one link. Messages of a higher priority can overtake them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// Real-time priority, express, dropped under congestion: reports and commands.
    RealTimeDrop,
    /// Real-time priority, express, blocks under congestion: emergency stop, calibration and
    /// controls. In lockstep also reports, commands and telemetry.
    RealTimeBlock,
    /// High priority, express, dropped under congestion: telemetry and capabilities.
    HighDrop,
    /// Low priority, in batches, dropped under congestion: status and truth, for viewers.
    LowDrop,
}

impl Class {
    fn priority(self) -> Priority {
        match self {
            Self::RealTimeDrop | Self::RealTimeBlock => Priority::RealTime,
            Self::HighDrop => Priority::DataHigh,
            Self::LowDrop => Priority::DataLow,
        }
    }

    fn congestion_control(self) -> CongestionControl {
        match self {
            Self::RealTimeBlock => CongestionControl::Block,
            Self::RealTimeDrop | Self::HighDrop | Self::LowDrop => CongestionControl::Drop,
        }
    }

    fn is_express(self) -> bool {
        self != Self::LowDrop
    }
}

/// Presence of a liveliness token.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Presence {
    /// The token appeared, or was present when the subscription began.
    Alive,
    /// The token was withdrawn, or its process or the connection to it ended.
    Gone,
}

/// A session in a room. Dropping or [closing](Self::close) it withdraws all its declarations.
pub struct Bus {
    /// Of a session with endpoints to connect to. Dropped before the session, so that the last one is the bounded one.
    watch: Option<Arc<ConnectionWatch>>,
    session: BoundedSession,
    room: Room,
    /// Whether a certificate limits it to the tokens of its room.
    is_limited: bool,
}

impl Bus {
    /// Opens a session.
    ///
    /// With [`Reach::Eventually`] a peer returns within about half a second, whether or not another
    /// process answers.
    ///
    /// # Errors
    /// [`BusError`] names the fault of the configuration, the endpoint that does not answer, or the
    /// endpoint in use.
    pub fn open(config: &BusConfig) -> Result<Self, BusError> {
        config.check()?;
        if config.is_exposed() {
            tracing::warn!(
                listen = ?config.listen,
                connect = ?config.connect,
                "this session is neither encrypted nor authenticated: each process on its network can turn the mirrors; give --tls DIR"
            );
        }
        let session = if config.role == Role::Client { open_client(config)? } else { open_session(config)? };
        let start = || ConnectionWatch::start(session.clone(), config);
        let watch = (!config.connect.is_empty()).then(|| Arc::new(start()));
        let is_limited = config.is_authenticated();
        Ok(Self { watch, session: BoundedSession::new(session), room: config.room.clone(), is_limited })
    }

    /// Waits until this session is connected to another process, at most `limit`; returns whether it is.
    pub fn wait_connected(&self, limit: Duration) -> bool {
        let begun = Instant::now();
        while connections(&self.session) == 0 {
            if begun.elapsed() >= limit {
                return false;
            }
            std::thread::sleep(CONNECTED_EVERY);
        }
        true
    }

    /// Whether each endpoint of the configuration refuses connections at once: no process listens there.
    pub fn is_refused(config: &BusConfig) -> bool {
        all_refuse(&config.connect)
    }

    /// That no process accepts connections at any endpoint of the configuration, in words.
    pub fn find_unanswered(config: &BusConfig) -> Option<String> {
        unanswered(&config.connect)
    }

    /// Looks now for the reason why a connection to an endpoint of the configuration fails although a
    /// process answers there: the fault of a certificate, or keys that this process lacks.
    pub fn find_connection_problem(config: &BusConfig) -> Option<String> {
        match &config.identity {
            Some(identity) => first_problem(identity, &config.connect),
            None => first_encrypted(&config.connect),
        }
    }

    /// That the name of an endpoint of the configuration has no address, or none in time, with what to do.
    pub fn find_unresolved(config: &BusConfig) -> Option<String> {
        first_unresolved(&config.connect)
    }

    /// Why a connection of this session fails: the fault of a certificate. Until the first connection also that no process
    /// answers, or that the one that answers needs keys.
    pub fn connection_problem(&self) -> Option<String> {
        self.watch.as_ref()?.problem()
    }

    /// That this session, which connects to endpoints, has lost its last connection, in words, until one is back.
    /// Processes that connect to it count too. A session that only listens reports no loss.
    pub fn lost_connection(&self) -> Option<String> {
        self.watch.as_ref()?.lost()
    }

    /// The endpoints of the router to which this session, as a client, has lost its connection, until it is back.
    pub fn lost_router(&self) -> Option<String> {
        self.watch.as_ref()?.lost_router()
    }

    /// The same session in another room; [`close`](Self::close) closes it for all rooms.
    #[must_use]
    pub fn enter(&self, room: Room) -> Self {
        Self { watch: self.watch.clone(), session: self.session.clone(), room, is_limited: self.is_limited }
    }

    /// Pattern for the liveliness tokens that this session may see: of every room, or with a certificate, which names a
    /// room, of its own.
    pub fn visible_alive(&self) -> String {
        if self.is_limited { self.room.all_alive() } else { alive_in_every_room() }
    }

    /// Room that gives the keys.
    pub fn room(&self) -> &Room {
        &self.room
    }

    /// Declares a publisher. A declaration is expensive, a publication is not: declare once.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the key is invalid, or the session is closed.
    pub fn publisher(&self, key: &str, class: Class) -> Result<Publisher, BusError> {
        let inner = self
            .session
            .declare_publisher(key.to_owned())
            .priority(class.priority())
            .congestion_control(class.congestion_control())
            .express(class.is_express())
            .wait()
            .map_err(refused("publish on", key))?;
        Ok(Publisher { inner })
    }

    /// Calls `callback` with each payload published under the key or pattern, until the
    /// subscription is dropped.
    ///
    /// The callback runs on a Zenoh thread, one call at a time. The payload is borrowed from the
    /// receive buffer; a payload that arrived in fragments is copied. Of one that is longer than a message may be, the
    /// callback gets the first [`MAX_PAYLOAD`] bytes and one more: the codec refuses it, and no queue holds the rest.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the key is invalid, or the session is closed.
    pub fn subscribe(
        &self,
        key: &str,
        mut callback: impl FnMut(&[u8]) + Send + Sync + 'static,
    ) -> Result<Subscription, BusError> {
        self.subscribe_keyed(key, move |_, payload| callback(payload))
    }

    /// Like [`subscribe`](Self::subscribe); `callback` also gets the key of each payload.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the pattern is invalid, or the session is closed.
    pub fn subscribe_keyed(
        &self,
        pattern: &str,
        mut callback: impl FnMut(&str, &[u8]) + Send + Sync + 'static,
    ) -> Result<Subscription, BusError> {
        let deliver = move |sample: Sample| {
            if sample.kind() == SampleKind::Put {
                let payload = sample.payload().to_bytes();
                callback(sample.key_expr().as_str(), &payload[..payload.len().min(MAX_PAYLOAD + 1)]);
            }
        };
        let inner = self
            .session
            .declare_subscriber(pattern.to_owned())
            .callback_mut(deliver)
            .wait()
            .map_err(refused("subscribe to", pattern))?;
        Ok(Subscription { _inner: inner })
    }

    /// Declares a liveliness token, present until it is dropped or the process ends.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the key is invalid, or the session is closed.
    pub fn announce(&self, key: &str) -> Result<Token, BusError> {
        let token = self.session.liveliness().declare_token(key.to_owned());
        Ok(Token { _inner: token.wait().map_err(refused("announce", key))? })
    }

    /// Keys of the liveliness tokens now present, sorted. Waits for all answers, at most `limit`;
    /// not for use in callbacks.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the pattern is invalid, or the session is closed.
    pub fn alive(&self, pattern: &str, limit: Duration) -> Result<Vec<String>, BusError> {
        let query = self.session.liveliness().get(pattern.to_owned()).timeout(limit);
        let replies = query.wait().map_err(refused("query liveliness under", pattern))?;
        let mut keys = Vec::new();
        while let Ok(reply) = replies.recv() {
            if let Ok(sample) = reply.result() {
                keys.push(sample.key_expr().as_str().to_owned());
            }
        }
        keys.sort_unstable();
        keys.dedup();
        Ok(keys)
    }

    /// Calls `callback` for each liveliness token that is present, appears or disappears, until the
    /// subscription is dropped.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the pattern is invalid, or the session is closed.
    pub fn watch(
        &self,
        pattern: &str,
        mut callback: impl FnMut(&str, Presence) + Send + Sync + 'static,
    ) -> Result<Subscription, BusError> {
        let deliver = move |sample: Sample| {
            let presence = match sample.kind() {
                SampleKind::Put => Presence::Alive,
                SampleKind::Delete => Presence::Gone,
            };
            callback(sample.key_expr().as_str(), presence);
        };
        let watch = self.session.liveliness().declare_subscriber(pattern.to_owned()).history(true);
        let inner = watch.callback_mut(deliver).wait().map_err(refused("watch", pattern))?;
        Ok(Subscription { _inner: inner })
    }

    /// Answers queries for the key, until the service is dropped. `answer` fills an empty buffer; a
    /// buffer left empty gives no answer.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the key is invalid, or the session is closed.
    pub fn serve(&self, key: &str, answer: impl Fn(&mut Vec<u8>) + Send + Sync + 'static) -> Result<Service, BusError> {
        let own_key = key.to_owned();
        let reply = move |query: zenoh::query::Query| {
            let mut payload = Vec::new();
            answer(&mut payload);
            if !payload.is_empty() {
                // The sender of the query may have gone; no other process needs this error.
                let _ = query.reply(own_key.as_str(), payload).wait();
            }
        };
        let queryable = self.session.declare_queryable(key.to_owned()).callback(reply);
        Ok(Service { _inner: queryable.wait().map_err(refused("serve", key))? })
    }

    /// Answers of all services to a query for the key. Waits for all answers, at most `limit`; not
    /// for use in callbacks.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the key is invalid, or the session is closed.
    pub fn fetch(&self, key: &str, limit: Duration) -> Result<Vec<Vec<u8>>, BusError> {
        let query = self
            .session
            .get(key.to_owned())
            .timeout(limit)
            .target(zenoh::query::QueryTarget::All)
            .consolidation(zenoh::query::ConsolidationMode::None);
        let replies = query.wait().map_err(refused("fetch", key))?;
        let mut payloads = Vec::new();
        while let Ok(reply) = replies.recv() {
            if let Ok(sample) = reply.result() {
                payloads.push(sample.payload().to_bytes().into_owned());
            }
        }
        Ok(payloads)
    }

    /// Closes the session; its liveliness tokens disappear at once.
    ///
    /// The close does not wait for acknowledgements, and takes a limited time. What was published
    /// just before it arrives unless the network loses it; confirm an order by its effect before
    /// closing.
    ///
    /// # Errors
    /// [`BusError::Close`].
    pub fn close(self) -> Result<(), BusError> {
        self.session.close()
    }
}

/// Publishes under one key.
pub struct Publisher {
    inner: zenoh::pubsub::Publisher<'static>,
}

impl Publisher {
    /// Publishes a payload; copies it once and does not wait for subscribers. Without subscribers
    /// it does nothing.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the session is closed.
    pub fn put(&self, payload: &[u8]) -> Result<(), BusError> {
        self.inner
            .put(ZBytes::from(payload))
            .wait()
            .map_err(|error| refused("publish on", self.inner.key_expr().as_str())(error))
    }

    /// Whether at least one subscriber of the key is known now.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the session is closed.
    pub fn has_subscribers(&self) -> Result<bool, BusError> {
        let matching = self.inner.matching_status().wait();
        Ok(matching.map_err(refused("look for subscribers of", self.inner.key_expr().as_str()))?.matching())
    }
}

/// A subscription; after it is dropped no call of the callback begins, but one may still run.
pub struct Subscription {
    _inner: Subscriber<()>,
}

/// A liveliness token; dropping it withdraws the token.
pub struct Token {
    _inner: LivelinessToken,
}

/// A service that answers queries for a key; dropping it ends the answers.
pub struct Service {
    _inner: Queryable<()>,
}

fn refused(action: &'static str, key: &str) -> impl FnOnce(zenoh::Error) -> BusError {
    let key = key.to_owned();
    move |error| BusError::Refused { action, key, problem: error.to_string() }
}

/// Zenoh's message without source locations, " at FILE.rs:LINE.".
fn without_locations(message: &str) -> String {
    let mut plain = message.to_owned();
    while let Some(end) = plain.find(".rs:") {
        let Some(start) = plain[..end].rfind(" at ") else { break };
        let line = plain[end + 4..].trim_start_matches(|letter: char| letter.is_ascii_digit());
        let rest = line.strip_prefix('.').unwrap_or(line).to_owned();
        plain.truncate(start);
        plain.push_str(&rest);
    }
    plain
}

/// Derives the error from Zenoh's message, since Zenoh reports all failures as text.
fn open_session(config: &BusConfig) -> Result<zenoh::Session, BusError> {
    zenoh::open(config.to_zenoh()?).wait().map_err(|error| open_error(config, &error.to_string()))
}

/// Opens a session with the first of several routers that answers. Zenoh gives a new client its first endpoint alone, and
/// the others after a loss.
fn open_client(config: &BusConfig) -> Result<zenoh::Session, BusError> {
    let limit = match config.reach {
        Reach::Within(limit) => limit,
        Reach::Eventually => Duration::MAX,
    };
    let endpoints = u32::try_from(config.connect.len()).unwrap_or(u32::MAX);
    if endpoints < 2 {
        return open_session(config);
    }
    let mut attempt = config.clone().reaching(Reach::Within(ATTEMPT_LIMIT.min(limit / endpoints)));
    let begun = Instant::now();
    while begun.elapsed() < limit {
        for _ in 0..endpoints {
            if let Some(session) = if_answered(&attempt, open_session) {
                return Ok(session);
            }
            attempt.connect.rotate_left(1);
        }
        std::thread::sleep(CONNECTED_EVERY);
    }
    Err(open_error(config, UNREACHED))
}

/// What `open` opens, where a process accepts connections at the first endpoint: it waits for no process that starts later.
pub(crate) fn if_answered<T>(config: &BusConfig, open: impl FnOnce(&BusConfig) -> Result<T, BusError>) -> Option<T> {
    if unanswered(&config.connect[..1]).is_some() {
        return None;
    }
    open(config).ok()
}

fn open_error(config: &BusConfig, message: &str) -> BusError {
    let problem = &*without_locations(message);
    let named = |endpoints: &[String]| {
        let mentioned = endpoints.iter().find(|endpoint| problem.contains(endpoint.as_str()));
        mentioned.cloned().unwrap_or_else(|| endpoints.join(", "))
    };
    let concerns_listening = !config.listen.is_empty() && problem.contains("listener");
    // A port is in use; a Unix socket is locked by the process that listens at it.
    let is_taken = problem.contains("in use") || problem.contains("acquire lock");
    match config.reach {
        _ if concerns_listening && is_taken => BusError::EndpointInUse { endpoint: named(&config.listen) },
        _ if concerns_listening => {
            BusError::CannotListen { endpoint: named(&config.listen), problem: problem.to_owned() }
        }
        Reach::Within(limit) if problem.contains(UNREACHED) => {
            if let Some(problem) = Bus::find_unresolved(config) {
                return BusError::Unresolved { problem };
            }
            match Bus::find_connection_problem(config) {
                Some(problem) => BusError::Untrusted { problem },
                None => BusError::CannotReach {
                    endpoints: config.connect.join(", "),
                    waited_ms: u64::try_from(limit.as_millis()).unwrap_or(u64::MAX),
                },
            }
        }
        _ => BusError::Open { problem: problem.to_owned() },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn source_locations_are_removed_from_messages() {
        let message = "Unable to listen on tcp/a: [os error 99] at /somewhere/zenoh/src/tcp.rs:61. at lib.rs:7.";
        assert_eq!(without_locations(message), "Unable to listen on tcp/a: [os error 99]");
        assert_eq!(without_locations("nothing of the kind"), "nothing of the kind");
    }
}
