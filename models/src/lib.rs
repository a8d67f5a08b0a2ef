//! Training, evaluation and export of the policies that learn.
//!
//! A learner meets a simulated room ([`env`](mod@env)) through the same observation encoder and the same decoder that serve in the
//! controller; what comes out is one ONNX file in which features, network and decoder are a single graph ([`export`]).
//!
//! Nothing here runs beside a live room: no transport, no clock, no deadline.
//!
//! # Parts
//! - [`learner`], [`algorithm`]: what every algorithm can do, and which there are.
//! - [`ddpg`]: Algorithm 1 with one weight a user; its head lists every departure from the paper.
//! - [`ddpg_raw`], [`ddpg_basis`]: Algorithm 1 with all angles as the action, as the paper has it and as it can be made to work.
//! - [`analytic`]: the gradient through the channel itself, in place of trial and critic.
//! - [`dql`], [`q_learning`], [`sarsa`]: a choice among the entries of a [`codebook`], by a network or by a [`table`].
//! - [`features`], [`actor`], [`raw`], [`networks`], [`explore`], [`replay`], [`needy`]: what learners share.
//! - [`evaluate`]: held-out states and the ratio to the oracle.
//! - [`comparison`]: any policies on the same states, in statics and in closed loop.
//! - [`mod@calibrate`]: the mounting of real mirrors from measured gains, and what that is worth.
//! - [`checkpoint`], [`curve`]: what a run leaves on disk while it goes on.
//! - [`export`], [`onnx`], [`card`]: what it leaves when it is done.
//! - [`train`]: the `heliostat train` command.

pub mod actor;
pub mod algorithm;
pub mod analytic;
pub mod calibrate;
pub mod card;
pub mod checkpoint;
pub mod codebook;
pub mod comparison;
pub mod curve;
pub mod ddpg;
pub mod ddpg_basis;
pub mod ddpg_raw;
pub mod dql;
pub mod env;
pub mod evaluate;
pub mod explore;
pub mod export;
pub mod features;
pub mod learner;
pub mod needy;
pub mod networks;
pub mod onnx;
pub mod q_learning;
pub mod raw;
pub mod replay;
pub mod sarsa;
pub mod table;
pub mod train;

pub use train::{TrainArgs, run_train};
