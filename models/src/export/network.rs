//! A trained network as nodes of an ONNX graph; what [`Network::forward`] computes for one state.

use candle_core::Result;

use crate::networks::{Encoder, Network, Shape};
use crate::onnx::{Graph, Value};

/// The parameters of a network as constants of the graph, so that every round uses the same.
pub struct NetworkNodes {
    shape: Shape,
    /// Name, weight and bias of each layer.
    layers: Vec<(&'static str, Value, Value)>,
}

impl NetworkNodes {
    /// Adds the parameters to a graph.
    ///
    /// # Errors
    /// Those of candle, when a parameter cannot be read.
    pub fn new(graph: &mut Graph, network: &Network) -> Result<Self> {
        let mut layers = Vec::new();
        for layer in network.layers() {
            let (inputs, outputs) = layer.weight.dims2()?;
            let weight = layer.weight.flatten_all()?.to_vec1::<f32>()?;
            let weight = graph.constant(&format!("{}.weight", layer.name), &[inputs, outputs], &weight);
            let bias = graph.constant(&format!("{}.bias", layer.name), &[1, outputs], &layer.bias.to_vec1::<f32>()?);
            layers.push((layer.name, weight, bias));
        }
        Ok(Self { shape: network.shape(), layers })
    }

    fn linear(&self, graph: &mut Graph, name: &str, input: &str) -> Value {
        let (_, weight, bias) =
            self.layers.iter().find(|layer| layer.0 == name).expect("the encoder fixes layer names");
        let product = graph.node("MatMul", &[input, weight]);
        graph.node("Add", &[&product, bias])
    }

    fn rectified(&self, graph: &mut Graph, name: &str, input: &str) -> Value {
        let raw = self.linear(graph, name, input);
        graph.node("Relu", &[&raw])
    }

    /// Outputs of the plain network before any activation, (1, outputs), from all inputs in a row, (1, slots x inputs).
    pub fn plain(&self, graph: &mut Graph, input: &str) -> Value {
        let first = self.rectified(graph, "first", input);
        let second = self.rectified(graph, "second", &first);
        self.linear(graph, "head", &second)
    }

    /// Logits in [-1, 1] from inputs (slots, inputs), zero in absent slots; (slots, 1).
    pub fn apply(&self, graph: &mut Graph, input: &str, present: &str) -> Value {
        let Shape { encoder, slots, inputs, .. } = self.shape;
        let outputs = match encoder {
            Encoder::Mlp => {
                let flat = graph.reshape(input, &[1, slots * inputs]);
                let raw = self.plain(graph, &flat);
                graph.reshape(&raw, &[slots, 1])
            }
            Encoder::Set => {
                let first = self.rectified(graph, "first", input);
                let pooled = pool(graph, &first, present, slots);
                let context = self.linear(graph, "context", &pooled);
                let second = self.linear(graph, "second", &first);
                let second = graph.node("Add", &[&second, &context]);
                let second = graph.node("Relu", &[&second]);
                self.linear(graph, "head", &second)
            }
        };
        let logits = graph.node("Tanh", &[&outputs]);
        graph.node("Mul", &[&logits, present])
    }
}

/// Mean and maximum over the users present of rows that are nowhere negative, (1, 2 width).
fn pool(graph: &mut Graph, rows: &str, present: &str, slots: usize) -> Value {
    let masked = graph.node("Mul", &[rows, present]);
    let sum = graph.sum(&masked, 0);
    let users = graph.sum(present, 0);
    let mean = graph.node("Div", &[&sum, &users]);
    let max = graph.max_of_rows(&masked, slots);
    graph.concat(&[&mean, &max], 1)
}
