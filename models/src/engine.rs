//! Builds policies, each learned one on the engine that its graph needs.

use heliostat_core::policy::{
    self, Actor, DenseNetwork, Engine, Finding, Network, Policy, PolicyKind, Resources,
    actor_file::{ActorError, ActorFile},
};
use heliostat_files::excerpt;
use heliostat_onnx::{ModelProto, validity::check_graph};
use heliostat_scenario::Scenario;
use prost::Message;

use crate::{error::BuildError, onnxruntime, source::ActorSource, time::monotonic_ns};

/// The dense engine for a chain of dense layers, ONNX Runtime for every other graph.
struct ByGraph;

impl Engine for ByGraph {
    fn load(&self, model: &[u8], input_length: usize) -> Result<Box<dyn Network>, String> {
        let not_dense = match DenseNetwork::read(model, input_length) {
            Ok(network) => return Ok(Box::new(network)),
            Err(refusal) => refusal,
        };
        check_valid(model)?;
        onnxruntime::load(model, input_length).map_err(|refusal| match refusal {
            onnxruntime::Refusal::NoLibrary(found) => format!(
                "{not_dense}; such a graph runs on ONNX Runtime, {found}: `pip install onnxruntime`, or export a chain of \
                 dense layers such as Gemm, Relu and Tanh{}",
                functions(model)
            ),
            onnxruntime::Refusal::Network(message) => {
                format!("ONNX Runtime refused the network: {message}{}", functions(model))
            }
        })
    }
}

/// ONNX Runtime for every graph.
struct OnnxRuntime;

impl Engine for OnnxRuntime {
    fn load(&self, model: &[u8], input_length: usize) -> Result<Box<dyn Network>, String> {
        onnxruntime::load(model, input_length).map_err(|refusal| match refusal {
            onnxruntime::Refusal::NoLibrary(found) => format!("ONNX Runtime, {found}: `pip install onnxruntime`"),
            onnxruntime::Refusal::Network(message) => format!("ONNX Runtime refused the network: {message}"),
        })
    }
}

/// Refuses a graph that no engine can evaluate.
fn check_valid(model: &[u8]) -> Result<(), String> {
    let Ok(ModelProto { graph: Some(graph), .. }) = ModelProto::decode(model) else { return Ok(()) };
    check_graph(&graph)
        .map_err(|fault| format!("the graph is invalid: {}; export it again", excerpt(&fault.to_string())))
}

/// What to do with functions that a file defines; nothing where it has none.
fn functions(model: &[u8]) -> &'static str {
    match ModelProto::decode(model) {
        Ok(model) if !model.functions.is_empty() => {
            "; the file has functions of its own: inline them with onnx.inliner, or export with a newer version"
        }
        _ => "",
    }
}

/// The network of a model on ONNX Runtime, with rows of `input_length` values: for comparisons.
///
/// # Errors
/// No library, or its own message where it refuses the model.
pub fn onnxruntime_network(model: &[u8], input_length: usize) -> Result<Box<dyn Network>, String> {
    OnnxRuntime.load(model, input_length)
}

/// Builds a policy for a room; a learned one reads its file from `source`.
///
/// # Errors
/// [`BuildError`] where the file is missing, does not fit the room, or is given for a policy that
/// reads none.
pub fn build(kind: PolicyKind, scenario: &Scenario, source: &ActorSource) -> Result<Box<dyn Policy>, BuildError> {
    source.check_used_by(kind)?;
    let file = if kind.is_learned() { Some(source.fetch(kind, scenario)?) } else { None };
    let resources = Resources { actor: file.as_ref(), engine: &ByGraph, monotonic_ns };
    Ok(policy::build(kind, scenario, &resources)?)
}

/// Builds a policy for a room and, if it is learned, tries it on sampled observations: for a
/// controller, and for checks before a run.
///
/// # Errors
/// As [`build`], and where the network gives no angles on any observation.
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
    let findings = actor.try_out(scenario, monotonic_ns).map_err(policy::BuildError::from)?;
    Ok((Box::new(actor), findings))
}

/// Loads an actor for a room.
///
/// # Errors
/// [`ActorError`] where the file does not fit the room, no engine evaluates its graph, or an engine
/// computes other outputs than the trainer's own network.
pub fn load_actor(file: &ActorFile, scenario: &Scenario) -> Result<Actor, ActorError> {
    Actor::load(file, scenario, &ByGraph)
}

/// Loads an actor for a room on ONNX Runtime, even if its graph is dense: for comparisons.
///
/// # Errors
/// As [`load_actor`].
pub fn load_actor_on_onnxruntime(file: &ActorFile, scenario: &Scenario) -> Result<Actor, ActorError> {
    Actor::load(file, scenario, &OnnxRuntime)
}
