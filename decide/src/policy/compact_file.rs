//! The ONNX file of a compact actor: its metadata and ports.
//!
//! The network reads rows of [`FEATURES`] values and gives rows of [`Correction::VALUES`], one for
//! each user. It depends on no array, wall, room or number of users.

use heliostat_onnx::{
    ModelProto, ValueInfoProto, describe, f32_extents,
    standard::{VersionError, check_versions},
    tensor::first_not_finite,
};
use prost::Message;
use thiserror::Error;

use super::actor_file::{ANGLES, ActorFile, COMPACT, CORRECTIONS_NAME, INPUT_NAME, key, quoted};
use crate::observe::{
    correction::Correction,
    evidence::{EVIDENCE_VERSION, FEATURES},
};

/// Why a compact actor cannot be used.
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
        "{origin} has the action {found}, expected \"{COMPACT}\" as the policy residual needs; \
         choose the policy of the file, or train one with `heliostat train residual`"
    )]
    Action {
        /// The file.
        origin: String,
        /// The action found.
        found: String,
    },
    /// The rows have another layout.
    #[error(
        "{origin} was made for observation version {found}, expected {EVIDENCE_VERSION}; \
         train it again with `heliostat train residual`"
    )]
    Version {
        /// The file.
        origin: String,
        /// The version found.
        found: String,
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
    /// The engine refused the network, or evaluates it otherwise than the reference.
    #[error("{origin}: {message}; export the actor again with dense layers only")]
    Engine {
        /// The file.
        origin: String,
        /// What happened.
        message: String,
    },
}

/// Whether a file says that it has the compact action. False for a file that is no ONNX model.
pub fn is_compact(file: &ActorFile) -> bool {
    let model = ModelProto::decode(file.bytes.as_ref());
    model.is_ok_and(|model| entry(&model, key::ACTION).is_some_and(|action| action == COMPACT))
}

/// Checks the metadata, the ports and the weights of a file.
///
/// # Errors
/// [`CompactError`] with the value found and the value expected.
pub fn check(file: &ActorFile) -> Result<ModelProto, CompactError> {
    let origin = || file.origin.clone();
    let model = ModelProto::decode(file.bytes.as_ref())
        .map_err(|error| CompactError::NotOnnx { origin: origin(), message: error.to_string() })?;
    let graph = model
        .graph
        .as_ref()
        .ok_or_else(|| CompactError::NotOnnx { origin: origin(), message: "it holds no graph".into() })?;
    check_versions(&model).map_err(|unknown| CompactError::OnnxVersion { origin: origin(), unknown })?;
    let action = entry(&model, key::ACTION).unwrap_or(ANGLES);
    if action != COMPACT {
        return Err(CompactError::Action { origin: origin(), found: quoted(action) });
    }
    let version = entry(&model, key::OBSERVATION_VERSION);
    if version != Some(&EVIDENCE_VERSION.to_string()) {
        let found = version.map_or("none".into(), quoted);
        return Err(CompactError::Version { origin: origin(), found });
    }
    if let Some(tensor) = first_not_finite(&model) {
        return Err(CompactError::NotFinite { origin: origin(), tensor });
    }
    let is_weight = |port: &&ValueInfoProto| graph.initializer.iter().any(|weight| weight.name == port.name);
    let inputs: Vec<_> = graph.input.iter().filter(|port| !is_weight(port)).collect();
    let outputs: Vec<_> = graph.output.iter().collect();
    let sides = [("inputs", INPUT_NAME, inputs, FEATURES), ("outputs", CORRECTIONS_NAME, outputs, Correction::VALUES)];
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

fn entry<'a>(model: &'a ModelProto, key: &str) -> Option<&'a str> {
    model.metadata_props.iter().find(|entry| entry.key == key).map(|entry| entry.value.as_str())
}
