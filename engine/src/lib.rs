//! ONNX inference for learned policies, behind [`Engine`](heliostat_decide::policy::Engine) of the decision core.
//!
//! - [`build`]: any policy by its name, with the engine of this build.
//! - [`source`]: where the file of a learned policy comes from; [`shipped`] holds the actors that are built in.
//!
//! The embedded engine is tract, called directly: it is Rust alone. The cargo feature `onnxruntime` selects ONNX Runtime through ort
//! instead. Only one module names each of them.

mod error;
#[cfg(feature = "onnxruntime")]
mod onnxruntime;
pub mod shipped;
pub mod source;
#[cfg(not(feature = "onnxruntime"))]
mod tract;

use std::{sync::OnceLock, time::Instant};

use heliostat_decide::policy::{
    self, Actor, Finding, Policy, PolicyKind, Resources,
    actor_file::{ActorError, ActorFile},
};
use heliostat_scenario::Scenario;

#[cfg(feature = "onnxruntime")]
use onnxruntime::OnnxRuntime as ThisEngine;
#[cfg(not(feature = "onnxruntime"))]
use tract::Tract as ThisEngine;

pub use error::{BuildError, SourceError};
pub use source::ActorSource;

/// Builds a policy for a room; a learned one reads its file from `source`.
///
/// # Errors
/// [`BuildError`] where the file is missing, does not fit the room, or is given for a policy that reads none.
pub fn build(kind: PolicyKind, scenario: &Scenario, source: &ActorSource) -> Result<Box<dyn Policy>, BuildError> {
    source.check_used_by(kind)?;
    let actor = if kind.is_learned() { Some(source.fetch(kind, scenario)?) } else { None };
    let resources = Resources { actor: actor.as_ref(), engine: &ThisEngine, monotonic_ns };
    Ok(policy::build(kind, scenario, &resources)?)
}

/// Builds a policy for a room and, if it is learned, tries it on sampled observations: for a
/// controller, and for checks before a run.
///
/// # Errors
/// As [`build`], and where the engine does not evaluate the network as a reference evaluation does.
pub fn build_tried(
    kind: PolicyKind,
    scenario: &Scenario,
    source: &ActorSource,
) -> Result<(Box<dyn Policy>, Vec<Finding>), BuildError> {
    if !kind.is_learned() {
        return Ok((build(kind, scenario, source)?, Vec::new()));
    }
    let file = source.fetch(kind, scenario)?;
    let mut actor = load_actor(&file, scenario).map_err(policy::BuildError::from)?.named(kind.name());
    let findings = actor.try_out(&file, scenario, monotonic_ns).map_err(policy::BuildError::from)?;
    Ok((Box::new(actor), findings))
}

/// Loads an actor for a room.
///
/// # Errors
/// [`ActorError`] where the file does not fit the room, or the engine refuses it.
pub fn load_actor(file: &ActorFile, scenario: &Scenario) -> Result<Actor, ActorError> {
    Actor::load(file, scenario, &ThisEngine)
}

/// Monotonic time in ns since the first call: the time source of policies with a time budget.
pub fn monotonic_ns() -> u64 {
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed().as_nanos() as u64
}
