//! One Zenoh session in one room, and what it declares.

use std::time::Duration;

use heliostat_proto::Room;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::Queryable;
use zenoh::sample::{Sample, SampleKind};

use crate::config::{BusConfig, Reach};
use crate::error::BusError;

/// How urgent a message is, and what happens to it when the network is full.
///
/// Messages of one class keep their order on one link; those of a more urgent class overtake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// What a decision waits for: reports and commands. Sent at once, ahead of the rest; dropped rather than late.
    Control,
    /// What the system needs, but not this instant: telemetry, capabilities. Sent at once; dropped when the network is full.
    State,
    /// What people look at: status, truth. May wait to be sent together with others; dropped when the network is full.
    Info,
    /// What must arrive: emergency stop, calibration, and in lockstep, where nobody is in a hurry, reports, commands and telemetry. Ahead of the rest; waits
    /// rather than being dropped.
    Order,
}

impl Class {
    fn priority(self) -> Priority {
        match self {
            Self::Control | Self::Order => Priority::RealTime,
            Self::State => Priority::DataHigh,
            Self::Info => Priority::DataLow,
        }
    }

    fn congestion_control(self) -> CongestionControl {
        match self {
            Self::Order => CongestionControl::Block,
            Self::Control | Self::State | Self::Info => CongestionControl::Drop,
        }
    }

    fn is_express(self) -> bool {
        self != Self::Info
    }
}

/// Whether a liveliness token is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Presence {
    /// It appeared, or was there when watching began.
    Alive,
    /// It was withdrawn, or its process or the way to it is gone.
    Gone,
}

/// One session in one room. Dropping it, or [`close`](Self::close), ends all that it declared.
pub struct Bus {
    session: zenoh::Session,
    room: Room,
}

impl Bus {
    /// Opens a session.
    ///
    /// With [`Reach::Eventually`] a peer returns within about half a second whether or not anybody answers.
    ///
    /// # Errors
    /// [`BusError`] says what is wrong with the configuration, or where nobody answers or somebody else listens.
    pub fn open(config: &BusConfig) -> Result<Self, BusError> {
        let session = zenoh::open(config.to_zenoh()?).wait().map_err(|error| open_error(config, &error.to_string()))?;
        Ok(Self { session, room: config.room.clone() })
    }

    /// The same session in another room; [`close`](Self::close) closes it for all of them.
    #[must_use]
    pub fn enter(&self, room: Room) -> Self {
        Self { session: self.session.clone(), room }
    }

    /// The room that gives the keys.
    pub fn room(&self) -> &Room {
        &self.room
    }

    /// Declares a publisher; declare once and publish often.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the key is none, or the session is closed.
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

    /// Calls back with each payload published under the key or pattern, until the subscription is dropped.
    ///
    /// The callback runs on a Zenoh thread, never twice at once. Bytes are borrowed from the receive buffer unless the
    /// network delivered them in pieces.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the key is none, or the session is closed.
    pub fn subscribe(
        &self,
        key: &str,
        mut callback: impl FnMut(&[u8]) + Send + Sync + 'static,
    ) -> Result<Subscription, BusError> {
        self.subscribe_keyed(key, move |_, payload| callback(payload))
    }

    /// Like [`subscribe`](Self::subscribe), with the key of each payload.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the pattern is none, or the session is closed.
    pub fn subscribe_keyed(
        &self,
        pattern: &str,
        mut callback: impl FnMut(&str, &[u8]) + Send + Sync + 'static,
    ) -> Result<Subscription, BusError> {
        let deliver = move |sample: Sample| {
            if sample.kind() == SampleKind::Put {
                callback(sample.key_expr().as_str(), &sample.payload().to_bytes());
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

    /// Says that this instance is there, until the token is dropped or the process ends.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the key is none, or the session is closed.
    pub fn announce(&self, key: &str) -> Result<Token, BusError> {
        let token = self.session.liveliness().declare_token(key.to_owned());
        Ok(Token { _inner: token.wait().map_err(refused("announce", key))? })
    }

    /// The liveliness tokens now there, sorted; waits for answers, at most `limit`. Not for use in callbacks.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the pattern is none, or the session is closed.
    pub fn alive(&self, pattern: &str, limit: Duration) -> Result<Vec<String>, BusError> {
        let query = self.session.liveliness().get(pattern.to_owned()).timeout(limit);
        let replies = query.wait().map_err(refused("ask who is alive under", pattern))?;
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

    /// Calls back with each liveliness token that is there, appears or goes, until the subscription is dropped.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the pattern is none, or the session is closed.
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

    /// Answers whoever fetches the key, until the service is dropped. The callback fills an empty buffer; leaving it empty
    /// gives no answer.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the key is none, or the session is closed.
    pub fn serve(&self, key: &str, answer: impl Fn(&mut Vec<u8>) + Send + Sync + 'static) -> Result<Service, BusError> {
        let own_key = key.to_owned();
        let reply = move |query: zenoh::query::Query| {
            let mut payload = Vec::new();
            answer(&mut payload);
            if !payload.is_empty() {
                // Whoever asked may be gone by now, and there is nobody else to tell.
                let _ = query.reply(own_key.as_str(), payload).wait();
            }
        };
        let queryable = self.session.declare_queryable(key.to_owned()).callback(reply);
        Ok(Service { _inner: queryable.wait().map_err(refused("serve", key))? })
    }

    /// The payloads that services give for a key; waits for all of them, at most `limit`. Not for use in callbacks.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the key is none, or the session is closed.
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

    /// Closes the session; others see its tokens go at once.
    ///
    /// # Errors
    /// [`BusError::Close`].
    pub fn close(self) -> Result<(), BusError> {
        self.session.close().wait().map_err(|error| BusError::Close { problem: error.to_string() })
    }
}

/// Publishes under one key.
pub struct Publisher {
    inner: zenoh::pubsub::Publisher<'static>,
}

impl Publisher {
    /// Publishes one payload; copies it once, waits for nobody. Without subscribers it does nothing.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the session is closed.
    pub fn put(&self, payload: &[u8]) -> Result<(), BusError> {
        self.inner
            .put(ZBytes::from(payload))
            .wait()
            .map_err(|error| refused("publish on", self.inner.key_expr().as_str())(error))
    }

    /// Whether anybody is known to subscribe to the key at this moment.
    ///
    /// # Errors
    /// [`BusError::Refused`] where the session is closed.
    pub fn is_heard(&self) -> Result<bool, BusError> {
        let matching = self.inner.matching_status().wait();
        Ok(matching.map_err(refused("look for subscribers of", self.inner.key_expr().as_str()))?.matching())
    }
}

/// A declared subscription; dropping it ends the calls back, save for one that is under way.
pub struct Subscription {
    _inner: Subscriber<()>,
}

/// A liveliness token; dropping it withdraws it.
pub struct Token {
    _inner: LivelinessToken,
}

/// A key that is answered; dropping it ends that.
pub struct Service {
    _inner: Queryable<()>,
}

fn refused(action: &'static str, key: &str) -> impl FnOnce(zenoh::Error) -> BusError {
    let key = key.to_owned();
    move |error| BusError::Refused { action, key, problem: error.to_string() }
}

/// Zenoh's account without the places in its sources, " at FILE.rs:LINE.", that it names.
fn without_places(account: &str) -> String {
    let mut plain = account.to_owned();
    while let Some(end) = plain.find(".rs:") {
        let Some(start) = plain[..end].rfind(" at ") else { break };
        let line = plain[end + 4..].trim_start_matches(|letter: char| letter.is_ascii_digit());
        let rest = line.strip_prefix('.').unwrap_or(line).to_owned();
        plain.truncate(start);
        plain.push_str(&rest);
    }
    plain
}

/// Zenoh reports all failures as text; this finds out which one it is.
fn open_error(config: &BusConfig, account: &str) -> BusError {
    let problem = &*without_places(account);
    let named = |endpoints: &[String]| {
        let mentioned = endpoints.iter().find(|endpoint| problem.contains(endpoint.as_str()));
        mentioned.cloned().unwrap_or_else(|| endpoints.join(", "))
    };
    let concerns_listening = !config.listen.is_empty() && problem.contains("listener");
    match config.reach {
        _ if concerns_listening && problem.contains("in use") => {
            BusError::EndpointInUse { endpoint: named(&config.listen) }
        }
        _ if concerns_listening => {
            BusError::CannotListen { endpoint: named(&config.listen), problem: problem.to_owned() }
        }
        Reach::Within(limit) if problem.contains("nable to connect") => BusError::CannotReach {
            endpoints: config.connect.join(", "),
            waited_ms: u64::try_from(limit.as_millis()).unwrap_or(u64::MAX),
        },
        _ => BusError::Open { problem: problem.to_owned() },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_in_sources_are_no_part_of_an_account() {
        let account = "Unable to listen on tcp/a: [os error 99] at /somewhere/zenoh/src/tcp.rs:61. at lib.rs:7.";
        assert_eq!(without_places(account), "Unable to listen on tcp/a: [os error 99]");
        assert_eq!(without_places("nothing of the kind"), "nothing of the kind");
    }
}
