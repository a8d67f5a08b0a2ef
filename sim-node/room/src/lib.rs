//! The simulated room: users who walk, obstacles, mirrors with delay and errors, and reports with
//! noise and latency.
//!
//! This crate does no I/O, reads no clock and starts no thread. Time, commands, seeds and the text
//! of a recorded walk are arguments. It contains no control policy and does not depend on the decision
//! core.
//!
//! Data flow:
//!
//! ```text
//! world (users, obstacles, channel) --+--> reports --> events
//!                                     |                  |  controller, outside this crate
//! mirrors (device) <-- array kit <----+-- commands <-----+
//! ```
//!
//! - [`world`]: users, obstacles and the channel between them; training steps it directly.
//! - [`mirrors`]: how mirrors follow their commands, as a device of `heliostat-array`.
//! - [`reports`]: the streams of position, channel and obstacle reports.
//! - [`room`]: world and mirrors on the same time line.
//! - [`episode`]: a room with its reports and telemetry, driven in closed loop in simulated time.
//! - [`baselines`]: the users' rates without the array, with flat mirrors and with the oracle.
//! - [`control`]: changes that an operator may order in a running room.
//! - [`walks`]: recorded walks of pedestrian data sets, prepared for a room.
//! - [`mismatch`]: the true room, drawn around the nominal one.
//! - [`random`]: one stream of random numbers for each purpose.

pub mod baselines;
pub mod control;
pub mod episode;
pub mod mirrors;
pub mod mismatch;
pub mod random;
pub mod reports;
pub mod room;
pub mod walks;
pub mod world;

pub use episode::Episode;
pub use room::SimulatedRoom;
pub use world::World;
