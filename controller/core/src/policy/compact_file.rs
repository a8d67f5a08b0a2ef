//! The ONNX file of a network that is applied to a row of each user: its metadata and ports.
//!
//! Such a file depends on no array, wall, room or number of users. [`CORRECTIONS`] and
//! [`DISPLACEMENTS`] are the two kinds.

use heliostat_onnx::{
    ModelProto, ValueInfoProto, describe, f32_extents,
    standard::{VersionError, check_versions},
    tensor::first_not_finite,
};
use prost::Message;
use thiserror::Error;

use super::actor_file::{ANGLES, ActorFile, COMPACT, CORRECTIONS_NAME, DISPLACEMENTS_NAME, INPUT_NAME, key, quoted};
use crate::observe::{
    correction::Correction,
    evidence::{EVIDENCE_VERSION, FEATURES},
    walk_history::{DISPLACEMENT_VALUES, WALK_VALUES, WALK_VERSION},
};

/// What the rows and outputs of such a network are.
#[derive(Debug, PartialEq, Eq)]
pub struct RowKind {
    /// The action in the metadata.
    pub action: &'static str,
    /// Version of the rows.
    pub version: u32,
    /// Length of a row.
    pub inputs: usize,
    /// Name of the output, and its length for each row.
    pub output: (&'static str, usize),
    /// The policy that such a network is trained for.
    pub policy: &'static str,
}

/// A network that corrects how users are believed to hold their receivers.
pub const CORRECTIONS: RowKind = RowKind {
    action: COMPACT,
    version: EVIDENCE_VERSION,
    inputs: FEATURES,
    output: (CORRECTIONS_NAME, Correction::VALUES),
    policy: "residual",
};

/// A network that predicts where users will be.
pub const DISPLACEMENTS: RowKind = RowKind {
    action: DISPLACEMENTS_NAME,
    version: WALK_VERSION,
    inputs: WALK_VALUES,
    output: (DISPLACEMENTS_NAME, DISPLACEMENT_VALUES),
    policy: "lstm",
};

/// Why the file of such a network cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum CompactError {
    /// The bytes are not an ONNX model.
    #[error("{origin} is not an ONNX model: {message}")]
    NotOnnx {
        /// The file.
        origin: String,
        /// Why.
        message: String,
    },
    /// The version of the format or of the operators is not known.
    #[error("{origin} has {unknown}")]
    OnnxVersion {
        /// The file.
        origin: String,
        /// The version found and those expected.
        unknown: VersionError,
    },
    /// The file has another action.
    #[error(
        "{origin} has the action {found}, expected \"{}\" as the policy {} needs; \
         choose the policy of the file, or train one with `heliostat train {}`", expected.action, expected.policy, expected.policy
    )]
    Action {
        /// The file.
        origin: String,
        /// The action found.
        found: String,
        /// The kind expected.
        expected: &'static RowKind,
    },
    /// The rows have another layout.
    #[error(
        "{origin} was made for observation version {found}, expected {}; \
         train it again with `heliostat train {}`", expected.version, expected.policy
    )]
    Version {
        /// The file.
        origin: String,
        /// The version found.
        found: String,
        /// The kind expected.
        expected: &'static RowKind,
    },
    /// A port has another name, type or shape.
    #[error(
        "{origin} has the {side} {found}, expected exactly one, \"{port}\" (f32 [rows, {expected}]): one file serves any \
         number of users, so its first dimension is dynamic; export the actor again with dynamic rows"
    )]
    Port {
        /// The file.
        origin: String,
        /// "inputs" or "outputs".
        side: &'static str,
        /// Names, types and shapes found.
        found: String,
        /// The name expected.
        port: &'static str,
        /// Length of a row.
        expected: usize,
    },
    /// A tensor holds a value that is not finite.
    #[error("{origin}: the tensor {tensor} holds a value that is not finite, expected finite weights; train it again")]
    NotFinite {
        /// The file.
        origin: String,
        /// The tensor's name.
        tensor: String,
    },
    /// The engine or the reference evaluation does not support the network.
    #[error("{origin}: {message}; export the actor again")]
    Engine {
        /// The file.
        origin: String,
        /// What happened.
        message: String,
    },
    /// The engine does not evaluate the network, gives an output that is not finite, or differs from the
    /// reference evaluation.
    #[error("{origin}: {message}; export the actor again")]
    Evaluation {
        /// The file.
        origin: String,
        /// What happened.
        message: String,
    },
}

impl RowKind {
    /// The kind that a file says it is; `None` for one that is not applied to rows of users.
    pub fn of(file: &ActorFile) -> Option<&'static Self> {
        let model = ModelProto::decode(file.bytes.as_ref()).ok()?;
        let action = entry(&model, key::ACTION)?;
        [&CORRECTIONS, &DISPLACEMENTS].into_iter().find(|kind| kind.action == action)
    }

    /// Checks the metadata, the ports and the weights of a file.
    ///
    /// # Errors
    /// [`CompactError`] with the value found and the value expected.
    pub fn check(&'static self, file: &ActorFile) -> Result<ModelProto, CompactError> {
        let origin = || file.origin.clone();
        let model = ModelProto::decode(file.bytes.as_ref())
            .map_err(|error| CompactError::NotOnnx { origin: origin(), message: error.to_string() })?;
        let graph = model
            .graph
            .as_ref()
            .ok_or_else(|| CompactError::NotOnnx { origin: origin(), message: "it holds no graph".into() })?;
        check_versions(&model).map_err(|unknown| CompactError::OnnxVersion { origin: origin(), unknown })?;
        let action = entry(&model, key::ACTION).unwrap_or(ANGLES);
        if action != self.action {
            return Err(CompactError::Action { origin: origin(), found: quoted(action), expected: self });
        }
        let version = entry(&model, key::OBSERVATION_VERSION);
        if version != Some(&self.version.to_string()) {
            let found = version.map_or("none".into(), quoted);
            return Err(CompactError::Version { origin: origin(), found, expected: self });
        }
        if let Some(tensor) = first_not_finite(&model) {
            return Err(CompactError::NotFinite { origin: origin(), tensor });
        }
        let is_weight = |port: &&ValueInfoProto| graph.initializer.iter().any(|weight| weight.name == port.name);
        let inputs: Vec<_> = graph.input.iter().filter(|port| !is_weight(port)).collect();
        let outputs: Vec<_> = graph.output.iter().collect();
        let (output, values) = self.output;
        let sides = [("inputs", INPUT_NAME, inputs, self.inputs), ("outputs", output, outputs, values)];
        for (side, port, ports, expected) in sides {
            let has_rows = |found: &ValueInfoProto| f32_extents(found).as_deref() == Some(&[None, Some(expected)]);
            if ports.len() != 1 || !ports.iter().all(|found| found.name == port && has_rows(found)) {
                let found: Vec<_> =
                    ports.iter().map(|port| format!("{} ({})", quoted(&port.name), describe(port))).collect();
                let found = if found.is_empty() { "none".into() } else { found.join(", ") };
                return Err(CompactError::Port { origin: origin(), side, found, port, expected });
            }
        }
        Ok(model)
    }
}

fn entry<'a>(model: &'a ModelProto, key: &str) -> Option<&'a str> {
    model.metadata_props.iter().find(|entry| entry.key == key).map(|entry| entry.value.as_str())
}
