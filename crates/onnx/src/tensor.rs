//! Tensors of an ONNX file as shapes and values, and the search for weights that diverged.

use crate::tensor_proto::DataType;
use crate::{AttributeProto, GraphProto, ModelProto, NodeProto, TensorProto};

/// A tensor in row-major order.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// The extent of each axis; none for a scalar.
    pub shape: Vec<usize>,
    /// The values.
    pub data: Data,
}

/// The values of a tensor.
#[derive(Clone, Debug, PartialEq)]
pub enum Data {
    /// 32-bit floats.
    Floats(Vec<f32>),
    /// 64-bit integers.
    Integers(Vec<i64>),
}

impl Tensor {
    /// Reads a tensor of 32-bit floats or 64-bit integers; `None` for another type, or where the
    /// number of values does not fit the shape.
    pub fn read(proto: &TensorProto) -> Option<Self> {
        let shape: Option<Vec<usize>> = proto.dims.iter().map(|extent| usize::try_from(*extent).ok()).collect();
        let shape = shape?;
        let data = match DataType::try_from(proto.data_type).ok()? {
            DataType::Float if proto.raw_data.is_empty() => Data::Floats(proto.float_data.clone()),
            DataType::Float => Data::Floats(raw(&proto.raw_data, f32::from_le_bytes)),
            DataType::Int64 if proto.raw_data.is_empty() => Data::Integers(proto.int64_data.clone()),
            DataType::Int64 => Data::Integers(raw(&proto.raw_data, i64::from_le_bytes)),
            _ => return None,
        };
        let expected = shape.iter().try_fold(1_usize, |product, extent| product.checked_mul(*extent))?;
        let found = match &data {
            Data::Floats(values) => values.len(),
            Data::Integers(values) => values.len(),
        };
        (found == expected).then_some(Self { shape, data })
    }
}

fn raw<const N: usize, T>(bytes: &[u8], convert: fn([u8; N]) -> T) -> Vec<T> {
    bytes.as_chunks::<N>().0.iter().map(|chunk| convert(*chunk)).collect()
}

/// The name of the first tensor or attribute of a file that holds NaN or infinity.
///
/// Some operators of some engines return finite results for them, so that a defect of the weights
/// does not show in the output. Minus infinity is legitimate: attention networks mask with it.
pub fn first_not_finite(model: &ModelProto) -> Option<String> {
    let functions = model.functions.iter().flat_map(|function| &function.node);
    model.graph.as_ref().and_then(in_graph).or_else(|| functions.into_iter().find_map(in_node))
}

fn in_graph(graph: &GraphProto) -> Option<String> {
    let sparse = graph.sparse_initializer.iter().filter_map(|tensor| tensor.values.as_ref());
    let mut tensors = graph.initializer.iter().chain(sparse);
    let named = tensors.find(|tensor| !is_sound(tensor)).map(|tensor| tensor.name.clone());
    named.or_else(|| graph.node.iter().find_map(in_node))
}

fn in_node(node: &NodeProto) -> Option<String> {
    node.attribute.iter().find_map(|attribute| in_attribute(node, attribute))
}

fn in_attribute(node: &NodeProto, attribute: &AttributeProto) -> Option<String> {
    let sparse = attribute.sparse_tensor.iter().chain(&attribute.sparse_tensors);
    let mut tensors =
        attribute.t.iter().chain(&attribute.tensors).chain(sparse.filter_map(|tensor| tensor.values.as_ref()));
    let mut floats = attribute.floats.iter().chain([&attribute.f]);
    if !tensors.all(is_sound) || !floats.all(|value| is_weight(*value)) {
        // A constant is known by the name of its output.
        let name = node.output.first().filter(|name| !name.is_empty()).unwrap_or(&node.name);
        return Some(format!("{name} ({} of the operator {})", attribute.name, node.op_type));
    }
    attribute.g.iter().chain(&attribute.graphs).find_map(in_graph)
}

/// Whether a value is a weight or a mask.
fn is_weight(value: impl Into<f64>) -> bool {
    let value = value.into();
    value.is_finite() || value == f64::NEG_INFINITY
}

/// Whether all values of a tensor are weights or masks; tensors of integers are.
fn is_sound(tensor: &TensorProto) -> bool {
    let raw_data = &tensor.raw_data;
    // The exponents of the formats of 16 bits; all ones mean NaN or infinity. The second pattern is
    // minus infinity.
    let half = |mask: u16| {
        let stored = tensor.int32_data.iter().map(move |value| *value as u16);
        let mut values = stored.chain(raw(raw_data, u16::from_le_bytes));
        values.all(|bits| bits & mask != mask || bits == mask | 0x8000)
    };
    match DataType::try_from(tensor.data_type) {
        Ok(DataType::Float) => {
            tensor.float_data.iter().all(|value| is_weight(*value))
                && raw(raw_data, f32::from_le_bytes).iter().all(|value| is_weight(*value))
        }
        Ok(DataType::Double) => {
            tensor.double_data.iter().all(|value| is_weight(*value))
                && raw(raw_data, f64::from_le_bytes).iter().all(|value| is_weight(*value))
        }
        Ok(DataType::Float16) => half(0x7c00),
        Ok(DataType::Bfloat16) => half(0x7f80),
        _ => true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::{Ends, Graph};
    use prost::Message;

    fn file(values: [f32; 2]) -> ModelProto {
        let mut graph = Graph::default();
        let weights = graph.constant("head.weight", &[2], &values);
        graph.node("Mul", &["x", &weights]);
        let bytes = graph.finish(&Ends { name: "test", input: ("x", 2), output: ("y", 2) }, &[]);
        ModelProto::decode(&bytes[..]).expect("just written")
    }

    fn tensor(data_type: DataType, raw_data: Vec<u8>) -> TensorProto {
        TensorProto { name: "w".into(), dims: vec![1], data_type: data_type as i32, raw_data, ..TensorProto::default() }
    }

    #[test]
    fn the_tensor_with_nan_or_infinity_is_named_and_a_mask_is_not() {
        assert_eq!(first_not_finite(&file([1.0, -2.0])), None);
        assert_eq!(first_not_finite(&file([1.0, f32::NEG_INFINITY])), None, "a mask");
        for value in [f32::NAN, f32::INFINITY] {
            assert_eq!(first_not_finite(&file([1.0, value])).as_deref(), Some("head.weight"));
        }
    }

    #[test]
    fn a_constant_node_with_a_value_that_is_not_finite_is_named_by_its_output() {
        let attribute = AttributeProto {
            name: "value".into(),
            t: Some(tensor(DataType::Float, f32::NAN.to_le_bytes().into())),
            ..AttributeProto::default()
        };
        let node = NodeProto {
            op_type: "Constant".into(),
            output: vec!["offset".into()],
            attribute: vec![attribute],
            ..NodeProto::default()
        };
        let mut model = file([1.0, 2.0]);
        model.graph.as_mut().expect("a graph").node.push(node);
        let found = first_not_finite(&model).expect("a constant that is NaN");
        assert!(found.contains("offset") && found.contains("Constant"), "{found}");
    }

    #[test]
    fn all_formats_of_floats_are_examined_and_integers_are_finite() {
        let formats = [
            (DataType::Float, f32::NAN.to_le_bytes().to_vec(), 1_f32.to_le_bytes().to_vec()),
            (DataType::Double, f64::INFINITY.to_le_bytes().to_vec(), 1_f64.to_le_bytes().to_vec()),
            (DataType::Float16, 0x7e00_u16.to_le_bytes().to_vec(), 0x3c00_u16.to_le_bytes().to_vec()),
            (DataType::Bfloat16, 0x7fc0_u16.to_le_bytes().to_vec(), 0x3f80_u16.to_le_bytes().to_vec()),
        ];
        for (format, bad, good) in formats {
            assert!(!is_sound(&tensor(format, bad)) && is_sound(&tensor(format, good)), "{format:?}");
        }
        assert!(is_sound(&tensor(DataType::Float16, 0xfc00_u16.to_le_bytes().to_vec())), "minus infinity");
        assert!(is_sound(&tensor(DataType::Int64, vec![0xff; 8])));
    }
}
