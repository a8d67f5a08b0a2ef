//! Errors of sessions, with the remedy.

use heliostat_proto::RoomError;
use thiserror::Error;

/// Why a session, a declaration, a publication or a query failed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum BusError {
    /// The name of the room is not valid in a key.
    #[error(transparent)]
    Room(#[from] RoomError),
    /// The configuration has no endpoint at all, so no connection is possible.
    #[error(
        "no endpoint: expected --listen tcp/127.0.0.1:7447 for one process and --connect tcp/127.0.0.1:7447 for the others (any free port works)"
    )]
    NoEndpoint,
    /// The client has no router to connect to, or listens.
    #[error("wrong endpoints for a client: expected no --listen, and --connect with the endpoint of a Zenoh router")]
    ClientWithoutRouter,
    /// The text is not an endpoint.
    #[error(
        "endpoint \"{endpoint}\": {problem}; expected tcp/HOST:PORT, for example tcp/127.0.0.1:7447, or unixsock-stream/PATH"
    )]
    InvalidEndpoint {
        /// The text.
        endpoint: String,
        /// Its fault.
        problem: String,
    },
    /// Another process listens at the endpoint.
    #[error("endpoint {endpoint} is in use: another process listens there; stop it, or listen at another port")]
    EndpointInUse {
        /// The endpoint.
        endpoint: String,
    },
    /// Listening failed for another reason.
    #[error("cannot listen at {endpoint}: {problem}; give --listen an address of this machine and a port it may use")]
    CannotListen {
        /// The endpoint.
        endpoint: String,
        /// Zenoh's message.
        problem: String,
    },
    /// No process answers within the limit of the configuration.
    #[error(
        "no answer from {endpoints} within {waited_ms} ms; start the process that listens there first, or correct --connect"
    )]
    CannotReach {
        /// The endpoints.
        endpoints: String,
        /// Duration of the wait in ms.
        waited_ms: u64,
    },
    /// The session could not be opened for another reason.
    #[error("the Zenoh session cannot be opened: {problem}")]
    Open {
        /// Zenoh's message.
        problem: String,
    },
    /// The key is invalid, or the session is closed.
    #[error("cannot {action} \"{key}\": {problem}")]
    Refused {
        /// The action that failed, for example "publish on".
        action: &'static str,
        /// The key or pattern.
        key: String,
        /// Zenoh's message.
        problem: String,
    },
    /// The session did not close cleanly.
    #[error("the Zenoh session did not close cleanly: {problem}")]
    Close {
        /// Zenoh's message.
        problem: String,
    },
    /// No loopback port is free.
    #[error("no free port on 127.0.0.1: {problem}")]
    NoFreePort {
        /// Message of the operating system.
        problem: String,
    },
}
