//! A trained network as nodes of an ONNX graph: [`Network::forward`] for one state.

use candle_core::Result;
use heliostat_onnx::graph::{Graph, Value};

use crate::networks::layers::{Encoder, Network, Shape};

/// The network's inputs that a column of the graph's input gives, each with its factor; empty for
/// an unused column.
pub type Column = Vec<(usize, f32)>;

/// The parameters of a network as constants of the graph, which all rounds share.
pub struct NetworkNodes<'a> {
    network: &'a Network,
    bias: Value,
    second: (Value, Value),
    head: (Value, Value),
}

/// The first layer's weights for one choice of columns.
pub struct Entry {
    columns: usize,
    weight: Value,
}

impl<'a> NetworkNodes<'a> {
    /// Adds the parameters to a graph, except the first layer's weights.
    ///
    /// # Errors
    /// Errors of candle, when a parameter cannot be read.
    pub fn new(graph: &mut Graph, network: &'a Network) -> Result<Self> {
        let bias = |graph: &mut Graph, name: &str| {
            let bias = network.layer(name).bias.to_vec1::<f32>()?;
            Ok::<_, candle_core::Error>(constant(graph, &format!("{name}.bias"), &[bias]))
        };
        let layer = |graph: &mut Graph, name: &str| {
            let weight = network.layer(name).weight.to_vec2::<f32>()?;
            Ok::<_, candle_core::Error>((constant(graph, &format!("{name}.weight"), &weight), bias(graph, name)?))
        };
        Ok(Self { network, bias: bias(graph, "first")?, second: layer(graph, "second")?, head: layer(graph, "head")? })
    }

    /// Adds the first layer's weights for these columns, slot by slot.
    ///
    /// # Errors
    /// Errors of candle, when a parameter cannot be read.
    pub fn entry(&self, graph: &mut Graph, columns: &[Column]) -> Result<Entry> {
        let weight = self.network.layer("first").weight.to_vec2::<f32>()?;
        let name = format!("first_of_{}.weight", columns.len());
        let weight = constant(graph, &name, &arranged(&weight, self.network.shape().inputs, columns));
        Ok(Entry { columns: columns.len(), weight })
    }

    /// Outputs before any activation, (rows, outputs), from rows of columns.
    pub fn plain(&self, graph: &mut Graph, entry: &Entry, input: &str) -> Value {
        let first = linear(graph, input, (&entry.weight, &self.bias));
        let first = graph.node("Relu", &[&first]);
        let second = linear(graph, &first, (&self.second.0, &self.second.1));
        let second = graph.node("Relu", &[&second]);
        linear(graph, &second, (&self.head.0, &self.head.1))
    }

    /// Actions in [-1, 1] from inputs (slots, columns); (slots, 1), without meaning in empty slots.
    pub fn apply(&self, graph: &mut Graph, entry: &Entry, input: &str) -> Value {
        let Shape { encoder, slots, .. } = self.network.shape();
        let outputs = match encoder {
            Encoder::PerUser => self.plain(graph, entry, input),
            Encoder::Mlp => {
                let flat = graph.reshape(input, &[1, slots * entry.columns]);
                let raw = self.plain(graph, entry, &flat);
                graph.reshape(&raw, &[slots, 1])
            }
        };
        graph.node("Tanh", &[&outputs])
    }
}

fn linear(graph: &mut Graph, input: &str, (weight, bias): (&str, &str)) -> Value {
    let product = graph.node("MatMul", &[input, weight]);
    graph.node("Add", &[&product, bias])
}

fn constant(graph: &mut Graph, name: &str, rows: &[Vec<f32>]) -> Value {
    graph.constant(name, &[rows.len(), rows[0].len()], &rows.concat())
}

/// The rows of the first layer's weight in the order of the columns, slot by slot; zero for an
/// unused column.
fn arranged(weight: &[Vec<f32>], inputs: usize, columns: &[Column]) -> Vec<Vec<f32>> {
    let row = |slot: &[Vec<f32>], column: &Column| {
        let mut row = vec![0.0; slot[0].len()];
        for (input, factor) in column {
            row.iter_mut().zip(&slot[*input]).for_each(|(sum, weight)| *sum += weight * factor);
        }
        row
    };
    weight.chunks(inputs).flat_map(|slot| columns.iter().map(|column| row(slot, column))).collect()
}
