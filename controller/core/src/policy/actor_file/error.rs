//! Why an actor cannot be used.

use heliostat_onnx::standard::VersionError;
use thiserror::Error;

use super::{ANGLES, CODEBOOK, ObservationKind, WEIGHTS, key, metadata::quoted};

/// Why an actor cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{origin}{problem}")]
pub struct ActorError {
    /// The file.
    pub origin: String,
    /// What is wrong with it.
    pub problem: ActorProblem,
}

/// What is wrong with the file of an actor; the text continues its name.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ActorProblem {
    /// The bytes are not an ONNX model.
    #[error(" is not an ONNX model: {message}")]
    NotOnnx {
        /// Why.
        message: String,
    },
    /// The version of the format or of the operators is not known.
    #[error(" has {unknown}")]
    Version {
        /// The version found and those expected.
        unknown: VersionError,
    },
    /// No policy has the action.
    #[error(
        " has the unknown action {found}, expected \"{ANGLES}\", \"{WEIGHTS}\" or \"{CODEBOOK}\": \
         correct its metadata \"{}\"",
        key::ACTION
    )]
    Action {
        /// The action found.
        found: String,
    },
    /// No policy gives the observation.
    #[error(
        " has the unknown observation {found}, expected one of {:?}: correct its metadata \"{}\"",
        ObservationKind::ALL.map(ObservationKind::name),
        key::OBSERVATION
    )]
    Observation {
        /// The observation found.
        found: String,
    },
    /// Observation and action do not go together.
    #[error(" has the action \"{action}\" with the observation \"{observation}\", expected {expected}")]
    Combination {
        /// The action found.
        action: &'static str,
        /// The observation found.
        observation: &'static str,
        /// The actions that go with the observation.
        expected: String,
    },
    /// The file is another format.
    #[error(" {what}")]
    Foreign {
        /// What it is, and what to do.
        what: String,
    },
    /// Inputs or outputs have other names or another number.
    #[error(" has {side} {found:?}, expected exactly one, \"{expected}\"; {}", one_port(side, found, expected))]
    Ports {
        /// "inputs" or "outputs".
        side: &'static str,
        /// The names found.
        found: Vec<String>,
        /// The name expected.
        expected: &'static str,
    },
    /// The input or output has another shape or element type.
    #[error(": \"{port}\" is {found}, expected {expected}; {advice}")]
    Shape {
        /// The input or output.
        port: String,
        /// Type and shape found.
        found: String,
        /// Type and shape expected, and what they follow from.
        expected: String,
        /// What to do.
        advice: &'static str,
    },
    /// The file has no metadata of an actor at all.
    #[error(
        " is an ONNX file without the metadata of an actor (\"{}\" and others): add the entries that \
         `heliostat config --as-json actor` prints for the scenario, or export an actor with `heliostat-lab train`",
        key::OBSERVATION_VERSION
    )]
    NoMetadata,
    /// A tensor holds NaN or infinity.
    #[error(
        ": the tensor {tensor} holds NaN or infinity, expected finite weights, or minus infinity as a mask; \
         export the actor again, or train it again if the training diverged"
    )]
    NotFinite {
        /// The tensor's name.
        tensor: String,
    },
    /// Two evaluations of one input differ.
    #[error(
        ": two runs on one observation differ{}, expected equal ones: this file samples; export the mean, \
         that is the deterministic action, after `eval()`",
        node.as_ref().map_or(String::new(), |node| format!(" ({node})"))
    )]
    Samples {
        /// The operator that draws.
        node: Option<String>,
    },
    /// The network gives other outputs than the trainer's own.
    #[error(
        ": output {place} for the fixed input {input} is {found} on the engine {engine}, expected {expected} \
         as its metadata \"{}\" says; export the actor again",
        key::CHECK
    )]
    Check {
        /// The engine.
        engine: &'static str,
        /// Number of the fixed input.
        input: usize,
        /// Index of the output.
        place: usize,
        /// The value found.
        found: String,
        /// The value expected.
        expected: String,
    },
    /// The network cannot be evaluated at all.
    #[error(" gave no angles on {failures} of {failures} sampled observations: {example}; export the actor again")]
    NoAngles {
        /// Observations without angles.
        failures: usize,
        /// The last reason.
        example: String,
    },
    /// A metadata entry is missing or unreadable.
    #[error(
        " has no usable metadata \"{key}\" (found {found}), expected the entries that \
         `heliostat config --as-json actor` prints for the scenario",
        found = found.as_ref().map_or("none".to_owned(), |value| quoted(value))
    )]
    Metadata {
        /// The entry.
        key: &'static str,
        /// The value found.
        found: Option<String>,
    },
    /// The actor was made for something else.
    #[error(" was made for {what} {found}, expected {expected} as in this room; {advice}")]
    Unfit {
        /// What differs.
        what: &'static str,
        /// The actor's value.
        found: String,
        /// The room's value.
        expected: String,
        /// What to do.
        advice: &'static str,
    },
    /// The inference engine refused the network.
    #[error(": {message}")]
    Engine {
        /// The engine's message.
        message: String,
    },
}

/// What to do about inputs or outputs that are not the one expected.
fn one_port(side: &str, found: &[String], expected: &str) -> String {
    match (found.len(), side) {
        (1, "inputs") => format!("export it with this name, in PyTorch with input_names=[\"{expected}\"]"),
        (1, _) => format!("export it with this name, in PyTorch with output_names=[\"{expected}\"]"),
        (_, "inputs") => "export a network of the observation alone, without a recurrent state".to_owned(),
        _ => "export a network that returns the action alone".to_owned(),
    }
}
