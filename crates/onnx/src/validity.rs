//! Faults of a graph with which no engine can evaluate it.

use std::collections::{BTreeMap, BTreeSet};

use thiserror::Error;

use crate::{GraphProto, NodeProto};

/// Why no engine can evaluate a graph.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum GraphError {
    /// A node reads a value that does not exist.
    #[error("the node {node} reads {value:?}, which is no input, no tensor and no output of a node")]
    Input {
        /// The node.
        node: String,
        /// The value.
        value: String,
    },
    /// An output of the graph does not exist.
    #[error("no node computes its output {value:?}")]
    Output {
        /// The output.
        value: String,
    },
    /// Nodes wait for one another.
    #[error("its nodes form a cycle at the node {node}, or before it")]
    Cycle {
        /// The first node in the file that waits.
        node: String,
    },
}

/// Checks that each value of a graph exists and that no value depends on itself. Graphs within nodes are not checked.
///
/// # Errors
/// [`GraphError`] with the first fault.
///
/// ```
/// use heliostat_onnx::validity::check_graph;
/// use heliostat_onnx::{GraphProto, f32_row};
///
/// let graph = GraphProto { output: vec![f32_row("angles", 2)], ..GraphProto::default() };
/// assert_eq!(check_graph(&graph).unwrap_err().to_string(), "no node computes its output \"angles\"");
/// ```
pub fn check_graph(graph: &GraphProto) -> Result<(), GraphError> {
    let sparse = graph.sparse_initializer.iter().filter_map(|tensor| tensor.values.as_ref());
    let tensors = graph.initializer.iter().chain(sparse).map(|tensor| tensor.name.as_str());
    let given: BTreeSet<&str> = tensors.chain(graph.input.iter().map(|port| port.name.as_str())).collect();
    let nodes = graph.node.iter().enumerate();
    let computed: BTreeMap<&str, usize> =
        nodes.flat_map(|(index, node)| node.output.iter().map(move |output| (output.as_str(), index))).collect();
    let exists = |name: &str| name.is_empty() || given.contains(name) || computed.contains_key(name);
    for node in &graph.node {
        if let Some(value) = node.input.iter().find(|name| !exists(name)) {
            return Err(GraphError::Input { node: described(node), value: value.clone() });
        }
    }
    if let Some(output) = graph.output.iter().find(|port| !exists(&port.name)) {
        return Err(GraphError::Output { value: output.name.clone() });
    }
    check_order(&graph.node, |name| computed.get(name).copied().filter(|_| !name.is_empty() && !given.contains(name)))
}

/// Checks that the nodes have an order in which each one follows those that compute its inputs.
fn check_order(nodes: &[NodeProto], computed_by: impl Fn(&str) -> Option<usize>) -> Result<(), GraphError> {
    let (mut awaited, mut readers) = (vec![0; nodes.len()], vec![Vec::new(); nodes.len()]);
    for (index, node) in nodes.iter().enumerate() {
        for source in node.input.iter().filter_map(|name| computed_by(name)) {
            awaited[index] += 1;
            readers[source].push(index);
        }
    }
    let mut ready: Vec<usize> = (0..nodes.len()).filter(|index| awaited[*index] == 0).collect();
    while let Some(index) = ready.pop() {
        for reader in &readers[index] {
            awaited[*reader] -= 1;
            if awaited[*reader] == 0 {
                ready.push(*reader);
            }
        }
    }
    match awaited.iter().position(|count| *count > 0) {
        Some(index) => Err(GraphError::Cycle { node: described(&nodes[index]) }),
        None => Ok(()),
    }
}

fn described(node: &NodeProto) -> String {
    format!("{:?} ({})", node.name, node.op_type.escape_debug())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{TensorProto, f32_row};

    fn node(name: &str, inputs: &[&str], output: &str) -> NodeProto {
        NodeProto {
            name: name.into(),
            op_type: "Add".into(),
            input: inputs.iter().map(|name| (*name).to_owned()).collect(),
            output: vec![output.into()],
            ..NodeProto::default()
        }
    }

    fn graph(node: Vec<NodeProto>) -> GraphProto {
        GraphProto {
            node,
            initializer: vec![TensorProto { name: "bias".into(), ..TensorProto::default() }],
            input: vec![f32_row("x", 1)],
            output: vec![f32_row("y", 1)],
            ..GraphProto::default()
        }
    }

    #[test]
    fn a_graph_is_valid_in_any_order_of_its_nodes_and_with_absent_inputs() {
        let sound = vec![node("b", &["a", "bias"], "y"), node("a", &["x", "", "bias"], "a")];
        assert_eq!(check_graph(&graph(sound)), Ok(()));
    }

    #[test]
    fn an_absent_value_an_absent_output_and_a_cycle_are_named() {
        for (nodes, expected) in [
            (vec![node("a", &["x", "z"], "y")], "the node \"a\" (Add) reads \"z\""),
            (vec![node("a", &["x", "bias"], "z")], "no node computes its output \"y\""),
            (
                vec![node("a", &["x", "b"], "a"), node("b", &["a", "x"], "b"), node("c", &["b"], "y")],
                "at the node \"a\"",
            ),
            (vec![node("a", &["y", "x"], "y")], "its nodes form a cycle at the node \"a\" (Add)"),
        ] {
            let error = check_graph(&graph(nodes)).expect_err(expected).to_string();
            assert!(error.contains(expected), "{expected}: {error}");
        }
    }
}
