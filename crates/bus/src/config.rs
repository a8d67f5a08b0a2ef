//! Endpoints of a session, and the settings of Zenoh for short delays.

use std::path::PathBuf;
use std::time::Duration;

use heliostat_files::shell_word;
use heliostat_proto::Room;
use serde_json::{Map, Value};
use zenoh::config::{Config, EndPoint};

use crate::access::AccessRole;
use crate::error::BusError;
use crate::platform::HAS_UNIX_SOCKETS;
use crate::tls::{self, CertificateEnds, Identity};

/// Default endpoint: one process of a room listens there, the others connect to it.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// Default endpoint of a session with keys.
pub const DEFAULT_TLS_ENDPOINT: &str = "tls/127.0.0.1:7447";

/// Room of a process for which neither a flag nor its keys name one.
const DEFAULT_ROOM: &str = "demo";

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
    /// The certificate of the process; without one the session is neither encrypted nor
    /// authenticated.
    pub identity: Option<Identity>,
    /// Whether the process may listen without a certificate where other machines reach it.
    pub insecure: bool,
}

impl BusConfig {
    /// A peer without endpoints and without a certificate.
    pub fn new(room: Room) -> Self {
        Self {
            room,
            listen: Vec::new(),
            connect: Vec::new(),
            role: Role::Peer,
            reach: Reach::Eventually,
            identity: None,
            insecure: false,
        }
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

    /// Encrypts every connection, and exchanges messages only with processes of the same authority,
    /// within the rights of their roles.
    #[must_use]
    pub fn secured_by(mut self, identity: Identity) -> Self {
        self.identity = Some(identity);
        self
    }

    /// Whether the certificates of the remote processes restrict what they publish.
    pub fn is_authenticated(&self) -> bool {
        self.identity.is_some()
    }

    /// When the certificates end that the folder of the keys has.
    pub fn certificate_ends(&self) -> CertificateEnds {
        self.identity.as_ref().map(|identity| identity.ends).unwrap_or_default()
    }

    /// Whether other machines can read or send the messages of this session without a certificate.
    pub(crate) fn is_exposed(&self) -> bool {
        let reaches_out = |text: &String| text.parse::<EndPoint>().is_ok_and(|endpoint| !tls::is_local(&endpoint));
        self.identity.is_none() && self.listen.iter().chain(&self.connect).any(reaches_out)
    }

    /// Checks each endpoint, that there is at least one, and that all suit the certificate.
    ///
    /// # Errors
    /// [`BusError::NoEndpoint`], [`BusError::ClientWithoutRouter`], [`BusError::InvalidEndpoint`],
    /// [`BusError::OpenListener`], [`BusError::Unencrypted`], [`BusError::NoKeys`] or
    /// [`BusError::OtherRoom`].
    pub fn check(&self) -> Result<(), BusError> {
        if self.role == Role::Client && (self.connect.is_empty() || !self.listen.is_empty()) {
            return Err(BusError::ClientWithoutRouter);
        }
        if self.listen.is_empty() && self.connect.is_empty() {
            return Err(BusError::NoEndpoint);
        }
        self.listen.iter().chain(&self.connect).try_for_each(|endpoint| check_endpoint(endpoint))?;
        if let Some(identity) = self.identity.as_ref().filter(|identity| *identity.room() != self.room) {
            return Err(BusError::OtherRoom { room: self.room.to_string(), of_keys: identity.room().to_string() });
        }
        tls::check_encryption(self.identity.as_ref(), &self.listen, &self.connect, self.insecure)
    }

    /// Zenoh's configuration.
    pub(crate) fn to_zenoh(&self) -> Result<Config, BusError> {
        zenoh_config(self.settings()?.into_iter().chain(from_environment()?))
    }

    /// Zenoh's settings and their values in JSON5.
    pub(crate) fn settings(&self) -> Result<Vec<(String, String)>, BusError> {
        self.check()?;
        let (timeout_ms, exit_on_failure) = match self.reach {
            Reach::Eventually => (-1, false),
            Reach::Within(limit) => (i64::try_from(limit.as_millis()).unwrap_or(i64::MAX), true),
        };
        let mode = match self.role {
            Role::Peer => "\"peer\"",
            Role::Client => "\"client\"",
        };
        let settings = [
            ("mode", mode.to_owned()),
            ("listen/endpoints", json_list(&self.listen)),
            ("connect/endpoints", json_list(&self.connect)),
            ("connect/timeout_ms", timeout_ms.to_string()),
            ("connect/exit_on_failure", exit_on_failure.to_string()),
        ];
        let fixed = FIXED_SETTINGS.iter().map(|(key, value)| (*key, (*value).to_owned()));
        let own = settings.into_iter().chain(fixed).map(|(key, value)| (key.to_owned(), value));
        Ok(own.chain(self.identity.iter().flat_map(Identity::zenoh_settings)).collect())
    }
}

fn zenoh_config(settings: impl Iterator<Item = (String, String)>) -> Result<Config, BusError> {
    let mut config = Config::default();
    for (key, value) in settings {
        config
            .insert_json5(&key, &value)
            .map_err(|error| BusError::Open { problem: format!("setting {key} = {value}: {error}") })?;
    }
    Ok(config)
}

/// These settings as the text of a configuration file, after Zenoh has checked them.
pub(crate) fn nested_json(settings: &[(String, String)]) -> Result<String, BusError> {
    let invalid = |key: &str, problem: String| BusError::Open { problem: format!("setting {key}: {problem}") };
    let config = zenoh_config(settings.iter().cloned())?;
    let mut document = Value::Object(Map::new());
    for (key, _) in settings {
        let text = config.get_json(key).map_err(|error| invalid(key, error.to_string()))?;
        let value = serde_json::from_str(&text).map_err(|error| invalid(key, error.to_string()))?;
        *key.split('/').fold(&mut document, |inner, part| &mut inner[part]) = value;
    }
    Ok(format!("{document:#}"))
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

/// Settings of Zenoh that a router has in place of those of a process.
const ROUTER_SETTINGS: [(&str, &str); 2] = [
    ("mode", "\"router\""),
    // In us. A stop that finds no place in the queue of a cut link waits so long before the router closes the link, and
    // delays the messages of all rooms meanwhile. The default is 5 s; a command is valid for 0.2 s.
    ("transport/link/tx/queue/congestion_control/block/wait_before_close", "50000"),
];

/// Turns the settings of a process into those of a router.
pub(crate) fn make_router(settings: &mut Vec<(String, String)>) {
    settings.retain(|(key, _)| !ROUTER_SETTINGS.iter().any(|(own, _)| own == key));
    settings.extend(ROUTER_SETTINGS.map(|(key, value)| (key.to_owned(), value.to_owned())));
}

/// The settings of Zenoh of every router, with values in JSON5: without endpoints and keys.
pub fn router_settings() -> Vec<(String, String)> {
    let fixed = FIXED_SETTINGS.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned()));
    let mut settings: Vec<_> = fixed.collect();
    make_router(&mut settings);
    settings
}

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

/// Command-line flags for the certificate of a process.
#[derive(Clone, Debug, Default, PartialEq, Eq, clap::Args)]
pub struct TlsArgs {
    /// Encrypt and authenticate with the keys in this folder, made by `heliostat keys`; endpoints
    /// then begin with tls/
    #[arg(long, value_name = "DIR")]
    pub tls: Option<PathBuf>,
    /// Listen without --tls where other machines reach this process: each of them can then turn the
    /// mirrors
    #[arg(long, conflicts_with = "tls")]
    pub insecure: bool,
}

impl TlsArgs {
    /// The certificate of the first of these roles in the folder of `--tls`; `None` without it.
    ///
    /// # Errors
    /// [`BusError::Keys`].
    pub fn identity(&self, roles: &[AccessRole]) -> Result<Option<Identity>, BusError> {
        Ok(self.tls.as_ref().map(|folder| Identity::load(folder, roles)).transpose()?)
    }
}

/// Command-line flags for the room, the endpoints and the certificate of a process. Their help is that of a command
/// with [`BusArgs::config_or_connect`]; a command with [`BusArgs::config_or_listen`] has texts of its own.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct BusArgs {
    /// Name of the room; messages stay within their room [default: the room of --tls, or demo]
    #[arg(long, value_name = "NAME")]
    pub room: Option<String>,
    /// Endpoint at which to listen (repeatable)
    #[arg(long, value_name = "ENDPOINT")]
    pub listen: Vec<String>,
    /// Endpoint of another process or of a router (repeatable) [default without --listen:
    /// tcp/127.0.0.1:7447, or tls/127.0.0.1:7447 with --tls]
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,
    /// Exchange messages only through the Zenoh router given by --connect
    #[arg(long)]
    pub client: bool,
    /// Certificate of the process.
    #[command(flatten)]
    pub tls: TlsArgs,
}

impl BusArgs {
    /// The configuration that the flags describe. With `--tls` the process has the first of these
    /// roles that the folder holds.
    ///
    /// # Errors
    /// [`BusError`] where a flag is invalid, no endpoint is given, or the keys cannot be used.
    pub fn config(&self, roles: &[AccessRole]) -> Result<BusConfig, BusError> {
        let identity = self.tls.identity(roles)?;
        let room = match (&self.room, &identity) {
            (Some(name), _) => Room::new(name)?,
            (None, Some(identity)) => identity.room().clone(),
            (None, None) => Room::new(DEFAULT_ROOM)?,
        };
        let config = BusConfig {
            room,
            listen: self.listen.clone(),
            connect: self.connect.clone(),
            role: if self.client { Role::Client } else { Role::Peer },
            // Opening blocks a client until it reaches its router, and it then ignores signals.
            reach: if self.client { Reach::Within(ROUTER_LIMIT) } else { Reach::Eventually },
            identity,
            insecure: self.tls.insecure,
        };
        config.check()?;
        Ok(config)
    }

    /// Like [`config`](Self::config); without any endpoint, listens at [`DEFAULT_ENDPOINT`] or
    /// [`DEFAULT_TLS_ENDPOINT`].
    ///
    /// # Errors
    /// As for [`config`](Self::config).
    pub fn config_or_listen(&self, roles: &[AccessRole]) -> Result<BusConfig, BusError> {
        let mut flags = self.clone();
        if !flags.has_endpoint() && !flags.client {
            flags.listen.push(self.default_endpoint().to_owned());
        }
        flags.config(roles)
    }

    /// Like [`config`](Self::config); without any endpoint, connects to [`DEFAULT_ENDPOINT`] or
    /// [`DEFAULT_TLS_ENDPOINT`].
    ///
    /// # Errors
    /// As for [`config`](Self::config).
    pub fn config_or_connect(&self, roles: &[AccessRole]) -> Result<BusConfig, BusError> {
        let mut flags = self.clone();
        if !flags.has_endpoint() {
            flags.connect.push(self.default_endpoint().to_owned());
        }
        flags.config(roles)
    }

    /// A command that joins the same room in the same way, for an operator to copy.
    pub fn command(&self, name: &str, rest: &str) -> String {
        let folder = self.tls.tls.as_ref().map(|folder| folder.to_string_lossy().into_owned());
        let named = [("--room", self.room.clone()), ("--tls", folder)];
        let named = named.into_iter().filter_map(|(flag, value)| Some((flag, value?)));
        let listen = self.listen.iter().map(|endpoint| ("--listen", endpoint.clone()));
        let connect = self.connect.iter().map(|endpoint| ("--connect", endpoint.clone()));
        let valued = named.chain(listen).chain(connect).map(|(flag, value)| format!("{flag} {}", shell_word(&value)));
        let switches = [("--client", self.client), ("--insecure", self.tls.insecure)];
        let switches = switches.into_iter().filter(|(_, is_set)| *is_set).map(|(flag, _)| flag.to_owned());
        let flags: Vec<String> = valued.chain(switches).collect();
        [&[name.to_owned()], &flags[..], &[rest.to_owned()]].concat().join(" ")
    }

    fn default_endpoint(&self) -> &'static str {
        if self.tls.tls.is_some() { DEFAULT_TLS_ENDPOINT } else { DEFAULT_ENDPOINT }
    }

    fn has_endpoint(&self) -> bool {
        !self.listen.is_empty() || !self.connect.is_empty()
    }
}

/// Name of the reliability of a connection in the metadata of an endpoint.
const RELIABILITY: &str = "rel";

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
        "tcp" | "tls" | "quic" => match address.rsplit_once(':') {
            None => refuse("it has no port".to_owned()),
            Some(_) if address.ends_with(']') => refuse("it has no port".to_owned()),
            Some(("", _)) => refuse("it has no host".to_owned()),
            Some((_, port)) => match port.parse::<u16>() {
                Ok(0) => refuse("its port is 0, which selects one that no other process knows".to_owned()),
                Ok(_) => Ok(()),
                Err(_) => refuse(format!("\"{port}\" is not a port")),
            },
        },
        "unixsock-stream" if HAS_UNIX_SOCKETS => Ok(()),
        "unixsock-stream" => refuse("Unix sockets need Linux or macOS".to_owned()),
        other => refuse(format!("protocol \"{other}\" is not built in")),
    }
}

fn json_list(endpoints: &[String]) -> String {
    let quoted: Vec<String> = endpoints.iter().map(|endpoint| format!("{endpoint:?}")).collect();
    format!("[{}]", quoted.join(","))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn a_command_to_copy_joins_as_this_one_does() {
        let connect = vec!["tcp/127.0.0.1:7448".to_owned()];
        let mut flags = BusArgs { room: Some("foyer".into()), connect, client: true, ..BusArgs::default() };
        let rearm = |flags: &BusArgs| flags.command("heliostat rearm", "--all");
        assert_eq!(rearm(&BusArgs::default()), "heliostat rearm --all");
        assert_eq!(rearm(&flags), "heliostat rearm --room foyer --connect tcp/127.0.0.1:7448 --client --all");
        flags.tls.tls = Some("keys of foyer".into());
        let quoted = rearm(&flags);
        assert!(quoted.starts_with("heliostat rearm --room foyer --tls 'keys of foyer' --connect tcp/"), "{quoted}");
    }

    #[test]
    fn the_router_of_deploy_has_the_settings_of_every_router() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/router/router.json5");
        let deployed = Config::from_file(&file).expect("a valid configuration");
        let made = zenoh_config(router_settings().into_iter()).expect("valid settings");
        for key in [
            "mode",
            "scouting/multicast/enabled",
            "scouting/gossip/enabled",
            "transport/shared_memory/enabled",
            "transport/unicast/accept_pending",
            "transport/unicast/accept_timeout",
            "transport/link/tx/lease",
            "transport/link/tx/queue/congestion_control",
            "transport/link/rx/max_message_size",
        ] {
            assert_eq!(deployed.get_json(key).expect("a key"), made.get_json(key).expect("a key"), "{key}");
        }
    }
}
