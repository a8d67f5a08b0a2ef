//! One operator of a graph with its inputs, and the shapes of tensors.

use crate::tensor::{Data, Tensor};
use crate::{AttributeProto, NodeProto};

/// One operator with its inputs.
pub struct Call<'a> {
    /// The operator.
    pub node: &'a NodeProto,
    /// Its inputs; optional ones may be absent.
    pub inputs: Vec<Option<&'a Tensor>>,
}

impl<'a> Call<'a> {
    /// An estimate of the multiplications, before any of them.
    pub fn work(&self) -> usize {
        let size = |tensor: &Tensor| tensor.shape.iter().product::<usize>();
        let values = self.inputs.iter().flatten().map(|tensor| size(tensor)).fold(0_usize, usize::saturating_add);
        match (self.node.op_type.as_str(), self.inputs.as_slice()) {
            // Each value of the left table meets a row of the right one, which may be transposed.
            ("MatMul" | "Gemm", [Some(left), Some(right), ..]) => {
                size(left).saturating_mul(right.shape.iter().copied().max().unwrap_or(1))
            }
            // By broadcasting.
            ("Add" | "Sub" | "Mul" | "Div" | "Pow" | "Max" | "Min", [Some(left), Some(right), ..]) => {
                let shape = broadcast(&left.shape, &right.shape).unwrap_or_default();
                shape.iter().fold(1, |product, extent| usize::saturating_mul(product, *extent))
            }
            ("Gather", [Some(table), Some(indices)]) => size(table).saturating_mul(size(indices)),
            _ => values,
        }
    }

    /// An input.
    pub fn input(&self, index: usize) -> Option<&'a Tensor> {
        self.inputs.get(index).copied().flatten()
    }

    /// The values of an input of floats.
    pub fn floats(&self, index: usize) -> Option<&'a [f32]> {
        match &self.input(index)?.data {
            Data::Floats(values) => Some(values),
            Data::Integers(_) => None,
        }
    }

    /// The values of an input of integers.
    pub fn integers(&self, index: usize) -> Option<&'a [i64]> {
        match &self.input(index)?.data {
            Data::Integers(values) => Some(values),
            Data::Floats(_) => None,
        }
    }

    /// An attribute.
    pub fn attribute(&self, name: &str) -> Option<&'a AttributeProto> {
        self.node.attribute.iter().find(|attribute| attribute.name == name)
    }

    /// An attribute that is an integer.
    pub fn integer(&self, name: &str, default: i64) -> i64 {
        self.attribute(name).map_or(default, |attribute| attribute.i)
    }

    /// An attribute that is a float.
    pub fn float(&self, name: &str, default: f32) -> f32 {
        self.attribute(name).map_or(default, |attribute| attribute.f)
    }
}

/// An axis that may be counted from the end.
pub fn axis_of(axis: i64, rank: usize) -> Option<usize> {
    let axis = if axis < 0 { axis + rank as i64 } else { axis };
    usize::try_from(axis).ok().filter(|axis| *axis < rank)
}

/// The extents before, at and after an axis: a tensor is `before` blocks of `at` rows of `after`
/// values.
pub fn around(shape: &[usize], axis: usize) -> (usize, usize, usize) {
    (shape[..axis].iter().product(), shape[axis], shape[axis + 1..].iter().product())
}

/// The shape of two tensors by the rules of broadcasting; `None` where they do not fit.
pub fn broadcast(left: &[usize], right: &[usize]) -> Option<Vec<usize>> {
    let rank = left.len().max(right.len());
    let extent = |shape: &[usize], axis: usize| (axis + shape.len()).checked_sub(rank).map_or(1, |axis| shape[axis]);
    let pair = |axis| match (extent(left, axis), extent(right, axis)) {
        (a, b) if a == b || b == 1 => Some(a),
        (1, b) => Some(b),
        _ => None,
    };
    (0..rank).map(pair).collect()
}
