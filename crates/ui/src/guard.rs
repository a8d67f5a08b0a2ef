//! Protection of the page against requests of other origins.
//!
//! Any page that is open in the browser can send requests to this address. Four measures prevent
//! misuse:
//!
//! - The `Host` header must hold an IP address, `localhost`, the name of this machine, or that of a
//!   public address ([`PublicAddress`]). Another name that an attacker resolves to this machine (DNS
//!   rebinding) is refused.
//! - The `Origin` header of an order must be the address of this page, or a public address.
//! - A browser states in `Sec-Fetch-Site` that the page of another origin asks, and in `Sec-Purpose` that a page has
//!   not been opened yet. Another page may link to this one, but not load or prefetch anything: it would take the places
//!   of event streams.
//! - The headers forbid the page to load from, send to, or be framed by other origins.

use std::net::{IpAddr, SocketAddr};
use std::str::FromStr;
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::header::{HOST, HeaderName, HeaderValue, ORIGIN};
use axum::http::{Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use heliostat_service::printable::printable;

/// Headers of every answer. They allow scripts, connections and images of this origin only, and
/// inline styles, which the charts set by script.
const HEADERS: [(HeaderName, HeaderValue); 6] = [
    (
        HeaderName::from_static("content-security-policy"),
        HeaderValue::from_static(
            "default-src 'none'; script-src 'self'; worker-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; connect-src 'self'; \
             base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
        ),
    ),
    (HeaderName::from_static("x-content-type-options"), HeaderValue::from_static("nosniff")),
    (HeaderName::from_static("referrer-policy"), HeaderValue::from_static("no-referrer")),
    (HeaderName::from_static("x-frame-options"), HeaderValue::from_static("DENY")),
    (HeaderName::from_static("cross-origin-resource-policy"), HeaderValue::from_static("same-origin")),
    (HeaderName::from_static("cache-control"), HeaderValue::from_static("no-store")),
];

/// The headers by which a browser tells whose page asks, what the answer becomes, and whether it asks in advance.
const FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");
const FETCH_DEST: HeaderName = HeaderName::from_static("sec-fetch-dest");
const PURPOSE: HeaderName = HeaderName::from_static("sec-purpose");
/// The answer to the page of another origin that loads from this one.
const FOREIGN: &str =
    "invalid Sec-Fetch-Site or Sec-Purpose: expected a request of this page; open it by a link or its address\n";

/// An address at which a proxy serves the page: `https://HOST[:PORT]`, with the path of the page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PublicAddress {
    scheme: &'static str,
    /// Host and port, without the default port of the scheme.
    host: String,
    path: String,
}

impl FromStr for PublicAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || format!("invalid address \"{text}\": expected https://HOST or https://HOST:PORT");
        let schemes = [("https", "443"), ("http", "80")];
        let (scheme, default_port, rest) = schemes
            .into_iter()
            .find_map(|(scheme, port)| Some((scheme, port, text.strip_prefix(scheme)?.strip_prefix("://")?)))
            .ok_or_else(expected)?;
        let (host, path) = rest.split_once('/').unwrap_or((rest, ""));
        let host = without_port(&folded(host), default_port);
        if host.is_empty() || host.contains(['@', '?', '#', ' ', '*', ',']) || path.contains(['?', '#', ' ']) {
            return Err(expected());
        }
        Ok(Self { scheme, host, path: path.to_owned() })
    }
}

impl std::fmt::Display for PublicAddress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}://{}/{}", self.scheme, self.host, self.path)
    }
}

/// The hosts and origins of one page.
#[derive(Clone, Debug)]
pub(crate) struct Guard {
    /// The names of this machine, in lower case.
    names: Vec<String>,
    public: Vec<PublicAddress>,
    /// An address that works.
    address: String,
}

impl Guard {
    /// The guard of a page that listens at an address of a machine with this name.
    pub fn new(address: SocketAddr, machine: Option<String>, public: Vec<PublicAddress>) -> Self {
        let machine = machine.map(|name| folded(&name)).unwrap_or_default();
        // A name with a domain has its first label in the local network.
        let label = machine.split('.').next().unwrap_or_default().to_owned();
        let is_name = |name: &&str| !name.is_empty();
        let mut names: Vec<String> =
            [&machine, &label].map(String::as_str).into_iter().filter(is_name).map(str::to_owned).collect();
        names.extend(Some(label).filter(|label| !label.is_empty()).map(|label| format!("{label}.local")));
        names.push("localhost".to_owned());
        names.dedup();
        let address = match (address.ip().is_unspecified(), names.first()) {
            (true, Some(name)) => format!("http://{name}:{}/", address.port()),
            _ => format!("http://{address}/"),
        };
        Self { names, public, address }
    }

    /// An address at which a browser opens the page.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// The reason to refuse a request with this host and this origin; `None` if it is allowed.
    fn refusal(&self, is_read: bool, host: Option<&str>, origin: Option<&str>) -> Option<String> {
        let Some(host) = host.map(folded).filter(|host| self.is_own(host) || self.is_public(host)) else {
            let found = host.map(shown).unwrap_or_default();
            return Some(format!(
                "invalid Host \"{found}\": expected an IP address, {} or an address of --ui-origin; open {}, or start \
                 heliostat with --ui-origin https://{found} if a proxy serves the page under this name\n",
                self.names.join(", "),
                self.address
            ));
        };
        if is_read || origin.is_some_and(|origin| self.is_same(&host, origin)) {
            return None;
        }
        let found = origin.map(shown).unwrap_or_default();
        let remedy = match origin {
            Some(origin) if origin.parse::<PublicAddress>().is_ok() => {
                format!("start heliostat with --ui-origin {found} if a proxy serves the page there")
            }
            _ => "send orders with its buttons".to_owned(),
        };
        Some(format!("invalid Origin \"{found}\": expected the address of this page, {}; {remedy}\n", self.address))
    }

    /// Whether an origin is that of the page under this host.
    fn is_same(&self, host: &str, origin: &str) -> bool {
        let Some((scheme, of)) = origin.split_once("://") else { return false };
        let of = folded(of);
        let is_public = |public: &PublicAddress| public.scheme == scheme && public.host == of;
        // A proxy may add TLS and pass the host on.
        (of == host && ["http", "https"].contains(&scheme)) || self.public.iter().any(is_public)
    }

    /// Whether a host, with or without a port, is an IP address or a name of this machine.
    fn is_own(&self, host: &str) -> bool {
        let name = match host.rsplit_once(':') {
            Some((name, port)) if !port.is_empty() && port.bytes().all(|byte| byte.is_ascii_digit()) => name,
            _ => host,
        };
        let name = name.strip_suffix('.').unwrap_or(name);
        let number = name.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).unwrap_or(name);
        self.names.iter().any(|own| own == name) || number.parse::<IpAddr>().is_ok()
    }

    fn is_public(&self, host: &str) -> bool {
        self.public.iter().any(|public| {
            let port = if public.scheme == "https" { "443" } else { "80" };
            public.host == without_port(host, port)
        })
    }
}

/// Whether a browser loads for the page of another origin, by its headers; other programs send none. A frame in that
/// page loads too. What a page has prefetched has no site, and this page prefetches nothing.
fn is_foreign(site: Option<&str>, dest: Option<&str>, purpose: Option<&str>) -> bool {
    let is_of_other = matches!(site, Some("cross-site" | "same-site"));
    (is_of_other && dest != Some("document")) || purpose.is_some()
}

/// A host in lower case: names of hosts have no case, and a dot at their end has no meaning.
fn folded(host: &str) -> String {
    let host = host.trim().to_ascii_lowercase();
    match host.rsplit_once(':') {
        Some((name, port)) if name.ends_with('.') => format!("{}:{port}", name.trim_end_matches('.')),
        _ => host.trim_end_matches('.').to_owned(),
    }
}

fn without_port(host: &str, port: &str) -> String {
    host.strip_suffix(port).and_then(|host| host.strip_suffix(':')).unwrap_or(host).to_owned()
}

/// A header of a request, as an answer may show it.
fn shown(header: &str) -> String {
    printable(header).chars().take(100).collect()
}

/// Refuses a request of another origin with 403, and adds the headers to every answer.
pub(crate) async fn check_origin(State(guard): State<Arc<Guard>>, request: Request, next: Next) -> Response {
    let is_read = matches!(*request.method(), Method::GET | Method::HEAD);
    let [site, dest, purpose] = [FETCH_SITE, FETCH_DEST, PURPOSE].map(|name| header(&request, name));
    let is_load = is_read && is_foreign(site, dest, purpose);
    let refusal = guard.refusal(is_read, header(&request, HOST), header(&request, ORIGIN));
    let mut response = match refusal.or_else(|| is_load.then(|| FOREIGN.to_owned())) {
        Some(reason) => (StatusCode::FORBIDDEN, reason).into_response(),
        None => next.run(request).await,
    };
    response.headers_mut().extend(HEADERS);
    response
}

/// The value of a header; `None` if it is absent or repeated.
fn header(request: &Request, name: HeaderName) -> Option<&str> {
    let mut values = request.headers().get_all(name).iter();
    let value = values.next().filter(|_| values.next().is_none())?;
    value.to_str().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guard(public: &[&str]) -> Guard {
        let public = public.iter().map(|address| address.parse().expect("an address")).collect();
        Guard::new("127.0.0.1:7480".parse().expect("an address"), Some("Mirrors.lab.example".into()), public)
    }

    #[test]
    fn orders_of_other_origins_are_refused() {
        let post = |host, origin| guard(&[]).refusal(false, Some(host), origin).is_none();
        assert!(post("127.0.0.1:7480", Some("http://127.0.0.1:7480")));
        assert!(post("localhost:7480", Some("http://localhost:7480")));
        assert!(post("[::1]:7480", Some("http://[::1]:7480")));
        assert!(post("Mirrors.local.:7480", Some("http://mirrors.local:7480")));
        assert!(!post("127.0.0.1:7480", None));
        assert!(!post("127.0.0.1:7480", Some("null")));
        assert!(!post("127.0.0.1:7480", Some("http://127.0.0.1:8080")));
        assert!(!post("127.0.0.1:7480", Some("http://example.org")));
        assert!(!post("127.0.0.1:7480", Some("ftp://127.0.0.1:7480")));
    }

    #[test]
    fn a_page_of_another_origin_may_link_to_this_one_and_load_nothing() {
        for site in ["cross-site", "same-site"] {
            for loaded in [Some("image"), Some("empty"), Some("iframe"), Some("object"), None] {
                assert!(is_foreign(Some(site), loaded, None), "{loaded:?}");
            }
            assert!(!is_foreign(Some(site), Some("document"), None));
        }
        assert!(is_foreign(Some("none"), Some("document"), Some("prefetch")), "by speculation rules of any page");
        assert!(!is_foreign(Some("same-origin"), Some("empty"), None));
        assert!(!is_foreign(Some("none"), Some("document"), None));
        assert!(!is_foreign(None, None, None), "a script");
    }

    #[test]
    fn a_name_that_resolves_to_this_machine_is_refused() {
        let guard = guard(&[]);
        let get = |host| guard.refusal(true, Some(host), None).is_none();
        assert!(get("127.0.0.1:7480") && get("localhost") && get("192.168.1.5:80") && get("[::1]:7480"));
        for own in
            ["localhost.:7480", "LOCALHOST:7480", "mirrors:7480", "MIRRORS", "mirrors.local.", "mirrors.lab.example:80"]
        {
            assert!(get(own), "{own}");
        }
        assert!(!get("example.org:7480") && !get("127.0.0.1.example.org:7480") && !get("localhost.example.org"));
        assert!(!get("mirrors.example.org") && !get("mirrors.local.example.org") && !get("lab.example") && !get(""));
        assert!(guard.refusal(true, None, None).is_some());
        let refused = guard.refusal(true, Some("example.org:7480"), None).expect("refused");
        assert!(refused.contains("open http://127.0.0.1:7480/"), "{refused}");
        let nameless = Guard::new("127.0.0.1:80".parse().expect("an address"), None, Vec::new());
        assert!(
            nameless.refusal(true, Some(""), None).is_some() && nameless.refusal(true, Some(".local"), None).is_some()
        );
    }

    #[test]
    fn a_page_on_all_addresses_is_opened_by_the_name_of_its_machine() {
        for (listens, opened) in
            [("0.0.0.0:7480", "http://mirrors:7480/"), ("127.0.0.1:7480", "http://127.0.0.1:7480/")]
        {
            let guard = Guard::new(listens.parse().expect("an address"), Some("Mirrors".into()), Vec::new());
            assert_eq!(guard.address(), opened);
        }
    }

    #[test]
    fn a_public_address_admits_its_name_and_its_orders_only() {
        let guard = guard(&["https://Mirrors.example.org", "https://example.org:8443/lab/room1/"]);
        let post = |host, origin| guard.refusal(false, Some(host), Some(origin));
        for host in ["127.0.0.1:7480", "mirrors.example.org", "mirrors.example.org:443"] {
            assert_eq!(post(host, "https://mirrors.example.org"), None, "{host}");
        }
        assert_eq!(post("127.0.0.1:7480", "https://example.org:8443"), None);
        assert_eq!(post("example.org:8443", "https://example.org:8443"), None);
        for origin in ["http://mirrors.example.org", "https://example.org", "https://other.example.org", "null"] {
            assert!(post("127.0.0.1:7480", origin).is_some(), "{origin}");
        }
        assert!(post("example.org", "https://example.org").is_some());
        let refused = post("127.0.0.1:7480", "https://lab.example.org").expect("refused");
        assert!(refused.contains("--ui-origin https://lab.example.org"), "{refused}");
    }

    #[test]
    fn a_public_address_has_a_scheme_and_a_host() {
        for invalid in
            ["mirrors.example.org", "https://", "ftp://a", "https://*", "https://a?b", "https://a,b", "https://u@a"]
        {
            let refused = invalid.parse::<PublicAddress>().expect_err(invalid);
            assert!(refused.contains("expected https://HOST"), "{refused}");
        }
        let shown = |text: &str| text.parse::<PublicAddress>().expect(text).to_string();
        assert_eq!(shown("https://A.example:443"), "https://a.example/");
        assert_eq!(shown("http://a.example:8080/lab/room1/"), "http://a.example:8080/lab/room1/");
    }
}
