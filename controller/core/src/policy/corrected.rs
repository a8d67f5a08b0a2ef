//! The learned policies that change what the solver of the model-based policies acts on.
//!
//! `residual` corrects how users are believed to hold their receivers: its network reads the
//! evidence of each user ([`Evidence`]), and [`correction`](crate::observe::correction) decodes its
//! output. `lstm` corrects the Gauss-Markov prediction of each user's place: its network reads the
//! last reports ([`WalkHistory`]).
//!
//! One network is applied to the row of every user, so one file serves any number of users, any
//! array and any room. A network that gives zeros leaves the belief or the prediction unchanged.

use heliostat_channel::{ChannelModel, mirrors::MirrorAngles};

use super::{
    actor_file::ActorFile,
    compact_file::{CORRECTIONS, CompactError, RowKind},
    engine::Engine,
    model_based::ModelBased,
    proposal::{Policy, PolicyError, PolicyMemory},
    row_network::RowNetwork,
};
use crate::observe::{
    evidence::{Evidence, FEATURES},
    observation::Observation,
    walk_history::{WALK_VALUES, WalkHistory},
};

/// A network that corrects the belief or predicts places, and the solver that acts on them.
pub struct Corrected {
    name: String,
    solver: ModelBased,
    network: Rows,
    failure: Option<PolicyError>,
}

/// A network, by the rows that it reads.
enum Rows {
    Evidence(RowNetwork<FEATURES>),
    Walks(RowNetwork<WALK_VALUES>),
}

impl Corrected {
    /// Loads the network of a file with rows of this kind, for a room with this number of users and
    /// mirrors, and compares the engine with a reference evaluation.
    ///
    /// # Errors
    /// [`CompactError`] with the value found and the value expected.
    pub fn load(
        kind: &'static RowKind,
        file: &ActorFile,
        (users, mirrors): (usize, usize),
        engine: &dyn Engine,
    ) -> Result<Self, CompactError> {
        let (name, network) = if *kind == CORRECTIONS {
            ("residual", Rows::Evidence(RowNetwork::load(file, kind, engine)?))
        } else {
            ("lstm", Rows::Walks(RowNetwork::load(file, kind, engine)?))
        };
        Ok(Self { name: name.into(), solver: ModelBased::greedy(users, mirrors), network, failure: None })
    }

    /// The same under the name of another policy.
    pub fn named(self, name: String) -> Self {
        Self { name, ..self }
    }
}

impl Policy for Corrected {
    fn name(&self) -> &str {
        &self.name
    }

    fn engine(&self) -> Option<&'static str> {
        Some(match &self.network {
            Rows::Evidence(network) => network.engine(),
            Rows::Walks(network) => network.engine(),
        })
    }

    fn reads_evidence(&self) -> bool {
        matches!(self.network, Rows::Evidence(_))
    }

    fn reads_walks(&self) -> bool {
        matches!(self.network, Rows::Walks(_))
    }

    fn correct(&mut self, evidence: &mut Evidence) {
        if let Rows::Evidence(network) = &mut self.network {
            self.failure = network.evaluate(evidence.rows()).map(|outputs| evidence.correct(outputs)).err();
        }
    }

    fn predict(&mut self, walks: &mut WalkHistory) {
        if let Rows::Walks(network) = &mut self.network {
            self.failure = network.evaluate(walks.rows()).map(|outputs| walks.predict(outputs)).err();
        }
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
