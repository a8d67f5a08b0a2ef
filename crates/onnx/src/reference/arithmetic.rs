//! Operators that compute: element by element, products of tables, and reductions.

use crate::reference::call::{Call, around, axis_of, broadcast};
use crate::tensor::{Data, Tensor};

/// The output of an arithmetic operator; `None` for any other.
pub fn evaluate(call: &Call<'_>) -> Option<Tensor> {
    match call.node.op_type.as_str() {
        "Abs" => unary(call, f32::abs),
        "Atan" => unary(call, f32::atan),
        "Ceil" => unary(call, f32::ceil),
        "Cos" => unary(call, f32::cos),
        "Exp" => unary(call, f32::exp),
        "Floor" => unary(call, f32::floor),
        "Log" => unary(call, f32::ln),
        "Neg" => unary(call, |value| -value),
        "Reciprocal" => unary(call, f32::recip),
        // `f32::max` would return 0 for NaN.
        "Relu" => unary(call, |value| if value < 0.0 { 0.0 } else { value }),
        "Sigmoid" => unary(call, |value| 1.0 / (1.0 + (-value).exp())),
        // `f32::signum` has no zero.
        "Sign" => unary(call, |value| if value == 0.0 { value } else { value.signum() }),
        "Sin" => unary(call, f32::sin),
        "Sqrt" => unary(call, f32::sqrt),
        "Tanh" => unary(call, f32::tanh),
        "LeakyRelu" => {
            let slope = call.float("alpha", 0.01);
            unary(call, move |value| if value < 0.0 { slope * value } else { value })
        }
        "Elu" => {
            let factor = call.float("alpha", 1.0);
            unary(call, move |value| if value < 0.0 { factor * value.exp_m1() } else { value })
        }
        "Softplus" => unary(call, |value| {
            let above = if value < 0.0 { 0.0 } else { value };
            above + (-value.abs()).exp().ln_1p()
        }),
        "Clip" => clip(call),
        "Add" => binary(call, |a, b| a + b, |a, b| a.checked_add(b)),
        "Sub" => binary(call, |a, b| a - b, |a, b| a.checked_sub(b)),
        "Mul" => binary(call, |a, b| a * b, |a, b| a.checked_mul(b)),
        "Div" => binary(call, |a, b| a / b, |a, b| a.checked_div(b)),
        "Pow" => binary(call, f32::powf, |_, _| None),
        "Max" => binary(call, larger, |a, b| Some(a.max(b))),
        "Min" => binary(call, |a, b| -larger(-a, -b), |a, b| Some(a.min(b))),
        "MatMul" => mat_mul(call),
        "Gemm" => gemm(call),
        "ReduceSum" => reduce(call, |sum, value| sum + value, 1.0),
        "ReduceMean" => reduce(call, |sum, value| sum + value, f32::NAN),
        "ArgMax" => arg_max(call),
        "Softmax" => softmax(call),
        _ => None,
    }
}

fn floats(shape: Vec<usize>, values: Vec<f32>) -> Tensor {
    Tensor { shape, data: Data::Floats(values) }
}

/// The larger value; NaN if one is.
fn larger(a: f32, b: f32) -> f32 {
    if a.is_nan() || a > b { a } else { b }
}

fn unary(call: &Call<'_>, operator: impl Fn(f32) -> f32) -> Option<Tensor> {
    let values = call.floats(0)?.iter().map(|value| operator(*value)).collect();
    Some(floats(call.input(0)?.shape.clone(), values))
}

/// Where the minimum exceeds the maximum, every value becomes the maximum.
fn clip(call: &Call<'_>) -> Option<Tensor> {
    let bound = |index, default| match call.input(index) {
        Some(_) => call.floats(index)?.first().copied(),
        None => Some(default),
    };
    let (low, high) = (bound(1, f32::MIN)?, bound(2, f32::MAX)?);
    unary(call, |value| {
        let value = if value < low { low } else { value };
        if value > high { high } else { value }
    })
}

/// For each value of the broadcast shape, the index of the tensor's value.
fn indices(shape: &[usize], of: &[usize]) -> Vec<usize> {
    let mut indices = vec![0];
    let missing = of.len() - shape.len();
    for (axis, extent) in of.iter().enumerate() {
        let own = axis.checked_sub(missing).map_or(1, |axis| shape[axis]);
        let step = |index: usize| (0..*extent).map(move |at| index * own + if own == 1 { 0 } else { at });
        indices = indices.into_iter().flat_map(step).collect();
    }
    indices
}

fn binary(
    call: &Call<'_>,
    on_floats: impl Fn(f32, f32) -> f32,
    on_integers: impl Fn(i64, i64) -> Option<i64>,
) -> Option<Tensor> {
    let (left, right) = (call.input(0)?, call.input(1)?);
    if call.inputs.len() != 2 {
        return None;
    }
    let shape = broadcast(&left.shape, &right.shape)?;
    let pairs = indices(&left.shape, &shape).into_iter().zip(indices(&right.shape, &shape));
    let data = match (&left.data, &right.data) {
        (Data::Floats(a), Data::Floats(b)) => Data::Floats(pairs.map(|(i, j)| on_floats(a[i], b[j])).collect()),
        (Data::Integers(a), Data::Integers(b)) => {
            Data::Integers(pairs.map(|(i, j)| on_integers(a[i], b[j])).collect::<Option<_>>()?)
        }
        _ => return None,
    };
    Some(Tensor { shape, data })
}

/// A table of (rows, columns), perhaps transposed.
struct Table<'a> {
    values: &'a [f32],
    rows: usize,
    columns: usize,
    transposed: bool,
}

impl<'a> Table<'a> {
    fn of(call: &Call<'a>, index: usize, transposed: bool) -> Option<Self> {
        let [first, second] = call.input(index)?.shape[..] else { return None };
        let (rows, columns) = if transposed { (second, first) } else { (first, second) };
        Some(Self { values: call.floats(index)?, rows, columns, transposed })
    }

    fn at(&self, row: usize, column: usize) -> f32 {
        if self.transposed { self.values[column * self.rows + row] } else { self.values[row * self.columns + column] }
    }

    /// The product of two tables, in 64-bit floats.
    fn times(&self, right: &Self) -> Option<Vec<f32>> {
        if self.columns != right.rows {
            return None;
        }
        let mut values = Vec::with_capacity(self.rows * right.columns);
        let mut sums = vec![0.0_f64; right.columns];
        for row in 0..self.rows {
            sums.fill(0.0);
            for middle in 0..self.columns {
                let factor = f64::from(self.at(row, middle));
                for (column, sum) in sums.iter_mut().enumerate() {
                    *sum += factor * f64::from(right.at(middle, column));
                }
            }
            values.extend(sums.iter().map(|sum| *sum as f32));
        }
        Some(values)
    }
}

fn mat_mul(call: &Call<'_>) -> Option<Tensor> {
    let (left, right) = (Table::of(call, 0, false)?, Table::of(call, 1, false)?);
    Some(floats(vec![left.rows, right.columns], left.times(&right)?))
}

fn gemm(call: &Call<'_>) -> Option<Tensor> {
    let transposed = |name| call.integer(name, 0) != 0;
    let (left, right) = (Table::of(call, 0, transposed("transA"))?, Table::of(call, 1, transposed("transB"))?);
    let (alpha, beta) = (call.float("alpha", 1.0), call.float("beta", 1.0));
    let shape = vec![left.rows, right.columns];
    let mut values = left.times(&right)?;
    values.iter_mut().for_each(|value| *value *= alpha);
    if let Some(offset) = call.input(2) {
        let offsets = call.floats(2)?;
        if broadcast(&shape, &offset.shape)? != shape {
            return None;
        }
        let places = indices(&offset.shape, &shape);
        values.iter_mut().zip(places).for_each(|(value, place)| *value += beta * offsets[place]);
    }
    Some(floats(shape, values))
}

/// A reduction over the axes that the second input or the attribute `axes` names, all without one;
/// NaN as the factor stands for one over the number of values.
fn reduce(call: &Call<'_>, combine: fn(f32, f32) -> f32, factor: f32) -> Option<Tensor> {
    let mut shape = call.input(0)?.shape.clone();
    let mut values = call.floats(0)?.to_vec();
    let axes = match (call.integers(1), call.attribute("axes")) {
        (Some(axes), _) => axes.to_vec(),
        (None, Some(attribute)) => attribute.ints.clone(),
        (None, None) => (0..shape.len() as i64).collect(),
    };
    let axes = axes.iter().map(|axis| axis_of(*axis, shape.len())).collect::<Option<Vec<_>>>()?;
    let count: usize = axes.iter().map(|axis| shape[*axis]).product();
    for axis in &axes {
        let (before, at, after) = around(&shape, *axis);
        let sum = |block: usize, place: usize| (0..at).map(move |row| (block * at + row) * after + place);
        values = (0..before * after)
            .map(|index| sum(index / after, index % after).map(|at| values[at]).reduce(combine).unwrap_or(0.0))
            .collect();
        shape[*axis] = 1;
    }
    let factor = if factor.is_nan() { 1.0 / count as f32 } else { factor };
    values.iter_mut().for_each(|value| *value *= factor);
    if call.integer("keepdims", 1) == 0 {
        shape = shape.iter().enumerate().filter(|(axis, _)| !axes.contains(axis)).map(|(_, extent)| *extent).collect();
    }
    Some(floats(shape, values))
}

/// The first index of the maximum along an axis.
fn arg_max(call: &Call<'_>) -> Option<Tensor> {
    let (values, mut shape) = (call.floats(0)?, call.input(0)?.shape.clone());
    let axis = axis_of(call.integer("axis", 0), shape.len())?;
    if call.integer("select_last_index", 0) != 0 {
        return None;
    }
    let (before, at, after) = around(&shape, axis);
    let best = |index: usize| {
        let value = |row: usize| values[(index / after * at + row) * after + index % after];
        (1..at).fold(0, |best, row| if value(row) > value(best) { row } else { best }) as i64
    };
    let rows = (0..before * after).map(best).collect();
    if call.integer("keepdims", 1) == 0 {
        shape.remove(axis);
    } else {
        shape[axis] = 1;
    }
    Some(Tensor { shape, data: Data::Integers(rows) })
}

/// Along the last axis, which is the default of opset 13 and later.
fn softmax(call: &Call<'_>) -> Option<Tensor> {
    let (values, shape) = (call.floats(0)?, &call.input(0)?.shape);
    if axis_of(call.integer("axis", -1), shape.len())? + 1 != shape.len() {
        return None;
    }
    let mut values = values.to_vec();
    for row in values.chunks_exact_mut((*shape.last()?).max(1)) {
        let top = row.iter().copied().reduce(larger)?;
        row.iter_mut().for_each(|value| *value = (*value - top).exp());
        let sum: f32 = row.iter().sum();
        row.iter_mut().for_each(|value| *value /= sum);
    }
    Some(floats(shape.clone(), values))
}
