//! Keys, sessions and a router for the tests of access.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use heliostat_bus::*;
use heliostat_proto::Room;
use tempfile::TempDir;
use zenoh::Wait;

/// Room of the tests.
pub const ROOM: &str = "lab";

/// Time limit of each wait, long enough for a busy machine; a test that succeeds does not wait for
/// it.
pub const LIMIT: Duration = Duration::from_secs(60);

/// Time limit of a connection that must fail.
pub const REFUSAL_LIMIT: Duration = Duration::from_millis(1500);

/// Waits until this is so.
pub fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let deadline = Instant::now() + LIMIT;
    while !is_so() {
        assert!(Instant::now() < deadline, "{what}: not within the limit");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// One test at a time: the more sessions a process has, the more often a data race in Zenoh's TLS
/// links aborts it. Source: eclipse-zenoh/zenoh, issue 2557.
pub fn turn() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A folder of keys, deleted at the end of the test.
pub struct Keys {
    folder: TempDir,
}

impl Keys {
    /// Keys of the tests' room.
    pub fn new() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let room = Room::new(ROOM).expect("a valid name");
        keys::init(&room, folder.path(), &keys::Terms::of_days(1, &[])).expect("an empty folder");
        Self { folder }
    }

    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Keys of the same authority whose certificates end at this time.
    pub fn until(&self, end: SystemTime) -> Self {
        let other = Self::new();
        for file in ["ca.key", "ca.pem"] {
            std::fs::copy(self.folder().join(file), other.folder().join(file)).expect("both are folders of keys");
        }
        keys::renew(other.folder(), other.folder(), end).expect("a folder of keys");
        other
    }

    /// Keys of the same authority whose certificates have expired.
    pub fn expired(&self) -> Self {
        self.until(SystemTime::now() - Duration::from_secs(60))
    }

    /// An operator's files with another common name, signed by the authority of these keys.
    pub fn of_name(&self, name: &str) -> TempDir {
        let read = |file: &str| std::fs::read_to_string(self.folder().join(file)).expect("a folder of keys");
        let authority = rcgen::KeyPair::from_pem(&read("ca.key")).expect("a private key");
        let named = |name: &str| {
            let mut params = rcgen::CertificateParams::new(vec!["127.0.0.1".to_owned()]).expect("an address");
            params.distinguished_name.remove(rcgen::DnType::CommonName);
            params.distinguished_name.push(rcgen::DnType::CommonName, name);
            params
        };
        let common_name = Certificate::read(&self.folder().join("ca.pem")).expect("a certificate").common_name;
        let issuer = rcgen::Issuer::new(named(&common_name), authority);
        let key = rcgen::KeyPair::generate().expect("a key");
        let certificate = named(name).signed_by(&key, &issuer).expect("a certificate");
        let folder = tempfile::tempdir().expect("a temporary folder");
        std::fs::write(folder.path().join("operator.pem"), certificate.pem()).expect("a file");
        std::fs::write(folder.path().join("operator.key"), key.serialize_pem()).expect("a file");
        folder
    }

    /// Configuration of a peer with a role.
    pub fn config(&self, role: AccessRole) -> BusConfig {
        let identity = Identity::load(self.folder(), &[role]).expect("keys of each role");
        BusConfig::new(identity.room().clone()).secured_by(identity)
    }

    /// A peer with a role.
    pub fn open(&self, role: AccessRole, endpoints: impl FnOnce(BusConfig) -> BusConfig) -> Bus {
        Bus::open(&endpoints(self.config(role))).expect("a free port and valid keys")
    }

    /// A client of a router with a role.
    pub fn client(&self, role: AccessRole, endpoint: &str) -> Bus {
        let config = BusConfig { role: Role::Client, ..self.config(role).connect_to(endpoint) };
        Bus::open(&config.reaching(Reach::Within(LIMIT))).expect("the router answers")
    }
}

/// A free loopback endpoint for TLS.
pub fn tls_endpoint() -> String {
    free_loopback_endpoint().expect("a free port").replace("tcp/", "tls/")
}

/// A router with the generated configuration, at a free endpoint.
pub fn router(folder: &Path) -> (zenoh::Session, String) {
    let file = folder.join("zenoh-router.json5");
    let mut config = zenoh::Config::from_file(file).expect("the generated configuration is valid");
    let endpoint = tls_endpoint();
    config.insert_json5("listen/endpoints", &format!("[{endpoint:?}]")).expect("a list of endpoints");
    (zenoh::open(config).wait().expect("the router opens"), endpoint)
}

pub fn close(router: zenoh::Session) {
    router.close().wait().expect("the router closes");
}

fn tls(settings: &[(&str, PathBuf)]) -> zenoh::Config {
    let mut config = zenoh::Config::default();
    let mut set = |key: &str, value: &str| config.insert_json5(key, value).expect("a valid setting");
    set("mode", "\"peer\"");
    set("scouting/multicast/enabled", "false");
    for (key, path) in settings {
        set(&format!("transport/link/tls/{key}"), &format!("{:?}", path.display().to_string()));
    }
    config
}

/// A session of a program without rules of its own. It connects within a time or fails. As a client it
/// publishes whether or not it knows of a subscriber.
pub fn foreign(
    within: Duration,
    identity: Option<(&Path, AccessRole)>,
    authority: &Path,
    endpoint: &str,
) -> Result<zenoh::Session, zenoh::Error> {
    let mut settings = vec![("root_ca_certificate", authority.join("ca.pem"))];
    if let Some((folder, role)) = identity {
        settings.push(("connect_certificate", folder.join(format!("{role}.pem"))));
        settings.push(("connect_private_key", folder.join(format!("{role}.key"))));
    }
    let mut config = tls(&settings);
    let mut set = |key: &str, value: &str| config.insert_json5(key, value).expect("a valid setting");
    set("mode", "\"client\"");
    set("transport/link/tls/enable_mtls", if identity.is_some() { "true" } else { "false" });
    set("connect/endpoints", &format!("[{endpoint:?}]"));
    set("connect/timeout_ms", &within.as_millis().to_string());
    set("connect/exit_on_failure", "true");
    zenoh::open(config).wait()
}

/// A listening session with any certificate.
pub fn foreign_listener(folder: &Path, role: AccessRole, endpoint: &str) -> zenoh::Session {
    let mut config = tls(&[
        ("root_ca_certificate", folder.join("ca.pem")),
        ("listen_certificate", folder.join(format!("{role}.pem"))),
        ("listen_private_key", folder.join(format!("{role}.key"))),
    ]);
    config.insert_json5("listen/endpoints", &format!("[{endpoint:?}]")).expect("a list of endpoints");
    zenoh::open(config).wait().expect("a free port")
}
