//! The engine of a build without an inference library: the plain evaluation that verifies other
//! engines at load.
//!
//! It is far slower than they are, and meant for checks and for the Python package.

use heliostat_core::policy::actor_file::INPUT_NAME;
use heliostat_core::policy::{Engine, Network, PolicyError};
use heliostat_onnx::{ModelProto, reference};
use prost::Message;

/// The name of this engine.
pub const REFERENCE: &str = "reference";

/// Evaluates networks by plain loops.
#[derive(Clone, Copy, Debug)]
pub struct Reference;

struct ReferenceNetwork {
    network: reference::Reference,
    input_length: usize,
    input: Vec<f32>,
    output: Vec<f32>,
}

impl Engine for Reference {
    fn load(&self, model: &[u8], input_length: usize) -> Result<Box<dyn Network>, String> {
        let model = ModelProto::decode(model).map_err(|error| error.to_string())?;
        let network = reference::Reference::new(&model)?;
        Ok(Box::new(ReferenceNetwork { network, input_length, input: vec![0.0; input_length], output: Vec::new() }))
    }
}

impl Network for ReferenceNetwork {
    fn engine(&self) -> &'static str {
        REFERENCE
    }

    fn set_rows(&mut self, rows: usize) -> Result<(), PolicyError> {
        self.input.resize(rows * self.input_length, 0.0);
        Ok(())
    }

    fn input_mut(&mut self) -> &mut [f32] {
        &mut self.input
    }

    fn run(&mut self) -> Result<&[f32], PolicyError> {
        self.output.clear();
        for row in self.input.chunks_exact(self.input_length) {
            let run = self.network.run(INPUT_NAME, row);
            self.output.extend(run.map_err(|message| PolicyError::Inference { message })?);
        }
        Ok(&self.output)
    }
}
