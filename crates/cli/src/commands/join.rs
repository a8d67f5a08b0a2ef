//! How a command joins a room for a moment. A viewer and a recorder last, and join as peers: a client would see nothing
//! after the end of its process.

use std::fmt;
use std::time::{Duration, Instant};

use heliostat_bus::{ACCEPTS_WITHIN, Bus, BusConfig, Reach, Role, is_joined_through, join_through};
use heliostat_service::output;

/// Shortest time in which another attempt to connect is of use.
const AGAIN_FROM: Duration = Duration::from_millis(100);

/// Why there is no connection.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Unconnected {
    reason: String,
    /// Whether the reason says what to do.
    is_advised: bool,
}

impl fmt::Display for Unconnected {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.reason)
    }
}

impl Unconnected {
    /// A reason that says what to do.
    pub fn advised(reason: impl fmt::Display) -> Self {
        Self { reason: reason.to_string(), is_advised: true }
    }

    /// The reason, with `one` where it says what to do, else with `other`.
    pub fn with_either(&self, one: &str, other: &str) -> String {
        format!("{}. {}", self.reason, if self.is_advised { one } else { other })
    }

    /// The reason, with this advice where it has none of its own.
    pub fn with_advice(&self, advice: &str) -> String {
        if self.is_advised { self.reason.clone() } else { format!("{}. {advice}", self.reason) }
    }
}

/// That no process answers at an endpoint.
pub(super) fn unanswered_in_words(endpoint: &str) -> String {
    format!("no process of a room answers at {endpoint}")
}

/// That a process accepts the connections and has not answered yet.
pub(super) fn accepting_in_words(config: &BusConfig) -> String {
    format!("the process at {} accepts connections and has not answered yet", config.connect.join(", "))
}

/// Joins a room; fails with the reason where there is no connection. `limit` is the time for a process that accepts
/// connections and does not answer: it may be slow, or frozen.
pub(super) fn join(config: &BusConfig, limit: Duration) -> Result<Bus, Unconnected> {
    let begun = Instant::now();
    if !is_joined_through(config) {
        let bus = match config.role {
            Role::Client => open_client(config, limit)?,
            Role::Peer => Bus::open(config).map_err(Unconnected::advised)?,
        };
        if config.listen.is_empty() {
            check_connected(&bus, config, limit)?;
        }
        return Ok(bus);
    }
    let (bus, unanswered) = join_through(config, ACCEPTS_WITHIN);
    if config.connect.len() > 1 {
        for endpoint in &unanswered {
            output::note(unanswered_in_words(endpoint));
        }
    }
    if let Some(bus) = bus {
        return Ok(bus);
    }
    why_unconnected(config, limit, || {
        let left = limit.saturating_sub(begun.elapsed());
        if left < AGAIN_FROM { None } else { join_through(config, left).0 }
    })
}

/// A client of the router in `connect`; fails at once where each endpoint refuses the connection, and otherwise after the
/// limit.
fn open_client(config: &BusConfig, limit: Duration) -> Result<Bus, Unconnected> {
    if Bus::is_refused(config)
        && let Some(problem) = find_unconnected(config)
    {
        return Err(problem);
    }
    // A process that is there has the time to accept the connection.
    let reach = Reach::Within(limit.max(ACCEPTS_WITHIN));
    Bus::open(&config.clone().reaching(reach)).map_err(Unconnected::advised)
}

/// The reason why there is no connection: soon where no process listens, and after the limit where one
/// accepts connections, for it may be slow.
pub(super) fn check_connected(bus: &Bus, config: &BusConfig, limit: Duration) -> Result<(), Unconnected> {
    let begun = Instant::now();
    if bus.wait_connected(ACCEPTS_WITHIN) {
        return Ok(());
    }
    why_unconnected(config, limit, || bus.wait_connected(limit.saturating_sub(begun.elapsed())).then_some(()))
}

/// Why an endpoint has no connection: a name without address, the problem, or that no process answers. `None` where one
/// accepts connections.
pub(super) fn find_problem(config: &BusConfig) -> Option<String> {
    find_unconnected(config).map(|found| found.reason)
}

/// As [`find_problem`], with whether the problem says what to do.
fn find_unconnected(config: &BusConfig) -> Option<Unconnected> {
    let of = |is_advised| move |reason| Unconnected { reason, is_advised };
    let advised = Bus::find_unresolved(config).or_else(|| Bus::find_connection_problem(config));
    advised.map(of(true)).or_else(|| Bus::find_unanswered(config).map(of(false)))
}

/// What `again` connects, where a process accepts connections and has not answered yet; else why there is no
/// connection.
pub(super) fn why_unconnected<T>(
    config: &BusConfig,
    limit: Duration,
    again: impl FnOnce() -> Option<T>,
) -> Result<T, Unconnected> {
    if let Some(problem) = find_unconnected(config) {
        return Err(problem);
    }
    let endpoints = config.connect.join(", ");
    output::note(accepting_in_words(config));
    again().ok_or_else(|| {
        let reason = format!(
            "the process at {endpoints} does not answer as a process of a room within {} s: it is frozen, overloaded, or \
             of another kind",
            limit.as_secs_f64()
        );
        Unconnected { reason, is_advised: false }
    })
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;

    use heliostat_bus::free_loopback_endpoint;
    use heliostat_proto::Room;

    use super::*;

    #[test]
    fn a_process_that_accepts_connections_and_does_not_answer_is_named_with_the_limit() {
        let frozen = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let frozen = format!("tcp/{}", frozen.local_addr().expect("bound"));
        let absent = free_loopback_endpoint().expect("a free port");
        let config = BusConfig::new(Room::new("frozen").expect("a valid name"));
        // A limit that has passed with the first attempt: the answer has no further one.
        let refusal = |endpoint: &str| {
            let joined = join(&config.clone().connect_to(endpoint), ACCEPTS_WITHIN);
            joined.err().map(|refused| refused.with_advice("Give --connect")).unwrap_or_default()
        };
        assert_eq!(refusal(&absent), format!("no process answers at {absent}. Give --connect"));
        let client = BusConfig { role: Role::Client, ..config.clone().connect_to(&absent) };
        let refused = join(&client, Duration::from_secs(60)).err().expect("no process is there");
        let expected = format!("no process answers at {absent}. Give --connect");
        assert_eq!(refused.with_advice("Give --connect"), expected, "at once, and not after the limit");
        let refused = refusal(&frozen);
        let expected =
            format!("the process at {frozen} does not answer as a process of a room within 1.2 s: it is frozen");
        assert!(refused.starts_with(&expected), "{refused}");
        let both = config.connect_to(&absent).connect_to(&frozen);
        let advised = Unconnected::advised("the certificate expired: renew it");
        assert_eq!(advised.with_advice("Give --connect"), "the certificate expired: renew it");
        assert_eq!(join_through(&both, ACCEPTS_WITHIN).1, [absent, frozen]);
    }
}
