//! Reads an ONNX graph that is a chain of dense operators into layers.

use std::collections::BTreeMap;

use heliostat_onnx::{GraphProto, ModelProto, NodeProto, TensorProto, ValueInfoProto, describe, f32_extents};

use super::{
    error::DenseError,
    layers::Layer,
    operator::{self, Call, Input},
};

/// The layers of a graph whose input has rows of `input_length` values.
///
/// # Errors
/// [`DenseError`] with the first node, port or tensor that is not dense.
pub fn read(model: &ModelProto, input_length: usize) -> Result<Vec<Layer>, DenseError> {
    let no_graph = || DenseError::NotOnnx { message: "it holds no graph".into() };
    let graph = model.graph.as_ref().ok_or_else(no_graph)?;
    let constants: BTreeMap<&str, &TensorProto> =
        graph.initializer.iter().map(|tensor| (tensor.name.as_str(), tensor)).collect();
    // Weights may be listed as inputs too, in files written for old versions of the format.
    let inputs = graph.input.iter().filter(|port| !constants.contains_key(port.name.as_str()));
    let input = only_port("input", inputs, input_length)?;
    let mut chain = Chain { constants, value: &input.name, width: input_length, layers: Vec::new() };
    for node in &graph.node {
        chain.add(node)?;
    }
    let output = only_port("output", graph.output.iter(), chain.width)?;
    chain.ends_at(graph, output)?;
    Ok(chain.layers)
}

/// The only port, of shape (rows, length).
fn only_port<'a>(
    port: &'static str,
    mut ports: impl Iterator<Item = &'a ValueInfoProto>,
    length: usize,
) -> Result<&'a ValueInfoProto, DenseError> {
    let wrong =
        |found: String| DenseError::Port { port, found, expected: format!("exactly one, f32 [rows, {length}]") };
    let first = ports.next().ok_or_else(|| wrong("absent".into()))?;
    if ports.next().is_some() {
        return Err(wrong("one of several".into()));
    }
    match f32_extents(first).as_deref() {
        Some([_, Some(columns)]) if *columns == length => Ok(first),
        _ => Err(wrong(format!("\"{}\", {}", first.name, describe(first)))),
    }
}

/// The chain so far.
struct Chain<'a> {
    constants: BTreeMap<&'a str, &'a TensorProto>,
    /// The name of the value that the last node computed.
    value: &'a str,
    /// The length of its rows.
    width: usize,
    layers: Vec<Layer>,
}

impl<'a> Chain<'a> {
    fn add(&mut self, node: &'a NodeProto) -> Result<(), DenseError> {
        let call = Call { node, inputs: self.inputs(node)?, width: self.width };
        let [output] = &node.output[..] else {
            return Err(call.refused(format!("{} outputs", node.output.len()), "one"));
        };
        if output == self.value || self.constants.contains_key(output.as_str()) {
            return Err(call.refused(format!("the output \"{output}\", which exists already"), "a new name"));
        }
        if let Some(tensor) = call.constant()? {
            self.constants.insert(output, tensor);
            return Ok(());
        }
        operator::append(&call, &mut self.layers)?;
        self.width = self.layers.last().map_or(self.width, Layer::outputs);
        self.value = output;
        Ok(())
    }

    fn inputs(&self, node: &'a NodeProto) -> Result<Vec<Input<'a>>, DenseError> {
        let input = |name: &'a String| match self.constants.get(name.as_str()) {
            _ if name.is_empty() => Ok(Input::Absent),
            _ if name == self.value => Ok(Input::Value),
            Some(tensor) => Ok(Input::Constant(tensor)),
            None => Err(Call { node, inputs: Vec::new(), width: self.width }.refused(
                format!("the input \"{name}\", which is no constant and not the value \"{}\"", self.value),
                "a chain, in which each node reads the output of the node before it, and tensors of the file",
            )),
        };
        node.input.iter().map(input).collect()
    }

    /// Checks that the last value is the output of the graph.
    fn ends_at(&self, graph: &GraphProto, output: &ValueInfoProto) -> Result<(), DenseError> {
        if output.name == self.value {
            return Ok(());
        }
        let last = graph.node.last().map_or("no node", |node| node.op_type.as_str());
        Err(DenseError::Port {
            port: "output",
            found: format!("\"{}\"", output.name),
            expected: format!("\"{}\", which the last node computes ({last})", self.value),
        })
    }
}
