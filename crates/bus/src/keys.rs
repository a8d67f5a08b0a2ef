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
use crate::config::{BusConfig, DEFAULT_TLS_ENDPOINT, make_router, nested_json};
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

/// Makes the authority of a room, and the keys of every role: all of them, or none.
///
/// # Errors
/// [`KeyError`]: what is no host, a file that cannot be written, or keys that exist.
pub fn init(room: &Room, folder: &Path, terms: &Terms) -> Result<(), BusError> {
    terms.check()?;
    let of_authority = [AUTHORITY_KEY, AUTHORITY_CERTIFICATE].map(str::to_owned);
    refuse_existing(folder, of_authority.into_iter().chain(AccessRole::ALL.map(certificate_file)))?;
    all_or_none(folder, || {
        write_authority(room, folder, terms)?;
        AccessRole::ALL.into_iter().try_for_each(|role| issue(role, folder, folder, terms))
    })
}

fn write_authority(room: &Room, folder: &Path, terms: &Terms) -> Result<(), BusError> {
    create_folder(folder)?;
    let key = KeyPair::generate().map_err(generation)?;
    let mut params = authority_params(room);
    (params.not_before, params.not_after) = (terms.from.into(), end_after(AUTHORITY_DAYS).into());
    let certificate = params.self_signed(&key).map_err(generation)?;
    replace(&folder.join(AUTHORITY_KEY), &key.serialize_pem(), PRIVATE)?;
    Ok(replace(&folder.join(AUTHORITY_CERTIFICATE), &certificate.pem(), PUBLIC)?)
}

/// Makes the keys of a role by the authority in `authority`, and writes them to `out` together with
/// the authority's certificate: all of these files, or none.
///
/// # Errors
/// [`KeyError`]: what is no host, an authority that cannot be read, a file that cannot be written, or
/// keys of this role that exist.
pub fn issue(role: AccessRole, authority: &Path, out: &Path, terms: &Terms) -> Result<(), BusError> {
    terms.check()?;
    refuse_existing(out, [certificate_file(role)])?;
    all_or_none(out, || {
        create_folder(out)?;
        Authority::read(authority)?.issue(role, out, terms)
    })
}

/// Refuses a folder that has a file of one of these names.
fn refuse_existing(folder: &Path, names: impl IntoIterator<Item = String>) -> Result<(), KeyError> {
    match names.into_iter().map(|name| folder.join(name)).find(|path| path.exists()) {
        Some(path) => Err(KeyError::Exists { path }),
        None => Ok(()),
    }
}

/// Makes files in a folder of keys. Where that fails, those that did not exist before are removed: the rest of a
/// folder is of no use, and would be in the way of the next attempt.
fn all_or_none(folder: &Path, make: impl FnOnce() -> Result<(), BusError>) -> Result<(), BusError> {
    let is_new = !folder.exists();
    let absent: Vec<PathBuf> = files_of_keys(folder).filter(|file| !file.exists()).collect();
    let made = make();
    if made.is_err() {
        absent.iter().for_each(|file| drop(fs::remove_file(file)));
        if is_new {
            drop(fs::remove_dir(folder));
        }
    }
    made
}

/// The files that a folder of keys can have.
fn files_of_keys(folder: &Path) -> impl Iterator<Item = PathBuf> {
    let of_role = |role: AccessRole| [certificate_file(role), key_file(role), zenoh_file(role)];
    let of_authority = [AUTHORITY_KEY, AUTHORITY_CERTIFICATE].map(str::to_owned);
    of_authority.into_iter().chain(AccessRole::ALL.into_iter().flat_map(of_role)).map(move |name| folder.join(name))
}

/// File of the Zenoh configuration of a role.
fn zenoh_file(role: AccessRole) -> String {
    format!("zenoh-{role}.json5")
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

/// The certificates of the roles in a folder, none of them valid before its authority.
///
/// # Errors
/// [`KeyError`]: a file that cannot be read or is no certificate.
pub fn list(folder: &Path) -> Result<Vec<(AccessRole, Certificate)>, BusError> {
    // Without an authority this is no folder of keys.
    let authority = Certificate::read(&folder.join(AUTHORITY_CERTIFICATE))?;
    let read = |role: AccessRole| {
        let certificate = Certificate::read(&folder.join(certificate_file(role)))?;
        Ok((role, certificate.not_before(&authority)))
    };
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
        if !key_path.exists() {
            return Err(KeyError::NoAuthorityKey { path: key_path });
        }
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
        // On a full disk no new key comes beside the old certificate: all files are on the disk before the first takes
        // its place.
        let files = [
            Prepared::new(&out.join(key_file(role)), &key.serialize_pem(), PRIVATE)?,
            Prepared::new(&out.join(certificate_file(role)), &certificate.pem(), PUBLIC)?,
            Prepared::new(&out.join(AUTHORITY_CERTIFICATE), &self.certificate_text, PUBLIC)?,
        ];
        files.into_iter().try_for_each(Prepared::put)?;
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
        make_router(&mut settings);
    }
    let user = if is_router { "a router: zenohd --config FILE" } else { "a peer: Config.from_file(FILE) in Python" };
    let text = format!(
        "// Zenoh configuration of role \"{role}\" in room \"{}\", for {user}.\n\
         // Adapt the endpoints. Adapt the paths after a copy to another folder. `heliostat keys renew` overwrites this file.\n{}\n",
        config.room,
        nested_json(&settings)?
    );
    Ok(replace(&folder.join(zenoh_file(role)), &text, PUBLIC)?)
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
    builder.recursive(true).create(folder).map_err(|error| KeyError::cannot_write(folder, &error))
}

/// Writes a file at once: a process that opens it reads the old content or the new one.
pub(crate) fn replace(path: &Path, text: &str, mode: u32) -> Result<(), KeyError> {
    Prepared::new(path, text, mode)?.put()
}

/// A complete file beside its place, which it has not taken yet. It is removed where it never does.
struct Prepared {
    temporary: PathBuf,
    path: PathBuf,
}

impl Prepared {
    fn new(path: &Path, text: &str, mode: u32) -> Result<Self, KeyError> {
        let mut temporary = PathBuf::from(path).into_os_string();
        temporary.push(".new");
        let prepared = Self { temporary: temporary.into(), path: path.into() };
        // A file left by an interrupted run may have other permissions.
        let _ = fs::remove_file(&prepared.temporary);
        let mut options = OpenOptions::new();
        options.write(true).create_new(true);
        platform::set_permissions(&mut options, mode);
        let written = options.open(&prepared.temporary).and_then(|mut file| {
            file.write_all(text.as_bytes())?;
            file.sync_all()
        });
        written.map_err(|error| KeyError::cannot_write(path, &error))?;
        Ok(prepared)
    }

    /// Takes the place of the file.
    fn put(self) -> Result<(), KeyError> {
        fs::rename(&self.temporary, &self.path).map_err(|error| KeyError::cannot_write(&self.path, &error))
    }
}

impl Drop for Prepared {
    fn drop(&mut self) {
        // After it has taken its place there is none.
        let _ = fs::remove_file(&self.temporary);
    }
}
