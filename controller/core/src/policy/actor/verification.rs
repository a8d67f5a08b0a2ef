//! The check of a network when it is loaded, without a room: does the engine compute what the
//! trainer's own network computed, and does it compute the same twice?

use heliostat_onnx::{GraphProto, ModelProto};
use prost::Message;

use super::Actor;
use crate::policy::actor_file::{ActorError, ActorFile, ActorProblem, key};

/// Fixed inputs of a check.
const INPUTS: usize = 4;
/// Outputs that differ by less count as equal, absolutely or relative to outputs above 1: both
/// evaluations round to f32, in another order.
const SAME: f32 = 1e-4;
/// Runs on one input; a dropped value may be the same by chance.
const RUNS: usize = 4;
/// Operators that draw random numbers.
const DRAWING: [&str; 7] =
    ["RandomNormal", "RandomNormalLike", "RandomUniform", "RandomUniformLike", "Multinomial", "Bernoulli", "Dropout"];

/// Element `index` of the fixed input of a number from 0: sin((number + 1) (index + 1)).
pub fn fixed_input(number: usize, index: usize) -> f32 {
    (((number + 1) * (index + 1)) as f64).sin() as f32
}

impl Actor {
    /// Compares the outputs for fixed inputs with those in the metadata, and two runs with each
    /// other. Whether the metadata has outputs.
    ///
    /// # Errors
    /// [`ActorProblem::Check`] with the first output that differs, [`ActorProblem::Samples`] where two
    /// runs differ.
    pub(super) fn verify(&mut self, file: &ActorFile) -> Result<bool, ActorError> {
        let expected = self.info.entry(key::CHECK).map(str::to_owned);
        if let Some(text) = &expected {
            for (number, line) in text.split(';').take(INPUTS).enumerate() {
                self.check_line(number, line).map_err(|problem| file.refused(problem))?;
            }
        }
        let graph = ModelProto::decode(file.bytes.as_ref()).ok().and_then(|model| model.graph).unwrap_or_default();
        // An engine may leave out a Dropout in training mode, and another one not.
        let dropout = training_dropout(&graph);
        if dropout.is_none() && self.repeats() {
            return Ok(expected.is_some());
        }
        let node = dropout.or_else(|| drawing_node(&graph));
        Err(file.refused(ActorProblem::Samples { node }))
    }

    /// Compares the outputs for one fixed input with the values of a line.
    fn check_line(&mut self, input: usize, line: &str) -> Result<(), ActorProblem> {
        let engine = self.network.engine();
        let expected: Vec<&str> = line.split_whitespace().collect();
        let differs = |place: usize, found: String, expected: &str| {
            Err(ActorProblem::Check { engine, input, place, found, expected: expected.to_owned() })
        };
        let found = match self.fixed_outputs(input) {
            Ok(found) => found,
            Err(message) => return differs(0, message, expected.first().unwrap_or(&"none")),
        };
        if found.len() != expected.len() {
            return differs(0, format!("one of {}", found.len()), &format!("one of {}", expected.len()));
        }
        for (place, (found, text)) in found.iter().zip(&expected).enumerate() {
            let is_same = text.parse::<f32>().is_ok_and(|value| {
                found.to_bits() == value.to_bits() || (found - value).abs() <= SAME * value.abs().max(1.0)
            });
            if !is_same {
                return differs(place, found.to_string(), text);
            }
        }
        Ok(())
    }

    /// Whether further runs on one input give the same bits. A network that fails is left to the
    /// trial.
    fn repeats(&mut self) -> bool {
        let Ok(first) = self.fixed_outputs(0) else { return true };
        let first: Vec<u32> = first.iter().map(|value| value.to_bits()).collect();
        (1..RUNS).all(|_| {
            let again = self.fixed_outputs(0).unwrap_or_default();
            again.iter().map(|value| value.to_bits()).eq(first.iter().copied())
        })
    }

    /// The outputs for a fixed input, in as few rows as the file admits.
    fn fixed_outputs(&mut self, number: usize) -> Result<Vec<f32>, String> {
        self.network.set_rows(self.info.rows.unwrap_or(1)).map_err(|error| error.to_string())?;
        for (index, value) in self.network.input_mut().iter_mut().enumerate() {
            *value = fixed_input(number, index);
        }
        self.network.run().map(<[f32]>::to_vec).map_err(|error| error.to_string())
    }
}

/// A Dropout whose third input, a constant of the file, is true.
fn training_dropout(graph: &GraphProto) -> Option<String> {
    let is_true = |name: &String| {
        let tensor = graph.initializer.iter().find(|tensor| tensor.name == *name)?;
        Some(tensor.raw_data.iter().any(|byte| *byte != 0) || tensor.int32_data.iter().any(|value| *value != 0))
    };
    let in_training = |inputs: &[String]| inputs.get(2).and_then(is_true).unwrap_or(false);
    let dropout = graph.node.iter().find(|node| node.op_type == "Dropout" && in_training(&node.input))?;
    Some(format!("Dropout in training mode, {}", dropout.name))
}

/// The first operator that draws, with the name of its node.
fn drawing_node(graph: &GraphProto) -> Option<String> {
    let node = graph.node.iter().find(|node| DRAWING.contains(&node.op_type.as_str()))?;
    Some(if node.name.is_empty() { node.op_type.clone() } else { format!("{}, {}", node.op_type, node.name) })
}
