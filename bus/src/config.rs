//! Who listens where, who connects whither, and how Zenoh is set up for short delays.

use std::hash::{BuildHasher, RandomState};
use std::net::TcpListener;
use std::time::Duration;

use heliostat_proto::Room;
use zenoh::config::{Config, EndPoint};

use crate::error::BusError;

/// Where the first process of a room listens, and others connect, unless told otherwise.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// How long a client started from the command line looks for its router.
const ROUTER_PATIENCE: Duration = Duration::from_secs(5);

/// How a session takes part in the network.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Role {
    /// Talks to others directly.
    #[default]
    Peer,
    /// Talks to one router only.
    Client,
}

/// What opening does when nobody answers yet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reach {
    /// Goes on, and keeps trying in the background, so that it does not matter who starts first. A client has nothing
    /// to do before it reaches its router: for it, opening waits without limit.
    #[default]
    Eventually,
    /// Fails after this long.
    Within(Duration),
}

/// Everything that opening a session needs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BusConfig {
    /// The room whose keys are used.
    pub room: Room,
    /// Endpoints at which to listen, such as `tcp/127.0.0.1:7447`.
    pub listen: Vec<String>,
    /// Endpoints of others.
    pub connect: Vec<String>,
    /// Peer or client.
    pub role: Role,
    /// What to do while nobody answers.
    pub reach: Reach,
}

impl BusConfig {
    /// A peer that listens nowhere and connects to nobody yet.
    pub fn new(room: Room) -> Self {
        Self { room, listen: Vec::new(), connect: Vec::new(), role: Role::Peer, reach: Reach::Eventually }
    }

    /// Listens at one more endpoint.
    #[must_use]
    pub fn listen_at(mut self, endpoint: &str) -> Self {
        self.listen.push(endpoint.to_owned());
        self
    }

    /// Connects to one more endpoint.
    #[must_use]
    pub fn connect_to(mut self, endpoint: &str) -> Self {
        self.connect.push(endpoint.to_owned());
        self
    }

    /// Sets what happens while nobody answers.
    #[must_use]
    pub fn reaching(mut self, reach: Reach) -> Self {
        self.reach = reach;
        self
    }

    /// Whether each endpoint is one, and whether anybody could be met.
    ///
    /// # Errors
    /// [`BusError::NoEndpoint`], [`BusError::ClientWithoutRouter`] or [`BusError::InvalidEndpoint`].
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

/// What is the same for every session.
const FIXED_SETTINGS: [(&str, &str); 9] = [
    // Peers are named, not discovered; scouting would also delay the opening.
    ("scouting/multicast/enabled", "false"),
    ("scouting/gossip/enabled", "false"),
    // Whoever starts first is tried again soon; the default begins at 1 s.
    ("connect/retry", "{ period_init_ms: 50, period_max_ms: 1000, period_increase_factor: 2 }"),
    // Payloads are far below the size at which shared memory pays.
    ("transport/shared_memory/enabled", "false"),
    // In us. The default of 1000 could hold a publication for twice the time that a decision has.
    ("transport/link/tx/queue/congestion_control/drop/wait_before_drop", "50"),
    // Batches that may wait while the sending thread sleeps: with the default of 2, a third report within a scheduler's
    // time slice is lost on a busy machine. Memory is taken only when used.
    ("transport/link/tx/queue/size/real_time", "8"),
    ("transport/link/tx/queue/size/data_high", "4"),
    // In ms. A partition without a closed connection shows after this long; the default is 10 s.
    ("transport/link/tx/lease", "5000"),
    // In bytes. Bounds what a stranger can make us assemble, yet lets an oversized payload arrive to be refused by name.
    ("transport/link/rx/max_message_size", "16777216"),
];

/// Settings of Zenoh that are laid over our own: `key=value`, several separated by semicolons, values in JSON5.
const ENVIRONMENT: &str = "HELIOSTAT_ZENOH";

fn from_environment() -> Result<Vec<(String, String)>, BusError> {
    let text = std::env::var(ENVIRONMENT).unwrap_or_default();
    let pair = |setting: &str| {
        let pair = setting.split_once('=').map(|(key, value)| (key.trim().to_owned(), value.trim().to_owned()));
        let wanted = "wanted key=value, for example transport/unicast/lowlatency=true";
        pair.ok_or_else(|| BusError::Open { problem: format!("{ENVIRONMENT}: \"{setting}\": {wanted}") })
    };
    text.split(';').filter(|setting| !setting.trim().is_empty()).map(pair).collect()
}

/// The flags by which a process is told its room and its endpoints.
#[derive(Clone, Debug, clap::Args)]
pub struct BusArgs {
    /// Name of the room; processes of different rooms never hear each other
    #[arg(long, value_name = "NAME", default_value = "demo")]
    pub room: String,
    /// Endpoint at which to listen (repeatable); without any endpoint sim-node listens at tcp/127.0.0.1:7447
    #[arg(long, value_name = "ENDPOINT")]
    pub listen: Vec<String>,
    /// Endpoint of another process or of a router (repeatable); without any endpoint controller connects to tcp/127.0.0.1:7447
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,
    /// Talk through a Zenoh router only, the one given by --connect
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
    /// [`BusError`] where a flag has no sense, or no endpoint is given.
    pub fn config(&self) -> Result<BusConfig, BusError> {
        let config = BusConfig {
            room: Room::new(&self.room)?,
            listen: self.listen.clone(),
            connect: self.connect.clone(),
            role: if self.client { Role::Client } else { Role::Peer },
            // A client without its router can do nothing, not even listen for a signal.
            reach: if self.client { Reach::Within(ROUTER_PATIENCE) } else { Reach::Eventually },
        };
        config.check()?;
        Ok(config)
    }

    /// The same; without any endpoint, listens at [`DEFAULT_ENDPOINT`].
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

    /// The same; without any endpoint, connects to [`DEFAULT_ENDPOINT`].
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

/// Ports that no system hands out by itself: below those that Linux, macOS and Windows give to outgoing connections and to listeners at port 0.
const PORTS_LEFT_TO_CHOICE: std::ops::Range<u16> = 20_000..32_768;

/// A TCP port on 127.0.0.1, chosen at random, that was free a moment ago, and that the system gives to nobody who does not ask for it by
/// number: what connects elsewhere in the meantime does not take it.
///
/// # Errors
/// [`BusError::NoFreePort`].
pub fn free_loopback_port() -> Result<u16, BusError> {
    let mut last = None;
    for _ in 0..100 {
        let span = u64::from(PORTS_LEFT_TO_CHOICE.end - PORTS_LEFT_TO_CHOICE.start);
        // Each `RandomState` has keys of its own; those of different processes have nothing in common.
        let offset = RandomState::new().hash_one(()) % span;
        let port = PORTS_LEFT_TO_CHOICE.start + u16::try_from(offset).expect("below the span of a u16 range");
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
        "tcp" => match address.rsplit_once(':') {
            None => refuse("it has no port".to_owned()),
            Some(("", _)) => refuse("it has no host".to_owned()),
            Some((_, port)) if port.parse::<u16>().is_err() => refuse(format!("\"{port}\" is no port")),
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
