//! The certificate of a session, and the endpoints at which a session without one may listen.

use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use heliostat_files::read_text;
use heliostat_proto::Room;
use rustls::crypto::ring;
use rustls::pki_types::PrivateKeyDer;
use rustls::pki_types::pem::{self, PemObject};
use zenoh::config::EndPoint;

use crate::access::{AccessRole, access_control};
use crate::certificate::Certificate;
use crate::error::{BusError, KeyError};
use crate::platform;

/// Certificate of the authority that signs all certificates of a room.
pub(crate) const AUTHORITY_CERTIFICATE: &str = "ca.pem";

/// Private key of the authority. Processes do not need it.
pub(crate) const AUTHORITY_KEY: &str = "ca.key";

/// File of the certificate of a role.
pub(crate) fn certificate_file(role: AccessRole) -> String {
    format!("{role}.pem")
}

/// File of the private key of a role.
pub(crate) fn key_file(role: AccessRole) -> String {
    format!("{role}.key")
}

/// A certificate with its private key, in a folder of keys: the room and the role of a process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Absolute, since a configuration file for Zenoh may be read from any folder.
    folder: PathBuf,
    room: Room,
    role: AccessRole,
    pub(crate) ends: CertificateEnds,
}

/// When certificates end that a process knows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CertificateEnds {
    /// That of the process.
    pub own: Option<SystemTime>,
    /// That of the router, where the folder of keys has it.
    pub router: Option<SystemTime>,
}

impl Identity {
    /// The first of these roles that has a certificate in the folder. The certificate must be valid
    /// now and signed by the authority of the folder, and have its private key beside it.
    ///
    /// # Errors
    /// [`KeyError`] names the file and its fault.
    pub fn load(folder: &Path, roles: &[AccessRole]) -> Result<Self, KeyError> {
        let folder = folder
            .canonicalize()
            .map_err(|error| KeyError::CannotRead { path: folder.into(), problem: error.to_string() })?;
        let authority = Certificate::read(&folder.join(AUTHORITY_CERTIFICATE))?;
        let role = roles.iter().copied().find(|role| folder.join(certificate_file(*role)).exists());
        let role = role.ok_or_else(|| KeyError::NoRole {
            folder: folder.clone(),
            expected: names(roles),
            found: names(&roles_in(&folder)),
        })?;
        let path = folder.join(certificate_file(role));
        let certificate = Certificate::read(&path)?;
        let (room, _) = certificate
            .room_and_role()
            .filter(|(_, named)| *named == role)
            .ok_or_else(|| KeyError::ForeignName { path: path.clone(), name: certificate.common_name.clone() })?;
        if certificate.signing_key_id != authority.own_key_id {
            return Err(KeyError::OtherAuthority { path });
        }
        authority.check_time(&folder.join(AUTHORITY_CERTIFICATE))?;
        certificate.check_time(&path)?;
        let key = folder.join(key_file(role));
        let public_key = public_key_of(&key)?;
        // A public key ends with its bits, which the certificate holds.
        if public_key.is_some_and(|public_key| !public_key.ends_with(&certificate.public_key)) {
            return Err(KeyError::OtherKey { key, certificate: path });
        }
        // Its private key need not be there, and the process does not use it.
        let router = Certificate::read(&folder.join(certificate_file(AccessRole::Router)));
        let ends = CertificateEnds { own: Some(certificate.end()), router: router.ok().map(|router| router.end()) };
        Ok(Self { folder, room, role, ends })
    }

    /// The certificate of another role in the same folder, for a process that has both.
    ///
    /// # Errors
    /// As for [`load`](Self::load).
    pub fn of_role(&self, role: AccessRole) -> Result<Self, KeyError> {
        Self::load(&self.folder, &[role])
    }

    /// Room in which it has rights.
    pub fn room(&self) -> &Room {
        &self.room
    }

    /// Role that gives its rights.
    pub fn role(&self) -> AccessRole {
        self.role
    }

    /// Folder of its files.
    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// File of its certificate.
    pub(crate) fn certificate(&self) -> PathBuf {
        self.folder.join(certificate_file(self.role))
    }

    /// File of its private key.
    pub(crate) fn private_key(&self) -> PathBuf {
        self.folder.join(key_file(self.role))
    }

    /// Whether the authority of its folder signed a certificate.
    pub(crate) fn signs(&self, certificate: &Certificate) -> bool {
        let authority = Certificate::read(&self.folder.join(AUTHORITY_CERTIFICATE));
        authority.is_ok_and(|authority| authority.own_key_id == certificate.signing_key_id)
    }

    /// Settings of Zenoh for mutual authentication and access control, with values in JSON.
    pub(crate) fn zenoh_settings(&self) -> Vec<(String, String)> {
        let mut settings =
            tls_settings(&self.folder.join(AUTHORITY_CERTIFICATE), &self.certificate(), &self.private_key());
        settings.push(("access_control".to_owned(), access_control(&self.room).to_string()));
        settings
    }
}

/// Settings of Zenoh for mutual authentication by these files, with values in JSON.
pub(crate) fn tls_settings(authority: &Path, certificate: &Path, private_key: &Path) -> Vec<(String, String)> {
    let file = |path: &Path| format!("{:?}", path.display().to_string());
    let (certificate, key) = (file(certificate), file(private_key));
    let yes = || "true".to_owned();
    let tls = [
        ("root_ca_certificate", file(authority)),
        ("listen_certificate", certificate.clone()),
        ("listen_private_key", key.clone()),
        ("connect_certificate", certificate),
        ("connect_private_key", key),
        ("enable_mtls", yes()),
        ("verify_name_on_connect", yes()),
        // Without this a connection outlives the certificate that opened it.
        ("close_link_on_expiration", yes()),
    ];
    tls.into_iter().map(|(name, value)| (format!("transport/link/tls/{name}"), value)).collect()
}

/// Roles that have a certificate in the folder.
pub(crate) fn roles_in(folder: &Path) -> Vec<AccessRole> {
    AccessRole::ALL.into_iter().filter(|role| folder.join(certificate_file(*role)).exists()).collect()
}

fn names(roles: &[AccessRole]) -> String {
    let names: Vec<&str> = roles.iter().map(|role| role.name()).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// Public key of a private key, with its algorithm; `None` for a kind of key that does not tell it.
fn public_key_of(path: &Path) -> Result<Option<Vec<u8>>, KeyError> {
    let refuse = |problem: &str| KeyError::NotAPrivateKey { path: path.into(), problem: problem.to_owned() };
    let text = read_private(path)?;
    let bytes = PrivateKeyDer::from_pem_slice(text.as_bytes()).map_err(|error| match error {
        pem::Error::NoItemsFound => refuse("it holds no private key"),
        pem::Error::MissingSectionEnd { .. } => refuse("it is cut: its end is missing"),
        _ => refuse("it is damaged"),
    })?;
    let key = ring::sign::any_supported_type(&bytes)
        .map_err(|_| refuse("its content is damaged, or is no key of RSA, ECDSA or EdDSA"))?;
    Ok(key.public_key().map(|public_key| public_key.to_vec()))
}

/// Reads the text of a private key; refuses one that every user of the machine can read.
pub(crate) fn read_private(path: &Path) -> Result<String, KeyError> {
    let unreadable = |error: std::io::Error| KeyError::CannotRead { path: path.into(), problem: error.to_string() };
    if platform::is_readable_by_others(&std::fs::metadata(path).map_err(unreadable)?) {
        return Err(KeyError::ReadableByOthers { path: path.into() });
    }
    let text = read_text(path).map_err(unreadable)?;
    if text.trim().is_empty() {
        return Err(KeyError::NotAPrivateKey { path: path.into(), problem: "it is empty".to_owned() });
    }
    Ok(text)
}

/// Whether every packet of an endpoint is encrypted and authenticated.
fn is_encrypted(endpoint: &EndPoint) -> bool {
    matches!(endpoint.protocol().as_str(), "tls" | "quic")
}

/// Whether only this machine reaches the endpoint. A host name other than `localhost` counts as
/// another machine, since its address can change.
pub(crate) fn is_local(endpoint: &EndPoint) -> bool {
    if endpoint.protocol().as_str() == "unixsock-stream" {
        return true;
    }
    let address = endpoint.address().as_str().to_owned();
    let host = address.rsplit_once(':').map_or(address.as_str(), |(host, _)| host);
    let host = host.trim_start_matches('[').trim_end_matches(']');
    match host.parse::<IpAddr>() {
        Ok(address) => address.to_canonical().is_loopback(),
        Err(_) => host == "localhost",
    }
}

/// Checks that the endpoints suit the keys: encrypted with a certificate, and without one
/// unencrypted and, for listening, on this machine only.
pub(crate) fn check_encryption(
    identity: Option<&Identity>,
    listen: &[String],
    connect: &[String],
    insecure: bool,
) -> Result<(), BusError> {
    for text in listen.iter().chain(connect) {
        let Ok(endpoint) = text.parse::<EndPoint>() else { continue };
        match (identity.is_some(), is_encrypted(&endpoint)) {
            (true, false) => return Err(BusError::Unencrypted { endpoint: text.clone() }),
            (false, true) => return Err(BusError::NoKeys { endpoint: text.clone() }),
            _ => {}
        }
    }
    let is_open = |text: &&String| text.parse::<EndPoint>().is_ok_and(|endpoint| !is_local(&endpoint));
    match listen.iter().find(is_open) {
        Some(endpoint) if identity.is_none() && !insecure => Err(BusError::OpenListener { endpoint: endpoint.clone() }),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_loopback_addresses_localhost_and_socket_files_are_local() {
        let local = |text: &str| is_local(&text.parse().expect("an endpoint"));
        for text in [
            "tcp/127.0.0.1:7447",
            "tcp/127.8.9.1:1",
            "tcp/[::1]:7447",
            "tcp/[::ffff:127.0.0.1]:7447",
            "udp/localhost:7447",
            "tcp/127.0.0.1:7447#iface=eth0",
            "unixsock-stream/run/lab.sock",
        ] {
            assert!(local(text), "{text}");
        }
        for text in [
            "tcp/0.0.0.0:7447",
            "tcp/[::]:7447",
            "tcp/192.168.0.1:7447",
            "udp/10.0.0.1:7447",
            "tcp/controller:7447",
            "tcp/localhost.example.org:7447",
            "tcp/127.0.0.1.example.org:7447",
            "tcp/[::ffff:10.0.0.1]:7447",
        ] {
            assert!(!local(text), "{text}");
        }
    }
}
