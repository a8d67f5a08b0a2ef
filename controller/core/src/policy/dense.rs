//! The dense engine: graphs of linear layers and elementwise operators, evaluated without an
//! inference library.
//!
//! An inference library executes one node after the other and allocates at each run. That costs
//! more than the arithmetic of a small network. This engine reads the graph once into contiguous
//! weights, and evaluates it without allocation.
//!
//! A dense graph is a chain: each node reads the output of the node before it, and constants. The
//! operators are Gemm, MatMul, Add, Sub, Mul, Div, Relu, LeakyRelu, Elu, Tanh, Sigmoid, Softplus,
//! Clip and Identity, all on rows of 32-bit floats. [`DenseError`] names the node that is another.
//!
//! It stands in the core because it is part of the decision path, performs no I/O, and serves
//! programs that build no inference library.
//!
//! ```
//! use heliostat_core::policy::{DenseEngine, Engine};
//! use heliostat_onnx::graph::{Ends, Graph};
//!
//! let mut graph = Graph::default();
//! let weights = graph.constant("weights", &[3, 2], &[1.0, -1.0, 2.0, -2.0, 3.0, -3.0]);
//! let sums = graph.node("MatMul", &["x", &weights]);
//! graph.node("Relu", &[&sums]);
//! let file = graph.finish(&Ends { name: "example", input: ("x", 3), output: ("y", 2) }, &[]);
//!
//! let mut network = DenseEngine.load(&file, 3)?;
//! network.set_rows(2).expect("a dense network takes any number of rows");
//! network.input_mut().copy_from_slice(&[1.0, 1.0, 1.0, 0.0, 0.0, -1.0]);
//! assert_eq!(network.run().expect("it is finite"), [6.0, 0.0, 0.0, 3.0]);
//! # Ok::<(), String>(())
//! ```

mod error;
mod graph;
mod layers;
mod operator;

use heliostat_channel::simd::with_widest_simd;
use heliostat_onnx::ModelProto;
use prost::Message;

use super::{
    engine::{Engine, Network},
    proposal::{PolicyError, PolicyResult},
};
use layers::Layer;

pub use error::DenseError;

/// The name of the dense engine.
pub const DENSE: &str = "dense";

/// Builds networks of dense graphs.
#[derive(Clone, Copy, Debug)]
pub struct DenseEngine;

impl Engine for DenseEngine {
    fn load(&self, model: &[u8], input_length: usize) -> Result<Box<dyn Network>, String> {
        match DenseNetwork::read(model, input_length) {
            Ok(network) => Ok(Box::new(network)),
            Err(refusal) => Err(refusal.to_string()),
        }
    }
}

/// A dense network: each row of the input passes through the layers in order.
#[derive(Clone, Debug)]
pub struct DenseNetwork {
    layers: Vec<Layer>,
    input_length: usize,
    output_length: usize,
    /// The largest length of a row between two layers.
    width: usize,
    rows: usize,
    input: Vec<f32>,
    /// The rows before and after a layer.
    work: [Vec<f32>; 2],
}

impl DenseNetwork {
    /// Reads a dense graph whose input has rows of `input_length` values.
    ///
    /// # Errors
    /// [`DenseError`] with the node that is not dense, or the tensor that does not fit.
    pub fn read(model: &[u8], input_length: usize) -> Result<Self, DenseError> {
        let model = ModelProto::decode(model).map_err(|error| DenseError::NotOnnx { message: error.to_string() })?;
        let layers = graph::read(&model, input_length)?;
        let mut widths = layers.iter().map(Layer::outputs);
        let width = widths.clone().fold(input_length, usize::max);
        let output_length = widths.next_back().unwrap_or(input_length);
        let mut network =
            Self { layers, input_length, output_length, width, rows: 0, input: Vec::new(), work: Default::default() };
        network.resize(1);
        Ok(network)
    }

    fn resize(&mut self, rows: usize) {
        self.rows = rows;
        self.input.resize(rows * self.input_length, 0.0);
        for work in &mut self.work {
            work.resize(rows * self.width, 0.0);
        }
    }

    /// The rows of the output.
    fn evaluate(&mut self) -> &[f32] {
        let Self { layers, rows, input, work: [present, next], .. } = self;
        present[..input.len()].copy_from_slice(input);
        let mut in_first = true;
        with_widest_simd(
            #[inline(always)]
            || {
                let (mut from, mut to) = (present.as_mut_slice(), next.as_mut_slice());
                for layer in layers {
                    if layer.apply(*rows, from, to) {
                        std::mem::swap(&mut from, &mut to);
                        in_first = !in_first;
                    }
                }
            },
        );
        &self.work[usize::from(!in_first)][..self.rows * self.output_length]
    }
}

impl Network for DenseNetwork {
    fn engine(&self) -> &'static str {
        DENSE
    }

    fn set_rows(&mut self, rows: usize) -> PolicyResult {
        if rows == 0 {
            return Err(PolicyError::Inference { message: "the input has 0 rows: expected at least 1".into() });
        }
        self.resize(rows);
        Ok(())
    }

    fn input_mut(&mut self) -> &mut [f32] {
        &mut self.input
    }

    fn run(&mut self) -> PolicyResult<&[f32]> {
        Ok(self.evaluate())
    }
}
