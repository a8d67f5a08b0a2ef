//! The interface to the inference engine of learned policies.

use super::proposal::PolicyResult;

/// Builds networks from ONNX files.
pub trait Engine {
    /// Builds the network of an ONNX model with one input of rows of `input_length` values and one
    /// output. It starts with one row, or with the number of rows that the model fixes.
    ///
    /// # Errors
    /// The engine's own message where it refuses the model.
    fn load(&self, model: &[u8], input_length: usize) -> Result<Box<dyn Network>, String>;
}

/// A network that is ready to run. It keeps its input between runs.
///
/// The caller sets the number of rows, writes the input, and runs:
///
/// 1. [`set_rows`](Self::set_rows), where the number changes;
/// 2. [`input_mut`](Self::input_mut), to be overwritten;
/// 3. [`run`](Self::run).
pub trait Network: Send {
    /// The name of the engine.
    fn engine(&self) -> &'static str;

    /// Sets the number of rows of later runs; the input is then unspecified.
    ///
    /// The network is applied to each row where the model fixes a first extent of one. It is
    /// applied to all rows at once where the model leaves the first extent open. Memory grows where
    /// `rows` exceeds every earlier number.
    ///
    /// # Errors
    /// For no row, or a number that the model excludes.
    fn set_rows(&mut self, rows: usize) -> PolicyResult;

    /// The input, (rows, input length) in row-major order, to be overwritten before each run.
    fn input_mut(&mut self) -> &mut [f32];

    /// Evaluates the network on its input, and returns the output, row after row.
    ///
    /// # Errors
    /// Where the engine fails.
    fn run(&mut self) -> PolicyResult<&[f32]>;
}
