//! ONNX Runtime through ort, from the shared library that ORT_DYLIB_PATH names.

use std::sync::{Mutex, PoisonError};

use heliostat_decide::policy::actor_file::OUTPUT_NAME;
use heliostat_decide::policy::{Engine, Network, PolicyError};
use ort::{
    environment::Environment,
    session::{Session, builder::GraphOptimizationLevel},
    value::Tensor,
};

/// Builds networks with ONNX Runtime.
#[derive(Clone, Copy, Debug)]
pub struct OnnxRuntime;

impl Engine for OnnxRuntime {
    fn load(&self, model: &[u8], input_length: usize) -> Result<Box<dyn Network>, String> {
        let session = session(model).map_err(|error| error.to_string())?;
        let input = Tensor::from_array(([1, input_length], vec![0.0_f32; input_length]));
        let input = input.map_err(|error| error.to_string())?;
        Ok(Box::new(OrtNetwork { session, input, output: Vec::new() }))
    }
}

/// A session with its input, and a copy of its last output.
struct OrtNetwork {
    session: Session,
    input: Tensor<f32>,
    output: Vec<f32>,
}

impl Network for OrtNetwork {
    fn input_mut(&mut self) -> &mut [f32] {
        self.input.extract_tensor_mut().1
    }

    fn run(&mut self) -> Result<&[f32], PolicyError> {
        let outputs = self.session.run(ort::inputs![&self.input]).map_err(failed)?;
        let (_, values) = outputs[OUTPUT_NAME].try_extract_tensor::<f32>().map_err(failed)?;
        self.output.clear();
        self.output.extend_from_slice(values);
        Ok(&self.output)
    }
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
