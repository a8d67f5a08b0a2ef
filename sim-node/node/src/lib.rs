//! The simulator process: the simulated room of `heliostat-room` on the bus.
//!
//! It uses the same contract as a real room, so a controller cannot distinguish the two.
//!
//! - [`run`]: one run, live or in lockstep; [`settings`] are its input, [`summary`] is its result.
//! - [`tick_ledger`]: which tick was answered, and when.
//! - [`cli`]: the command line.

pub mod array_node;
pub mod cli;
mod coverage;
mod error;
mod live;
mod lockstep;
mod metrics;
mod node;
pub mod run;
mod session;
pub mod settings;
pub mod summary;
pub mod tick_ledger;
mod truth_publisher;

pub use error::NodeError;
pub use settings::{Pace, Settings};
pub use summary::{SumRatesMbps, Summary};
