//! Training, evaluation and export of the learned policies.
//!
//! A learner acts in a simulated room through the same observation encoder and the same decoder as
//! the controller. The result is one ONNX file in which features, network and decoder are one
//! graph. This crate uses no transport, and nothing in it runs in the decision path.
//!
//! # Modules, in the order of the data flow
//! - [`environment`]: rooms, observations as inputs of a network, actions, and the reward.
//! - [`networks`]: layers, optimiser, and the actor.
//! - [`training`]: the training loop and the files of a run.
//! - [`learners`]: the algorithms, one file each, with their deviations from the paper.
//! - [`export`]: ONNX graphs.
//! - [`evaluation`]: held-out states, the ratio to the oracle, and confidence intervals.
//! - [`comparison`]: policies on the same states, static and in closed loop.
//! - [`calibrate`](mod@calibrate): how well a calibration measures rooms, and what it is worth.
//! - [`threads`]: the threads of a computation.
//! - [`train`]: the `heliostat-lab train` command.

pub mod calibrate;
pub mod comparison;
pub mod environment;
pub mod evaluation;
pub mod export;
pub mod learners;
pub mod networks;
pub mod threads;
pub mod train;
pub mod training;

pub use train::{TrainArgs, run_train};
