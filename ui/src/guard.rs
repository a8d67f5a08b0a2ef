//! What keeps pages of others from reading this one or pressing its buttons.
//!
//! A browser may be led to this address by any page that is open in it. Three things stand against that: the address in the
//! `Host` header must be a number or `localhost`, which a name that was bound anew to this machine is not; an order must come
//! from this very page (`Origin`); and the headers forbid the page to load, send or be framed from elsewhere.

use std::net::IpAddr;

/// Headers of every answer. Plotly sets styles by script; scripts, connections and images come from here alone.
pub(crate) const HEADERS: [(&str, &str); 5] = [
    (
        "Content-Security-Policy",
        "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; connect-src 'self'; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    ("X-Content-Type-Options", "nosniff"),
    ("Referrer-Policy", "no-referrer"),
    ("X-Frame-Options", "DENY"),
    ("Cross-Origin-Resource-Policy", "same-origin"),
];

/// Why a request is refused that has this host and this origin; nothing where it is not.
pub(crate) fn refusal(reads: bool, host: Option<&str>, origin: Option<&str>) -> Option<&'static str> {
    let Some(host) = host.filter(|host| is_address(host)) else {
        return Some("this page answers to the number of its address or to localhost only\n");
    };
    let own = origin.is_some_and(|origin| origin.strip_prefix("http://") == Some(host));
    (!reads && !own).then_some("an order must come from the page of this address\n")
}

/// Whether a host, with or without a port, is `localhost` or a number: no name that anybody could point here.
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
    fn orders_come_from_the_page_alone() {
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
    fn a_name_that_points_here_is_refused() {
        let get = |host| refusal(true, Some(host), None).is_none();
        assert!(get("127.0.0.1:7480") && get("localhost") && get("192.168.1.5:80") && get("[::1]:7480"));
        assert!(!get("example.org:7480") && !get("127.0.0.1.example.org:7480") && !get("localhost.example.org"));
        assert!(refusal(true, None, None).is_some());
    }
}
