//! What can go wrong between processes, and what to do about it.

use heliostat_proto::RoomError;
use thiserror::Error;

/// Why something could not be opened, declared, published or asked.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum BusError {
    /// The name of the room cannot stand in a key.
    #[error(transparent)]
    Room(#[from] RoomError),
    /// Nowhere to listen and nowhere to connect: nobody could be met.
    #[error(
        "no endpoint given: one process needs --listen tcp/127.0.0.1:7447, the others --connect tcp/127.0.0.1:7447 (any free port will do)"
    )]
    NoEndpoint,
    /// A client without a router to connect to.
    #[error("a client listens nowhere and connects to a router: give --connect with the router's endpoint")]
    ClientWithoutRouter,
    /// Not an endpoint.
    #[error(
        "endpoint \"{endpoint}\": {problem}; wanted tcp/HOST:PORT, for example tcp/127.0.0.1:7447, or unixsock-stream/PATH"
    )]
    InvalidEndpoint {
        /// As given.
        endpoint: String,
        /// What is wrong with it.
        problem: String,
    },
    /// Another process listens there.
    #[error("endpoint {endpoint} is in use: another process listens there; stop it, or listen at another port")]
    EndpointInUse {
        /// Where.
        endpoint: String,
    },
    /// Listening failed for another reason.
    #[error("cannot listen at {endpoint}: {problem}; give --listen an address of this machine and a port it may use")]
    CannotListen {
        /// Where.
        endpoint: String,
        /// Zenoh's account.
        problem: String,
    },
    /// Nobody answers, and the configuration says not to go on without.
    #[error(
        "nobody answers at {endpoints} within {waited_ms} ms; start the process that listens there first, or correct --connect"
    )]
    CannotReach {
        /// Where.
        endpoints: String,
        /// How long was waited.
        waited_ms: u64,
    },
    /// The session could not be opened for another reason.
    #[error("the Zenoh session cannot be opened: {problem}")]
    Open {
        /// Zenoh's account.
        problem: String,
    },
    /// Not a key, or the session is closed.
    #[error("cannot {action} \"{key}\": {problem}")]
    Refused {
        /// What was tried: "publish on", "subscribe to".
        action: &'static str,
        /// The key or pattern.
        key: String,
        /// Zenoh's account.
        problem: String,
    },
    /// The session did not close in good order.
    #[error("the Zenoh session did not close cleanly: {problem}")]
    Close {
        /// Zenoh's account.
        problem: String,
    },
    /// No loopback port is free.
    #[error("no free port on 127.0.0.1: {problem}")]
    NoFreePort {
        /// The operating system's account.
        problem: String,
    },
}
