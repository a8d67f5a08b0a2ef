//! A trained network as nodes of an ONNX graph; what [`Network::forward`] computes for one state.

use candle_core::Result;

use crate::features::PRESENT;
use crate::networks::{Encoder, Network, Shape};
use crate::onnx::{Graph, Value};

/// The layer that reads the inputs.
const FIRST: &str = "first";

/// Which of the network's inputs stands in a column of what it is given, and what makes the input of the column's value; none is left out.
pub type Column = Option<(usize, f32)>;

/// The parameters of a network as constants of the graph, so that every round uses the same.
pub struct NetworkNodes<'a> {
    network: &'a Network,
    /// Weight and bias of each layer after the first, by name.
    layers: Vec<(&'static str, Value, Value)>,
}

/// The first layer for one choice of columns.
pub struct Entry {
    columns: usize,
    weight: Value,
    /// None where a column that is 1 for every user present carries it.
    bias: Option<Value>,
}

impl<'a> NetworkNodes<'a> {
    /// Adds the parameters of all layers but the first to a graph.
    ///
    /// # Errors
    /// Those of candle, when a parameter cannot be read.
    pub fn new(graph: &mut Graph, network: &'a Network) -> Result<Self> {
        let mut layers = Vec::new();
        for layer in network.layers().iter().filter(|layer| layer.name != FIRST) {
            let weight = layer.weight.to_vec2::<f32>()?;
            let mut bias = layer.bias.to_vec1::<f32>()?;
            if layer.name == "context" {
                // Both products are added before the activation, so that one bias serves.
                let second = network.layer("second").bias.to_vec1::<f32>()?;
                bias.iter_mut().zip(second).for_each(|(bias, second)| *bias += second);
            }
            let weight = constant(graph, &format!("{}.weight", layer.name), &weight);
            let bias = constant(graph, &format!("{}.bias", layer.name), &[bias]);
            layers.push((layer.name, weight, bias));
        }
        Ok(Self { network, layers })
    }

    /// Adds the first layer for inputs in these columns, slot by slot.
    ///
    /// # Errors
    /// Those of candle, when a parameter cannot be read.
    pub fn entry(&self, graph: &mut Graph, columns: &[Column]) -> Result<Entry> {
        let Shape { encoder, inputs, .. } = self.network.shape();
        let layer = self.network.layer(FIRST);
        let (mut weight, bias) = (layer.weight.to_vec2::<f32>()?, layer.bias.to_vec1::<f32>()?);
        let name = format!("{FIRST}_of_{}", columns.len());
        let bias = match encoder {
            Encoder::Mlp => Some(constant(graph, &format!("{name}.bias"), &[bias])),
            Encoder::Set => {
                weight[PRESENT].iter_mut().zip(bias).for_each(|(weight, bias)| *weight += bias);
                None
            }
        };
        let weight = constant(graph, &format!("{name}.weight"), &arranged(&weight, inputs, columns));
        Ok(Entry { columns: columns.len(), weight, bias })
    }

    fn layer(&self, name: &str) -> (&str, &str) {
        let layer = self.layers.iter().find(|layer| layer.0 == name).expect("the encoder fixes layer names");
        (&layer.1, &layer.2)
    }

    fn linear(&self, graph: &mut Graph, name: &str, input: &str) -> Value {
        let (weight, bias) = self.layer(name);
        let product = graph.node("MatMul", &[input, weight]);
        graph.node("Add", &[&product, bias])
    }

    /// Outputs of the plain network before any activation, (1, outputs), from all inputs in a row, (1, slots x inputs).
    pub fn plain(&self, graph: &mut Graph, entry: &Entry, input: &str) -> Value {
        let first = entry.apply(graph, input);
        let second = self.linear(graph, "second", &first);
        let second = graph.node("Relu", &[&second]);
        self.linear(graph, "head", &second)
    }

    /// Logits in [-1, 1] from inputs (slots, columns), zero in absent slots; (slots, 1), of no meaning in absent slots.
    ///
    /// `per_user`: one over the number of users, (1, 1).
    pub fn apply(&self, graph: &mut Graph, entry: &Entry, input: &str, per_user: &str) -> Value {
        let Shape { encoder, slots, hidden, .. } = self.network.shape();
        let outputs = match encoder {
            Encoder::Mlp => {
                let flat = graph.reshape(input, &[1, slots * entry.columns]);
                let raw = self.plain(graph, entry, &flat);
                graph.reshape(&raw, &[slots, 1])
            }
            Encoder::Set => {
                let first = entry.apply(graph, input);
                let sum = graph.sum(&first, 0);
                let mean = graph.node("Mul", &[&sum, per_user]);
                let max = graph.max_of_rows(&first, [slots, hidden[0]]);
                let pooled = graph.concat(&[&mean, &max], 1);
                let context = self.linear(graph, "context", &pooled);
                let second = graph.node("MatMul", &[&first, self.layer("second").0]);
                let second = graph.node("Add", &[&second, &context]);
                let second = graph.node("Relu", &[&second]);
                self.linear(graph, "head", &second)
            }
        };
        graph.node("Tanh", &[&outputs])
    }
}

impl Entry {
    /// The first layer's activations; nowhere negative, and of a set network zero in absent slots.
    fn apply(&self, graph: &mut Graph, input: &str) -> Value {
        let product = graph.node("MatMul", &[input, &self.weight]);
        let raw = match &self.bias {
            Some(bias) => graph.node("Add", &[&product, bias]),
            None => product,
        };
        graph.node("Relu", &[&raw])
    }
}

fn constant(graph: &mut Graph, name: &str, rows: &[Vec<f32>]) -> Value {
    graph.constant(name, &[rows.len(), rows[0].len()], &rows.concat())
}

/// The rows of a first layer's weight in the order of the columns that it will be given, slot by slot; zero for a column without an input.
fn arranged(weight: &[Vec<f32>], inputs: usize, columns: &[Column]) -> Vec<Vec<f32>> {
    let row = |slot: &[Vec<f32>], column: &Column| match column {
        None => vec![0.0; slot[0].len()],
        Some((input, factor)) => slot[*input].iter().map(|weight| weight * factor).collect(),
    };
    weight.chunks(inputs).flat_map(|slot| columns.iter().map(|column| row(slot, column))).collect()
}
