//! The exported networks of rows, for any number of rows: their metadata, and a chain of dense
//! layers.

use candle_core::Result;
use heliostat_core::policy::actor_file::key;
use heliostat_core::policy::compact_file::RowKind;
use heliostat_onnx::graph::{Ends, Graph};

use crate::networks::layers::Network;

/// The metadata of a network of this kind: the entries without which no policy reads it, and the
/// others of `entries` that such a network has.
pub fn metadata(kind: &RowKind, entries: &[(String, String)]) -> Vec<(String, String)> {
    let own = [(key::ACTION, kind.action.to_owned()), (key::OBSERVATION_VERSION, kind.version.to_string())];
    let replaced = [key::OBSERVATION_VERSION, key::USERS_MAX, key::MIRRORS, key::MODE, key::GEOMETRY];
    let others = entries.iter().filter(|(key, _)| !replaced.contains(&key.as_str())).cloned();
    own.map(|(key, value)| (key.to_owned(), value)).into_iter().chain(others).collect()
}

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
