//! The central unit: from reports about a room to mirror angles, within the deadline.
//!
//! A position report arrives; the [`inbox`] takes it or refuses it by name; the [`observer`] brings the latest of each stream
//! into one [`observation`]; a [`policy`] proposes angles; [`safety`] brings them within limits; the command leaves. All of that
//! is [`core`], which is sans-I/O: it reads no clock, opens nothing, logs nothing, waits for nothing.
//!
//! [`capabilities`] holds what the array announces against the scenario, and heeds the emergency stop.
//!
//! [`node`] is the edge: subscriptions, the put, the clock, a [`ledger`] of how long each stage took and a [`summary`] at the end. [`intake`] says who
//! decides, and when; [`machine`] asks the operating system for memory, processors and precedence.
//!
//! `control` lets an operator exchange the policy while the node runs.
//!
//! It knows nothing of simulators: a real room that speaks the contract takes their place without a change here.

pub mod capabilities;
pub mod cli;
mod control;
pub mod core;
mod desk;
pub mod inbox;
pub mod intake;
pub mod ledger;
pub mod machine;
mod metrics;
pub mod node;
pub mod observation;
pub mod observer;
mod outcome;
pub mod policy;
mod post;
pub mod refused;
mod rhythm;
pub mod safety;
mod standby;
mod status;
pub mod summary;
