//! The central unit: from reports about a room to mirror angles, within the deadline.
//!
//! A position report arrives; the [`inbox`] takes it or refuses it by name; the [`observer`] brings the latest of each stream
//! into one [`observation`]; a [`policy`] proposes angles; [`safety`] brings them within limits; the command leaves. All of that
//! is [`core`], which is sans-I/O: it reads no clock, opens nothing, logs nothing, waits for nothing.
//!
//! [`node`] is the edge: subscriptions, the put, the clock, a [`ledger`] of how long each stage took and a [`summary`] at the end. [`intake`] says who
//! decides, and when; [`machine`] asks the operating system for memory, processors and precedence.
//!
//! It knows nothing of simulators: a real room that speaks the contract takes their place without a change here.

pub mod cli;
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
pub mod safety;
mod status;
pub mod summary;
