//! The simulated room: people who walk, obstacles, mirrors that follow commands late and imperfectly, and reports with noise and delay.
//!
//! It takes the place of a real room behind the same contract: a controller cannot tell the two apart. It decides nothing about the
//! mirrors and shares no code with a controller.
//!
//! # The room, without clock or transport
//! - [`world`]: people, obstacles and the channel between them; what the trainer steps.
//! - [`mobility`], [`trace`], [`obstacles`]: the random waypoint walk, recordings in its place, the hard-core process.
//! - [`actuator`]: how mirrors follow their commands.
//! - [`mirrors`]: the same as a device of the driver kit, which decides what is followed, as in a real driver.
//! - [`streams`], [`schedule`]: what is reported, when, how late and how exactly.
//! - [`room`]: all of these moving through the same time.
//! - [`yardstick`]: what the users get, beside no array, flat mirrors and the best there is.
//! - [`control`]: what an operator may change in a running room.
//! - [`random`]: one stream of random numbers for each purpose.
//!
//! # The process
//! - [`node`]: the room on the bus, live or in lockstep; [`summary`] is what a run came to.
//! - [`ledger`]: which tick was answered when.
//! - [`cli`]: its command line.

pub mod actuator;
mod axis;
pub mod cli;
pub mod control;
mod edge;
pub mod ledger;
mod live;
mod lockstep;
mod metrics;
pub mod mirrors;
pub mod mobility;
pub mod node;
pub mod obstacles;
pub mod random;
mod reporter;
pub mod room;
pub mod schedule;
pub mod streams;
pub mod summary;
pub mod trace;
pub mod world;
pub mod yardstick;

pub use heliostat_driver::clock;
pub use room::SimulatedRoom;
pub use summary::Summary;
pub use world::World;
