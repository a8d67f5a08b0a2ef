//! The trained policy: an ONNX network whose last layers are the geometric decoder, so that it gives angles itself.
//!
//! This is the only file that names the inference engine: tract, which is built in, or ONNX Runtime with the cargo feature `onnxruntime`. The engine
//! copies its input and allocates at each run; our part writes into one tensor that lives as long as the actor.

use std::sync::{Mutex, PoisonError};

use heliostat_channel::{ChannelModel, mirrors::MirrorAngles};
use heliostat_scenario::Scenario;
use ort::{
    environment::Environment,
    session::{
        Session,
        builder::{GraphOptimizationLevel, SessionBuilder},
    },
    value::Tensor,
};

use super::{
    Policy, PolicyError,
    actor_file::{ActorError, ActorFile, ActorInfo, OUTPUT_NAME},
};
use crate::{
    observation::{Observation, ObservationEncoder},
    safety::check_finite,
};

/// An actor that was found to fit the room, ready to run.
pub struct Actor {
    name: String,
    info: ActorInfo,
    encoder: ObservationEncoder,
    session: Session,
    input: Tensor<f32>,
}

impl Actor {
    /// Checks that an actor fits the room, and builds its network.
    ///
    /// # Errors
    /// [`ActorError`] that names what does not fit, and what to do.
    pub fn load(file: &ActorFile, scenario: &Scenario) -> Result<Self, ActorError> {
        let info = ActorInfo::read(file)?;
        info.check_fits(scenario)?;
        let engine_refused = |message: String| ActorError::Engine { origin: file.origin.clone(), message };
        let session = build_session(&file.bytes).map_err(|error| engine_refused(error.to_string()))?;
        let encoder = info.encoder();
        let input = Tensor::from_array(([1, encoder.len()], vec![0.0_f32; encoder.len()]))
            .map_err(|error| engine_refused(error.to_string()))?;
        Ok(Self { name: "actor".into(), info, encoder, session, input })
    }

    /// The same actor under the name of a policy, for summaries.
    pub fn named(self, name: String) -> Self {
        Self { name, ..self }
    }

    /// What the actor says about itself.
    pub fn info(&self) -> &ActorInfo {
        &self.info
    }

    /// Runs the network on a ready-made vector: roll then yaw of each mirror in rad.
    ///
    /// # Errors
    /// [`PolicyError`] where the engine fails or an output is not finite.
    ///
    /// # Panics
    /// Where `vector` has not the encoder's length.
    pub fn answer(&mut self, vector: &[f32], out: &mut MirrorAngles) -> Result<(), PolicyError> {
        self.input.extract_tensor_mut().1.copy_from_slice(vector);
        self.run(out)
    }

    /// Runs the network on its last input and throws the answer away: what the engine costs without anything of ours, for
    /// benchmarks and for the count of its allocations.
    ///
    /// # Errors
    /// [`PolicyError`] where the engine fails.
    pub fn run_engine_alone(&mut self) -> Result<(), PolicyError> {
        self.session.run(ort::inputs![&self.input]).map(drop).map_err(engine_failed)
    }

    /// Runs the network on the tensor as it stands.
    fn run(&mut self, out: &mut MirrorAngles) -> Result<(), PolicyError> {
        let outputs = self.session.run(ort::inputs![&self.input]).map_err(engine_failed)?;
        let (_, angles) = outputs[OUTPUT_NAME].try_extract_tensor::<f32>().map_err(engine_failed)?;
        let (roll, yaw) = angles
            .split_at_checked(self.info.mirrors)
            .filter(|(_, yaw)| yaw.len() == self.info.mirrors)
            .ok_or_else(|| PolicyError::Inference { message: format!("the network gave {} values", angles.len()) })?;
        widen(roll, &mut out.roll);
        widen(yaw, &mut out.yaw);
        Ok(check_finite(out)?)
    }
}

impl Policy for Actor {
    fn name(&self) -> &str {
        &self.name
    }

    fn act(
        &mut self,
        model: &ChannelModel,
        observation: &Observation,
        out: &mut MirrorAngles,
    ) -> Result<(), PolicyError> {
        self.encoder.encode(model, observation, self.input.extract_tensor_mut().1)?;
        self.run(out)
    }

    fn rehearse(&mut self, model: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) {
        // It remembers nothing, and a failure shows when it matters.
        let _ = self.act(model, observation, out);
    }
}

fn build_session(bytes: &[u8]) -> ort::Result<Session> {
    // Without the level set by hand the engine runs the graph as written, thirty times slower.
    let builder = Session::builder(&engine()?)?.with_optimization_level(GraphOptimizationLevel::Level3)?;
    one_thread(builder)?.commit_from_memory(bytes)
}

fn engine_failed(error: ort::Error) -> PolicyError {
    PolicyError::Inference { message: error.to_string() }
}

/// The inference engine. It can be started only once in a process, so all actors share it.
fn engine() -> ort::Result<Environment> {
    static ENGINE: Mutex<Option<Environment>> = Mutex::new(None);
    let mut engine = ENGINE.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(engine) = engine.as_ref() {
        return Ok(engine.clone());
    }
    choose_engine();
    Ok(engine.insert(ort::init().with_telemetry(false).build()?).clone())
}

#[cfg(all(feature = "tract", feature = "onnxruntime"))]
compile_error!(
    "the features tract and onnxruntime exclude each other: build with --no-default-features --features onnxruntime"
);

#[cfg(not(any(feature = "tract", feature = "onnxruntime")))]
compile_error!("an inference engine is wanted: the feature tract (the default) or onnxruntime");

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

fn widen(values: &[f32], out: &mut [f64]) {
    for (out, value) in out.iter_mut().zip(values) {
        *out = f64::from(*value);
    }
}
