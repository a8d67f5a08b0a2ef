//! A network that is applied to a row of each user, so that one file serves any number of users,
//! any array and any room.

use heliostat_onnx::reference::Reference;
use heliostat_proto::MAX_USERS;

use super::{
    actor_file::{ActorFile, INPUT_NAME},
    compact_file::{CompactError, RowKind},
    engine::{Engine, Network},
    proposal::PolicyError,
};

/// Rows on which engine and reference are compared at the load.
const COMPARED: usize = 64;

/// Outputs that differ by less count as equal: both evaluations round to f32.
const SAME: f32 = 1e-3;

/// The network of a file, with rows of `N` values.
pub struct RowNetwork<const N: usize> {
    network: Box<dyn Network>,
    /// Outputs for each row.
    values: usize,
    /// Outputs of all users. Shape: K * `values`.
    outputs: Vec<f32>,
}

impl<const N: usize> RowNetwork<N> {
    /// Loads the network of a file of this kind, and compares the engine with a reference
    /// evaluation.
    ///
    /// # Errors
    /// [`CompactError`] with the value found and the value expected.
    pub fn load(file: &ActorFile, kind: &'static RowKind, engine: &dyn Engine) -> Result<Self, CompactError> {
        let origin = || file.origin.clone();
        let refused = |message: String| CompactError::Engine { origin: origin(), message };
        let model = kind.check(file)?;
        let network = engine
            .load(&file.bytes, N)
            .map_err(|message| refused(format!("the inference engine refused the network: {message}")))?;
        let values = kind.output.1;
        let mut loaded = Self { network, values, outputs: Vec::with_capacity(MAX_USERS * values) };
        let rows = sampled_rows();
        let reference = Reference::new(&model).map_err(|reason| refused(unsupported(&reason)))?;
        let expected: Vec<Vec<f32>> = rows
            .iter()
            .map(|row| reference.run(INPUT_NAME, row))
            .collect::<Result<_, _>>()
            .map_err(|reason| refused(unsupported(&reason)))?;
        loaded.compare(&rows, &expected).map_err(|message| CompactError::Evaluation { origin: origin(), message })?;
        Ok(loaded)
    }

    /// The name of the inference engine.
    pub fn engine(&self) -> &'static str {
        self.network.engine()
    }

    /// Compares the engine with the expected outputs of some rows.
    fn compare(&mut self, rows: &[[f32; N]], expected: &[Vec<f32>]) -> Result<(), String> {
        let engine = self.engine();
        let failed = |error: PolicyError| format!("the engine {engine} does not evaluate {COMPARED} rows: {error}");
        self.evaluate(rows).map_err(failed)?;
        for (found, expected) in self.outputs.chunks_exact(self.values).zip(expected) {
            let differs = |(found, expected): (&f32, &f32)| {
                let allowed = SAME * expected.abs().max(1.0);
                found.is_finite() != expected.is_finite() || (found - expected).abs() > allowed
            };
            if expected.len() != self.values || found.iter().zip(expected).any(differs) {
                return Err(format!(
                    "the engine {engine} gives {found:?} and the reference evaluation {expected:?} for the same row, \
                     expected equal values"
                ));
            }
        }
        Ok(())
    }

    /// Applies the network to all rows. Shape of the result: K * outputs of a row, row-major.
    ///
    /// # Errors
    /// [`PolicyError::Inference`] where the engine fails or an output is not finite.
    pub fn evaluate(&mut self, rows: &[[f32; N]]) -> Result<&[f32], PolicyError> {
        self.outputs.clear();
        if rows.is_empty() {
            return Ok(&self.outputs);
        }
        self.network.set_rows(rows.len())?;
        self.network.input_mut().copy_from_slice(rows.as_flattened());
        let found = self.network.run()?;
        let expected = rows.len() * self.values;
        if found.len() != expected {
            let message = format!("the output has {} values, expected {expected}: export the actor again", found.len());
            return Err(PolicyError::Inference { message });
        }
        if !found.iter().all(|value| value.is_finite()) {
            let message = "a correction is not finite: train the actor again".to_owned();
            return Err(PolicyError::Inference { message });
        }
        self.outputs.extend_from_slice(found);
        Ok(&self.outputs)
    }
}

/// Rows with points that fill [-1, 1) evenly, other ones for each row and feature.
fn sampled_rows<const N: usize>() -> Vec<[f32; N]> {
    let value = |index: usize| (index as f32 * 0.618_034).fract() * 2.0 - 1.0;
    (0..COMPARED).map(|row| std::array::from_fn(|column| value(row * N + column))).collect()
}

/// The refusal of a network that the reference cannot evaluate, for this reason.
fn unsupported(reason: &str) -> String {
    format!("the reference evaluation, which verifies the engine, does not support {reason}")
}
