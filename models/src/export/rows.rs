//! The exported network of rows: a chain of dense layers, for any number of rows.

use candle_core::Result;
use heliostat_onnx::graph::{Ends, Graph};

use crate::networks::layers::Network;

/// Writes a network of two hidden layers as an ONNX file with the given metadata: `Gemm`, `Relu`,
/// `Gemm`, `Relu`, `Gemm`.
///
/// # Errors
/// Errors of candle, when a parameter cannot be read.
pub fn export(network: &Network, ends: &Ends<'_>, metadata: &[(String, String)]) -> Result<Vec<u8>> {
    let mut graph = Graph::default();
    let mut value = ends.input.0.to_owned();
    for (index, layer) in network.layers().iter().enumerate() {
        let weight = layer.weight.to_vec2::<f32>()?;
        let bias = layer.bias.to_vec1::<f32>()?;
        let shape = [weight.len(), bias.len()];
        let weight = graph.constant(&format!("{}.weight", layer.name), &shape, &weight.concat());
        let bias = graph.constant(&format!("{}.bias", layer.name), &[shape[1]], &bias);
        if index > 0 {
            value = graph.node("Relu", &[&value]);
        }
        value = graph.node("Gemm", &[&value, &weight, &bias]);
    }
    Ok(graph.finish_rows(ends, metadata))
}
