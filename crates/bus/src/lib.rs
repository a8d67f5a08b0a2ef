//! Publishers, subscribers and liveliness over Zenoh; no other crate names Zenoh.
//!
//! Payloads are bytes in this crate; `heliostat-proto` defines their contents and their keys. All
//! calls block, none is async. Endpoints are explicit, without multicast or gossip discovery, so
//! that rooms never connect by accident.
//!
//! - [`BusConfig`] and [`BusArgs`]: endpoints at which to listen and to which to connect.
//! - [`Bus`]: one session in one room.
//! - [`Publisher`], [`Subscription`], [`Token`], [`Service`]: declarations of a session; dropping
//!   one withdraws it.
//! - [`arriving`]: the decoded messages of one key, for a command that waits for some of them.
//!
//! # Connections
//! Two peers exchange messages when one listens at an endpoint and the other connects to it. A peer
//! does not forward messages: a viewer that needs a controller and a simulator connects to both, or
//! all three are clients of a Zenoh router. [`join_through`] looks into a room through one process.
//!
//! # Security
//! [`Identity`] gives a session a certificate: connections are encrypted, and both sides apply the
//! rights of [`AccessRole`]. [`keys`] makes the certificates. A session without one may listen on
//! this machine only, unless [`BusConfig::insecure`] is set.
//!
//! # Threads
//! Callbacks run on Zenoh's receive threads, one at a time for each subscription. A slow callback
//! delays everything else that arrives over the same link. Callbacks may publish, but must not
//! open, close, query or declare. Zenoh panics when this crate is called from a current-thread
//! tokio runtime.
//!
//! # Environment
//! - `ZENOH_RUNTIME` sets the number of threads, for example
//!   `ZENOH_RUNTIME='(rx:(worker_threads:1))'`. Zenoh reads it when the first session of a process
//!   opens.
//! - `HELIOSTAT_ZENOH='key=value;key=value'` overrides settings of Zenoh, for measurements.

mod access;
pub mod arriving;
mod bounded_session;
mod building;
mod certificate;
mod config;
mod connection_watch;
mod error;
mod free_endpoint;
pub mod keys;
mod platform;
mod resolve;
mod session;
mod through;
mod tls;
mod tls_check;

pub use access::{AccessRole, UnknownRole, access_control};
pub use building::{BuildingRouter, Protocol, RoomEndpoint};
pub use certificate::Certificate;
pub use config::{BusArgs, BusConfig, DEFAULT_ENDPOINT, DEFAULT_TLS_ENDPOINT, Reach, Role, TlsArgs, router_settings};
pub use error::{BusError, KeyError};
pub use free_endpoint::{free_loopback_endpoint, free_loopback_port, private_endpoint};
pub use session::{Bus, Class, Presence, Publisher, Service, Subscription, Token};
pub use through::{
    ACCEPTS_WITHIN, is_joined_through, join_all_through, join_each, join_through, reached, reached_rooms,
};
pub use tls::{CertificateEnds, Identity};
