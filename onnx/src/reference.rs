//! A reference evaluation of ONNX graphs: plain loops over the operators that exported actors use.
//!
//! It verifies an inference engine when a file is loaded, and takes no part in decisions. NaN passes
//! through every operator, as the definition of ONNX and IEEE 754 require.
//!
//! ```
//! use heliostat_onnx::{ModelProto, graph::{Ends, Graph}, reference::Reference};
//! use prost::Message;
//!
//! let mut graph = Graph::default();
//! let two = graph.scalar(2.0);
//! graph.node("Mul", &["x", &two]);
//! let file = graph.finish(&Ends { name: "double", input: ("x", 3), output: ("y", 3) }, &[]);
//! let model = ModelProto::decode(&file[..]).unwrap();
//! assert_eq!(Reference::new(&model).unwrap().run("x", &[1.0, 2.0, 3.0]).unwrap(), [2.0, 4.0, 6.0]);
//! ```

mod arithmetic;
mod layout;

use std::collections::HashMap;

use crate::tensor::{Data, Tensor};
use crate::{AttributeProto, GraphProto, ModelProto, NodeProto};

/// Largest number of multiplications and values of one evaluation: a fraction of a second.
const WORK_MAX: usize = 50_000_000;

/// Why a graph cannot be evaluated here.
pub type Reason = String;

/// A graph that is ready to be evaluated.
pub struct Reference {
    graph: GraphProto,
    constants: HashMap<String, Tensor>,
}

impl Reference {
    /// Prepares the graph of a file.
    ///
    /// # Errors
    /// The file has no graph, or a constant of another type than f32 and i64.
    pub fn new(model: &ModelProto) -> Result<Self, Reason> {
        let graph = model.graph.clone().ok_or("the file holds no graph")?;
        let read = |proto: &crate::TensorProto| {
            let tensor =
                Tensor::read(proto).ok_or_else(|| format!("the type or shape of the tensor {}", proto.name))?;
            Ok::<_, Reason>((proto.name.clone(), tensor))
        };
        let constants = graph.initializer.iter().map(read).collect::<Result<_, _>>()?;
        Ok(Self { graph, constants })
    }

    /// Evaluates the graph on one input of shape (1, n), and returns the values of its first output.
    ///
    /// # Errors
    /// An operator, or a use of it, that this evaluation does not know; or too much work.
    pub fn run(&self, input_name: &str, input: &[f32]) -> Result<Vec<f32>, Reason> {
        let input = Tensor { shape: vec![1, input.len()], data: Data::Floats(input.to_vec()) };
        let mut values = HashMap::from([(input_name.to_owned(), input)]);
        let mut work = 0;
        for node in &self.graph.node {
            let find = |name: &String| values.get(name).or_else(|| self.constants.get(name));
            // An empty name stands for an optional input that is absent.
            let inputs: Vec<Option<&Tensor>> = node.input.iter().map(find).collect();
            let call = Call { node, inputs };
            work += call.work();
            if work > WORK_MAX {
                return Err(format!("more than {WORK_MAX} multiplications"));
            }
            let outputs = call.evaluate().ok_or_else(|| format!("the operator {} as it is used here", node.op_type))?;
            let names = node.output.iter().filter(|name| !name.is_empty());
            values.extend(names.cloned().zip(outputs));
        }
        let output = self.graph.output.first().and_then(|port| values.remove(&port.name));
        match output.map(|tensor| tensor.data) {
            Some(Data::Floats(values)) => Ok(values),
            _ => Err("an output that no operator computes as f32".into()),
        }
    }
}

/// One operator with its inputs.
struct Call<'a> {
    node: &'a NodeProto,
    inputs: Vec<Option<&'a Tensor>>,
}

impl<'a> Call<'a> {
    /// The outputs; `None` for an operator, or a use of it, that is not known.
    fn evaluate(&self) -> Option<Vec<Tensor>> {
        if self.node.op_type == "MaxPool" {
            return layout::max_pool(self);
        }
        arithmetic::evaluate(self).or_else(|| layout::evaluate(self)).map(|output| vec![output])
    }

    /// An estimate of the multiplications, before any of them.
    fn work(&self) -> usize {
        let size = |tensor: &Tensor| tensor.shape.iter().product::<usize>();
        let values = self.inputs.iter().flatten().map(|tensor| size(tensor)).fold(0_usize, usize::saturating_add);
        match (self.node.op_type.as_str(), self.inputs.as_slice()) {
            // Each value of the left table meets a row of the right one.
            ("MatMul" | "Gemm", [Some(left), Some(right), ..]) => {
                size(left).saturating_mul(right.shape.last().copied().unwrap_or(1).max(1))
            }
            // By broadcasting.
            ("Add" | "Sub" | "Mul" | "Div" | "Pow" | "Max" | "Min", [Some(left), Some(right), ..]) => {
                let shape = arithmetic::broadcast(&left.shape, &right.shape).unwrap_or_default();
                shape.iter().fold(1, |product, extent| usize::saturating_mul(product, *extent))
            }
            ("Gather", [Some(table), Some(indices)]) => size(table).saturating_mul(size(indices)),
            _ => values,
        }
    }

    fn input(&self, index: usize) -> Option<&'a Tensor> {
        self.inputs.get(index).copied().flatten()
    }

    fn floats(&self, index: usize) -> Option<&'a [f32]> {
        match &self.input(index)?.data {
            Data::Floats(values) => Some(values),
            Data::Integers(_) => None,
        }
    }

    fn integers(&self, index: usize) -> Option<&'a [i64]> {
        match &self.input(index)?.data {
            Data::Integers(values) => Some(values),
            Data::Floats(_) => None,
        }
    }

    fn attribute(&self, name: &str) -> Option<&'a AttributeProto> {
        self.node.attribute.iter().find(|attribute| attribute.name == name)
    }

    fn integer(&self, name: &str, default: i64) -> i64 {
        self.attribute(name).map_or(default, |attribute| attribute.i)
    }

    fn float(&self, name: &str, default: f32) -> f32 {
        self.attribute(name).map_or(default, |attribute| attribute.f)
    }
}

/// An axis that may be counted from the end.
fn axis_of(axis: i64, rank: usize) -> Option<usize> {
    let axis = if axis < 0 { axis + rank as i64 } else { axis };
    usize::try_from(axis).ok().filter(|axis| *axis < rank)
}

/// The extents before, at and after an axis: a tensor is `before` blocks of `at` rows of `after`
/// values.
fn around(shape: &[usize], axis: usize) -> (usize, usize, usize) {
    (shape[..axis].iter().product(), shape[axis], shape[axis + 1..].iter().product())
}
