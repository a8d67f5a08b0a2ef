//! Protection of the page against pages of other origins.
//!
//! Any page that is open in a browser can send requests to this address. Three measures stand against it:
//!
//! - The `Host` header must hold an IP address or `localhost`. A name that an attacker resolves to
//!   this machine (DNS rebinding) is refused.
//! - An order must come from this page (`Origin`).
//! - The headers forbid the page to load from, send to, or be framed by other origins.

use std::net::IpAddr;

use axum::extract::Request;
use axum::http::header::{HOST, HeaderName, HeaderValue, ORIGIN};
use axum::http::{Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

/// Headers of every answer of the page. Plotly sets styles by script; scripts, connections and images come from here only.
const HEADERS: [(HeaderName, HeaderValue); 6] = [
    (
        HeaderName::from_static("content-security-policy"),
        HeaderValue::from_static(
            "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; connect-src 'self'; \
             base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
        ),
    ),
    (HeaderName::from_static("x-content-type-options"), HeaderValue::from_static("nosniff")),
    (HeaderName::from_static("referrer-policy"), HeaderValue::from_static("no-referrer")),
    (HeaderName::from_static("x-frame-options"), HeaderValue::from_static("DENY")),
    (HeaderName::from_static("cross-origin-resource-policy"), HeaderValue::from_static("same-origin")),
    (HeaderName::from_static("cache-control"), HeaderValue::from_static("no-store")),
];

/// Refuses a request of a foreign page with 403, and adds the headers to every answer.
pub(crate) async fn guard(request: Request, next: Next) -> Response {
    let reads = matches!(*request.method(), Method::GET | Method::HEAD);
    let mut response = match refusal(reads, header(&request, HOST), header(&request, ORIGIN)) {
        Some(reason) => (StatusCode::FORBIDDEN, reason).into_response(),
        None => next.run(request).await,
    };
    response.headers_mut().extend(HEADERS);
    response
}

/// The value of a header that occurs once.
fn header(request: &Request, name: HeaderName) -> Option<&str> {
    let mut values = request.headers().get_all(name).iter();
    let value = values.next().filter(|_| values.next().is_none())?;
    value.to_str().ok()
}

/// The reason to refuse a request with this host and this origin; nothing where it is allowed.
fn refusal(reads: bool, host: Option<&str>, origin: Option<&str>) -> Option<&'static str> {
    let Some(host) = host.filter(|host| is_address(host)) else {
        return Some("this page is served under the IP address of its machine or localhost only\n");
    };
    let own = origin.is_some_and(|origin| origin.strip_prefix("http://") == Some(host));
    (!reads && !own).then_some("an order must come from the page of this address\n")
}

/// Whether a host, with or without a port, is `localhost` or an IP address.
fn is_address(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if !port.is_empty() && port.bytes().all(|byte| byte.is_ascii_digit()) => name,
        _ => host,
    };
    let number = name.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).unwrap_or(name);
    name == "localhost" || number.parse::<IpAddr>().is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_come_from_this_page_only() {
        let post = |host, origin| refusal(false, Some(host), origin).is_none();
        assert!(post("127.0.0.1:7480", Some("http://127.0.0.1:7480")));
        assert!(post("localhost:7480", Some("http://localhost:7480")));
        assert!(post("[::1]:7480", Some("http://[::1]:7480")));
        assert!(!post("127.0.0.1:7480", None));
        assert!(!post("127.0.0.1:7480", Some("null")));
        assert!(!post("127.0.0.1:7480", Some("http://127.0.0.1:8080")));
        assert!(!post("127.0.0.1:7480", Some("http://example.org")));
    }

    #[test]
    fn a_name_that_resolves_to_this_machine_is_refused() {
        let get = |host| refusal(true, Some(host), None).is_none();
        assert!(get("127.0.0.1:7480") && get("localhost") && get("192.168.1.5:80") && get("[::1]:7480"));
        assert!(!get("example.org:7480") && !get("127.0.0.1.example.org:7480") && !get("localhost.example.org"));
        assert!(refusal(true, None, None).is_some());
    }
}
