//! The learned policy that predicts where users will be: a network corrects the Gauss-Markov
//! prediction of each user by the last reports, and the solver of the model-based policies acts on
//! the predicted places.
//!
//! One network is applied to the row of every user ([`WalkHistory`]), so one file serves any number
//! of users, any array and any room. A network that gives zeros leaves the Gauss-Markov prediction
//! unchanged.

use heliostat_channel::{ChannelModel, mirrors::MirrorAngles};

use super::{
    actor_file::ActorFile,
    compact_file::{CompactError, DISPLACEMENTS},
    engine::Engine,
    model_based::ModelBased,
    proposal::{Policy, PolicyError, PolicyMemory},
    row_network::RowNetwork,
};
use crate::observe::{
    observation::Observation,
    walk_history::{WALK_VALUES, WalkHistory},
};

/// A network that predicts places, and the solver that acts on them.
pub struct Lstm {
    name: String,
    solver: ModelBased,
    network: RowNetwork<WALK_VALUES>,
    failure: Option<PolicyError>,
}

impl Lstm {
    /// Loads the network of a file for a room with this number of users and mirrors, and compares
    /// the engine with a reference evaluation.
    ///
    /// # Errors
    /// [`CompactError`] with the value found and the value expected.
    pub fn load(file: &ActorFile, (users, mirrors): (usize, usize), engine: &dyn Engine) -> Result<Self, CompactError> {
        let network = RowNetwork::load(file, &DISPLACEMENTS, engine)?;
        Ok(Self { name: "lstm".into(), solver: ModelBased::greedy(users, mirrors), network, failure: None })
    }

    /// The same under the name of another policy.
    pub fn named(self, name: String) -> Self {
        Self { name, ..self }
    }
}

impl Policy for Lstm {
    fn name(&self) -> &str {
        &self.name
    }

    fn engine(&self) -> Option<&'static str> {
        Some(self.network.engine())
    }

    fn reads_walks(&self) -> bool {
        true
    }

    fn predict(&mut self, walks: &mut WalkHistory) {
        self.failure = self.network.evaluate(walks.rows()).map(|outputs| walks.predict(outputs)).err();
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
