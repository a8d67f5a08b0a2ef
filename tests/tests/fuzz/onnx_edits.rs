//! Edits of an ONNX file that keep it well-formed: shapes, operators, attributes and names change.

use heliostat_onnx::{AttributeProto, GraphProto, ModelProto, TensorProto};
use prost::Message;

use crate::script::Script;

/// Sizes of dimensions that break readers.
const SIZES: [i64; 10] = [0, -1, 1, 2, 200_000, 1 << 31, 1 << 40, i64::MAX, i64::MIN, 17];

/// Operators that a graph could name instead of its own.
const OPERATORS: [&str; 14] = [
    "",
    "Loop",
    "If",
    "ConstantOfShape",
    "Expand",
    "Tile",
    "Reshape",
    "Gather",
    "MatMul",
    "Conv",
    "Softmax",
    "Range",
    "Scan",
    "Nul\0Name",
];

/// The file after 1 to 4 edits of its structure, or of its bytes.
pub fn edited(script: &mut Script<'_>, file: &[u8]) -> Vec<u8> {
    if script.one_in(6) {
        let mut bytes = file.to_vec();
        script.edit_bytes(&mut bytes);
        return bytes;
    }
    let mut model = ModelProto::decode(file).expect("the shipped actor is valid");
    for _ in 0..=script.below(4) {
        edit(script, &mut model);
    }
    model.encode_to_vec()
}

fn edit(script: &mut Script<'_>, model: &mut ModelProto) {
    let Some(graph) = &mut model.graph else { return };
    match script.below(10) {
        0 if !model.opset_import.is_empty() => model.opset_import[0].version = SIZES[script.below(SIZES.len())],
        1 => model.graph = None,
        2 if !model.metadata_props.is_empty() => {
            let entry = script.position(model.metadata_props.len());
            let value = &mut model.metadata_props[entry].value;
            *value = script.edit_text(value);
        }
        3..=5 if !graph.initializer.is_empty() => {
            let tensor = script.position(graph.initializer.len());
            edit_tensor(script, &mut graph.initializer[tensor]);
        }
        _ => edit_node(script, graph),
    }
}

fn edit_tensor(script: &mut Script<'_>, tensor: &mut TensorProto) {
    match script.below(6) {
        0 => tensor.dims.push(SIZES[script.below(SIZES.len())]),
        1 | 2 if !tensor.dims.is_empty() => {
            let at = script.position(tensor.dims.len());
            tensor.dims[at] = SIZES[script.below(SIZES.len())];
        }
        3 => tensor.data_type = i32::from(script.byte() % 24),
        4 => tensor.raw_data.truncate(script.position(64)),
        _ => tensor.dims = vec![200_000, 200_000],
    }
}

fn edit_node(script: &mut Script<'_>, graph: &mut GraphProto) {
    if graph.node.is_empty() {
        return;
    }
    let names: Vec<String> = graph.node.iter().flat_map(|node| node.output.clone()).collect();
    let at = script.position(graph.node.len());
    let node = &mut graph.node[at];
    match script.below(7) {
        0 => node.op_type = OPERATORS[script.below(OPERATORS.len())].into(),
        1 if !node.input.is_empty() => {
            let input = script.position(node.input.len());
            // May form a circle.
            node.input[input] = names[script.position(names.len())].clone();
        }
        2 => drop(node.input.pop()),
        3 => drop(node.output.pop()),
        4 if !node.attribute.is_empty() => {
            let attribute = script.position(node.attribute.len());
            edit_attribute(script, &mut node.attribute[attribute]);
        }
        5 => node.name = "a\0b\u{1b}[2J".into(),
        _ => drop(graph.node.remove(at)),
    }
}

fn edit_attribute(script: &mut Script<'_>, attribute: &mut AttributeProto) {
    let size = SIZES[script.below(SIZES.len())];
    match script.below(5) {
        0 => attribute.i = size,
        1 => attribute.ints = vec![size; script.below(8)],
        2 => attribute.r#type = i32::from(script.byte() % 16),
        3 => attribute.f = f32::from_bits(size as u32),
        _ => attribute.name = "axis".into(),
    }
}
