//! The simulator process: the simulated room of `heliostat-sim` on the bus.
//!
//! It takes the place of a real room behind the same contract: a controller cannot tell the two apart.
//!
//! - [`node`]: the room on the bus, live or in lockstep; [`summary`] is the result of a run.
//! - [`ledger`]: which tick was answered when.
//! - [`cli`]: its command line.

pub mod cli;
mod edge;
pub mod ledger;
mod live;
mod lockstep;
mod metrics;
pub mod node;
mod reporter;
pub mod summary;

pub use summary::Summary;
