//! Export of trained networks as ONNX files: the network alone, as a chain of dense layers.
//!
//! The metadata names the encoder before the network and the decoder after it
//! ([`heliostat_core::policy::actor_file`]), which training and controller share. It also holds
//! outputs of the trainer's own network for fixed inputs, so that a controller can verify its engine.
//!
//! - [`actor`]: the actor of `ddpg` and `analytic`.
//! - [`dense`]: any network of dense layers.

pub mod actor;
pub mod dense;
