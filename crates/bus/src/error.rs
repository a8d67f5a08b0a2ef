//! Errors of sessions and of keys, with the remedy.

use std::path::{Path, PathBuf};

use heliostat_files::write_advice;
use heliostat_proto::RoomError;
use thiserror::Error;

/// Why a session, a declaration, a publication or a query failed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum BusError {
    /// The name of the room is not valid in a key.
    #[error(transparent)]
    Room(#[from] RoomError),
    /// The keys cannot be made or used.
    #[error(transparent)]
    Keys(#[from] KeyError),
    /// Other machines could reach the endpoint, and the session has no certificate.
    #[error(
        "endpoint {endpoint}: each process that reaches it could turn the mirrors; expected an address of this machine such as tcp/127.0.0.1:7447, or --tls DIR with a tls/ endpoint (heliostat keys init makes the keys), or --insecure on an isolated network"
    )]
    OpenListener {
        /// The endpoint.
        endpoint: String,
    },
    /// The endpoint is not encrypted, and the session has a certificate.
    #[error(
        "endpoint {endpoint}: it is not encrypted; with --tls expected tls/HOST:PORT or quic/HOST:PORT, for example \
         tls/127.0.0.1:7447"
    )]
    Unencrypted {
        /// The endpoint.
        endpoint: String,
    },
    /// The endpoint is encrypted, and the session has no certificate.
    #[error(
        "endpoint {endpoint}: this process has no certificate for it; expected --tls DIR with the keys of the room"
    )]
    NoKeys {
        /// The endpoint.
        endpoint: String,
    },
    /// The keys are for another room.
    #[error(
        "the keys are for room \"{of_keys}\", not for \"{room}\"; omit --room, or give --tls the keys of room \"{room}\""
    )]
    OtherRoom {
        /// The room of the session.
        room: String,
        /// The room of the keys.
        of_keys: String,
    },
    /// The configuration has no endpoint at all, so no connection is possible.
    #[error(
        "no endpoint: expected --listen tcp/127.0.0.1:7447 for one process and --connect tcp/127.0.0.1:7447 for the others (any free port works)"
    )]
    NoEndpoint,
    /// The client has no router to connect to, or listens.
    #[error("wrong endpoints for a client: expected no --listen, and --connect with the endpoint of a Zenoh router")]
    ClientWithoutRouter,
    /// The text is not an endpoint.
    #[error(
        "endpoint \"{endpoint}\": {problem}; expected tcp/HOST:PORT, for example tcp/127.0.0.1:7447, or \
         unixsock-stream/PATH; with --tls expected tls/HOST:PORT or quic/HOST:PORT"
    )]
    InvalidEndpoint {
        /// The text.
        endpoint: String,
        /// Its fault.
        problem: String,
    },
    /// Another process listens at the endpoint.
    #[error("endpoint {endpoint} is in use: another process listens there; stop it, or listen at another endpoint")]
    EndpointInUse {
        /// The endpoint.
        endpoint: String,
    },
    /// Listening failed for another reason.
    #[error("cannot listen at {endpoint}: {problem}; give --listen an address of this machine and a port it may use")]
    CannotListen {
        /// The endpoint.
        endpoint: String,
        /// Zenoh's message.
        problem: String,
    },
    /// No process answers within the limit of the configuration.
    #[error(
        "no answer from {endpoints} within {waited_ms} ms; start the process that listens there first, or correct --connect"
    )]
    CannotReach {
        /// The endpoints.
        endpoints: String,
        /// Duration of the wait in ms.
        waited_ms: u64,
    },
    /// The name of an endpoint has no address, or none in time.
    #[error("{problem}")]
    Unresolved {
        /// The endpoint, its name, and what to do.
        problem: String,
    },
    /// A process answers, and the TLS connection to it fails, or it accepts no connection without TLS.
    #[error("{problem}")]
    Untrusted {
        /// The endpoint and what is wrong with a certificate, or that keys are missing.
        problem: String,
    },
    /// The session could not be opened for another reason.
    #[error("the Zenoh session cannot be opened: {problem}")]
    Open {
        /// Zenoh's message.
        problem: String,
    },
    /// The key is invalid, or the session is closed.
    #[error("cannot {action} \"{key}\": {problem}")]
    Refused {
        /// The action that failed, for example "publish on".
        action: &'static str,
        /// The key or pattern.
        key: String,
        /// Zenoh's message.
        problem: String,
    },
    /// The session did not close cleanly.
    #[error("the Zenoh session did not close cleanly: {problem}")]
    Close {
        /// Zenoh's message.
        problem: String,
    },
    /// No loopback port is free.
    #[error("no free port on 127.0.0.1: {problem}")]
    NoFreePort {
        /// Message of the operating system.
        problem: String,
    },
}

impl BusError {
    /// Whether the settings of a session cannot be used, of which nothing was tried yet: room, endpoints or keys.
    pub fn is_of_settings(&self) -> bool {
        match self {
            Self::Keys(KeyError::CannotWrite { .. }) => false,
            Self::Room(_)
            | Self::Keys(_)
            | Self::OpenListener { .. }
            | Self::Unencrypted { .. }
            | Self::NoKeys { .. }
            | Self::OtherRoom { .. }
            | Self::NoEndpoint
            | Self::ClientWithoutRouter
            | Self::InvalidEndpoint { .. } => true,
            Self::EndpointInUse { .. }
            | Self::CannotListen { .. }
            | Self::CannotReach { .. }
            | Self::Unresolved { .. }
            | Self::Untrusted { .. }
            | Self::Open { .. }
            | Self::Refused { .. }
            | Self::Close { .. }
            | Self::NoFreePort { .. } => false,
        }
    }
}

/// Why keys cannot be made or used.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum KeyError {
    /// A file or folder cannot be read.
    #[error("cannot read {}: {problem}; expected a folder made by heliostat keys init or heliostat keys issue", path.display())]
    CannotRead {
        /// The file or folder.
        path: PathBuf,
        /// The operating system's or parser's message.
        problem: String,
    },
    /// A folder has the certificate of an authority, but not its private key.
    #[error(
        "there is no {}: expected the folder of the authority, which has ca.key; give that one with --dir AUTHORITY, and \
         the folder whose certificates are written with --out DIR", path.display()
    )]
    NoAuthorityKey {
        /// The file of the key.
        path: PathBuf,
    },
    /// A file or folder cannot be written.
    #[error("cannot write {}: {problem}; {advice}", path.display())]
    CannotWrite {
        /// The file or folder.
        path: PathBuf,
        /// The operating system's message.
        problem: String,
        /// What to do.
        advice: &'static str,
    },
    /// The file exists.
    #[error("{} exists: expected a folder without these keys; heliostat keys renew replaces certificates", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The folder is that of a router for several rooms.
    #[error(
        "{} has the files of a router for several rooms: renew the keys of each room where its authority is, then write \
         these files again with heliostat keys router", folder.display()
    )]
    RouterFolder {
        /// The folder.
        folder: PathBuf,
    },
    /// Two folders have the keys of one room.
    #[error("two folders have the keys of room \"{room}\": expected one folder for each room")]
    SameRoom {
        /// The room.
        room: String,
    },
    /// The path cannot be part of an endpoint.
    #[error("{}: expected a path without the characters ; # = ?, which end it in an endpoint of Zenoh", path.display())]
    UnusablePath {
        /// The path.
        path: PathBuf,
    },
    /// The text is no name or address of a host.
    #[error(
        "\"{host}\" is no host: expected a name or an address without protocol and port, for example host-a.example.org"
    )]
    NotAHost {
        /// The text.
        host: String,
    },
    /// The certificates of the first room do not name the host of another router.
    #[error(
        "the certificates in {} name no \"{host}\", so no router can connect to it: expected one of {hosts}, or keys of \
         another folder by heliostat keys init --host {host}", folder.display()
    )]
    UnnamedHost {
        /// The folder of keys.
        folder: PathBuf,
        /// The host of the other router.
        host: String,
        /// The hosts that the certificates name.
        hosts: String,
    },
    /// There are fewer ports than rooms.
    #[error("{rooms} rooms need as many ports from {first} on: expected a lower first port, for example 7448")]
    NoPort {
        /// Number of rooms.
        rooms: usize,
        /// The first port.
        first: u16,
    },
    /// The folder holds the certificate of another authority.
    #[error("{} is of another authority: expected an empty folder, or the folder of the same room", path.display())]
    ForeignFolder {
        /// The certificate.
        path: PathBuf,
    },
    /// The file is no certificate.
    #[error("{}: {problem}; expected a certificate in PEM format, made by heliostat keys", path.display())]
    NotACertificate {
        /// The file.
        path: PathBuf,
        /// Its fault.
        problem: String,
    },
    /// The file is no private key.
    #[error(
        "{}: {problem}; expected a private key in PEM format: copy it again with its certificate, or issue both again \
         with heliostat keys issue", path.display()
    )]
    NotAPrivateKey {
        /// The file.
        path: PathBuf,
        /// Its fault.
        problem: String,
    },
    /// The common name is not the expected one.
    #[error(
        "{}: the certificate is for \"{name}\", which is no name of this file; issue it again with heliostat keys issue", path.display()
    )]
    ForeignName {
        /// The file.
        path: PathBuf,
        /// The common name.
        name: String,
    },
    /// The folder has no certificate of a suitable role.
    #[error(
        "{} has certificates of: {found}; expected one of: {expected}; make it with heliostat keys issue --role ROLE", folder.display()
    )]
    NoRole {
        /// The folder.
        folder: PathBuf,
        /// The suitable roles.
        expected: String,
        /// The roles in the folder.
        found: String,
    },
    /// The private key is not that of the certificate.
    #[error(
        "{} is not the private key of {} beside it; copy both from the same folder, or issue them again with heliostat \
         keys issue", key.display(), certificate.display()
    )]
    OtherKey {
        /// The private key.
        key: PathBuf,
        /// The certificate.
        certificate: PathBuf,
    },
    /// The certificate is signed by another authority than that of its folder.
    #[error("{}: another authority than ca.pem of this folder signed it; copy both from the same folder", path.display())]
    OtherAuthority {
        /// The certificate.
        path: PathBuf,
    },
    /// The certificate has expired.
    #[error("{}: the certificate expired on {expires}; renew it with heliostat keys renew", path.display())]
    Expired {
        /// The certificate.
        path: PathBuf,
        /// Date of its expiry.
        expires: String,
    },
    /// The certificate becomes valid later.
    #[error("{}: the certificate is not valid yet; set the clock of this machine, or issue it again", path.display())]
    NotYetValid {
        /// The certificate.
        path: PathBuf,
    },
    /// Every user of the machine may read the private key.
    #[error(
        "{}: every user of this machine can read or change this private key; expected chmod 600 or 640, or for a \
         secret that a container mounts defaultMode: 0440",
        path.display()
    )]
    ReadableByOthers {
        /// The private key.
        path: PathBuf,
    },
    /// A key or a certificate could not be made.
    #[error("cannot make a certificate: {problem}; expected hosts that are names in ASCII or IP addresses")]
    Generation {
        /// The library's message.
        problem: String,
    },
}

impl KeyError {
    /// The error of a write, with what to do about its cause.
    pub(crate) fn cannot_write(path: &Path, error: &std::io::Error) -> Self {
        let advice = write_advice(error, "expected a folder that this user may write");
        Self::CannotWrite { path: path.into(), problem: error.to_string(), advice }
    }
}
