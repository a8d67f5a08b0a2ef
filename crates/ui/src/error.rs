//! Errors of the page and the terminal view.

use std::io;
use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

use heliostat_bus::BusError;
use heliostat_channel::ChannelError;
use heliostat_files::UnusableInput;
use heliostat_proto::CodecError;
use heliostat_service::duration;
use thiserror::Error;

/// What to do where nothing of a room is seen, although there is a connection.
pub(crate) const CHECK_REACH: &str = "check --room and --connect";

/// An error of the view, of the page, or of an order.
#[derive(Debug, Error)]
pub enum UiError {
    /// The room cannot be joined, or an order cannot be published.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The channel model refuses the scenario.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// An order cannot be encoded.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// No port is available at the address.
    #[error(
        "the page cannot be served at {address}: {problem}; expected an address of this machine; \
         set --ui-listen, or use --no-ui"
    )]
    CannotListen {
        /// The address.
        address: IpAddr,
        /// The error of the operating system.
        problem: io::Error,
    },
    /// The port that was asked for is in use, or this user may not open it.
    #[error(
        "the page cannot be served at {at}: {problem}; expected a free port: end the process that listens there, \
         set another --ui-port, or leave the flag out for the next free port"
    )]
    PortRefused {
        /// Address and port.
        at: SocketAddr,
        /// The error of the operating system.
        problem: io::Error,
    },
    /// The threads of the web server could not be started.
    #[error("the web server of the page did not start: {0}; retry, or use --no-ui")]
    Threads(io::Error),
    /// The page has no token: the operating system has no random numbers.
    #[error("the token of the page: no random numbers: {0}")]
    Token(String),
    /// The file with the token of the page cannot be used.
    #[error("the token of the page")]
    TokenFile(#[source] UnusableInput),
    /// The terminal cannot be used for the full-screen view.
    #[error("the terminal cannot show the full-screen view; use --plain to print lines")]
    Terminal(#[from] io::Error),
    /// An order with an invalid value.
    #[error("invalid {name} \"{value}\": expected {expected}")]
    InvalidOrder {
        /// The quantity that the order sets.
        name: &'static str,
        /// Its value.
        value: String,
        /// The valid values.
        expected: String,
    },
    /// An order about a process that this program did not start.
    #[error(
        "cannot {0} from this page: expected the page of a running `heliostat demo`; \
         otherwise end or start the process directly"
    )]
    NoProcessControl(&'static str),
    /// An order that the certificate of the page does not permit.
    #[error("{0}; nothing was sent")]
    NoRight(&'static str),
    /// An order that was published without a subscriber.
    #[error(
        "no {0} received the order: expected one that is connected to this process; {reach}, or start one",
        reach = CHECK_REACH
    )]
    NoReceiver(&'static str),
    /// A re-arm of an array that reports no stop.
    #[error("no array that answers reports an emergency stop; nothing to release")]
    NotStopped,
    /// A stop that not every array has confirmed.
    #[error(
        "the stop is not confirmed after {}: {}",
        duration::in_seconds(*waited),
        if arrays.is_empty() { format!("no array reports: {CHECK_REACH}, and cut the power of the mirrors") } else { arrays.join("; ") }
    )]
    StopUnconfirmed {
        /// How long it waited.
        waited: Duration,
        /// What is open, array by array.
        arrays: Vec<String>,
    },
    /// A re-arm that names no stop although there are several.
    #[error("{} stops are in force: {}; name one with --stop, or release each with --all", stops.len(), stops.join("; "))]
    SeveralStops {
        /// The stops in words.
        stops: Vec<String>,
    },
    /// A re-arm that not every array has confirmed.
    #[error(
        "the re-arm is not confirmed after {}: {}",
        duration::in_seconds(*waited),
        if arrays.is_empty() { format!("no array reports: {CHECK_REACH}") } else { arrays.join("; ") }
    )]
    RearmUnconfirmed {
        /// How long it waited.
        waited: Duration,
        /// What is open, array by array.
        arrays: Vec<String>,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_order_that_nothing_receives_advises_to_check_the_room_before_a_start() {
        let text = UiError::NoReceiver("array").to_string();
        assert!(text.ends_with("check --room and --connect, or start one"), "{text}");
    }

    #[test]
    fn a_release_without_a_stop_is_refused_in_one_clause() {
        assert_eq!(
            UiError::NotStopped.to_string(),
            "no array that answers reports an emergency stop; nothing to release"
        );
    }

    #[test]
    fn a_wait_is_shown_in_seconds_of_few_digits() {
        let waited = Duration::from_nanos(3_485_468_733);
        let rearm = UiError::RearmUnconfirmed { waited, arrays: Vec::new() }.to_string();
        assert!(rearm.starts_with("the re-arm is not confirmed after 3.5 s: no array reports"), "{rearm}");
        let stop = UiError::StopUnconfirmed { waited: Duration::from_secs(5), arrays: Vec::new() }.to_string();
        assert!(stop.starts_with("the stop is not confirmed after 5 s: no array reports"), "{stop}");
    }
}
