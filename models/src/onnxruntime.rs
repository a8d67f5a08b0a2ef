//! ONNX Runtime through ort, from a shared library that is loaded when the first network needs it.
//!
//! The input tensor is allocated once for a number of rows. A run executes on the calling thread; the
//! library allocates the output. Bound tensors are no alternative: `run_binding` of ort 2.0.0-rc.15
//! leaks at each run.

use std::sync::{Mutex, PoisonError};

use heliostat_core::policy::{Network, PolicyError, PolicyResult};
use heliostat_files::open_file;
use ort::{
    environment::Environment,
    session::{Session, builder::GraphOptimizationLevel},
    value::Tensor,
};

use crate::{
    batch::Batch,
    library::{self, ORT},
};

/// Why a network cannot be built.
pub enum Refusal {
    /// No library was found, or the one that was named does not load; text after "ONNX Runtime,".
    NoLibrary(String),
    /// ONNX Runtime's own message.
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
        Err(error) => Err(Refusal::Network(one_line(&error))),
    }
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
        _ => "which was not found".into(),
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
