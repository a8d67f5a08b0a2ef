//! The ONNX file of a compact actor: its metadata and ports.
//!
//! The network reads rows of [`FEATURES`] values and gives rows of [`Correction::VALUES`], one for
//! each user. It depends on no array, wall, room or number of users.

use heliostat_onnx::{
    ModelProto, ValueInfoProto, tensor::first_not_finite, tensor_proto::DataType,
    tensor_shape_proto::dimension::Value as Dimension, type_proto,
};
use prost::Message;
use thiserror::Error;

use super::actor_file::{ActorFile, COMPACT, CORRECTIONS_NAME, INPUT_NAME, key};
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
    #[error("{origin}: {found}, expected \"{port}\" of f32 [rows, {expected}]; export the actor again")]
    Port {
        /// The file.
        origin: String,
        /// Name and shape found.
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
    let action = entry(&model, key::ACTION).unwrap_or("angles");
    if action != COMPACT {
        return Err(CompactError::Action { origin: origin(), found: format!("\"{action}\"") });
    }
    let version = entry(&model, key::OBSERVATION_VERSION).unwrap_or("none");
    if version != EVIDENCE_VERSION.to_string() {
        return Err(CompactError::Version { origin: origin(), found: version.into() });
    }
    if let Some(tensor) = first_not_finite(&model) {
        return Err(CompactError::NotFinite { origin: origin(), tensor });
    }
    let graph = model
        .graph
        .as_ref()
        .ok_or_else(|| CompactError::NotOnnx { origin: origin(), message: "it holds no graph".into() })?;
    let is_weight = |port: &&ValueInfoProto| graph.initializer.iter().any(|weight| weight.name == port.name);
    let inputs: Vec<_> = graph.input.iter().filter(|port| !is_weight(port)).collect();
    let outputs: Vec<_> = graph.output.iter().collect();
    for (port, ports, length) in [(INPUT_NAME, inputs, FEATURES), (CORRECTIONS_NAME, outputs, Correction::VALUES)] {
        let is_expected = |found: &&ValueInfoProto| found.name == port && row_length(found) == Some(length as i64);
        if ports.len() != 1 || !ports.iter().all(is_expected) {
            let names: Vec<String> =
                ports.iter().map(|port| format!("\"{}\" with rows of {:?}", port.name, row_length(port))).collect();
            return Err(CompactError::Port { origin: origin(), found: names.join(", "), port, expected: length });
        }
    }
    Ok(model)
}

fn entry<'a>(model: &'a ModelProto, key: &str) -> Option<&'a str> {
    model.metadata_props.iter().find(|entry| entry.key == key).map(|entry| entry.value.as_str())
}

/// The second extent of a table of 32-bit floats; `None` for other types and shapes.
fn row_length(port: &ValueInfoProto) -> Option<i64> {
    let type_proto::Value::TensorType(tensor) = port.r#type.as_ref()?.value.as_ref()? else { return None };
    let [_, extent] = tensor.shape.as_ref()?.dim.as_slice() else { return None };
    match extent.value.as_ref()? {
        Dimension::DimValue(length) if tensor.elem_type == DataType::Float as i32 => Some(*length),
        _ => None,
    }
}
