//! ONNX Runtime through ort, from a shared library that is loaded when the first network needs it.
//!
//! Input and output tensors are allocated once for a number of rows, and bound to the session. A run
//! executes on the calling thread.

use std::sync::{Mutex, PoisonError};

use heliostat_core::policy::{Network, PolicyError};
use ort::{
    environment::Environment,
    memory::{AllocationDevice, Allocator, AllocatorType, MemoryInfo, MemoryType},
    session::{IoBinding, Session, builder::GraphOptimizationLevel},
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

/// A session with its tensors.
struct OrtNetwork {
    session: Session,
    bound: Bound,
    /// The extents of the output, `None` for an open one.
    output: [Option<usize>; 2],
    batch: Batch,
}

/// The tensors of one number of rows.
struct Bound {
    shape: [usize; 2],
    input: Tensor<f32>,
    binding: IoBinding,
}

impl OrtNetwork {
    fn new(environment: &Environment, model: &[u8], input_length: usize) -> ort::Result<Self> {
        let builder = Session::builder(environment)?.with_optimization_level(GraphOptimizationLevel::Level3)?;
        // Handing work to another thread costs more than the work of a small network.
        let session = builder.with_intra_threads(1)?.commit_from_memory(model)?;
        // An open extent is negative.
        let extent = |value: Option<&i64>| value.and_then(|extent| usize::try_from(*extent).ok());
        let rows = match session.inputs().first().and_then(|port| port.dtype().tensor_shape()) {
            Some(shape) => extent(shape.first()),
            None => Some(1),
        };
        let output = match session.outputs().first().and_then(|port| port.dtype().tensor_shape()) {
            Some(shape) if shape.len() == 2 => [extent(shape.first()), extent(shape.last())],
            _ => [None; 2],
        };
        let bound = Bound::new(&session, [rows.unwrap_or(1), input_length], output)?;
        Ok(Self { session, bound, output, batch: Batch::new(input_length, rows) })
    }
}

impl Bound {
    fn new(session: &Session, shape: [usize; 2], output: [Option<usize>; 2]) -> ort::Result<Self> {
        let tensor = |shape: [usize; 2]| Tensor::<f32>::new(&Allocator::default(), shape.map(|extent| extent as i64));
        let (input, mut binding) = (tensor(shape)?, session.create_binding()?);
        binding.bind_input(session.inputs()[0].name(), &input)?;
        let name = session.outputs()[0].name();
        match output {
            [rows, Some(columns)] => binding.bind_output(name, tensor([rows.unwrap_or(shape[0]), columns])?)?,
            // ONNX Runtime allocates an output whose size is not known before the run.
            _ => {
                let memory = MemoryInfo::new(AllocationDevice::CPU, 0, AllocatorType::Device, MemoryType::CPUOutput)?;
                binding.bind_output_to_device(name, &memory)?;
            }
        }
        Ok(Self { shape, input, binding })
    }
}

impl Network for OrtNetwork {
    fn engine(&self) -> &'static str {
        ORT
    }

    fn set_rows(&mut self, rows: usize) -> Result<(), PolicyError> {
        self.batch.set_rows(rows)
    }

    fn input_mut(&mut self) -> &mut [f32] {
        self.batch.input_mut()
    }

    fn run(&mut self) -> Result<&[f32], PolicyError> {
        let Self { session, bound, output: extents, batch } = self;
        batch.run(|shape, values, output| {
            if bound.shape != shape {
                *bound = Bound::new(session, shape, *extents).map_err(failed)?;
            }
            bound.input.extract_tensor_mut().1.copy_from_slice(values);
            let found = session.run_binding(&bound.binding).map_err(failed)?;
            let (_, found) = found[0].try_extract_tensor::<f32>().map_err(failed)?;
            output.extend_from_slice(found);
            Ok(())
        })
    }
}

fn failed(error: ort::Error) -> PolicyError {
    PolicyError::Inference { message: one_line(&error) }
}

/// The message of an error without line breaks.
fn one_line(error: &ort::Error) -> String {
    error.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}
