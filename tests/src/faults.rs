//! The fault campaign: rooms of real processes over real sockets, faults, and their measured effect.
//!
//! - [`FaultRoom`]: an array, a controller and a [`Witness`] that records telemetry and status.
//! - [`Building`]: two hosts, each with a Zenoh router, and rooms whose standbys are on the other host.
//! - [`Team`]: an array whose controllers are on hosts of their own, and [`Succession`], the effect of a fault of one.
//! - What acts on the room: signals to its processes, a [`Proxy`] between them, a shifted
//!   [`SystemClock`], an [`Attacker`] that publishes, a [`LoopbackBoard`] that misbehaves.
//! - [`Effect`]: the longest gap between two accepted commands, commands lost, time to recovery.
//! - [`Fault`]: a row of the table of faults, with the [`Promise`] that its effect must keep.
//!
//! With `HELIOSTAT_WRITE_FAULTS=1` each measured fault replaces its row of docs/faults.md.

mod attacker;
mod board;
mod building;
mod effect;
mod namespace;
pub mod page;
mod promise;
mod proxy;
mod room;
mod system_clock;
mod table;
mod team;
mod tracker;
mod witness;

pub use attacker::Attacker;
pub use board::{Behaviour, LoopbackBoard};
pub use building::{Building, Host};
pub use effect::Effect;
pub use namespace::{Cable, Link, Segment};
pub use promise::Promise;
pub use proxy::Proxy;
pub use room::{Array, FaultRoom, Launch, Setup, make_keys};
pub use system_clock::SystemClock;
pub use table::{FAULTS, Fault};
pub use team::{Succession, Team};
pub use tracker::{Tracker, users_at_rest};
pub use witness::Witness;
