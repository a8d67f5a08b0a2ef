//! Export of trained networks as ONNX files.
//!
//! - [`actor`]: the actor of `ddpg` and `analytic` with the geometric decoder.
//! - [`network`]: the layers of a network, which `ddpg-raw` uses too.

pub mod actor;
pub mod network;
