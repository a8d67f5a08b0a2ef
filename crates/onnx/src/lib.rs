//! The protobuf messages of ONNX files, and a builder of graphs.
//!
//! `src/generated.rs` is generated from `proto/onnx.proto3`, the definition that ONNX 1.23.2
//! publishes under the licence Apache-2.0. That file documents every message and field.
//! The test `tests/generated.rs` compares the two; run it with `HELIOSTAT_ONNX_GENERATE=1` to
//! write `generated.rs` again after a change of the definition.
//!
//! ```
//! use heliostat_onnx::{GraphProto, ModelProto, f32_row};
//! use prost::Message;
//!
//! let graph = GraphProto { output: vec![f32_row("angles", 200)], ..GraphProto::default() };
//! let model = ModelProto { ir_version: 8, graph: Some(graph), ..ModelProto::default() };
//! let read = ModelProto::decode(&model.encode_to_vec()[..])?;
//! assert_eq!(read.graph.expect("the graph was written").output[0].name, "angles");
//! # Ok::<(), prost::DecodeError>(())
//! ```

pub mod external;
pub mod graph;
pub mod standard;
pub mod tensor;
pub mod validity;

#[allow(missing_docs, unused_qualifications, clippy::all)]
#[rustfmt::skip]
mod generated;

pub use generated::*;

use tensor_proto::DataType;
use tensor_shape_proto::{Dimension, dimension};

/// An input or output of shape (1, `length`) whose elements are 32-bit floats.
pub fn f32_row(name: &str, length: usize) -> ValueInfoProto {
    f32_table(name, dimension::Value::DimValue(1), length)
}

/// An input or output of any number of rows of `length` 32-bit floats.
pub fn f32_rows(name: &str, length: usize) -> ValueInfoProto {
    f32_table(name, dimension::Value::DimParam("rows".into()), length)
}

fn f32_table(name: &str, rows: dimension::Value, length: usize) -> ValueInfoProto {
    let extents = [rows, dimension::Value::DimValue(length as i64)];
    let dim = extents.map(|extent| Dimension { value: Some(extent), ..Dimension::default() }).to_vec();
    let tensor = type_proto::Tensor { elem_type: DataType::Float as i32, shape: Some(TensorShapeProto { dim }) };
    ValueInfoProto {
        name: name.into(),
        r#type: Some(TypeProto { value: Some(type_proto::Value::TensorType(tensor)), ..TypeProto::default() }),
        ..ValueInfoProto::default()
    }
}

/// The extents of an input or output whose elements are 32-bit floats, `None` for an open one,
/// which exporters also write as a negative number;
/// `None` where the type is another one or the shape is absent.
pub fn f32_extents(port: &ValueInfoProto) -> Option<Vec<Option<usize>>> {
    let extent = |dimension: &Dimension| match dimension.value {
        Some(dimension::Value::DimValue(size)) => usize::try_from(size).ok(),
        _ => None,
    };
    let shape = tensor_type(port).filter(|_| is_f32(port))?.shape.as_ref()?;
    Some(shape.dim.iter().map(extent).collect())
}

/// Whether the elements of an input or output are 32-bit floats.
pub fn is_f32(port: &ValueInfoProto) -> bool {
    tensor_type(port).is_some_and(|tensor| tensor.elem_type == DataType::Float as i32)
}

fn tensor_type(port: &ValueInfoProto) -> Option<&type_proto::Tensor> {
    match port.r#type.as_ref()?.value.as_ref()? {
        type_proto::Value::TensorType(tensor) => Some(tensor),
        _ => None,
    }
}

/// Element type and shape of an input or output, as "f32 [1, 200]".
pub fn describe(port: &ValueInfoProto) -> String {
    let Some(tensor) = tensor_type(port) else { return "of no known type".into() };
    let element = match DataType::try_from(tensor.elem_type) {
        Ok(DataType::Float) => "f32".into(),
        Ok(DataType::Double) => "f64".into(),
        Ok(DataType::Float16) => "f16".into(),
        Ok(other) => format!("{other:?}"),
        Err(_) => format!("type {}", tensor.elem_type),
    };
    let Some(shape) = &tensor.shape else { return format!("{element} without a shape") };
    let dimensions = shape.dim.iter();
    let sizes: Vec<String> = dimensions
        .map(|dimension| match &dimension.value {
            Some(dimension::Value::DimValue(size)) => size.to_string(),
            Some(dimension::Value::DimParam(name)) => name.clone(),
            None => "?".into(),
        })
        .collect();
    format!("{element} [{}]", sizes.join(", "))
}
