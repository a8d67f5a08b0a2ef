//! What can keep the page or the screen from being there.

use std::io;
use std::net::IpAddr;

use heliostat_bus::BusError;
use heliostat_channel::ChannelError;
use heliostat_proto::CodecError;
use thiserror::Error;

/// Why there is no view, no page, or no effect of a button.
#[derive(Debug, Error)]
pub enum UiError {
    /// The room could not be joined, or an order not be sent.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The scenario's optics are refused.
    #[error(transparent)]
    Optics(#[from] ChannelError),
    /// An order cannot be written as a message.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// No port can be had at the address.
    #[error(
        "the page cannot be served at {address}: {problem}; wanted an address of this machine (--ui-listen), or --no-ui"
    )]
    CannotListen {
        /// Where it was tried.
        address: IpAddr,
        /// What the system said.
        problem: io::Error,
    },
    /// The web server's threads could not be started.
    #[error("the page's web server did not start: {0}")]
    Threads(io::Error),
    /// The terminal refuses to be drawn on.
    #[error("the terminal cannot be drawn on: {0}; --plain prints lines instead")]
    Terminal(#[from] io::Error),
    /// An order that has no sense.
    #[error("{what} = {value}: wanted {wanted}")]
    Order {
        /// What was ordered.
        what: &'static str,
        /// How much of it.
        value: String,
        /// What would do.
        wanted: &'static str,
    },
    /// An order that only the process that started the room can carry out.
    #[error("nobody here can {0}: only `heliostat demo` owns the processes that it started")]
    NotOwned(&'static str),
    /// An order that nobody was there to hear.
    #[error(
        "the {0} does not hear it: no such process is in the room, or it is not connected; start it, or give its endpoint with --connect"
    )]
    Unheard(&'static str),
}
