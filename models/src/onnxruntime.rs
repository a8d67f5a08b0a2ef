//! ONNX Runtime through ort, from the shared library that ORT_DYLIB_PATH names.

use std::sync::{Mutex, PoisonError};

use heliostat_core::policy::actor_file::OUTPUT_NAME;
use heliostat_core::policy::{Engine, Network, PolicyError};
use ort::{
    environment::Environment,
    session::{Session, builder::GraphOptimizationLevel},
    value::Tensor,
};

use crate::batch::Batch;

/// The name of this engine.
pub const ORT: &str = "ort";

/// Builds networks with ONNX Runtime.
#[derive(Clone, Copy, Debug)]
pub struct OnnxRuntime;

impl Engine for OnnxRuntime {
    fn load(&self, model: &[u8], input_length: usize) -> Result<Box<dyn Network>, String> {
        let session = session(model).map_err(|error| error.to_string())?;
        let rows = match session.inputs().first().and_then(|input| input.dtype().tensor_shape()) {
            // An open extent is negative.
            Some(shape) => shape.first().and_then(|rows| usize::try_from(*rows).ok()),
            None => Some(1),
        };
        let batch = Batch::new(input_length, rows);
        let input = tensor([rows.unwrap_or(1), input_length]).map_err(|error| error.to_string())?;
        Ok(Box::new(OrtNetwork { session, input, shape: [rows.unwrap_or(1), input_length], batch }))
    }
}

/// A session with its input.
struct OrtNetwork {
    session: Session,
    input: Tensor<f32>,
    /// The shape of the input.
    shape: [usize; 2],
    batch: Batch,
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
        let Self { session, input, shape: present, batch } = self;
        batch.run(|shape, values, output| {
            if *present != shape {
                (*input, *present) = (tensor(shape).map_err(failed)?, shape);
            }
            input.extract_tensor_mut().1.copy_from_slice(values);
            let outputs = session.run(ort::inputs![&*input]).map_err(failed)?;
            let (_, found) = outputs[OUTPUT_NAME].try_extract_tensor::<f32>().map_err(failed)?;
            output.extend_from_slice(found);
            Ok(())
        })
    }
}

fn tensor(shape: [usize; 2]) -> ort::Result<Tensor<f32>> {
    Tensor::from_array((shape, vec![0.0_f32; shape[0] * shape[1]]))
}

fn failed(error: ort::Error) -> PolicyError {
    PolicyError::Inference { message: error.to_string() }
}

fn session(model: &[u8]) -> ort::Result<Session> {
    let builder = Session::builder(&environment()?)?.with_optimization_level(GraphOptimizationLevel::Level3)?;
    // Handing work to another thread costs more than the work of a small network.
    builder.with_intra_threads(1)?.commit_from_memory(model)
}

/// The environment of the engine. A process can create it only once, so all networks share it.
fn environment() -> ort::Result<Environment> {
    static ENVIRONMENT: Mutex<Option<Environment>> = Mutex::new(None);
    let mut environment = ENVIRONMENT.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(environment) = environment.as_ref() {
        return Ok(environment.clone());
    }
    Ok(environment.insert(ort::init().with_telemetry(false).build()?).clone())
}
