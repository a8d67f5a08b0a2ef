//! Why a graph is not dense.

use thiserror::Error;

/// The operators of dense graphs.
pub(super) const SUPPORTED: &str =
    "Gemm, MatMul, Add, Sub, Mul, Div, Relu, LeakyRelu, Elu, Tanh, Sigmoid, Softplus, Clip, Identity, Constant";

/// Why the dense engine refuses a file.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DenseError {
    /// The bytes are not an ONNX model.
    #[error("it is not an ONNX model: {message}; export it again")]
    NotOnnx {
        /// Why.
        message: String,
    },
    /// The inputs or outputs of the graph have another number, type or shape.
    #[error("the {port} of the graph is {found}, expected {expected}; export it again in this shape")]
    Port {
        /// "input" or "output".
        port: &'static str,
        /// What was found.
        found: String,
        /// What was expected.
        expected: String,
    },
    /// An operator is not part of dense graphs.
    #[error(
        "the node {node} has the operator {operator}, which is not part of a dense graph: expected one of {SUPPORTED}"
    )]
    Operator {
        /// The node's name.
        node: String,
        /// The operator, with its domain if that is not the standard one.
        operator: String,
    },
    /// An operator of dense graphs is used in another way.
    #[error("the node {node} ({operator}) has {found}, expected {expected}")]
    Node {
        /// The node's name.
        node: String,
        /// The operator.
        operator: String,
        /// What was found.
        found: String,
        /// What was expected.
        expected: String,
    },
}
