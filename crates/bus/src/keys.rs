//! Making and renewing the keys of a room.
//!
//! A folder of keys has `ca.pem` and `ca.key`, the authority of one room. For each role it has
//! `ROLE.pem`, `ROLE.key` and `zenoh-ROLE.json5`, a configuration for Zenoh in other programs. A
//! folder for one machine has neither `ca.key` nor the files of other roles.

use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use heliostat_files::read_text;
use heliostat_proto::Room;
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair, KeyUsagePurpose,
};
use rustls::pki_types::ServerName;

use crate::access::AccessRole;
use crate::certificate::Certificate;
use crate::config::{BusConfig, DEFAULT_TLS_ENDPOINT, nested_json};
use crate::error::{BusError, KeyError};
use crate::platform;
use crate::tls::{AUTHORITY_CERTIFICATE, AUTHORITY_KEY, Identity, certificate_file, key_file, read_private, roles_in};

/// Validity of a certificate unless a caller gives another. Zenoh knows no revocation, so a lost
/// key is of use until its certificate expires.
pub const DEFAULT_DAYS: u32 = 90;

/// Validity of an authority.
const AUTHORITY_DAYS: u32 = 3650;

/// Time by which a certificate is valid before it is made, for machines whose clock is behind.
const CLOCK_TOLERANCE: Duration = Duration::from_secs(3600);

/// Hosts of every certificate.
const LOCAL_HOSTS: [&str; 3] = ["localhost", "127.0.0.1", "::1"];

/// Configuration in the folder of a router for several rooms.
pub(crate) const ROUTER_CONFIGURATION: &str = "router.json5";

/// Where a router listens.
const ROUTER_ENDPOINT: &str = "tls/0.0.0.0:7448";

/// The hosts and the validity of new certificates.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Terms {
    /// Hosts at which the holder may listen, apart from loopback.
    pub hosts: Vec<String>,
    /// Start of the validity.
    pub from: SystemTime,
    /// End of the validity; the end of the authority's own validity bounds it.
    pub until: SystemTime,
}

impl Terms {
    /// Valid from now for so many days.
    pub fn of_days(days: u32, hosts: &[String]) -> Self {
        Self { hosts: hosts.to_vec(), from: SystemTime::now() - CLOCK_TOLERANCE, until: end_after(days) }
    }

    /// A certificate with a URL or a port in the place of a host fits no connection.
    fn check(&self) -> Result<(), KeyError> {
        match self.hosts.iter().find(|host| ServerName::try_from(host.as_str()).is_err()) {
            Some(host) => Err(KeyError::NotAHost { host: host.clone() }),
            None => Ok(()),
        }
    }
}

/// Makes the authority of a room, and the keys of every role.
///
/// # Errors
/// [`KeyError`]: what is no host, a file that cannot be written, or an authority that exists.
pub fn init(room: &Room, folder: &Path, terms: &Terms) -> Result<(), BusError> {
    terms.check()?;
    create_folder(folder)?;
    let key = KeyPair::generate().map_err(generation)?;
    let mut params = authority_params(room);
    (params.not_before, params.not_after) = (terms.from.into(), end_after(AUTHORITY_DAYS).into());
    let certificate = params.self_signed(&key).map_err(generation)?;
    write_new(&folder.join(AUTHORITY_KEY), &key.serialize_pem(), PRIVATE)?;
    write_new(&folder.join(AUTHORITY_CERTIFICATE), &certificate.pem(), PUBLIC)?;
    AccessRole::ALL.into_iter().try_for_each(|role| issue(role, folder, folder, terms))
}

/// Makes the keys of a role by the authority in `authority`, and writes them to `out` together with
/// the authority's certificate.
///
/// # Errors
/// [`KeyError`]: what is no host, an authority that cannot be read, a file that cannot be written, or
/// keys of this role that exist.
pub fn issue(role: AccessRole, authority: &Path, out: &Path, terms: &Terms) -> Result<(), BusError> {
    terms.check()?;
    let existing = out.join(certificate_file(role));
    if existing.exists() {
        return Err(KeyError::Exists { path: existing }.into());
    }
    create_folder(out)?;
    Authority::read(authority)?.issue(role, out, terms)
}

/// Makes new keys for every role in `out`, with the hosts of the old ones, by the authority in
/// `authority`. Returns the roles.
///
/// # Errors
/// [`KeyError`]: a file that cannot be read or written, a folder without keys, or that of a router for several
/// rooms.
pub fn renew(authority: &Path, out: &Path, until: SystemTime) -> Result<Vec<AccessRole>, BusError> {
    let (authority, roles) = (Authority::read(authority)?, roles_in(out));
    if out.join(ROUTER_CONFIGURATION).exists() {
        return Err(KeyError::RouterFolder { folder: out.into() }.into());
    }
    if roles.is_empty() {
        let expected = AccessRole::ALL.map(AccessRole::name).join(", ");
        return Err(KeyError::NoRole { folder: out.into(), expected, found: "none".to_owned() }.into());
    }
    for role in &roles {
        let hosts = Certificate::read(&out.join(certificate_file(*role)))?.hosts;
        let terms = Terms { hosts, from: SystemTime::now() - CLOCK_TOLERANCE, until };
        authority.issue(*role, out, &terms)?;
    }
    Ok(roles)
}

/// End of the validity of a certificate that is made now for so many days.
pub fn end_after(days: u32) -> SystemTime {
    SystemTime::now() + of_days(days)
}

/// The certificates of the roles in a folder.
///
/// # Errors
/// [`KeyError`]: a file that cannot be read or is no certificate.
pub fn list(folder: &Path) -> Result<Vec<(AccessRole, Certificate)>, BusError> {
    // Without an authority this is no folder of keys.
    Certificate::read(&folder.join(AUTHORITY_CERTIFICATE))?;
    let read = |role: AccessRole| Ok((role, Certificate::read(&folder.join(certificate_file(role)))?));
    roles_in(folder).into_iter().map(read).collect()
}

/// The authority of a room, with its private key.
struct Authority {
    room: Room,
    certificate: Certificate,
    certificate_text: String,
    issuer: Issuer<'static, KeyPair>,
}

impl Authority {
    fn read(folder: &Path) -> Result<Self, KeyError> {
        let path = folder.join(AUTHORITY_CERTIFICATE);
        let certificate = Certificate::read(&path)?;
        let room = certificate.common_name.strip_prefix(AUTHORITY_NAME_PREFIX).and_then(|name| Room::new(name).ok());
        let room =
            room.ok_or_else(|| KeyError::ForeignName { path: path.clone(), name: certificate.common_name.clone() })?;
        let key_path = folder.join(AUTHORITY_KEY);
        let key = KeyPair::from_pem(&read_private(&key_path)?)
            .map_err(|error| KeyError::NotAPrivateKey { path: key_path, problem: error.to_string() })?;
        let certificate_text =
            read_text(&path).map_err(|error| KeyError::CannotRead { path, problem: error.to_string() })?;
        Ok(Self { issuer: Issuer::new(authority_params(&room), key), room, certificate, certificate_text })
    }

    /// Writes the keys of a role, in place of older ones.
    fn issue(&self, role: AccessRole, out: &Path, terms: &Terms) -> Result<(), BusError> {
        let present = out.join(AUTHORITY_CERTIFICATE);
        if present.exists() && Certificate::read(&present)?.own_key_id != self.certificate.own_key_id {
            return Err(KeyError::ForeignFolder { path: present }.into());
        }
        let key = KeyPair::generate().map_err(generation)?;
        let mut hosts: Vec<String> = LOCAL_HOSTS.map(str::to_owned).to_vec();
        hosts.extend(terms.hosts.iter().filter(|host| !LOCAL_HOSTS.contains(&host.as_str())).cloned());
        let mut params = CertificateParams::new(hosts).map_err(generation)?;
        params.distinguished_name.remove(DnType::CommonName);
        params.distinguished_name.push(DnType::CommonName, role.common_name(&self.room));
        params.not_before = terms.from.into();
        params.not_after = terms.until.min(self.certificate.end()).into();
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth];
        params.use_authority_key_identifier_extension = true;
        let certificate = params.signed_by(&key, &self.issuer).map_err(generation)?;
        replace(&out.join(key_file(role)), &key.serialize_pem(), PRIVATE)?;
        replace(&out.join(certificate_file(role)), &certificate.pem(), PUBLIC)?;
        replace(&out.join(AUTHORITY_CERTIFICATE), &self.certificate_text, PUBLIC)?;
        write_zenoh_configuration(role, out)
    }
}

/// Writes `zenoh-ROLE.json5`, for programs that open a Zenoh session themselves.
fn write_zenoh_configuration(role: AccessRole, folder: &Path) -> Result<(), BusError> {
    let Ok(identity) = Identity::load(folder, &[role]) else {
        // The certificate is not valid now; its configuration would not open a session.
        return Ok(());
    };
    let is_router = role == AccessRole::Router;
    let config = BusConfig::new(identity.room().clone()).secured_by(identity);
    let config = if is_router { config.listen_at(ROUTER_ENDPOINT) } else { config.connect_to(DEFAULT_TLS_ENDPOINT) };
    let mut settings = config.settings()?;
    if is_router {
        settings.iter_mut().filter(|(key, _)| key == "mode").for_each(|(_, mode)| *mode = "\"router\"".to_owned());
    }
    let user = if is_router { "a router: zenohd --config FILE" } else { "a peer: Config.from_file(FILE) in Python" };
    let text = format!(
        "// Zenoh configuration of role \"{role}\" in room \"{}\", for {user}.\n\
         // Adapt the endpoints. Adapt the paths after a copy to another folder. `heliostat keys renew` overwrites this file.\n{}\n",
        config.room,
        nested_json(&settings)?
    );
    Ok(replace(&folder.join(format!("zenoh-{role}.json5")), &text, PUBLIC)?)
}

const AUTHORITY_NAME_PREFIX: &str = "Heliostat authority of room ";

fn authority_params(room: &Room) -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name.remove(DnType::CommonName);
    params.distinguished_name.push(DnType::CommonName, format!("{AUTHORITY_NAME_PREFIX}{room}"));
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    params
}

fn of_days(days: u32) -> Duration {
    Duration::from_secs(u64::from(days) * 86_400)
}

fn generation(error: rcgen::Error) -> KeyError {
    KeyError::Generation { problem: error.to_string() }
}

/// Permissions of a file for its owner only.
pub(crate) const PRIVATE: u32 = 0o600;
/// Permissions of a file that others may read.
pub(crate) const PUBLIC: u32 = 0o644;

pub(crate) fn create_folder(folder: &Path) -> Result<(), KeyError> {
    let mut builder = fs::DirBuilder::new();
    platform::make_private(&mut builder);
    builder
        .recursive(true)
        .create(folder)
        .map_err(|error| KeyError::CannotWrite { path: folder.into(), problem: error.to_string() })
}

/// Writes a file that does not exist.
fn write_new(path: &Path, text: &str, mode: u32) -> Result<(), KeyError> {
    if path.exists() {
        return Err(KeyError::Exists { path: path.into() });
    }
    replace(path, text, mode)
}

/// Writes a file at once: a process that opens it reads the old content or the new one.
pub(crate) fn replace(path: &Path, text: &str, mode: u32) -> Result<(), KeyError> {
    let failed = |error: std::io::Error| KeyError::CannotWrite { path: path.into(), problem: error.to_string() };
    let mut temporary = PathBuf::from(path).into_os_string();
    temporary.push(".new");
    // A file left by an interrupted run may have other permissions.
    let _ = fs::remove_file(&temporary);
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    platform::set_permissions(&mut options, mode);
    let mut file = options.open(&temporary).map_err(failed)?;
    file.write_all(text.as_bytes()).and_then(|()| file.sync_all()).map_err(failed)?;
    fs::rename(&temporary, path).map_err(failed)
}
