//! The controller process: the decision core of `heliostat-decide` on the bus, within the deadline.
//!
//! It knows nothing of simulators: a real room that follows the contract takes their place without a change here.

pub mod cli;
mod control;
mod desk;
pub mod intake;
pub mod ledger;
pub mod machine;
mod metrics;
pub mod node;
mod post;
mod rhythm;
mod standby;
mod status;
pub mod summary;
