//! Endpoints of a session, and the settings of Zenoh for short delays.

use std::hash::{BuildHasher, RandomState};
use std::net::TcpListener;
use std::time::Duration;

use heliostat_proto::Room;
use zenoh::config::{Config, EndPoint};

use crate::error::BusError;

/// Default endpoint: one process of a room listens there, the others connect to it.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// Time limit for a client started from the command line to reach its router.
const ROUTER_LIMIT: Duration = Duration::from_secs(5);

/// Role of a session in the network.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Role {
    /// Exchanges messages with other peers directly.
    #[default]
    Peer,
    /// Exchanges messages through one router only.
    Client,
}

/// Behaviour of opening a session while no process answers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reach {
    /// Returns and keeps trying in the background, so that processes may start in any order. A
    /// client is of no use before it reaches its router; for a client, opening waits without limit.
    #[default]
    Eventually,
    /// Fails after this duration.
    Within(Duration),
}

/// Configuration of a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BusConfig {
    /// Room that gives the keys.
    pub room: Room,
    /// Endpoints at which to listen, such as `tcp/127.0.0.1:7447`.
    pub listen: Vec<String>,
    /// Endpoints of other processes.
    pub connect: Vec<String>,
    /// Peer or client.
    pub role: Role,
    /// Behaviour while no process answers.
    pub reach: Reach,
}

impl BusConfig {
    /// A peer without endpoints.
    pub fn new(room: Room) -> Self {
        Self { room, listen: Vec::new(), connect: Vec::new(), role: Role::Peer, reach: Reach::Eventually }
    }

    /// Adds an endpoint at which to listen.
    #[must_use]
    pub fn listen_at(mut self, endpoint: &str) -> Self {
        self.listen.push(endpoint.to_owned());
        self
    }

    /// Adds an endpoint to which to connect.
    #[must_use]
    pub fn connect_to(mut self, endpoint: &str) -> Self {
        self.connect.push(endpoint.to_owned());
        self
    }

    /// Sets the behaviour while no process answers.
    #[must_use]
    pub fn reaching(mut self, reach: Reach) -> Self {
        self.reach = reach;
        self
    }

    /// Checks each endpoint, and that there is at least one.
    ///
    /// # Errors
    /// [`BusError::NoEndpoint`], [`BusError::ClientWithoutRouter`] or
    /// [`BusError::InvalidEndpoint`].
    pub fn check(&self) -> Result<(), BusError> {
        if self.role == Role::Client && (self.connect.is_empty() || !self.listen.is_empty()) {
            return Err(BusError::ClientWithoutRouter);
        }
        if self.listen.is_empty() && self.connect.is_empty() {
            return Err(BusError::NoEndpoint);
        }
        self.listen.iter().chain(&self.connect).try_for_each(|endpoint| check_endpoint(endpoint))
    }

    /// Zenoh's configuration.
    pub(crate) fn to_zenoh(&self) -> Result<Config, BusError> {
        self.check()?;
        let (timeout_ms, exit_on_failure) = match self.reach {
            Reach::Eventually => (-1, false),
            Reach::Within(limit) => (i64::try_from(limit.as_millis()).unwrap_or(i64::MAX), true),
        };
        let mode = match self.role {
            Role::Peer => "\"peer\"",
            Role::Client => "\"client\"",
        };
        let mut config = Config::default();
        let settings = [
            ("mode", mode.to_owned()),
            ("listen/endpoints", json_list(&self.listen)),
            ("connect/endpoints", json_list(&self.connect)),
            ("connect/timeout_ms", timeout_ms.to_string()),
            ("connect/exit_on_failure", exit_on_failure.to_string()),
        ];
        let fixed = FIXED_SETTINGS.iter().map(|(key, value)| (*key, (*value).to_owned()));
        let own = settings.into_iter().chain(fixed).map(|(key, value)| (key.to_owned(), value));
        for (key, value) in own.chain(from_environment()?) {
            config
                .insert_json5(&key, &value)
                .map_err(|error| BusError::Open { problem: format!("setting {key} = {value}: {error}") })?;
        }
        Ok(config)
    }
}

/// Settings of Zenoh that are the same for every session.
const FIXED_SETTINGS: [(&str, &str); 12] = [
    // Endpoints are explicit; scouting would also delay opening.
    ("scouting/multicast/enabled", "false"),
    ("scouting/gossip/enabled", "false"),
    // A process may start before the one to which it connects. The default first retry comes after
    // 1 s.
    ("connect/retry", "{ period_init_ms: 50, period_max_ms: 1000, period_increase_factor: 2 }"),
    // Payloads are far below the size at which shared memory is faster.
    ("transport/shared_memory/enabled", "false"),
    // In us. The default of 1000 us is twice the latency budget of a decision, 0.5 ms.
    ("transport/link/tx/queue/congestion_control/drop/wait_before_drop", "50"),
    // Batches that may wait while the sending thread sleeps. With the default of 2, a third report
    // within one scheduler time slice is dropped on a busy machine. Memory is allocated only when
    // used.
    ("transport/link/tx/queue/size/real_time", "8"),
    ("transport/link/tx/queue/size/data_high", "4"),
    // In ms. A partition without a closed connection is detected after this time; the default is 10
    // s.
    ("transport/link/tx/lease", "5000"),
    // Connections that have not introduced themselves yet. With the defaults, 100 silent connections
    // keep out every other process for 10 s. The number is half of the usual limit of open files.
    ("transport/unicast/accept_pending", "512"),
    // In ms. Connections beyond that number wait at most for this time. An introduction takes two
    // round trips; the time also covers several lost packets.
    ("transport/unicast/accept_timeout", "3000"),
    // In ms. An attempt to connect that no process answers; the next one follows after the retry
    // period.
    ("transport/unicast/open_timeout", "3000"),
    // In bytes. Limits the memory that an unknown sender can occupy. It is above the limit of
    // payloads, so that the codec can refuse an oversized payload with a specific error.
    ("transport/link/rx/max_message_size", "16777216"),
];

/// Environment variable that overrides settings of Zenoh: `key=value`, separated by semicolons,
/// values in JSON5.
const ENVIRONMENT: &str = "HELIOSTAT_ZENOH";

fn from_environment() -> Result<Vec<(String, String)>, BusError> {
    let text = std::env::var(ENVIRONMENT).unwrap_or_default();
    let pair = |setting: &str| {
        let pair = setting.split_once('=').map(|(key, value)| (key.trim().to_owned(), value.trim().to_owned()));
        let expected = "expected key=value, for example transport/unicast/lowlatency=true";
        pair.ok_or_else(|| BusError::Open { problem: format!("{ENVIRONMENT}: \"{setting}\": {expected}") })
    };
    text.split(';').filter(|setting| !setting.trim().is_empty()).map(pair).collect()
}

/// Command-line flags for the room and the endpoints of a process.
#[derive(Clone, Debug, clap::Args)]
pub struct BusArgs {
    /// Name of the room; messages stay within their room
    #[arg(long, value_name = "NAME", default_value = "demo")]
    pub room: String,
    /// Endpoint at which to listen (repeatable); without any endpoint sim-node listens at
    /// tcp/127.0.0.1:7447
    #[arg(long, value_name = "ENDPOINT")]
    pub listen: Vec<String>,
    /// Endpoint of another process or of a router (repeatable); without any endpoint controller
    /// connects to tcp/127.0.0.1:7447
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,
    /// Exchange messages only through the Zenoh router given by --connect
    #[arg(long)]
    pub client: bool,
}

impl Default for BusArgs {
    fn default() -> Self {
        Self { room: "demo".to_owned(), listen: Vec::new(), connect: Vec::new(), client: false }
    }
}

impl BusArgs {
    /// The configuration that the flags describe.
    ///
    /// # Errors
    /// [`BusError`] where a flag is invalid, or no endpoint is given.
    pub fn config(&self) -> Result<BusConfig, BusError> {
        let config = BusConfig {
            room: Room::new(&self.room)?,
            listen: self.listen.clone(),
            connect: self.connect.clone(),
            role: if self.client { Role::Client } else { Role::Peer },
            // Opening blocks a client until it reaches its router, and it then ignores signals.
            reach: if self.client { Reach::Within(ROUTER_LIMIT) } else { Reach::Eventually },
        };
        config.check()?;
        Ok(config)
    }

    /// Like [`config`](Self::config); without any endpoint, listens at [`DEFAULT_ENDPOINT`].
    ///
    /// # Errors
    /// As for [`config`](Self::config).
    pub fn config_or_listen(&self) -> Result<BusConfig, BusError> {
        let mut flags = self.clone();
        if !flags.has_endpoint() && !flags.client {
            flags.listen.push(DEFAULT_ENDPOINT.to_owned());
        }
        flags.config()
    }

    /// Like [`config`](Self::config); without any endpoint, connects to [`DEFAULT_ENDPOINT`].
    ///
    /// # Errors
    /// As for [`config`](Self::config).
    pub fn config_or_connect(&self) -> Result<BusConfig, BusError> {
        let mut flags = self.clone();
        if !flags.has_endpoint() {
            flags.connect.push(DEFAULT_ENDPOINT.to_owned());
        }
        flags.config()
    }

    fn has_endpoint(&self) -> bool {
        !self.listen.is_empty() || !self.connect.is_empty()
    }
}

/// Name of the reliability of a connection in the metadata of an endpoint.
const RELIABILITY: &str = "rel";

/// Ports below the ephemeral ranges of Linux, macOS and Windows, so that no outgoing connection and
/// no listener at port 0 gets one.
const PORTS_BELOW_EPHEMERAL: std::ops::Range<u16> = 20_000..32_768;

/// A random TCP port on 127.0.0.1 that is free at the time of the call. It is below the ephemeral
/// range, so that no outgoing connection takes it in the meantime.
///
/// # Errors
/// [`BusError::NoFreePort`].
pub fn free_loopback_port() -> Result<u16, BusError> {
    let mut last = None;
    for _ in 0..100 {
        let span = u64::from(PORTS_BELOW_EPHEMERAL.end - PORTS_BELOW_EPHEMERAL.start);
        // Each `RandomState` has its own random keys, in every process.
        let offset = RandomState::new().hash_one(()) % span;
        let port = PORTS_BELOW_EPHEMERAL.start + u16::try_from(offset).expect("below the span of a u16 range");
        match TcpListener::bind(("127.0.0.1", port)) {
            Ok(_) => return Ok(port),
            Err(error) => last = Some(error),
        }
    }
    Err(BusError::NoFreePort { problem: last.map(|error| error.to_string()).unwrap_or_default() })
}

/// An endpoint on 127.0.0.1, at a [`free_loopback_port`].
///
/// # Errors
/// [`BusError::NoFreePort`].
pub fn free_loopback_endpoint() -> Result<String, BusError> {
    free_loopback_port().map(|port| format!("tcp/127.0.0.1:{port}"))
}

fn check_endpoint(text: &str) -> Result<(), BusError> {
    let refuse = |problem: String| Err(BusError::InvalidEndpoint { endpoint: text.to_owned(), problem });
    let endpoint: EndPoint = match text.parse() {
        Ok(endpoint) => endpoint,
        Err(_) => return refuse("it has no protocol before a '/'".to_owned()),
    };
    let address = endpoint.address().as_str().to_owned();
    match endpoint.protocol().as_str() {
        // A datagram that is lost is not sent again, and an emergency stop could be one.
        "quic" if endpoint.metadata().get(RELIABILITY).is_some_and(|value| value != "1") => {
            refuse("its connection would not repeat lost messages; remove \"rel\"".to_owned())
        }
        "tcp" | "quic" => match address.rsplit_once(':') {
            None => refuse("it has no port".to_owned()),
            Some(("", _)) => refuse("it has no host".to_owned()),
            Some((_, port)) if port.parse::<u16>().is_err() => refuse(format!("\"{port}\" is not a port")),
            Some(_) => Ok(()),
        },
        "unixsock-stream" => Ok(()),
        other => refuse(format!("protocol \"{other}\" is not built in")),
    }
}

fn json_list(endpoints: &[String]) -> String {
    let quoted: Vec<String> = endpoints.iter().map(|endpoint| format!("{endpoint:?}")).collect();
    format!("[{}]", quoted.join(","))
}
