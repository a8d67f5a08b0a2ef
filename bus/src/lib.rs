//! Publishers, subscribers and liveliness over Zenoh: the only crate that names it.
//!
//! Payloads are bytes here; `heliostat-proto` knows what they mean and under which key they travel. All calls block and none
//! is async. Endpoints are explicit: nothing is discovered by multicast or gossip, so a room never meets another by chance.
//!
//! - [`BusConfig`] and [`BusArgs`]: who listens, who connects.
//! - [`Bus`]: one session in one room.
//! - [`Publisher`], [`Subscription`], [`Token`], [`Service`]: what a session declares; dropping one ends it.
//!
//! # Who hears whom
//! Two peers talk when one of them listens at an endpoint to which the other connects. A peer does not pass on what it hears:
//! a viewer that wants to hear a controller and a simulator connects to both, or all three are clients of a Zenoh router.
//!
//! # Threads
//! Callbacks run on Zenoh's receive threads, one at a time for each subscription. A slow callback delays everything else
//! that arrives over the same link. Callbacks may publish, but must not open, close, query or declare. The number of threads
//! is set by the environment variable `ZENOH_RUNTIME`, for example `ZENOH_RUNTIME='(rx:(worker_threads:1))'`, read when the
//! first session of a process opens. Any other setting of Zenoh can be laid over ours by `HELIOSTAT_ZENOH='key=value;key=value'`, for measurements. Never call this crate from a current-thread tokio runtime: Zenoh panics there.

mod config;
mod error;
mod session;

pub use config::{BusArgs, BusConfig, DEFAULT_ENDPOINT, Reach, Role, free_loopback_endpoint, free_loopback_port};
pub use error::BusError;
pub use session::{Bus, Class, Presence, Publisher, Service, Subscription, Token};
