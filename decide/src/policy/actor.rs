//! The trained policy: an ONNX network whose last layers are the geometric decoder, so that it gives angles itself.
//!
//! The inference engine is behind [`Engine`]. It may copy its input and allocate at each run; our part writes into one input that lives as
//! long as the actor.

use heliostat_channel::{ChannelModel, mirrors::MirrorAngles};
use heliostat_scenario::Scenario;

use super::{
    Policy, PolicyError,
    actor_file::{ActorError, ActorFile, ActorInfo},
    network::{Engine, Network},
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
    network: Box<dyn Network>,
}

impl Actor {
    /// Checks that an actor fits the room, and builds its network.
    ///
    /// # Errors
    /// [`ActorError`] that names what does not fit, and what to do.
    pub fn load(file: &ActorFile, scenario: &Scenario, engine: &dyn Engine) -> Result<Self, ActorError> {
        let info = ActorInfo::read(file)?;
        info.check_fits(scenario)?;
        let encoder = info.encoder();
        let network = engine
            .load(&file.bytes, encoder.len())
            .map_err(|message| ActorError::Engine { origin: file.origin.clone(), message })?;
        Ok(Self { name: "actor".into(), info, encoder, network })
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
        self.network.input_mut().copy_from_slice(vector);
        self.run(out)
    }

    /// Runs the network on its last input and throws the answer away: what the engine costs without anything of ours, for
    /// benchmarks and for the count of its allocations.
    ///
    /// # Errors
    /// [`PolicyError`] where the engine fails.
    pub fn run_engine_alone(&mut self) -> Result<(), PolicyError> {
        self.network.run().map(drop)
    }

    /// Runs the network on its input as it stands.
    fn run(&mut self, out: &mut MirrorAngles) -> Result<(), PolicyError> {
        let angles = self.network.run()?;
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
        self.encoder.encode(model, observation, self.network.input_mut())?;
        self.run(out)
    }

    fn rehearse(&mut self, model: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) {
        // It remembers nothing, and a failure shows when it matters.
        let _ = self.act(model, observation, out);
    }
}

fn widen(values: &[f32], out: &mut [f64]) {
    for (out, value) in out.iter_mut().zip(values) {
        *out = f64::from(*value);
    }
}
