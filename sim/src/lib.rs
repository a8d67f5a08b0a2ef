//! The simulated room: users who walk, obstacles, mirrors that follow commands late and imperfectly, and reports with noise and delay.
//!
//! It does no I/O, reads no clock and starts no thread: time, commands and the text of a recorded walk are arguments. It decides nothing
//! about the mirrors and shares no code with the controller.
//!
//! - [`world`]: users, obstacles and the channel between them; what the trainer steps.
//! - [`mobility`], [`trace`], [`obstacles`]: random waypoint walks, recorded walks, the hard-core process.
//! - [`actuator`]: how mirrors follow their commands; [`mirrors`]: the same as a device of `heliostat-array`.
//! - [`streams`], [`schedule`]: what is reported, when, how late and how exactly.
//! - [`room`]: all of these, moving through the same time.
//! - [`baselines`]: what the users get, beside no array, flat mirrors and the oracle.
//! - [`control`]: what an operator may change in a running room.
//! - [`random`]: one stream of random numbers for each purpose.

pub mod actuator;
mod axis;
pub mod baselines;
pub mod control;
pub mod mirrors;
pub mod mobility;
pub mod obstacles;
pub mod random;
pub mod room;
pub mod schedule;
pub mod streams;
pub mod trace;
pub mod world;

pub use room::SimulatedRoom;
pub use world::World;
