//! One node of a dense graph, and the layers that it stands for.
//!
//! Source: the operators as ONNX defines them from opset 7 on. Later opsets define them for more
//! types than f32; Clip has its bounds as attributes before opset 11.

use heliostat_onnx::{
    AttributeProto, NodeProto, TensorProto,
    tensor::{Data, Tensor},
};

use super::{
    error::DenseError,
    layers::{Activation, Layer, Linear, Operation},
};

/// What a node reads.
pub enum Input<'a> {
    /// The value of the node before it.
    Value,
    /// A tensor of the file.
    Constant(&'a TensorProto),
    /// Nothing, in place of an optional input.
    Absent,
}

/// A tensor of 32-bit floats, row-major.
struct Floats {
    shape: Vec<usize>,
    values: Vec<f32>,
}

/// A node with its inputs.
pub struct Call<'a> {
    /// The node.
    pub node: &'a NodeProto,
    /// Its inputs.
    pub inputs: Vec<Input<'a>>,
    /// The length of the rows that it reads.
    pub width: usize,
}

/// Appends the layers of a node.
///
/// # Errors
/// [`DenseError`] for another operator, or another use of an operator.
pub fn append(call: &Call<'_>, layers: &mut Vec<Layer>) -> Result<(), DenseError> {
    let activation = match call.operator()? {
        "Gemm" => return call.gemm(layers),
        "MatMul" => return call.mat_mul(layers),
        "Add" | "Sub" | "Mul" | "Div" => return call.arithmetic(layers),
        "Identity" => {
            call.check_form(&[], 1)?;
            return Ok(());
        }
        "Relu" => Activation::Relu,
        "LeakyRelu" => Activation::LeakyRelu(call.float("alpha", 0.01)?),
        "Elu" => Activation::Elu(call.float("alpha", 1.0)?),
        "Tanh" => Activation::Tanh,
        "Sigmoid" => Activation::Sigmoid,
        "Softplus" => Activation::Softplus,
        "Clip" => call.clip()?,
        _ => return Err(call.unsupported()),
    };
    match activation {
        Activation::LeakyRelu(_) | Activation::Elu(_) => call.check_form(&["alpha"], 1)?,
        Activation::Clip(..) => call.check_form(&["min", "max"], 3)?,
        _ => call.check_form(&[], 1)?,
    }
    layers.push(Layer::Activation(activation, call.width));
    Ok(())
}

impl<'a> Call<'a> {
    /// The refusal of this use of the operator.
    pub fn refused(&self, found: impl Into<String>, expected: impl Into<String>) -> DenseError {
        let (node, operator) = (self.name(), self.node.op_type.clone());
        DenseError::Node { node, operator, found: found.into(), expected: expected.into() }
    }

    /// The tensor of a node that is a constant; `None` for any other node.
    ///
    /// # Errors
    /// The constant is not given as a tensor.
    pub fn constant(&self) -> Result<Option<&'a TensorProto>, DenseError> {
        if self.operator()? != "Constant" {
            return Ok(None);
        }
        let [AttributeProto { name, t: Some(tensor), .. }] = &self.node.attribute[..] else {
            return Err(self.refused("another form of constant", "the attribute value, a tensor"));
        };
        if name != "value" || !self.inputs.is_empty() {
            return Err(self.refused(format!("the attribute {name}"), "the attribute value alone"));
        }
        Ok(Some(tensor))
    }

    /// The operator, of the standard domain.
    fn operator(&self) -> Result<&'a str, DenseError> {
        if ["", "ai.onnx"].contains(&self.node.domain.as_str()) {
            Ok(&self.node.op_type)
        } else {
            Err(self.unsupported())
        }
    }

    fn unsupported(&self) -> DenseError {
        let NodeProto { domain, op_type, .. } = self.node;
        let operator = if domain.is_empty() { op_type.clone() } else { format!("{domain}.{op_type}") };
        DenseError::Operator { node: self.name(), operator }
    }

    /// The node's name, or that of its output.
    fn name(&self) -> String {
        let name = Some(&self.node.name).filter(|name| !name.is_empty());
        let name = name.or(self.node.output.first());
        format!("\"{}\"", name.map_or("", String::as_str))
    }

    /// Checks that the value is the first of at most so many inputs, the others are constants, and
    /// no other attribute is set.
    fn check_form(&self, attributes: &[&str], inputs_max: usize) -> Result<(), DenseError> {
        if !matches!(self.inputs.first(), Some(Input::Value)) {
            return Err(self.refused("a first input that is a constant", "the output of the node before it"));
        }
        self.check_rest(attributes, inputs_max)
    }

    /// Checks that at most so many inputs are present, exactly one of them the value, and no other
    /// attribute is set.
    fn check_rest(&self, attributes: &[&str], inputs_max: usize) -> Result<(), DenseError> {
        if self.inputs.len() > inputs_max {
            return Err(self.refused(format!("{} inputs", self.inputs.len()), format!("at most {inputs_max}")));
        }
        if self.inputs.iter().filter(|input| matches!(input, Input::Value)).count() != 1 {
            return Err(self.refused("other inputs", "the output of the node before it exactly once, and constants"));
        }
        match self.node.attribute.iter().find(|attribute| !attributes.contains(&attribute.name.as_str())) {
            Some(other) => {
                let known = if attributes.is_empty() { "no attribute".to_owned() } else { attributes.join(", ") };
                Err(self.refused(format!("the attribute {}", other.name), known))
            }
            None => Ok(()),
        }
    }

    fn attribute(&self, name: &str) -> Option<&'a AttributeProto> {
        self.node.attribute.iter().find(|attribute| attribute.name == name)
    }

    fn float(&self, name: &str, default: f32) -> Result<f32, DenseError> {
        let value = self.attribute(name).map_or(default, |attribute| attribute.f);
        if value.is_finite() { Ok(value) } else { Err(self.refused(format!("{name} = {value}"), "a finite number")) }
    }

    fn flag(&self, name: &str) -> bool {
        self.attribute(name).is_some_and(|attribute| attribute.i != 0)
    }

    /// An input of 32-bit floats; `None` where it is absent.
    fn floats(&self, index: usize) -> Result<Option<Floats>, DenseError> {
        let proto = match self.inputs.get(index) {
            None | Some(Input::Absent) => return Ok(None),
            Some(Input::Value) => return Err(self.refused("a computed operand", "a tensor of the file")),
            Some(Input::Constant(proto)) => proto,
        };
        let Some(Tensor { shape, data: Data::Floats(values) }) = Tensor::read(proto) else {
            let found = format!("the tensor \"{}\" of another type or length", proto.name);
            return Err(self.refused(found, "32-bit floats, as many as the shape holds"));
        };
        Ok(Some(Floats { shape, values }))
    }

    fn expect_floats(&self, index: usize) -> Result<Floats, DenseError> {
        self.floats(index)?.ok_or_else(|| self.refused(format!("no input {}", index + 1), "a tensor of the file"))
    }

    /// The operands of an elementwise operator or of a bias: one value for each column.
    fn operands(&self, index: usize, columns: usize) -> Result<Vec<f32>, DenseError> {
        let Floats { shape, values } = self.expect_floats(index)?;
        match values[..] {
            _ if shape.len() > 2 || (shape.len() == 2 && shape[0] != 1) => {}
            [value] => return Ok(vec![value; columns]),
            _ if values.len() == columns => return Ok(values),
            _ => {}
        }
        let expected = format!("one value, or one for each of {columns} columns");
        Err(self.refused(format!("an operand of the shape {shape:?}"), expected))
    }

    fn mat_mul(&self, layers: &mut Vec<Layer>) -> Result<(), DenseError> {
        self.check_form(&[], 2)?;
        let Floats { shape, values } = self.expect_floats(1)?;
        let columns = self.columns(&shape, false)?;
        layers.push(Layer::Linear(Linear::new([self.width, columns], |row, column| values[row * columns + column])));
        Ok(())
    }

    fn gemm(&self, layers: &mut Vec<Layer>) -> Result<(), DenseError> {
        self.check_form(&["alpha", "beta", "transA", "transB"], 3)?;
        if self.flag("transA") {
            return Err(self.refused("transA = 1", "transA = 0"));
        }
        let (alpha, beta, width) = (self.float("alpha", 1.0)?, self.float("beta", 1.0)?, self.width);
        let (Floats { shape, values }, is_transposed) = (self.expect_floats(1)?, self.flag("transB"));
        let columns = self.columns(&shape, is_transposed)?;
        let place =
            |row: usize, column: usize| if is_transposed { column * width + row } else { row * columns + column };
        let mut linear = Linear::new([width, columns], |row, column| alpha * values[place(row, column)]);
        if !matches!(self.inputs.get(2), None | Some(Input::Absent)) {
            let bias = self.operands(2, columns)?;
            linear.add_bias(&bias.iter().map(|value| beta * value).collect::<Vec<_>>());
        }
        layers.push(Layer::Linear(linear));
        Ok(())
    }

    /// The columns of a table of weights, whose rows are the columns of the value.
    fn columns(&self, shape: &[usize], is_transposed: bool) -> Result<usize, DenseError> {
        match (shape, is_transposed) {
            ([rows, columns], false) | ([columns, rows], true) if *rows == self.width && *columns > 0 => Ok(*columns),
            _ => {
                let expected = if is_transposed { "[outputs, {}]" } else { "[{}, outputs]" };
                let expected = expected.replace("{}", &self.width.to_string());
                Err(self.refused(format!("weights of the shape {shape:?}"), expected))
            }
        }
    }

    fn arithmetic(&self, layers: &mut Vec<Layer>) -> Result<(), DenseError> {
        self.check_rest(&[], 2)?;
        let is_first = matches!(self.inputs[0], Input::Value);
        let operands = self.operands(usize::from(is_first), self.width)?;
        let negated = || operands.iter().map(|value| -value).collect();
        match (self.node.op_type.as_str(), is_first) {
            ("Add", _) => self.add(operands, layers),
            ("Sub", true) => self.add(negated(), layers),
            // c - x = (-x) + c, exactly.
            ("Sub", false) => {
                layers.push(Layer::Operands(Operation::Multiply, vec![-1.0; self.width]));
                layers.push(Layer::Operands(Operation::Add, operands));
            }
            ("Mul", _) => layers.push(Layer::Operands(Operation::Multiply, operands)),
            (_, true) => layers.push(Layer::Operands(Operation::Divide, operands)),
            (_, false) => layers.push(Layer::Operands(Operation::DivideInto, operands)),
        }
        Ok(())
    }

    /// Adds to the bias of the linear layer before it, or as a layer of its own.
    fn add(&self, operands: Vec<f32>, layers: &mut Vec<Layer>) {
        match layers.last_mut() {
            Some(Layer::Linear(linear)) => linear.add_bias(&operands),
            _ => layers.push(Layer::Operands(Operation::Add, operands)),
        }
    }

    fn clip(&self) -> Result<Activation, DenseError> {
        let bound = |index, name, default| match self.floats(index)? {
            None => self.float(name, default),
            Some(Floats { values, .. }) if values.len() == 1 => Ok(values[0]),
            Some(Floats { shape, .. }) => Err(self.refused(format!("a bound of the shape {shape:?}"), "one value")),
        };
        Ok(Activation::Clip(bound(1, "min", f32::MIN)?, bound(2, "max", f32::MAX)?))
    }
}
