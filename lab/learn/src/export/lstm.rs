//! An exported [`Lstm`]: its steps one after the other, for any number of rows.

use candle_core::Result;
use heliostat_onnx::graph::{Graph, Value};

use crate::networks::layers::Linear;
use crate::networks::lstm::{Lstm, LstmShape};

/// Adds the network to a graph; returns its outputs for rows of the value `input`.
///
/// # Errors
/// Errors of candle, when a parameter cannot be read.
pub fn add(network: &Lstm, graph: &mut Graph, input: &str) -> Result<Value> {
    let LstmShape { steps, inputs, hidden, .. } = network.shape();
    let [gates, first, head] = network.layers();
    let weight = gates.weight.to_vec2::<f32>()?;
    let (of_input, of_state) = weight.split_at(inputs);
    let of_input = graph.constant("gates.input", &[inputs, 4 * hidden], &of_input.concat());
    let of_state = graph.constant("gates.state", &[hidden, 4 * hidden], &of_state.concat());
    let bias = graph.constant("gates.bias", &[4 * hidden], &gates.bias.to_vec1::<f32>()?);
    // Cell and state; both are zero before the first step, so their terms are left out there.
    let mut last: Option<[Value; 2]> = None;
    for step in 0..steps {
        let of_step = graph.slice(input, 1, step * inputs..(step + 1) * inputs);
        let mut raw = graph.node("Gemm", &[&of_step, &of_input, &bias]);
        if let Some([_, state]) = &last {
            let more = graph.node("MatMul", &[state, &of_state]);
            raw = graph.node("Add", &[&raw, &more]);
        }
        let open = graph.slice(&raw, 1, 0..3 * hidden);
        let open = graph.node("Sigmoid", &[&open]);
        let mut gate = |index: usize| graph.slice(&open, 1, index * hidden..(index + 1) * hidden);
        let [enter, forget, leave] = [gate(0), gate(1), gate(2)];
        let candidate = graph.slice(&raw, 1, 3 * hidden..4 * hidden);
        let candidate = graph.node("Tanh", &[&candidate]);
        let mut cell = graph.node("Mul", &[&enter, &candidate]);
        if let Some([former, _]) = &last {
            let kept = graph.node("Mul", &[&forget, former]);
            cell = graph.node("Add", &[&kept, &cell]);
        }
        let shown = graph.node("Tanh", &[&cell]);
        let state = graph.node("Mul", &[&leave, &shown]);
        last = Some([cell, state]);
    }
    let further = graph.slice(input, 1, steps * inputs..network.shape().row());
    let joined = match &last {
        Some([_, state]) => graph.concat(&[state, &further], 1),
        None => further,
    };
    let first = dense(graph, &joined, first)?;
    let first = graph.node("Relu", &[&first]);
    dense(graph, &first, head)
}

fn dense(graph: &mut Graph, input: &str, layer: &Linear) -> Result<Value> {
    let (weight, bias) = (layer.weight.to_vec2::<f32>()?, layer.bias.to_vec1::<f32>()?);
    let weight = graph.constant(&format!("{}.weight", layer.name), &[weight.len(), bias.len()], &weight.concat());
    let bias = graph.constant(&format!("{}.bias", layer.name), &[bias.len()], &bias);
    Ok(graph.node("Gemm", &[input, &weight, &bias]))
}
