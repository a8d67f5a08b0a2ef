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
    /// `columns`: which of the network's inputs stands in each column of what it will be given for a slot; none is left out.
    ///
    /// # Errors
    /// Those of candle, when a parameter cannot be read.
    pub fn new(graph: &mut Graph, network: &Network, columns: &[Option<usize>]) -> Result<Self> {
        let mut layers = Vec::new();
        let shape = Shape { inputs: columns.len(), ..network.shape() };
        for layer in network.layers() {
            let weight = layer.weight.to_vec2::<f32>()?;
            let outputs = layer.weight.dim(1)?;
            let weight =
                if layer.name == "first" { arranged(&weight, network.shape().inputs, columns) } else { weight };
            let weight = graph.constant(&format!("{}.weight", layer.name), &[weight.len(), outputs], &weight.concat());
            let bias = graph.constant(&format!("{}.bias", layer.name), &[1, outputs], &layer.bias.to_vec1::<f32>()?);
            layers.push((layer.name, weight, bias));
        }
        Ok(Self { shape, layers })
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

    /// Logits in [-1, 1] from inputs (slots, columns); (slots, 1), of no meaning in absent slots.
    ///
    /// `present`: 1 or 0, and `share`: the same over the number of users, (slots, 1) each.
    pub fn apply(&self, graph: &mut Graph, input: &str, present: &str, share: &str) -> Value {
        let Shape { encoder, slots, inputs, .. } = self.shape;
        let outputs = match encoder {
            Encoder::Mlp => {
                let flat = graph.reshape(input, &[1, slots * inputs]);
                let raw = self.plain(graph, &flat);
                graph.reshape(&raw, &[slots, 1])
            }
            Encoder::Set => {
                let first = self.rectified(graph, "first", input);
                let pooled = pool(graph, &first, [present, share], [slots, self.shape.hidden[0]]);
                let context = self.linear(graph, "context", &pooled);
                let second = self.linear(graph, "second", &first);
                let second = graph.node("Add", &[&second, &context]);
                let second = graph.node("Relu", &[&second]);
                self.linear(graph, "head", &second)
            }
        };
        graph.node("Tanh", &[&outputs])
    }
}

/// The rows of a first layer's weight in the order of the columns that it will be given, slot by slot; zero for a column without an input.
fn arranged(weight: &[Vec<f32>], inputs: usize, columns: &[Option<usize>]) -> Vec<Vec<f32>> {
    let row =
        |slot: &[Vec<f32>], input: &Option<usize>| input.map_or(vec![0.0; slot[0].len()], |input| slot[input].clone());
    weight.chunks(inputs).flat_map(|slot| columns.iter().map(|input| row(slot, input))).collect()
}

/// Mean and maximum over the users present of rows that are nowhere negative, (1, 2 width).
fn pool(graph: &mut Graph, rows: &str, [present, share]: [&str; 2], shape: [usize; 2]) -> Value {
    let shares = graph.node("Mul", &[rows, share]);
    let mean = graph.sum(&shares, 0);
    let masked = graph.node("Mul", &[rows, present]);
    let max = graph.max_of_rows(&masked, shape);
    graph.concat(&[&mean, &max], 1)
}
