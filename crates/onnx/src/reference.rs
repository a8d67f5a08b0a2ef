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
mod call;
mod layout;

use std::collections::HashMap;

use crate::standard::foreign_operator;
use crate::tensor::{Data, Tensor};
use crate::{GraphProto, ModelProto, uncomputed_output};
use call::Call;

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
    /// The file has no graph, an output that no node computes, an operator that is not of the standard domain, or a constant of
    /// another type than f32 and i64.
    pub fn new(model: &ModelProto) -> Result<Self, Reason> {
        let graph = model.graph.clone().ok_or("a file without a graph")?;
        if let Some(foreign) = foreign_operator(&graph) {
            return Err(format!("the operator {foreign}"));
        }
        if let Some(output) = uncomputed_output(&graph) {
            return Err(format!("the output {output:?}, which no node computes"));
        }
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
            let outputs = evaluate(&call).ok_or_else(|| format!("the operator {} as it is used here", node.op_type))?;
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

/// The outputs of an operator; `None` where it, or this use of it, is not known.
fn evaluate(call: &Call<'_>) -> Option<Vec<Tensor>> {
    if call.node.op_type == "MaxPool" {
        return layout::max_pool(call);
    }
    arithmetic::evaluate(call).or_else(|| layout::evaluate(call)).map(|output| vec![output])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::{Ends, Graph};
    use prost::Message;

    fn model(graph: Graph) -> ModelProto {
        let file = graph.finish(&Ends { name: "test", input: ("x", 3), output: ("y", 3) }, &[]);
        ModelProto::decode(&file[..]).expect("just written")
    }

    #[test]
    fn clip_between_swapped_bounds_gives_the_maximum_and_keeps_nan() {
        let mut graph = Graph::default();
        let (low, high) = (graph.scalar(1.0), graph.scalar(-2.0));
        graph.node("Clip", &["x", &low, &high]);
        let found = Reference::new(&model(graph)).expect("it is known").run("x", &[-9.0, f32::NAN, 9.0]);
        let found = found.expect("it is known");
        assert!(found[0] == -2.0 && found[1].is_nan() && found[2] == -2.0, "{found:?}");
    }

    #[test]
    fn sign_is_zero_at_zero_and_keeps_nan() {
        let mut graph = Graph::default();
        graph.node("Sign", &["x"]);
        let reference = Reference::new(&model(graph)).expect("it is known");
        assert_eq!(reference.run("x", &[-9.0, 0.0, 0.5]).expect("it is known"), [-1.0, 0.0, 1.0]);
        assert!(reference.run("x", &[f32::NAN; 3]).expect("it is known").iter().all(|value| value.is_nan()));
    }

    #[test]
    fn an_operator_of_another_domain_is_not_taken_for_the_standard_one_of_its_name() {
        let mut graph = Graph::default();
        graph.node("Relu", &["x"]);
        let mut model = model(graph);
        model.graph.as_mut().expect("a graph").node[0].domain = "com.example".into();
        let reason = Reference::new(&model).err().expect("another domain");
        assert_eq!(reason, "the operator Relu of the domain \"com.example\"");
    }
}
