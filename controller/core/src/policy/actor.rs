//! The learned policy: an ONNX network whose last layers are the geometric decoder, so that its
//! output is angles.
//!
//! The inference engine is behind [`Engine`]. It may copy its input and allocate at each run. The
//! actor writes into one input buffer that it keeps.

mod agreement;
mod samples;
mod trial;

use heliostat_channel::{ChannelModel, mirrors::MirrorAngles};
use heliostat_scenario::Scenario;

use super::{
    actor_file::{ActorError, ActorFile, ActorInfo},
    engine::{Engine, Network},
    proposal::{Policy, PolicyError, PolicyMemory},
};
use crate::{
    observe::{
        observation::{Observation, ObservationEncoder},
        selection::Selection,
    },
    output::safety::check_finite,
};

pub use trial::Finding;

/// An actor that fits the room, ready to run.
pub struct Actor {
    name: String,
    info: ActorInfo,
    encoder: ObservationEncoder,
    selection: Selection,
    network: Box<dyn Network>,
}

impl Actor {
    /// Checks that an actor fits the room, and builds its network.
    ///
    /// # Errors
    /// [`ActorError`] with the value found and the value expected.
    pub fn load(file: &ActorFile, scenario: &Scenario, engine: &dyn Engine) -> Result<Self, ActorError> {
        let info = ActorInfo::read(file)?;
        info.check_fits(scenario)?;
        let encoder = info.encoder();
        let network = engine
            .load(&file.bytes, encoder.len())
            .map_err(|message| ActorError::Engine { origin: file.origin.clone(), message })?;
        let selection = Selection::new(encoder.users_max());
        Ok(Self { name: "actor".into(), info, encoder, selection, network })
    }

    /// The same actor under the name of a policy, for summaries.
    pub fn named(self, name: String) -> Self {
        Self { name, ..self }
    }

    /// The metadata of the actor.
    pub fn info(&self) -> &ActorInfo {
        &self.info
    }

    /// The name of the engine that evaluates the network.
    pub fn engine_name(&self) -> &'static str {
        self.network.engine()
    }

    /// Runs the network on a ready-made vector: roll then yaw of each mirror in rad.
    ///
    /// # Errors
    /// [`PolicyError`] where the engine fails or an output is not finite.
    ///
    /// # Panics
    /// If the length of `vector` is not that of the encoder.
    pub fn answer(&mut self, vector: &[f32], out: &mut MirrorAngles) -> Result<(), PolicyError> {
        self.network.input_mut().copy_from_slice(vector);
        self.run(out)
    }

    /// Runs the network on its last input and discards the output: the cost of the engine alone,
    /// for benchmarks and for the count of its allocations.
    ///
    /// # Errors
    /// [`PolicyError`] where the engine fails.
    pub fn run_engine_alone(&mut self) -> Result<(), PolicyError> {
        self.network.run().map(drop)
    }

    /// Runs the network on its present input.
    fn run(&mut self, out: &mut MirrorAngles) -> Result<(), PolicyError> {
        let angles = self.network.run()?;
        let (roll, yaw) = angles
            .split_at_checked(self.info.mirrors)
            .filter(|(_, yaw)| yaw.len() == self.info.mirrors)
            .ok_or_else(|| PolicyError::Inference {
                message: format!("the output of the network has a length of {}", angles.len()),
            })?;
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
        let chosen = self.selection.choose(observation).iter().copied();
        self.encoder.encode_users(model, observation, chosen, self.network.input_mut())?;
        self.run(out)
    }

    fn engine(&self) -> Option<&'static str> {
        Some(self.network.engine())
    }

    fn users_max(&self) -> usize {
        self.encoder.users_max()
    }

    fn warm_cache(&mut self, model: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) {
        // An actor keeps slots only, and the next decision reports a failure.
        let _ = self.act(model, observation, out);
    }

    fn memory(&self) -> PolicyMemory {
        PolicyMemory { users: self.selection.slots().to_vec(), ..PolicyMemory::default() }
    }

    fn restore(&mut self, memory: &PolicyMemory) {
        self.selection.set_slots(&memory.users);
    }
}

fn widen(values: &[f32], out: &mut [f64]) {
    for (out, value) in out.iter_mut().zip(values) {
        *out = f64::from(*value);
    }
}
