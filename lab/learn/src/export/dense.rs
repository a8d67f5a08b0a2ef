//! A network of dense layers as an ONNX file.

use candle_core::{Device, Result, Tensor};
use heliostat_core::policy::actor_file::{ActionKind, INPUT_NAME, ObservationKind, key};
use heliostat_core::policy::fixed_input;
use heliostat_onnx::graph::{Ends, Graph};

use crate::networks::layers::Network;

/// Fixed inputs in the metadata.
const CHECKS: usize = 4;

/// The inputs of the trainer's network that a column of the file's input gives, each with its
/// factor; empty for an unused column.
pub type Column = Vec<(usize, f32)>;

/// Encoder and decoder of a file.
pub struct Form<'a> {
    /// What the network reads.
    pub observation: ObservationKind,
    /// What it gives.
    pub action: ActionKind,
    /// How the columns of the input become inputs of the trainer's network.
    pub columns: &'a [Column],
    /// The metadata without the entries of this form.
    pub metadata: &'a [(String, String)],
}

/// What follows the last layer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tail {
    /// Nothing.
    Plain,
    /// The hyperbolic tangent, times this factor.
    Tanh(f32),
}

/// Writes a network of two hidden layers: `Gemm`, `Relu`, `Gemm`, `Relu`, `Gemm` and the tail.
///
/// # Errors
/// Errors of candle, when a parameter cannot be read.
pub fn export(network: &Network, form: &Form<'_>, tail: Tail) -> Result<Vec<u8>> {
    let mut graph = Graph::default();
    let mut value = INPUT_NAME.to_owned();
    let mut outputs = 0;
    for (index, layer) in network.layers().iter().enumerate() {
        let (mut weight, bias) = (layer.weight.to_vec2::<f32>()?, layer.bias.to_vec1::<f32>()?);
        if index == 0 {
            weight = form.columns.iter().map(|column| combined(&weight, column)).collect();
        } else {
            value = graph.node("Relu", &[&value]);
        }
        outputs = bias.len();
        let weight = graph.constant(&format!("{}.weight", layer.name), &[weight.len(), outputs], &weight.concat());
        let bias = graph.constant(&format!("{}.bias", layer.name), &[outputs], &bias);
        value = graph.node("Gemm", &[&value, &weight, &bias]);
    }
    if let Tail::Tanh(factor) = tail {
        value = graph.node("Tanh", &[&value]);
        if factor != 1.0 {
            let factor = graph.scalar(factor);
            graph.node("Mul", &[&value, &factor]);
        }
    }
    finish(graph, form, outputs, |row| trainers_outputs(network, form.columns, tail, row))
}

/// The finished file of a graph; `evaluate` is the trainer's own network for one row.
///
/// # Errors
/// That of `evaluate`.
pub fn finish(
    graph: Graph,
    form: &Form<'_>,
    outputs: usize,
    evaluate: impl Fn(&[f32]) -> Result<Vec<f32>>,
) -> Result<Vec<u8>> {
    let inputs = form.columns.len();
    let line = |number: usize| {
        let row: Vec<f32> = (0..inputs).map(|index| fixed_input(number, index)).collect();
        Ok::<_, candle_core::Error>(evaluate(&row)?.iter().map(f32::to_string).collect::<Vec<_>>().join(" "))
    };
    let check = (0..CHECKS).map(line).collect::<Result<Vec<_>>>()?.join("; ");
    let mut entries = vec![(key::OBSERVATION.to_owned(), form.observation.name().to_owned())];
    entries.extend(form.action.entries());
    let of_array = [key::USERS_MAX, key::MIRRORS, key::GEOMETRY];
    let fits = |key: &String| !form.observation.fits_any_array() || !of_array.contains(&key.as_str());
    entries.extend(form.metadata.iter().filter(|(key, _)| fits(key)).cloned());
    entries.push((key::CHECK.to_owned(), check));
    let ends = Ends { name: "heliostat-actor", input: (INPUT_NAME, inputs), output: (form.action.output(), outputs) };
    let has_rows = matches!(form.observation, ObservationKind::Users | ObservationKind::Codewords);
    Ok(if has_rows { graph.finish_rows(&ends, &entries) } else { graph.finish(&ends, &entries) })
}

/// Each input of the trainer's network as a column of its own.
pub fn all_columns(inputs: usize) -> Vec<Column> {
    (0..inputs).map(|input| vec![(input, 1.0)]).collect()
}

/// The first layer's weights of one column.
fn combined(weight: &[Vec<f32>], column: &Column) -> Vec<f32> {
    let mut row = vec![0.0; weight[0].len()];
    for (input, factor) in column {
        row.iter_mut().zip(&weight[*input]).for_each(|(sum, weight)| *sum += weight * factor);
    }
    row
}

/// The outputs of the trainer's network for one row of the file's input.
fn trainers_outputs(network: &Network, columns: &[Column], tail: Tail, row: &[f32]) -> Result<Vec<f32>> {
    let layers = network.layers();
    let mut inputs = vec![0.0_f32; layers[0].weight.dim(0)?];
    for (value, column) in row.iter().zip(columns) {
        column.iter().for_each(|(input, factor)| inputs[*input] += factor * value);
    }
    let mut value = Tensor::from_slice(&inputs, (1, inputs.len()), &Device::Cpu)?;
    for (index, layer) in layers.iter().enumerate() {
        let rows = if index == 0 { value } else { value.relu()? };
        value = rows.matmul(&layer.weight)?.broadcast_add(&layer.bias)?;
    }
    let value = match tail {
        Tail::Plain => value,
        Tail::Tanh(factor) => (value.tanh()? * f64::from(factor))?,
    };
    value.squeeze(0)?.to_vec1()
}
