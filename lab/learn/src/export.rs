//! Export of trained networks as ONNX files.
//!
//! - [`actor`]: the actor of `ddpg` and `analytic` with the geometric decoder.
//! - [`lstm`]: the steps of a long short-term memory, for the learner of that name.
//! - [`network`]: the layers of a network, which `ddpg-raw` uses too.
//! - [`rows`]: a chain of dense layers over any number of rows, for `residual`.

pub mod actor;
pub mod lstm;
pub mod network;
pub mod rows;
