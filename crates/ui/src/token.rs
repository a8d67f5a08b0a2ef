//! The secret that admits a browser to a page on a network.
//!
//! A page without keys on a loopback address needs none: only processes of this machine reach it. Else
//! the server prints its URL with a token. The first request with this URL sets a cookie
//! and redirects to the page without the token. A script sends `Authorization: Bearer TOKEN`.
//!
//! HTTP does not encrypt: on a network that is not trusted, a tunnel or a TLS proxy belongs in front
//! of the page.

use std::fmt::Write;
use std::io::ErrorKind;
use std::path::Path;
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::StatusCode;
use axum::http::header::{AUTHORIZATION, COOKIE, HeaderMap, LOCATION, SET_COOKIE};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use heliostat_files::{UnusableInput, read_text};
use heliostat_service::whole_file;
use subtle::ConstantTimeEq;

use crate::UiError;

/// Bytes of a random token: too many to guess.
const RANDOM_BYTES: usize = 16;
/// Shortest token that a file may hold, in characters.
const LENGTH_MIN: usize = 16;
/// Name of the cookie. Cookies of one host are common to all ports, so it has the port in its name.
const COOKIE_NAME: &str = "heliostat";

/// A token: ASCII letters and digits.
#[derive(Clone)]
pub(crate) struct Token(String);

impl Token {
    /// A random token.
    ///
    /// # Errors
    /// [`UiError::Token`] if the operating system has no random numbers.
    pub fn random() -> Result<Self, UiError> {
        let mut bytes = [0; RANDOM_BYTES];
        getrandom::fill(&mut bytes).map_err(|error| UiError::Token(error.to_string()))?;
        let mut text = String::new();
        for byte in bytes {
            // Writing to a string cannot fail.
            let _ = write!(text, "{byte:02x}");
        }
        Ok(Self(text))
    }

    /// The token in a file, without the white space around it. An absent file is made, with a random token.
    ///
    /// # Errors
    /// [`UiError::TokenFile`] if the file cannot be read or made, or its token is too short or has other
    /// characters; as of [`Token::random`].
    pub fn kept_in(file: &Path) -> Result<Self, UiError> {
        let text = match read_text(file) {
            Ok(text) => text,
            Err(error) if error.kind() == ErrorKind::NotFound => return Self::make(file),
            Err(error) => return Err(unusable(format!("cannot read {}: {error}", file.display()))),
        };
        let token = text.trim();
        if token.len() < LENGTH_MIN || !token.bytes().all(|byte| byte.is_ascii_alphanumeric()) {
            return Err(unusable(format!(
                "{} holds no token: expected at least {LENGTH_MIN} ASCII letters and digits; \
                 without the file the next start makes one",
                file.display()
            )));
        }
        Ok(Self(token.to_owned()))
    }

    /// A random token, in a new file for its owner only.
    fn make(file: &Path) -> Result<Self, UiError> {
        let token = Self::random()?;
        let written = whole_file::write_new_secret(file, format!("{}\n", token.as_str()).as_bytes());
        written.map_err(|error| unusable(format!("{error:#}")))?;
        Ok(token)
    }

    /// The token as text, for the URL.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    fn is(&self, given: &str) -> bool {
        self.0.as_bytes().ct_eq(given.as_bytes()).into()
    }
}

fn unusable(message: String) -> UiError {
    UiError::TokenFile(UnusableInput::new(message))
}

/// What guards the page on a network.
#[derive(Clone)]
pub(crate) struct Gate {
    pub token: Arc<Token>,
    pub port: u16,
}

impl Gate {
    fn cookie_name(&self) -> String {
        format!("{COOKIE_NAME}-{}", self.port)
    }

    /// Whether the cookie or the authorization of a request is right.
    fn admits(&self, headers: &HeaderMap) -> bool {
        let texts = |name| headers.get_all(name).iter().filter_map(|value| value.to_str().ok());
        let name = self.cookie_name();
        let cookies = texts(COOKIE).flat_map(|text| text.split(';')).filter_map(|pair| pair.trim().split_once('='));
        let bearer = texts(AUTHORIZATION).filter_map(|text| text.strip_prefix("Bearer "));
        let mut given = cookies.filter(|(key, _)| *key == name).map(|(_, value)| value).chain(bearer);
        given.any(|value| self.token.is(value.trim()))
    }
}

/// Answers a request without the token with 401; sets the cookie for a URL with the token.
pub(crate) async fn check(State(gate): State<Gate>, request: Request, next: Next) -> Response {
    let query = request.uri().query().unwrap_or_default();
    let given = query.split('&').find_map(|pair| pair.strip_prefix("token="));
    if given.is_some_and(|given| gate.token.is(given)) {
        // Relative, for a page below a path of another host.
        let cookie = format!("{}={}; HttpOnly; SameSite=Strict; Path=/", gate.cookie_name(), gate.token.as_str());
        return (StatusCode::SEE_OTHER, [(SET_COOKIE, cookie), (LOCATION, "./".to_owned())]).into_response();
    }
    if gate.admits(request.headers()) {
        return next.run(request).await;
    }
    let problem = "no valid token: expected the URL with ?token= that heliostat printed at its start\n";
    (StatusCode::UNAUTHORIZED, problem).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(name: axum::http::HeaderName, value: &str) -> HeaderMap {
        HeaderMap::from_iter([(name, value.parse().expect("a header"))])
    }

    #[test]
    fn cookie_and_authorization_admit_with_the_right_token_only() {
        let gate = Gate { token: Arc::new(Token("0123456789abcdef".into())), port: 7480 };
        assert!(gate.admits(&headers(COOKIE, "a=b; heliostat-7480=0123456789abcdef")));
        assert!(gate.admits(&headers(AUTHORIZATION, "Bearer 0123456789abcdef")));
        assert!(!gate.admits(&HeaderMap::new()));
        assert!(!gate.admits(&headers(COOKIE, "heliostat-7481=0123456789abcdef")));
        assert!(!gate.admits(&headers(COOKIE, "heliostat-7480=0123456789abcde")));
        assert!(!gate.admits(&headers(AUTHORIZATION, "Bearer ")));
    }

    #[test]
    fn a_file_that_holds_no_token_is_an_input_that_cannot_be_used() {
        use std::error::Error;
        for file in ["Cargo.toml", "src", "no-such-folder/token"] {
            let refused = Token::kept_in(Path::new(file)).err().expect("no token");
            assert!(refused.source().is_some_and(|source| source.is::<UnusableInput>()), "{refused:?}");
        }
    }

    #[test]
    fn random_tokens_differ_and_have_32_digits() {
        let [one, other] = [(); 2].map(|()| Token::random().expect("random numbers"));
        assert_ne!(one.as_str(), other.as_str());
        assert_eq!(one.as_str().len(), 2 * RANDOM_BYTES);
    }
}
