//! Protection of the page against requests of other origins.
//!
//! Any page that is open in the browser can send requests to this address. Three measures prevent
//! misuse:
//!
//! - The `Host` header must hold an IP address or `localhost`. A name that an attacker resolves to
//!   this machine (DNS rebinding) is refused.
//! - The `Origin` header of an order must be the address of this page.
//! - The headers forbid the page to load from, send to, or be framed by other origins.

use std::net::IpAddr;

use axum::extract::Request;
use axum::http::header::{HOST, HeaderName, HeaderValue, ORIGIN};
use axum::http::{Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

/// Headers of every answer. They allow scripts, connections and images of this origin only, and
/// inline styles, which the charts set by script.
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

/// Refuses a request of another origin with 403, and adds the headers to every answer.
pub(crate) async fn check_origin(request: Request, next: Next) -> Response {
    let is_read = matches!(*request.method(), Method::GET | Method::HEAD);
    let mut response = match refusal(is_read, header(&request, HOST), header(&request, ORIGIN)) {
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

/// The reason to refuse a request with this host and this origin; `None` if it is allowed.
fn refusal(is_read: bool, host: Option<&str>, origin: Option<&str>) -> Option<&'static str> {
    let Some(host) = host.filter(|host| is_address(host)) else {
        return Some("invalid Host: expected an IP address or localhost; open the page under one of them\n");
    };
    let is_same_origin = origin.is_some_and(|origin| origin.strip_prefix("http://") == Some(host));
    (!is_read && !is_same_origin)
        .then_some("invalid Origin: expected the address of this page; send orders with its buttons\n")
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
    fn orders_of_other_origins_are_refused() {
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
