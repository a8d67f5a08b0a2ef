//! The learned policy: an encoder, an ONNX network and a decoder.
//!
//! The metadata of the file names encoder and decoder ([`actor_file`](super::actor_file)); the
//! network runs on an [`Engine`]. The actor does not allocate in a decision; an inference library
//! may.

mod input;
mod output;
mod samples;
mod trial;
mod verification;

use heliostat_channel::{ChannelModel, mirrors::MirrorAngles};
use heliostat_scenario::Scenario;

use super::{
    actor_file::{ActionKind, ActorError, ActorFile, ActorInfo, ActorProblem, ObservationKind},
    engine::{Engine, Network},
    proposal::{Policy, PolicyMemory, PolicyResult},
};
use crate::observe::observation::{EncodeError, Observation};
use input::Input;
use output::Output;

pub use trial::Finding;
pub use verification::fixed_input;

/// An actor that fits the room, ready to run.
pub struct Actor {
    name: String,
    info: ActorInfo,
    input: Input,
    network: Box<dyn Network>,
    output: Output,
    /// Whether the outputs for fixed inputs are those in the metadata.
    is_verified: bool,
    /// The hash of the file.
    hash: String,
}

impl Actor {
    /// Checks that an actor fits the room, builds its network and verifies it.
    ///
    /// # Errors
    /// [`ActorError`] with the value found and the value expected.
    pub fn load(file: &ActorFile, scenario: &Scenario, engine: &dyn Engine) -> Result<Self, ActorError> {
        let info = ActorInfo::read(file)?;
        info.check_fits(scenario)?;
        let mut network =
            engine.load(&file.bytes, info.columns).map_err(|message| file.refused(ActorProblem::Engine { message }))?;
        let (input, output) = (Input::new(&info, scenario), Output::new(&info, scenario)?);
        // Memory for every number of rows. A model that excludes this one is refused in the trial.
        let _ = network.set_rows(input.rows_max());
        let mut actor =
            Self { name: "actor".into(), info, input, network, output, is_verified: false, hash: file.hash() };
        actor.is_verified = actor.verify(file)?;
        Ok(actor)
    }

    /// The same actor under the name of a policy, for summaries.
    pub fn named(self, name: String) -> Self {
        Self { name, ..self }
    }

    /// The angles for an observation vector; those in the vector where no user is present.
    ///
    /// # Errors
    /// Where the vector has another length, or as [`act`](Policy::act).
    pub fn answer(&mut self, model: &ChannelModel, vector: &[f32], out: &mut MirrorAngles) -> PolicyResult {
        let encoder = self.info.vector_encoder(model.mirrors.len());
        if (self.info.observation, self.info.action) != (ObservationKind::Flat, ActionKind::Angles) {
            let observation = Observation::of_vector(model, encoder, vector)?;
            // As in a controller: without users no angle is better than the last one.
            if observation.users() == 0 {
                out.clone_from(&observation.angles);
                return Ok(());
            }
            return self.act(model, &observation, out);
        }
        if vector.len() != encoder.len() {
            return Err(EncodeError::Buffer { found: vector.len(), expected: encoder.len() }.into());
        }
        self.network.set_rows(1)?;
        self.network.input_mut().copy_from_slice(vector);
        output::split_angles(self.network.run()?, out)
    }

    /// Runs the network on its last input and discards the output: the cost of the engine alone,
    /// for benchmarks and for the count of its allocations.
    ///
    /// # Errors
    /// Where the engine fails.
    pub fn run_engine_alone(&mut self) -> PolicyResult {
        self.network.run().map(drop)
    }
}

impl Policy for Actor {
    fn name(&self) -> &str {
        &self.name
    }

    fn act(&mut self, model: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) -> PolicyResult {
        self.input.encode(model, observation, self.network.as_mut())?;
        let values = self.network.run()?;
        self.output.decode(model, self.input.seen(observation), values, out)
    }

    fn engine(&self) -> Option<&'static str> {
        Some(self.network.engine())
    }

    fn file_hash(&self) -> Option<&str> {
        Some(&self.hash)
    }

    fn users_max(&self) -> usize {
        self.input.selection.users_max()
    }

    fn memory(&self) -> PolicyMemory {
        PolicyMemory { users: self.input.selection.slots().to_vec(), ..PolicyMemory::default() }
    }

    fn restore(&mut self, memory: &PolicyMemory) {
        self.input.selection.set_slots(&memory.users);
    }
}
