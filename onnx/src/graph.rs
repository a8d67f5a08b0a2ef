//! A small builder of ONNX graphs: nodes, constants and metadata, written through tract's protobuf types.
//!
//! Files carry opset 17 and IR version 8, which tract and ONNX Runtime both read.

use prost::Message;
use tract_onnx::pb;
use tract_onnx::pb::attribute_proto::AttributeType;
use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::pb::{tensor_shape_proto, type_proto};

const IR_VERSION: i64 = 8;
const OPSET: i64 = 17;

/// The name of a value in the graph.
pub type Value = String;

/// A graph under construction: each method adds a node and gives the name of its output.
#[derive(Debug, Default)]
pub struct Graph {
    nodes: Vec<pb::NodeProto>,
    constants: Vec<pb::TensorProto>,
}

impl Graph {
    /// A constant of real numbers, row-major.
    ///
    /// # Panics
    /// When the shape and the number of values differ.
    pub fn constant(&mut self, name: &str, shape: &[usize], values: &[f32]) -> Value {
        assert_eq!(shape.iter().product::<usize>(), values.len(), "constant {name} of another shape");
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.tensor(name, shape, DataType::Float, bytes)
    }

    /// A constant real number.
    pub fn scalar(&mut self, value: f32) -> Value {
        let name = format!("scalar_{}", self.constants.len());
        self.constant(&name, &[], &[value])
    }

    /// Adds a node with one output.
    pub fn node(&mut self, operator: &str, inputs: &[&str]) -> Value {
        self.node_with(operator, inputs, Vec::new())
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

    /// The sum along an axis, which stays with extent 1.
    pub fn sum(&mut self, input: &str, axis: usize) -> Value {
        let axes = self.indices(&[axis as i64]);
        self.node_with("ReduceSum", &[input, &axes], vec![integer("keepdims", 1)])
    }

    /// The row that holds the largest value of each column of a table of this shape, the first of equal ones; (columns).
    ///
    /// By pooling: many times as fast in tract as its search for the largest.
    pub fn best_row(&mut self, input: &str, [rows, columns]: [usize; 2]) -> Value {
        let image = self.reshape(input, &[1, 1, rows, columns]);
        let window = integers("kernel_shape", &[rows as i64, 1]);
        let best = self.node_with("MaxPool", &[&image], vec![window]);
        // The place of the value in the image, row by row.
        let place = format!("{best}_place");
        self.nodes.last_mut().expect("just added").output.push(place.clone());
        let width = self.indices(&[columns as i64]);
        let row = self.node("Div", &[&place, &width]);
        self.reshape(&row, &[columns])
    }

    /// A table turned about, so that its rows are columns.
    pub fn transpose(&mut self, input: &str) -> Value {
        self.node_with("Transpose", &[input], vec![integers("perm", &[1, 0])])
    }

    /// The first index of the maximum along an axis, which disappears.
    pub fn argmax(&mut self, input: &str, axis: usize) -> Value {
        self.node_with("ArgMax", &[input], vec![integer("axis", axis as i64), integer("keepdims", 0)])
    }

    /// Parts of a value along an axis by index.
    pub fn gather(&mut self, input: &str, indices: &str, axis: usize) -> Value {
        self.node_with("Gather", &[input, indices], vec![integer("axis", axis as i64)])
    }

    /// Values side by side along an axis.
    pub fn concat(&mut self, inputs: &[&str], axis: usize) -> Value {
        self.node_with("Concat", inputs, vec![integer("axis", axis as i64)])
    }

    /// The finished file: one input and one output of shape (1, n), with metadata.
    pub fn finish(mut self, ends: &Ends<'_>, metadata: &[(String, String)]) -> Vec<u8> {
        if let Some(last) = self.nodes.last_mut() {
            last.output = vec![ends.output.0.into()];
        }
        let graph = pb::GraphProto {
            name: ends.name.into(),
            node: self.nodes,
            initializer: self.constants,
            input: vec![row(ends.input)],
            output: vec![row(ends.output)],
            ..pb::GraphProto::default()
        };
        let pair =
            |(key, value): &(String, String)| pb::StringStringEntryProto { key: key.clone(), value: value.clone() };
        pb::ModelProto {
            ir_version: IR_VERSION,
            opset_import: vec![pb::OperatorSetIdProto { domain: String::new(), version: OPSET }],
            producer_name: "heliostat".into(),
            producer_version: env!("CARGO_PKG_VERSION").into(),
            graph: Some(graph),
            metadata_props: metadata.iter().map(pair).collect(),
            ..pb::ModelProto::default()
        }
        .encode_to_vec()
    }

    fn indices(&mut self, values: &[i64]) -> Value {
        let name = format!("indices_{}", self.constants.len());
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.tensor(&name, &[values.len()], DataType::Int64, bytes)
    }

    fn tensor(&mut self, name: &str, shape: &[usize], kind: DataType, bytes: Vec<u8>) -> Value {
        self.constants.push(pb::TensorProto {
            name: name.into(),
            dims: shape.iter().map(|&extent| extent as i64).collect(),
            data_type: kind as i32,
            raw_data: bytes,
            ..pb::TensorProto::default()
        });
        name.into()
    }

    fn node_with(&mut self, operator: &str, inputs: &[&str], attribute: Vec<pb::AttributeProto>) -> Value {
        let output = format!("{}_{}", operator.to_lowercase(), self.nodes.len());
        self.nodes.push(pb::NodeProto {
            name: output.clone(),
            op_type: operator.into(),
            input: inputs.iter().map(|name| (*name).into()).collect(),
            output: vec![output.clone()],
            attribute,
            ..pb::NodeProto::default()
        });
        output
    }
}

/// What a graph is called, and the name and length of its only input and output.
#[derive(Clone, Copy, Debug)]
pub struct Ends<'a> {
    /// The graph's name.
    pub name: &'a str,
    /// Name and length of the input, of shape (1, length).
    pub input: (&'a str, usize),
    /// Name and length of the output, of shape (1, length); the node added last computes it.
    pub output: (&'a str, usize),
}

fn row((name, length): (&str, usize)) -> pb::ValueInfoProto {
    let dimension = |extent: usize| tensor_shape_proto::Dimension {
        value: Some(tensor_shape_proto::dimension::Value::DimValue(extent as i64)),
        ..tensor_shape_proto::Dimension::default()
    };
    let tensor = type_proto::Tensor {
        elem_type: DataType::Float as i32,
        shape: Some(pb::TensorShapeProto { dim: vec![dimension(1), dimension(length)] }),
    };
    pb::ValueInfoProto {
        name: name.into(),
        r#type: Some(pb::TypeProto { value: Some(type_proto::Value::TensorType(tensor)), ..pb::TypeProto::default() }),
        ..pb::ValueInfoProto::default()
    }
}

fn integer(name: &str, value: i64) -> pb::AttributeProto {
    pb::AttributeProto {
        name: name.into(),
        r#type: AttributeType::Int as i32,
        i: value,
        ..pb::AttributeProto::default()
    }
}

fn integers(name: &str, values: &[i64]) -> pb::AttributeProto {
    pb::AttributeProto {
        name: name.into(),
        r#type: AttributeType::Ints as i32,
        ints: values.to_vec(),
        ..pb::AttributeProto::default()
    }
}
