//! The learned policy with the compact action: a network corrects the belief about each user, and
//! the solver of the model-based policies turns the corrected observation into angles.
//!
//! One network is applied to the row of every user ([`Evidence`]), so one file serves any number of
//! users, any array and any room. [`correction`](crate::observe::correction) decodes its output. A
//! network that gives zeros leaves the model-based policy unchanged.

use heliostat_channel::{ChannelModel, mirrors::MirrorAngles};
use heliostat_onnx::reference::Reference;

use super::{
    actor_file::{ActorFile, INPUT_NAME},
    compact_file::{CompactError, check},
    engine::{Engine, Network},
    model_based::ModelBased,
    proposal::{Policy, PolicyError, PolicyMemory},
};
use crate::observe::{
    correction::Correction,
    evidence::{Evidence, FEATURES},
    observation::Observation,
};

/// Rows on which engine and reference are compared at the load.
const COMPARED: usize = 64;

/// Outputs that differ by less count as equal: both evaluations round to f32.
const SAME: f32 = 1e-3;

/// A network that corrects the belief, and the solver that acts on the corrected observation.
pub struct Residual {
    name: String,
    solver: ModelBased,
    network: Box<dyn Network>,
    /// Outputs of all users. Shape: K * [`Correction::VALUES`].
    outputs: Vec<f32>,
    failure: Option<PolicyError>,
}

impl Residual {
    /// Loads the network of a file for a room with this number of users and mirrors, and compares
    /// the engine with a reference evaluation.
    ///
    /// # Errors
    /// [`CompactError`] with the value found and the value expected.
    pub fn load(file: &ActorFile, (users, mirrors): (usize, usize), engine: &dyn Engine) -> Result<Self, CompactError> {
        let refused = |message: String| CompactError::Engine { origin: file.origin.clone(), message };
        let model = check(file)?;
        let network = engine
            .load(&file.bytes, FEATURES)
            .map_err(|message| refused(format!("the inference engine refused the network: {message}")))?;
        let capacity = heliostat_proto::MAX_USERS * Correction::VALUES;
        let solver = ModelBased::greedy(users, mirrors);
        let mut policy =
            Self { name: "residual".into(), solver, network, outputs: Vec::with_capacity(capacity), failure: None };
        let reference = Reference::new(&model).map_err(|reason| refused(unsupported(&reason)))?;
        policy.compare(&reference).map_err(refused)?;
        Ok(policy)
    }

    /// The same under the name of another policy.
    pub fn named(self, name: String) -> Self {
        Self { name, ..self }
    }

    /// Compares the engine with a reference evaluation on sampled rows.
    fn compare(&mut self, reference: &Reference) -> Result<(), String> {
        let rows: Vec<[f32; FEATURES]> = (0..COMPARED)
            .map(|sample| {
                std::array::from_fn(|index| {
                    // Points that fill [-1, 1) evenly, other ones for each sample and feature.
                    ((sample * FEATURES + index) as f32 * 0.618_034).fract() * 2.0 - 1.0
                })
            })
            .collect();
        let engine = self.network.engine();
        let failed = |error: PolicyError| format!("the engine {engine} does not evaluate {COMPARED} rows: {error}");
        self.evaluate(&rows).map_err(failed)?;
        for (row, found) in rows.iter().zip(self.outputs.chunks_exact(Correction::VALUES)) {
            let expected = reference.run(INPUT_NAME, row).map_err(|reason| unsupported(&reason))?;
            let differs = |(found, expected): (&f32, &f32)| (found - expected).abs() > SAME * expected.abs().max(1.0);
            if expected.len() != Correction::VALUES || found.iter().zip(&expected).any(differs) {
                return Err(format!(
                    "the engine {engine} gives {found:?} and the reference evaluation {expected:?} for the same row, \
                     expected equal values"
                ));
            }
        }
        Ok(())
    }

    /// Applies the network to all rows, and keeps its output.
    fn evaluate(&mut self, rows: &[[f32; FEATURES]]) -> Result<(), PolicyError> {
        self.outputs.clear();
        if rows.is_empty() {
            return Ok(());
        }
        self.network.set_rows(rows.len())?;
        self.network.input_mut().copy_from_slice(rows.as_flattened());
        let found = self.network.run()?;
        let expected = rows.len() * Correction::VALUES;
        if found.len() != expected {
            let message = format!("the output has {} values, expected {expected}: export the actor again", found.len());
            return Err(PolicyError::Inference { message });
        }
        if !found.iter().all(|value| value.is_finite()) {
            let message = "a correction is not finite: train the actor again".to_owned();
            return Err(PolicyError::Inference { message });
        }
        self.outputs.extend_from_slice(found);
        Ok(())
    }
}

/// The refusal of a network that the reference cannot evaluate, for this reason.
fn unsupported(reason: &str) -> String {
    format!("the reference evaluation, which verifies the engine, does not support {reason}")
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
        self.failure = self.evaluate(evidence.rows()).err();
        if self.failure.is_none() {
            evidence.correct(&self.outputs);
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
