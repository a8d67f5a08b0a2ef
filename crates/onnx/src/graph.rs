//! A builder of ONNX graphs: nodes, constants and metadata.
//!
//! Files carry opset 17 and IR version 8, which ONNX Runtime reads.
//!
//! ```
//! use heliostat_onnx::graph::{Ends, Graph};
//!
//! let mut graph = Graph::default();
//! let two = graph.scalar(2.0);
//! graph.node("Mul", &["x", &two]);
//! let file = graph.finish(&Ends { name: "double", input: ("x", 4), output: ("y", 4) }, &[]);
//! assert!(!file.is_empty());
//! ```

use prost::Message;

use crate::attribute_proto::AttributeType;
use crate::tensor_proto::DataType;
use crate::{
    AttributeProto, GraphProto, ModelProto, NodeProto, OperatorSetIdProto, StringStringEntryProto, TensorProto,
    ValueInfoProto, f32_row, f32_rows,
};

const IR_VERSION: i64 = 8;
const OPSET: i64 = 17;

/// The name of a value in the graph.
pub type Value = String;

/// A graph under construction. Each method adds a node and returns the name of its output.
#[derive(Debug, Default)]
pub struct Graph {
    nodes: Vec<NodeProto>,
    constants: Vec<TensorProto>,
}

impl Graph {
    /// A constant of 32-bit floats, row-major.
    ///
    /// # Panics
    /// The shape does not hold this number of values.
    pub fn constant(&mut self, name: &str, shape: &[usize], values: &[f32]) -> Value {
        assert_eq!(
            shape.iter().product::<usize>(),
            values.len(),
            "the shape of constant {name} does not hold its values"
        );
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.tensor(name, shape, DataType::Float, bytes)
    }

    /// A constant 32-bit float.
    pub fn scalar(&mut self, value: f32) -> Value {
        let name = format!("scalar_{}", self.constants.len());
        self.constant(&name, &[], &[value])
    }

    /// Adds a node with one output.
    pub fn node(&mut self, operator: &str, inputs: &[&str]) -> Value {
        self.node_with(operator, inputs, Vec::new())
    }

    /// Adds the nodes and constants of another graph, whose names differ from those in this one.
    pub fn insert(&mut self, nodes: Vec<NodeProto>, constants: Vec<TensorProto>) {
        self.nodes.extend(nodes);
        self.constants.extend(constants);
    }

    /// The part `[start, end)` of a value along an axis.
    pub fn slice(&mut self, input: &str, axis: usize, range: std::ops::Range<usize>) -> Value {
        let bounds = [range.start, range.end, axis].map(|value| self.indices(&[value as i64]));
        self.node("Slice", &[input, &bounds[0], &bounds[1], &bounds[2]])
    }

    /// A value in another shape.
    pub fn reshape(&mut self, input: &str, shape: &[usize]) -> Value {
        let shape: Vec<i64> = shape.iter().map(|&extent| extent as i64).collect();
        let shape = self.indices(&shape);
        self.node("Reshape", &[input, &shape])
    }

    /// The sum along an axis, which keeps extent 1.
    pub fn sum(&mut self, input: &str, axis: usize) -> Value {
        let axes = self.indices(&[axis as i64]);
        self.node_with("ReduceSum", &[input, &axes], vec![integer("keepdims", 1)])
    }

    /// The transpose of a table.
    pub fn transpose(&mut self, input: &str) -> Value {
        self.node_with("Transpose", &[input], vec![integers("perm", &[1, 0])])
    }

    /// The parts of a value at indices along an axis.
    pub fn gather(&mut self, input: &str, indices: &str, axis: usize) -> Value {
        self.node_with("Gather", &[input, indices], vec![integer("axis", axis as i64)])
    }

    /// Values concatenated along an axis.
    pub fn concat(&mut self, inputs: &[&str], axis: usize) -> Value {
        self.node_with("Concat", inputs, vec![integer("axis", axis as i64)])
    }

    /// The finished file: one input and one output of shape (1, n), with metadata.
    pub fn finish(self, ends: &Ends<'_>, metadata: &[(String, String)]) -> Vec<u8> {
        self.finish_with(ends, f32_row, metadata)
    }

    /// The same with one input and one output of any number of rows.
    pub fn finish_rows(self, ends: &Ends<'_>, metadata: &[(String, String)]) -> Vec<u8> {
        self.finish_with(ends, f32_rows, metadata)
    }

    fn finish_with(
        mut self,
        ends: &Ends<'_>,
        port: fn(&str, usize) -> ValueInfoProto,
        metadata: &[(String, String)],
    ) -> Vec<u8> {
        if let Some(last) = self.nodes.last_mut() {
            last.output = vec![ends.output.0.into()];
        }
        let graph = GraphProto {
            name: ends.name.into(),
            node: self.nodes,
            initializer: self.constants,
            input: vec![port(ends.input.0, ends.input.1)],
            output: vec![port(ends.output.0, ends.output.1)],
            ..GraphProto::default()
        };
        let pair = |(key, value): &(String, String)| StringStringEntryProto { key: key.clone(), value: value.clone() };
        ModelProto {
            ir_version: IR_VERSION,
            opset_import: vec![OperatorSetIdProto { domain: String::new(), version: OPSET }],
            producer_name: "heliostat".into(),
            producer_version: env!("CARGO_PKG_VERSION").into(),
            graph: Some(graph),
            metadata_props: metadata.iter().map(pair).collect(),
            ..ModelProto::default()
        }
        .encode_to_vec()
    }

    fn indices(&mut self, values: &[i64]) -> Value {
        let name = format!("indices_{}", self.constants.len());
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.tensor(&name, &[values.len()], DataType::Int64, bytes)
    }

    fn tensor(&mut self, name: &str, shape: &[usize], kind: DataType, bytes: Vec<u8>) -> Value {
        self.constants.push(TensorProto {
            name: name.into(),
            dims: shape.iter().map(|&extent| extent as i64).collect(),
            data_type: kind as i32,
            raw_data: bytes,
            ..TensorProto::default()
        });
        name.into()
    }

    fn node_with(&mut self, operator: &str, inputs: &[&str], attribute: Vec<AttributeProto>) -> Value {
        let output = format!("{}_{}", operator.to_lowercase(), self.nodes.len());
        self.nodes.push(NodeProto {
            name: output.clone(),
            op_type: operator.into(),
            input: inputs.iter().map(|name| (*name).into()).collect(),
            output: vec![output.clone()],
            attribute,
            ..NodeProto::default()
        });
        output
    }
}

/// The name of a graph, and the name and length of its only input and output.
#[derive(Clone, Copy, Debug)]
pub struct Ends<'a> {
    /// The graph's name.
    pub name: &'a str,
    /// Name and length of the input, of shape (1, length).
    pub input: (&'a str, usize),
    /// Name and length of the output, of shape (1, length); the last added node computes it.
    pub output: (&'a str, usize),
}

fn integer(name: &str, value: i64) -> AttributeProto {
    AttributeProto { name: name.into(), r#type: AttributeType::Int as i32, i: value, ..AttributeProto::default() }
}

fn integers(name: &str, values: &[i64]) -> AttributeProto {
    AttributeProto {
        name: name.into(),
        r#type: AttributeType::Ints as i32,
        ints: values.to_vec(),
        ..AttributeProto::default()
    }
}
