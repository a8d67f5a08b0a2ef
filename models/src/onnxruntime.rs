//! ONNX Runtime through ort, from a shared library that is loaded when the first network needs it.
//!
//! The input tensor is allocated once for a number of rows. A run executes on the calling thread; the
//! library allocates the output. Bound tensors are no alternative: `run_binding` of ort 2.0.0-rc.15
//! leaks at each run.

use std::sync::{Mutex, PoisonError};

use heliostat_core::policy::{Network, PolicyError, PolicyResult};
use heliostat_files::{excerpt, open_file};
use heliostat_onnx::{
    ModelProto, NodeProto,
    standard::{OPSETS, find_node, is_standard},
};
use ort::{
    environment::Environment,
    session::{Session, builder::GraphOptimizationLevel},
    value::Tensor,
};
use prost::Message;

use crate::{
    batch::Batch,
    library::{self, ORT, PLACES},
};

/// Why a network cannot be built.
pub enum Refusal {
    /// No library was found, or the one that was named does not load; text after "ONNX Runtime,".
    NoLibrary(String),
    /// ONNX Runtime's own message, behind what to do where it does not know an operator.
    Network(String),
}

/// Builds the network of an ONNX model with rows of `input_length` values.
///
/// # Errors
/// [`Refusal`].
pub fn load(model: &[u8], input_length: usize) -> Result<Box<dyn Network>, Refusal> {
    let environment = environment().map_err(Refusal::NoLibrary)?;
    match OrtNetwork::new(&environment, model, input_length) {
        Ok(network) => Ok(Box::new(network)),
        Err(error) => {
            let message = one_line(&error);
            Err(Refusal::Network(unknown_operator(&message, model).unwrap_or(message)))
        }
    }
}

/// The message of ONNX Runtime behind the node whose operator it does not know; `None` for another message.
fn unknown_operator(message: &str, model: &[u8]) -> Option<String> {
    let ModelProto { graph, opset_import, .. } = ModelProto::decode(model).ok()?;
    let is_unknown = |node: &NodeProto| {
        let NodeProto { op_type, domain, .. } = node;
        let foreign = [format!("{domain}:{op_type}("), format!("No opset import for domain '{domain}'")];
        message.contains(&format!("No Op registered for {op_type} with"))
            || !is_standard(domain) && foreign.iter().any(|words| message.contains(words))
    };
    let graph = graph?;
    let NodeProto { name, op_type, domain, output, .. } = find_node(&graph, &is_unknown)?;
    let name = excerpt(if name.is_empty() { output.first().unwrap_or(name) } else { name });
    let domain = excerpt(if domain.is_empty() { "ai.onnx" } else { domain.as_str() });
    let opset = opset_import.iter().find(|set| is_standard(&set.domain)).map_or(0, |set| set.version);
    Some(format!(
        "the node {name:?} has the operator {} of the domain {domain:?}, which ONNX Runtime does not know: expected an \
         operator of the ONNX standard in opset {opset}, that of the file; export it again with such operators, or with \
         a higher opset of {} to {} ({message})",
        excerpt(op_type).escape_debug(),
        OPSETS.start(),
        OPSETS.end()
    ))
}

/// The environment of the process, which loads the library at the first call.
fn environment() -> Result<Environment, String> {
    static ENVIRONMENT: Mutex<Option<Environment>> = Mutex::new(None);
    let mut environment = ENVIRONMENT.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(environment) = environment.as_ref() {
        return Ok(environment.clone());
    }
    let library::Candidates { files, named_by } = library::candidates();
    let mut reasons = Vec::new();
    for file in &files {
        // The system's loader would wait for a pipe.
        if file.exists()
            && let Err(error) = open_file(file)
        {
            reasons.push(error.to_string());
            continue;
        }
        // The path is given first: ort panics where it searches by itself and finds none.
        match ort::init_from(file) {
            Ok(builder) => {
                let built = builder.with_telemetry(false).build().map_err(|error| one_line(&error))?;
                return Ok(environment.insert(built).clone());
            }
            Err(error) => reasons.push(error.to_string()),
        }
    }
    // The last candidate is a name for the system's loader, which says only that it found none.
    let reason = match (named_by, reasons.split_last()) {
        (Some(by), Some((reason, _))) => format!("which {by} names, does not load ({reason})"),
        (None, Some((_, [first, ..]))) => format!("which does not load ({first})"),
        _ => format!("which was not found {PLACES}"),
    };
    Err(reason)
}

/// A session with its input.
struct OrtNetwork {
    session: Session,
    input: Tensor<f32>,
    /// The shape of the input.
    shape: [usize; 2],
    batch: Batch,
}

/// A session with its settings.
fn session(environment: &Environment, model: &[u8]) -> ort::Result<Session> {
    let builder = Session::builder(environment)?.with_optimization_level(GraphOptimizationLevel::Level3)?;
    // Handing work to another thread costs more than the work of a small network.
    builder.with_intra_threads(1)?.commit_from_memory(model)
}

/// `Session::run` alone on an input of zeros: the reference for the cost of [`Network`] around it.
pub struct BareSession {
    session: Session,
    input: Tensor<f32>,
}

impl BareSession {
    /// A session of a model, with this number of rows where the model leaves it open.
    ///
    /// # Errors
    /// No library, or its own message where it refuses the model.
    pub fn new(model: &[u8], rows: usize) -> Result<Self, String> {
        let session = session(&environment()?, model).map_err(|error| one_line(&error))?;
        let shape = session.inputs().first().and_then(|port| port.dtype().tensor_shape());
        let extents = shape.map(|shape| shape.iter().map(|extent| usize::try_from(*extent).unwrap_or(rows)).collect());
        let [rows, columns] = extents.unwrap_or_else(Vec::new)[..] else {
            return Err("the input of the model is no matrix: expected [rows, columns]".into());
        };
        let input = tensor([rows, columns]).map_err(|error| one_line(&error))?;
        Ok(Self { session, input })
    }

    /// One run.
    ///
    /// # Errors
    /// [`PolicyError::Inference`].
    pub fn run(&mut self) -> PolicyResult {
        self.session.run(ort::inputs![&self.input]).map(drop).map_err(failed)
    }
}

impl OrtNetwork {
    fn new(environment: &Environment, model: &[u8], input_length: usize) -> ort::Result<Self> {
        let session = session(environment, model)?;
        let rows = match session.inputs().first().and_then(|port| port.dtype().tensor_shape()) {
            // An open extent is negative.
            Some(shape) => shape.first().and_then(|rows| usize::try_from(*rows).ok()),
            None => Some(1),
        };
        let shape = [rows.unwrap_or(1), input_length];
        Ok(Self { session, input: tensor(shape)?, shape, batch: Batch::new(input_length, rows) })
    }
}

impl Network for OrtNetwork {
    fn engine(&self) -> &'static str {
        ORT
    }

    fn set_rows(&mut self, rows: usize) -> PolicyResult {
        self.batch.set_rows(rows)
    }

    fn input_mut(&mut self) -> &mut [f32] {
        self.batch.input_mut()
    }

    fn run(&mut self) -> PolicyResult<&[f32]> {
        let Self { session, input, shape: present, batch } = self;
        batch.run(|shape, values, output| {
            if *present != shape {
                (*input, *present) = (tensor(shape).map_err(failed)?, shape);
            }
            input.extract_tensor_mut().1.copy_from_slice(values);
            let found = session.run(ort::inputs![&*input]).map_err(failed)?;
            let (_, found) = found[0].try_extract_tensor::<f32>().map_err(failed)?;
            output.extend_from_slice(found);
            Ok(())
        })
    }
}

fn tensor(shape: [usize; 2]) -> ort::Result<Tensor<f32>> {
    Tensor::from_array((shape, vec![0.0_f32; shape[0] * shape[1]]))
}

fn failed(error: ort::Error) -> PolicyError {
    PolicyError::Inference { message: one_line(&error) }
}

/// The message of an error without line breaks.
fn one_line(error: &ort::Error) -> String {
    error.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use heliostat_onnx::{GraphProto, OperatorSetIdProto};

    use super::*;

    #[test]
    fn an_operator_that_onnxruntime_does_not_know_is_named_with_node_domain_opset_and_what_to_do() {
        let node = |name: &str, op_type: &str, domain: &str| NodeProto {
            name: name.into(),
            op_type: op_type.into(),
            domain: domain.into(),
            output: vec!["y".into()],
            ..NodeProto::default()
        };
        let nodes = [node("first", "Tanh", ""), node("act", "Tahn", ""), node("", "Foo", "com.example")];
        let model = ModelProto {
            graph: Some(GraphProto { node: nodes.into(), ..GraphProto::default() }),
            opset_import: vec![OperatorSetIdProto { domain: String::new(), version: 17 }],
            ..ModelProto::default()
        };
        let model = model.encode_to_vec();
        // Messages of ONNX Runtime 1.32.
        for (message, start) in [
            (
                "This is an invalid model. In Node, (\"act\", Tahn, \"\", -1), Error No Op registered for Tahn with \
                 domain_version of 17",
                "the node \"act\" has the operator Tahn of the domain \"ai.onnx\"",
            ),
            (
                "Fatal error: com.example:Foo(-1) is not a registered function/op",
                "the node \"y\" has the operator Foo of the domain \"com.example\"",
            ),
            (
                "This is an invalid model. Error No opset import for domain 'com.example'",
                "the node \"y\" has the operator Foo of the domain \"com.example\"",
            ),
        ] {
            let text = unknown_operator(message, &model).expect("an unknown operator");
            assert!(text.starts_with(start) && text.ends_with(&format!("({message})")), "{text}");
            assert!(text.contains("in opset 17, that of the file; export it again") && text.contains("of 7 to 28"));
        }
        assert_eq!(unknown_operator("Type Error: Type 'tensor(int64)' is invalid", &model), None);
    }
}
