//! The interface to the inference engine of learned policies.

use super::proposal::PolicyError;

/// Builds networks from ONNX files.
pub trait Engine {
    /// Builds the network of an ONNX model with one input of `input_length` values and one output.
    ///
    /// # Errors
    /// The engine's own message where it refuses the model.
    fn load(&self, model: &[u8], input_length: usize) -> Result<Box<dyn Network>, String>;
}

/// A network that is ready to run. It keeps its input between runs.
pub trait Network: Send {
    /// The input, to be overwritten before each run.
    fn input_mut(&mut self) -> &mut [f32];

    /// Evaluates the network on its input, and returns the output.
    ///
    /// # Errors
    /// [`PolicyError::Inference`] where the engine fails.
    fn run(&mut self) -> Result<&[f32], PolicyError>;
}
