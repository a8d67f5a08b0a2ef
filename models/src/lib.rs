//! Learned policies: the shipped actors, and the engines that evaluate their networks.
//!
//! - [`build`]: any policy by its name; [`build_tried`] also tries a learned one on sampled
//!   observations.
//! - [`source`]: where the file of a learned policy comes from; [`shipped`] holds the actors that
//!   are built in.
//! - [`library`]: where the shared library of ONNX Runtime comes from.
//!
//! A chain of dense layers runs on [`DenseEngine`](heliostat_core::policy::DenseEngine), every other
//! graph on ONNX Runtime. The shipped actors are dense, so that a controller with them needs no
//! library. Only the module `onnxruntime` names ort.

mod batch;
mod engine;
mod error;
pub mod library;
mod onnxruntime;
pub mod shipped;
pub mod source;
mod time;

pub use engine::{build, build_tried, load_actor, load_actor_on_onnxruntime, onnxruntime_network};
pub use error::{BuildError, SourceError};
pub use library::ORT;
pub use onnxruntime::BareSession;
pub use source::{ActorSource, PolicyArgs};
pub use time::monotonic_ns;
