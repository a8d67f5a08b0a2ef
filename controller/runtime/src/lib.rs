//! The controller process: the decision core of `heliostat-core` on the bus, in real time.
//!
//! It depends on no simulator: a real room that follows the contract takes the place of the
//! simulated one without a change here.
//!
//! - [`cli`], [`config`], [`machine`]: flags, and what they configure.
//! - [`node`]: the process, with any number of rooms.
//! - [`room_runtime`]: one room with its decision loop, receive queue and watchdog.
//! - [`report`]: stage times, summary and metrics.

pub mod cli;
pub mod config;
pub mod machine;
pub mod node;
mod pauses;
pub mod report;
pub mod room_runtime;
