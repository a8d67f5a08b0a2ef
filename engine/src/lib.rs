//! ONNX inference for learned policies, behind [`Engine`](heliostat_decide::policy::Engine) of the decision core.
//!
//! This is the only crate that names ort. The embedded engine is tract; the cargo feature `onnxruntime` selects ONNX Runtime instead. The
//! engine copies its input and allocates at each run.
//!
//! - [`Ort`]: the engine.
//! - [`source`]: where the file of a learned policy comes from; [`shipped`] holds the actors that are built in.
//! - [`build`]: any policy by its name, with this engine.

mod error;
pub mod shipped;
pub mod source;

use std::{
    sync::{Mutex, OnceLock, PoisonError},
    time::Instant,
};

use heliostat_decide::policy::{
    self, Actor, Engine, Network, Policy, PolicyError, PolicyKind, Resources,
    actor_file::{ActorError, ActorFile, OUTPUT_NAME},
};
use heliostat_scenario::Scenario;
use ort::{
    environment::Environment,
    session::{
        Session,
        builder::{GraphOptimizationLevel, SessionBuilder},
    },
    value::Tensor,
};

pub use source::{ActorSource, BuildError, SourceError};

/// Builds a policy for a room; a learned one reads its file from `source`.
///
/// # Errors
/// [`BuildError`] where the file is missing, does not fit the room, or is given for a policy that reads none.
pub fn build(kind: PolicyKind, scenario: &Scenario, source: &ActorSource) -> Result<Box<dyn Policy>, BuildError> {
    source.check_used_by(kind)?;
    let actor = if kind.is_learned() { Some(source.fetch(kind, scenario)?) } else { None };
    let resources = Resources { actor: actor.as_ref(), engine: &Ort, monotonic_ns };
    Ok(policy::build(kind, scenario, &resources)?)
}

/// Loads an actor for a room.
///
/// # Errors
/// [`ActorError`] where the file does not fit the room, or the engine refuses it.
pub fn load_actor(file: &ActorFile, scenario: &Scenario) -> Result<Actor, ActorError> {
    Actor::load(file, scenario, &Ort)
}

/// Monotonic time in ns since the first call: the time source of policies with a time budget.
pub fn monotonic_ns() -> u64 {
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed().as_nanos() as u64
}

/// The inference engine of this build.
#[derive(Clone, Copy, Debug)]
pub struct Ort;

impl Engine for Ort {
    fn load(&self, model: &[u8], input_length: usize) -> Result<Box<dyn Network>, String> {
        let session = build_session(model).map_err(|error| error.to_string())?;
        let input = Tensor::from_array(([1, input_length], vec![0.0_f32; input_length]));
        let input = input.map_err(|error| error.to_string())?;
        Ok(Box::new(OrtNetwork { session, input, output: Vec::new() }))
    }
}

/// A session with its input, and a copy of its last output.
struct OrtNetwork {
    session: Session,
    input: Tensor<f32>,
    output: Vec<f32>,
}

impl Network for OrtNetwork {
    fn input_mut(&mut self) -> &mut [f32] {
        self.input.extract_tensor_mut().1
    }

    fn run(&mut self) -> Result<&[f32], PolicyError> {
        let outputs = self.session.run(ort::inputs![&self.input]).map_err(inference_failed)?;
        let (_, values) = outputs[OUTPUT_NAME].try_extract_tensor::<f32>().map_err(inference_failed)?;
        self.output.clear();
        self.output.extend_from_slice(values);
        Ok(&self.output)
    }
}

fn inference_failed(error: ort::Error) -> PolicyError {
    PolicyError::Inference { message: error.to_string() }
}

fn build_session(bytes: &[u8]) -> ort::Result<Session> {
    // Without the level set by hand the engine runs the graph as written, thirty times slower.
    let builder = Session::builder(&environment()?)?.with_optimization_level(GraphOptimizationLevel::Level3)?;
    one_thread(builder)?.commit_from_memory(bytes)
}

/// The environment of the engine. A process can create it only once, so all networks share it.
fn environment() -> ort::Result<Environment> {
    static ENVIRONMENT: Mutex<Option<Environment>> = Mutex::new(None);
    let mut environment = ENVIRONMENT.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(environment) = environment.as_ref() {
        return Ok(environment.clone());
    }
    choose_engine();
    Ok(environment.insert(ort::init().with_telemetry(false).build()?).clone())
}

#[cfg(all(feature = "tract", feature = "onnxruntime"))]
compile_error!(
    "the features tract and onnxruntime exclude each other: build with --no-default-features --features onnxruntime"
);

#[cfg(not(any(feature = "tract", feature = "onnxruntime")))]
compile_error!("expected an inference engine: the feature tract (the default) or onnxruntime");

#[cfg(feature = "tract")]
fn choose_engine() {
    ort::set_api(ort_tract::api());
}

/// The library is found by itself, by ORT_DYLIB_PATH.
#[cfg(not(feature = "tract"))]
fn choose_engine() {}

/// tract uses the calling thread alone.
#[cfg(feature = "tract")]
fn one_thread(builder: SessionBuilder) -> ort::Result<SessionBuilder> {
    Ok(builder)
}

/// Handing work to another thread costs more than all the work.
#[cfg(not(feature = "tract"))]
fn one_thread(builder: SessionBuilder) -> ort::Result<SessionBuilder> {
    Ok(builder.with_intra_threads(1)?)
}
