//! The dense engine: which graphs it reads, and which it refuses with the reason.

use allocation_counter::measure;
use heliostat_core::policy::{DenseError, DenseNetwork, Network};
use heliostat_onnx::{ModelProto, NodeProto, tensor_proto::DataType};
use prost::Message;

use crate::dense_graphs::{Chain, tensor, with_open_rows};

/// 3 inputs, 4 hidden values, 2 outputs.
fn small() -> ModelProto {
    let ramp = |count: usize| (0..count).map(|index| 0.1 * index as f32 - 0.3).collect::<Vec<f32>>();
    let mut chain = Chain::new(3);
    chain.node("MatMul", 0, &[(&[3, 4], ramp(12))]).node("Add", 0, &[(&[1, 4], ramp(4))]).node("Relu", 0, &[]);
    chain.node("Gemm", 0, &[(&[4, 2], ramp(8)), (&[2], ramp(2))]).node("Tanh", 0, &[]).model(2)
}

fn read(model: &ModelProto) -> Result<DenseNetwork, DenseError> {
    DenseNetwork::read(&model.encode_to_vec(), 3)
}

/// The refusal of a model, which names all these words.
fn assert_refused(model: &ModelProto, words: &[&str]) {
    let refusal = read(model).expect_err("a refusal").to_string();
    assert!(words.iter().all(|word| refusal.contains(word)), "{refusal}: expected {words:?}");
}

fn node<'a>(model: &'a mut ModelProto, operator: &str) -> &'a mut NodeProto {
    let nodes = &mut model.graph.as_mut().expect("a graph").node;
    nodes.iter_mut().find(|node| node.op_type == operator).expect("it was added")
}

#[test]
fn a_small_network_has_the_values_of_the_equations() {
    let mut network = read(&small()).expect("a dense graph");
    network.set_rows(2).expect("any number");
    network.input_mut().copy_from_slice(&[1.0, -2.0, 0.5, 0.0, 0.0, 0.0]);
    let found = network.run().expect("it is finite").to_vec();
    let ramp = |index: usize| 0.1 * index as f64 - 0.3;
    for (row, input) in [[1.0, -2.0, 0.5], [0.0; 3]].iter().enumerate() {
        let hidden: Vec<f64> = (0..4)
            .map(|column| (0..3).map(|at| input[at] * ramp(4 * at + column)).sum::<f64>() + ramp(column))
            .map(|value| value.max(0.0))
            .collect();
        for column in 0..2 {
            let sum: f64 = (0..4).map(|at| hidden[at] * ramp(2 * at + column)).sum();
            let expected = (sum + ramp(column)).tanh();
            let found = f64::from(found[2 * row + column]);
            assert!((found - expected).abs() < 1e-6, "row {row}, column {column}: {found}, expected {expected}");
        }
    }
}

#[test]
fn every_operator_outside_dense_graphs_is_refused_by_name() {
    for operator in ["Softmax", "Concat", "Slice", "ArgMax", "ReduceSum", "Conv", "Reshape", "Pow", "Transpose"] {
        let mut model = small();
        node(&mut model, "Relu").op_type = operator.into();
        assert_refused(&model, &["relu_2", operator, "LeakyRelu"]);
    }
    let mut model = small();
    node(&mut model, "Relu").domain = "com.example".into();
    assert_refused(&model, &["com.example.Relu"]);
}

#[test]
fn another_use_of_a_dense_operator_is_refused_with_what_is_expected() {
    let mut transposed = Chain::new(3);
    transposed.node("Gemm", 0, &[(&[3, 2], vec![0.5; 6])]).integer("transA", 1);
    assert_refused(&transposed.model(2), &["Gemm", "transA = 1"]);
    let mut attribute = Chain::new(3);
    attribute.node("Relu", 0, &[]).integer("axis", 1);
    assert_refused(&attribute.model(3), &["Relu", "the attribute axis", "no attribute"]);
    let mut first = Chain::new(3);
    first.node("MatMul", 1, &[(&[1, 3], vec![0.5; 3])]);
    assert_refused(&first.model(3), &["MatMul", "a first input that is a constant"]);
    let mut model = small();
    node(&mut model, "Tanh").output.push("more".into());
    assert_refused(&model, &["Tanh", "2 outputs"]);
    let mut model = small();
    node(&mut model, "Relu").input[0] = "matmul_0".into();
    assert_refused(&model, &["Relu", "\"matmul_0\"", "a chain"]);
    let mut squared = Chain::new(3);
    squared.node("Mul", 0, &[(&[3], vec![1.0; 3])]);
    let mut squared = squared.model(3);
    node(&mut squared, "Mul").input[1] = "x".into();
    assert_refused(&squared, &["Mul", "exactly once"]);
    let mut model = small();
    model.graph.as_mut().expect("a graph").node.pop();
    assert_refused(&model, &["output", "\"y\"", "gemm_3"]);
}

#[test]
fn shapes_that_do_not_fit_are_refused_with_both() {
    let mut model = small();
    let weights = tensor(&mut model, "MatMul");
    weights.dims = vec![4, 3];
    assert_refused(&model, &["MatMul", "[4, 3]", "[3, outputs]"]);
    let mut model = small();
    tensor(&mut model, "Add").dims = vec![4, 1];
    assert_refused(&model, &["Add", "[4, 1]", "4 columns"]);
    let mut wider = Chain::new(1);
    wider.node("Add", 0, &[(&[3], vec![1.0; 3])]);
    let refusal = DenseNetwork::read(&wider.model(3).encode_to_vec(), 1).expect_err("it widens the rows").to_string();
    assert!(refusal.contains("[3]") && refusal.contains("1 columns"), "{refusal}");
    let refusal = DenseNetwork::read(&small().encode_to_vec(), 5).expect_err("it has 3 inputs").to_string();
    assert!(["input", "f32 [1, 3]", "f32 [rows, 5]"].iter().all(|word| refusal.contains(word)), "{refusal}");
}

#[test]
fn constants_that_are_absent_or_damaged_are_refused_by_name() {
    let mut model = small();
    model.graph.as_mut().expect("a graph").initializer.remove(0);
    assert_refused(&model, &["MatMul", "\"MatMul_x_0\"", "tensors of the file"]);
    let mut model = small();
    tensor(&mut model, "Gemm").raw_data.truncate(5);
    assert_refused(&model, &["Gemm", "another type or length"]);
    let mut model = small();
    tensor(&mut model, "Gemm").data_type = DataType::Float16 as i32;
    assert_refused(&model, &["Gemm", "32-bit floats"]);
    let mut slope = Chain::new(3);
    slope.node("LeakyRelu", 0, &[]).float("alpha", f32::NAN);
    assert_refused(&slope.model(3), &["LeakyRelu", "alpha = NaN"]);
}

#[test]
fn a_cut_file_is_refused_or_computes_the_same() {
    let file = small().encode_to_vec();
    let answer = |mut network: DenseNetwork| {
        network.input_mut().copy_from_slice(&[0.3, -0.2, 0.9]);
        network.run().expect("it is finite").to_vec()
    };
    let expected = answer(DenseNetwork::read(&file, 3).expect("the complete file"));
    let cuts = (0..file.len()).map(|length| DenseNetwork::read(&file[..length], 3));
    let refused = cuts.filter_map(|cut| cut.map(|network| assert_eq!(answer(network), expected)).err()).count();
    assert!(2 * refused > file.len(), "{refused} of {} refused", file.len());
}

#[test]
fn a_run_allocates_nothing_whatever_the_rows_up_to_the_largest_number_so_far() {
    let mut network = read(&with_open_rows(small())).expect("a dense graph");
    network.set_rows(64).expect("any number");
    let allocated = measure(|| {
        for rows in [64, 1, 5, 64, 17] {
            network.set_rows(rows).expect("any number");
            network.input_mut().fill(0.5);
            assert_eq!(network.run().expect("it is finite").len(), 2 * rows);
        }
    });
    assert_eq!(allocated.count_total, 0, "{allocated:?}");
    assert!(network.set_rows(0).is_err());
}
