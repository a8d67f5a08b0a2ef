//! Why a TLS connection to another process fails.
//!
//! Zenoh retries a failed connection without a reason. A check makes the same handshake, reads the certificate of
//! the other side whatever it is, and names what does not fit: host, date, authority, or this process's own
//! certificate. No data is exchanged.

use std::io::{ErrorKind, Read};
use std::net::{SocketAddr, TcpStream};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::crypto::{CryptoProvider, ring, verify_tls12_signature, verify_tls13_signature};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName, UnixTime};
use rustls::{ClientConfig, ClientConnection, DigitallySignedStruct, Error, SignatureScheme};
use zenoh::config::EndPoint;

use crate::certificate::Certificate;
use crate::platform;
use crate::resolve::resolve;
use crate::tls::Identity;

/// Longest wait for the other side in each step.
const STEP_LIMIT: Duration = Duration::from_millis(500);

/// Whether a process accepts connections at an endpoint. One of a protocol without connections may.
fn accepts(endpoint: &str) -> bool {
    let Ok(parsed) = endpoint.parse::<EndPoint>() else { return false };
    let address = parsed.address().as_str().to_owned();
    match parsed.protocol().as_str() {
        "tcp" | "tls" => connect(&address).is_some(),
        "unixsock-stream" => platform::accepts_at_socket(&address),
        _ => true,
    }
}

/// Whether an endpoint refuses connections at once, because no process listens there. One that does not answer in time
/// may be slow.
fn refuses(endpoint: &str) -> bool {
    let Ok(parsed) = endpoint.parse::<EndPoint>() else { return false };
    let address = parsed.address().as_str().to_owned();
    let is_refused = |at: &SocketAddr| {
        TcpStream::connect_timeout(at, STEP_LIMIT).is_err_and(|error| error.kind() == ErrorKind::ConnectionRefused)
    };
    match parsed.protocol().as_str() {
        "tcp" | "tls" => resolve(&address).is_ok_and(|found| !found.is_empty() && found.iter().all(is_refused)),
        "unixsock-stream" => !platform::accepts_at_socket(&address),
        _ => false,
    }
}

/// Whether there are endpoints, and each refuses connections at once.
pub(crate) fn all_refuse(endpoints: &[String]) -> bool {
    !endpoints.is_empty() && endpoints.iter().all(|endpoint| refuses(endpoint))
}

/// That no process accepts connections at any of these endpoints, in words.
pub(crate) fn unanswered(endpoints: &[String]) -> Option<String> {
    let is_answered = endpoints.iter().any(|endpoint| accepts(endpoint));
    (!is_answered).then(|| format!("no process answers at {}", endpoints.join(", ")))
}

/// The first fault of the endpoints that answer.
pub(crate) fn first_problem(identity: &Identity, endpoints: &[String]) -> Option<String> {
    endpoints.iter().find_map(|endpoint| problem(identity, endpoint))
}

/// The first of these endpoints of a process without keys at which another process encrypts.
pub(crate) fn first_encrypted(endpoints: &[String]) -> Option<String> {
    endpoints.iter().find(|endpoint| encrypts(endpoint).unwrap_or(false)).map(|endpoint| encrypted(endpoint))
}

/// What an answer with a certificate shows: it may be of any server, not only of a process with keys.
fn encrypted(endpoint: &str) -> String {
    let address = endpoint.split_once('/').map_or("", |(_, address)| address);
    format!(
        "{endpoint}: the process there accepts encrypted connections only: if it is a process of this room, give --tls \
         DIR, the folder of its room's keys, and --connect tls/{address}; otherwise check --connect"
    )
}

/// Whether a process answers an encrypted connection at an endpoint without encryption; `None` where
/// nothing is known.
fn encrypts(endpoint: &str) -> Option<bool> {
    let parsed: EndPoint = endpoint.parse().ok()?;
    if parsed.protocol().as_str() != "tcp" {
        return None;
    }
    let seen = Arc::new(Seen::default());
    let verifier: Arc<dyn ServerCertVerifier> = Arc::<Seen>::clone(&seen);
    let config = ClientConfig::builder_with_provider(Arc::clone(&seen.provider)).with_safe_default_protocol_versions();
    let config = config.ok()?.dangerous().with_custom_certificate_verifier(verifier).with_no_client_auth();
    let name = ServerName::try_from("localhost").ok()?;
    let mut connection = ClientConnection::new(Arc::new(config), name).ok()?;
    let mut stream = connect(parsed.address().as_str())?;
    // The other side shows its certificate before it asks for one.
    while seen.certificate.get().is_none() && connection.is_handshaking() {
        if connection.complete_io(&mut stream).is_err() {
            break;
        }
    }
    Some(seen.certificate.get().is_some())
}

/// A connection to the first address of a name that accepts one. Its steps, and the search for addresses, have a bound.
fn connect(address: &str) -> Option<TcpStream> {
    let stream = first_that_accepts(resolve(address).ok()?.into_iter())?;
    stream.set_read_timeout(Some(STEP_LIMIT)).and_then(|()| stream.set_write_timeout(Some(STEP_LIMIT))).ok()?;
    Some(stream)
}

fn first_that_accepts(mut addresses: impl Iterator<Item = SocketAddr>) -> Option<TcpStream> {
    addresses.find_map(|at| TcpStream::connect_timeout(&at, STEP_LIMIT).ok())
}

/// The fault of a connection to an endpoint; `None` if there is none, or no process answers there.
fn problem(identity: &Identity, endpoint: &str) -> Option<String> {
    let parsed: EndPoint = endpoint.parse().ok()?;
    if parsed.protocol().as_str() != "tls" {
        return None;
    }
    let address = parsed.address().as_str().to_owned();
    let (host, _) = address.rsplit_once(':')?;
    let host = host.trim_start_matches('[').trim_end_matches(']');
    let mut stream = connect(&address)?;
    let seen = Arc::new(Seen::default());
    let name = ServerName::try_from(host.to_owned()).ok()?;
    let mut connection = ClientConnection::new(Arc::new(client(identity, &seen)?), name).ok()?;
    let mut refused = None;
    while connection.is_handshaking() {
        if let Err(error) = connection.complete_io(&mut stream) {
            refused = Some(error);
            break;
        }
    }
    let Some(certificate) = seen.certificate.get() else {
        let error = refused.filter(|error| !matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut))?;
        return Some(format!("{endpoint}: the TLS handshake failed ({error}): expected a process with --tls there"));
    };
    let fault = match Certificate::from_der(certificate) {
        Ok(certificate) => fault(identity, host, &certificate),
        Err(problem) => Some(format!("the certificate of {host} cannot be used: {problem}")),
    };
    // The other side reads the certificate of this one after the handshake.
    fault
        .or_else(|| alert(&mut connection, &mut stream, refused, identity, host))
        .map(|fault| format!("{endpoint}: {fault}"))
}

/// What is wrong with the certificate of a host.
fn fault(identity: &Identity, host: &str, certificate: &Certificate) -> Option<String> {
    if let Some(problem) = certificate.time_fault() {
        return Some(format!(
            "the certificate of {host} {problem}: renew it there with `heliostat keys renew`, and restart the process"
        ));
    }
    let folder = identity.folder().display();
    if !identity.signs(certificate) {
        return Some(format!(
            "another authority than {folder}/ca.pem signed the certificate of {host} ({}): if it is a process of this room, \
             give both processes keys of one `heliostat keys init`; otherwise check --connect",
            certificate.common_name
        ));
    }
    if certificate.room_and_role().is_none() {
        return Some(format!(
            "the certificate of {host} is for \"{}\", which is no role of a room: issue it with `heliostat keys issue`",
            certificate.common_name
        ));
    }
    let is_named = certificate.hosts.iter().any(|named| named.eq_ignore_ascii_case(host.trim_end_matches('.')));
    (!is_named).then(|| {
        format!(
            "the certificate of {host} names {}: issue it with `heliostat keys issue --host {host}`, or connect to one of \
             these names",
            certificate.hosts.join(", ")
        )
    })
}

/// The refusal of the other side.
fn alert(
    connection: &mut ClientConnection,
    stream: &mut TcpStream,
    refused: Option<std::io::Error>,
    identity: &Identity,
    host: &str,
) -> Option<String> {
    let error = refused.or_else(|| rustls::Stream::new(connection, stream).read(&mut [0; 1]).err())?;
    let reason = error.get_ref()?.downcast_ref::<Error>()?;
    let Error::AlertReceived(alert) = reason else { return None };
    Some(format!(
        "{host} refuses the certificate {} of this process ({alert:?}): renew it with `heliostat keys renew`, and give \
         both processes keys of one `heliostat keys init`",
        identity.certificate().display()
    ))
}

fn client(identity: &Identity, seen: &Arc<Seen>) -> Option<ClientConfig> {
    let chain: Vec<_> = CertificateDer::pem_file_iter(identity.certificate()).ok()?.collect::<Result<_, _>>().ok()?;
    let key = PrivateKeyDer::from_pem_file(identity.private_key()).ok()?;
    let config = ClientConfig::builder_with_provider(Arc::clone(&seen.provider)).with_safe_default_protocol_versions();
    let verifier: Arc<dyn ServerCertVerifier> = Arc::<Seen>::clone(seen);
    config.ok()?.dangerous().with_custom_certificate_verifier(verifier).with_client_auth_cert(chain, key).ok()
}

/// Keeps the certificate of the other side. It accepts each, because nothing is sent over the connection.
#[derive(Debug)]
struct Seen {
    provider: Arc<CryptoProvider>,
    certificate: OnceLock<Vec<u8>>,
}

impl Default for Seen {
    fn default() -> Self {
        Self { provider: Arc::new(ring::default_provider()), certificate: OnceLock::new() }
    }
}

impl ServerCertVerifier for Seen {
    fn verify_server_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        _intermediates: &[CertificateDer<'_>],
        _server_name: &ServerName<'_>,
        _ocsp_response: &[u8],
        _now: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        // There is one for each connection.
        let _ = self.certificate.set(end_entity.to_vec());
        Ok(ServerCertVerified::assertion())
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        verify_tls12_signature(message, certificate, signature, &self.provider.signature_verification_algorithms)
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        verify_tls13_signature(message, certificate, signature, &self.provider.signature_verification_algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.provider.signature_verification_algorithms.supported_schemes()
    }
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;

    use super::*;

    #[test]
    fn a_server_that_encrypts_is_not_taken_for_a_process_of_the_room() {
        let problem = encrypted("tcp/10.0.0.7:443");
        let expected = "if it is a process of this room, give --tls DIR, the folder of its room's keys, and \
                        --connect tls/10.0.0.7:443; otherwise check --connect";
        assert!(problem.ends_with(expected), "{problem}");
    }

    #[test]
    fn a_name_is_reached_at_any_of_its_addresses() {
        let bind = || TcpListener::bind("127.0.0.1:0").expect("a free port");
        let address = |listener: &TcpListener| listener.local_addr().expect("bound");
        let (listener, closed) = (bind(), address(&bind()));
        let found = first_that_accepts([closed, address(&listener)].into_iter());
        assert_eq!(found.and_then(|stream| stream.peer_addr().ok()), Some(address(&listener)));
        assert!(first_that_accepts([closed].into_iter()).is_none());
    }

    #[test]
    fn endpoints_refuse_where_no_process_listens_at_any() {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let listening = format!("tcp/{}", listener.local_addr().expect("bound"));
        let closed = crate::free_loopback_endpoint().expect("a free port");
        assert!(all_refuse(std::slice::from_ref(&closed)));
        assert!(!all_refuse(&[closed, listening]));
        assert!(!all_refuse(&[]), "a configuration without endpoints has a fault of its own");
    }
}
