//! The learned policy with the compact action: a network corrects the belief about each user, and
//! the solver of the model-based policies turns the corrected observation into angles.
//!
//! One network is applied to the row of every user ([`Evidence`]), so one file serves any number of
//! users, any array and any room. [`correction`](crate::observe::correction) decodes its output. A
//! network that gives zeros leaves the model-based policy unchanged.

use heliostat_channel::{ChannelModel, mirrors::MirrorAngles};

use super::{
    actor_file::ActorFile,
    compact_file::{CORRECTIONS, CompactError},
    engine::Engine,
    model_based::ModelBased,
    proposal::{Policy, PolicyError, PolicyMemory},
    row_network::RowNetwork,
};
use crate::observe::{
    evidence::{Evidence, FEATURES},
    observation::Observation,
};

/// A network that corrects the belief, and the solver that acts on the corrected observation.
pub struct Residual {
    name: String,
    solver: ModelBased,
    network: RowNetwork<FEATURES>,
    failure: Option<PolicyError>,
}

impl Residual {
    /// Loads the network of a file for a room with this number of users and mirrors, and compares
    /// the engine with a reference evaluation.
    ///
    /// # Errors
    /// [`CompactError`] with the value found and the value expected.
    pub fn load(file: &ActorFile, (users, mirrors): (usize, usize), engine: &dyn Engine) -> Result<Self, CompactError> {
        let network = RowNetwork::load(file, &CORRECTIONS, engine)?;
        Ok(Self { name: "residual".into(), solver: ModelBased::greedy(users, mirrors), network, failure: None })
    }

    /// The same under the name of another policy.
    pub fn named(self, name: String) -> Self {
        Self { name, ..self }
    }
}

impl Policy for Residual {
    fn name(&self) -> &str {
        &self.name
    }

    fn engine(&self) -> Option<&'static str> {
        Some(self.network.engine())
    }

    fn reads_evidence(&self) -> bool {
        true
    }

    fn correct(&mut self, evidence: &mut Evidence) {
        self.failure = self.network.evaluate(evidence.rows()).map(|outputs| evidence.correct(outputs)).err();
    }

    fn act(
        &mut self,
        model: &ChannelModel,
        observation: &Observation,
        out: &mut MirrorAngles,
    ) -> Result<(), PolicyError> {
        match self.failure.take() {
            Some(failure) => Err(failure),
            None => self.solver.act(model, observation, out),
        }
    }

    fn warm_cache(&mut self, model: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) {
        self.solver.warm_cache(model, observation, out);
    }

    fn memory(&self) -> PolicyMemory {
        self.solver.memory()
    }

    fn restore(&mut self, memory: &PolicyMemory) {
        self.solver.restore(memory);
    }
}
