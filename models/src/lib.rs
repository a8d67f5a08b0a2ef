//! ONNX inference for learned policies, behind [`Engine`](heliostat_core::policy::Engine) of the
//! decision core.
//!
//! - [`build`]: any policy by its name, on the engine that suits its graph; [`EngineChoice`]
//!   selects another.
//! - [`source`]: where the file of a learned policy comes from; [`shipped`] holds the actors that
//!   are built in.
//!
//! The embedded engine is tract, called directly: it is Rust alone. The cargo feature `onnxruntime`
//! selects ONNX Runtime through ort instead. Only one module names each of them. Dense graphs run
//! on [`DenseEngine`](heliostat_core::policy::DenseEngine), which needs neither. A build without
//! both features evaluates other graphs by the reference evaluation, which is slow.

#[cfg(any(feature = "tract", feature = "onnxruntime"))]
mod batch;
mod choice;
mod embedded;
mod error;
#[cfg(feature = "onnxruntime")]
mod onnxruntime;
#[cfg(not(any(feature = "tract", feature = "onnxruntime")))]
mod reference;
pub mod shipped;
pub mod source;
mod time;
#[cfg(all(feature = "tract", not(feature = "onnxruntime")))]
mod tract;

use heliostat_core::policy::{
    Actor, Finding, Policy, PolicyKind,
    actor_file::{ActorError, ActorFile},
};
use heliostat_scenario::Scenario;

pub use choice::{EngineChoice, UnknownEngine};
pub use embedded::{EMBEDDED, embedded_network};
pub use error::{BuildError, SourceError};
pub use source::ActorSource;
pub use time::monotonic_ns;

/// Builds a policy for a room on the engine of [`EngineChoice::Auto`]; a learned one reads its file
/// from `source`.
///
/// # Errors
/// As [`EngineChoice::build`].
pub fn build(kind: PolicyKind, scenario: &Scenario, source: &ActorSource) -> Result<Box<dyn Policy>, BuildError> {
    EngineChoice::Auto.build(kind, scenario, source)
}

/// Builds a policy for a room on the engine of [`EngineChoice::Auto`] and, if it is learned, tries
/// it on sampled observations.
///
/// # Errors
/// As [`EngineChoice::build_tried`].
pub fn build_tried(
    kind: PolicyKind,
    scenario: &Scenario,
    source: &ActorSource,
) -> Result<(Box<dyn Policy>, Vec<Finding>), BuildError> {
    EngineChoice::Auto.build_tried(kind, scenario, source)
}

/// Loads an actor for a room on the engine of [`EngineChoice::Auto`].
///
/// # Errors
/// As [`EngineChoice::load_actor`].
pub fn load_actor(file: &ActorFile, scenario: &Scenario) -> Result<Actor, ActorError> {
    EngineChoice::Auto.load_actor(file, scenario)
}
