//! Reading a certificate file: its room, role, hosts and validity.

use std::net::IpAddr;
use std::path::Path;
use std::time::{Duration, SystemTime};

use heliostat_files::read_text;
use heliostat_proto::Room;
use x509_parser::certificate::X509Certificate;
use x509_parser::extensions::{GeneralName, ParsedExtension};
use x509_parser::time::ASN1Time;

use crate::access::AccessRole;
use crate::error::KeyError;

const SECONDS_A_DAY: i64 = 86_400;

/// Content of a certificate file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Certificate {
    /// Common name of its subject.
    pub common_name: String,
    /// Host names and addresses at which its holder may listen.
    pub hosts: Vec<String>,
    /// Date of the start of its validity in UTC, as YYYY-MM-DD.
    pub valid_from: String,
    /// Date of its expiry in UTC, as YYYY-MM-DD.
    pub expires: String,
    /// Its public key, as the certificate holds it.
    pub(crate) public_key: Vec<u8>,
    /// Identifier of its own key.
    pub(crate) own_key_id: Vec<u8>,
    /// Identifier of the key that signed it.
    pub(crate) signing_key_id: Vec<u8>,
    /// Start and end of its validity, in s since 1970-01-01 UTC.
    validity_s: (i64, i64),
}

impl Certificate {
    /// Reads a file in PEM format.
    ///
    /// # Errors
    /// [`KeyError::CannotRead`] or [`KeyError::NotACertificate`].
    pub fn read(path: &Path) -> Result<Self, KeyError> {
        let text =
            read_text(path).map_err(|error| KeyError::CannotRead { path: path.into(), problem: error.to_string() })?;
        let refuse = |problem: String| KeyError::NotACertificate { path: path.into(), problem };
        let (_, pem) = x509_parser::pem::parse_x509_pem(text.as_bytes()).map_err(|error| refuse(error.to_string()))?;
        Self::from_der(&pem.contents).map_err(refuse)
    }

    /// Reads a certificate in DER format.
    ///
    /// # Errors
    /// What is wrong with it.
    pub(crate) fn from_der(bytes: &[u8]) -> Result<Self, String> {
        let (_, parsed) = x509_parser::parse_x509_certificate(bytes).map_err(|error| error.to_string())?;
        let common_name = parsed.subject().iter_common_name().next().and_then(|name| name.as_str().ok());
        Ok(Self {
            common_name: common_name.ok_or("it has no common name")?.to_owned(),
            hosts: hosts(&parsed),
            valid_from: date(&parsed.validity().not_before),
            expires: date(&parsed.validity().not_after),
            public_key: parsed.public_key().subject_public_key.data.to_vec(),
            own_key_id: key_id(&parsed, |extension| match extension {
                ParsedExtension::SubjectKeyIdentifier(id) => Some(id.0),
                _ => None,
            }),
            signing_key_id: key_id(&parsed, |extension| match extension {
                ParsedExtension::AuthorityKeyIdentifier(authority) => authority.key_identifier.as_ref().map(|id| id.0),
                _ => None,
            }),
            validity_s: (parsed.validity().not_before.timestamp(), parsed.validity().not_after.timestamp()),
        })
    }

    /// Room and role of its common name; `None` for a certificate of another kind.
    pub fn room_and_role(&self) -> Option<(Room, AccessRole)> {
        AccessRole::parse_common_name(&self.common_name)
    }

    /// Days until it expires, to the nearest; negative after that.
    pub fn days_left(&self) -> i64 {
        (self.validity_s.1 - unix_s(SystemTime::now()) + SECONDS_A_DAY / 2).div_euclid(SECONDS_A_DAY)
    }

    /// Whether it becomes valid later.
    pub fn is_not_yet_valid(&self) -> bool {
        unix_s(SystemTime::now()) < self.validity_s.0
    }

    /// The same certificate, which is of no use before its authority is valid.
    pub(crate) fn not_before(mut self, authority: &Self) -> Self {
        if authority.validity_s.0 > self.validity_s.0 {
            self.validity_s.0 = authority.validity_s.0;
            self.valid_from.clone_from(&authority.valid_from);
        }
        self
    }

    /// Whether it is valid now; `Err` names the fault.
    pub(crate) fn check_time(&self, path: &Path) -> Result<(), KeyError> {
        let now_s = unix_s(SystemTime::now());
        if self.is_not_yet_valid() {
            return Err(KeyError::NotYetValid { path: path.into() });
        }
        if now_s > self.validity_s.1 {
            return Err(KeyError::Expired { path: path.into(), expires: self.expires.clone() });
        }
        Ok(())
    }

    /// Why it is not valid now, as a predicate.
    pub(crate) fn time_fault(&self) -> Option<String> {
        let now_s = unix_s(SystemTime::now());
        if self.is_not_yet_valid() {
            return Some("is not valid yet, by the clock of this machine".to_owned());
        }
        (now_s > self.validity_s.1).then(|| format!("expired on {}", self.expires))
    }

    /// End of its validity.
    pub(crate) fn end(&self) -> SystemTime {
        SystemTime::UNIX_EPOCH + Duration::from_secs(u64::try_from(self.validity_s.1).unwrap_or_default())
    }
}

fn unix_s(time: SystemTime) -> i64 {
    let since = time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_secs()).unwrap_or(i64::MAX)
}

fn date(time: &ASN1Time) -> String {
    let date = time.to_datetime();
    format!("{:04}-{:02}-{:02}", date.year(), u8::from(date.month()), date.day())
}

fn key_id<'a>(
    certificate: &'a X509Certificate<'a>,
    of: impl Fn(&'a ParsedExtension<'a>) -> Option<&'a [u8]>,
) -> Vec<u8> {
    let mut extensions = certificate.extensions().iter();
    extensions.find_map(|extension| of(extension.parsed_extension()).map(<[u8]>::to_vec)).unwrap_or_default()
}

fn hosts(certificate: &X509Certificate) -> Vec<String> {
    let Ok(Some(names)) = certificate.subject_alternative_name() else { return Vec::new() };
    let host = |name: &GeneralName| match name {
        GeneralName::DNSName(name) => Some((*name).to_owned()),
        GeneralName::IPAddress(bytes) => address(bytes).map(|address| address.to_string()),
        _ => None,
    };
    names.value.general_names.iter().filter_map(host).collect()
}

fn address(bytes: &[u8]) -> Option<IpAddr> {
    let v4 = || <[u8; 4]>::try_from(bytes).map(IpAddr::from);
    v4().or_else(|_| <[u8; 16]>::try_from(bytes).map(IpAddr::from)).ok()
}
