//! The layers of a dense network, and their arithmetic on rows of 32-bit floats.
//!
//! All functions that run per value are inlined into the caller, which selects the instructions of
//! the processor. The order of operations is fixed and independent of the number of rows: a row has
//! the same result alone and among others, on every processor.

/// Outputs that are computed together: two vectors of AVX, or one of AVX-512.
const PANEL: usize = 16;
/// Rows that share one pass over the weights.
const ROWS: usize = 4;

/// One layer.
#[derive(Clone, Debug, PartialEq)]
pub enum Layer {
    /// y = x W + b.
    Linear(Linear),
    /// The same operation with the same operands for each row.
    Operands(Operation, Vec<f32>),
    /// The same function for each value; rows have this length.
    Activation(Activation, usize),
}

/// An operation of a value x and an operand c.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operation {
    /// x + c
    Add,
    /// x c
    Multiply,
    /// x / c
    Divide,
    /// c / x
    DivideInto,
}

/// A function of one value. NaN stays NaN in each of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Activation {
    /// max(x, 0)
    Relu,
    /// x, or this slope times x below 0.
    LeakyRelu(f32),
    /// x, or this factor times (exp(x) - 1) below 0.
    Elu(f32),
    /// tanh(x)
    Tanh,
    /// 1 / (1 + exp(-x))
    Sigmoid,
    /// ln(1 + exp(x))
    Softplus,
    /// x, within these bounds.
    Clip(f32, f32),
}

impl Layer {
    /// The length of a row after the layer.
    pub fn outputs(&self) -> usize {
        match self {
            Self::Linear(linear) => linear.outputs,
            Self::Operands(_, operands) => operands.len(),
            Self::Activation(_, length) => *length,
        }
    }

    /// Applies the layer to `rows` rows of `from`; whether the result is in `to` instead of `from`.
    #[inline(always)]
    pub fn apply(&self, rows: usize, from: &mut [f32], to: &mut [f32]) -> bool {
        match self {
            Self::Linear(linear) => {
                linear.apply(rows, from, to);
                return true;
            }
            Self::Operands(operation, operands) => {
                for row in from[..rows * operands.len()].chunks_exact_mut(operands.len()) {
                    operation.apply(row, operands);
                }
            }
            Self::Activation(activation, length) => activation.apply(&mut from[..rows * length]),
        }
        false
    }
}

/// A linear layer, y = x W + b.
///
/// The weights are stored as panels of 16 outputs, each with 16 weights per input. The last panel
/// is filled up with zeros.
#[derive(Clone, Debug, PartialEq)]
pub struct Linear {
    inputs: usize,
    outputs: usize,
    panels: Vec<[f32; PANEL]>,
    bias: Vec<[f32; PANEL]>,
}

impl Linear {
    /// A layer without bias from its weights (inputs, outputs).
    pub fn new([inputs, outputs]: [usize; 2], weight: impl Fn(usize, usize) -> f32) -> Self {
        let lane = |input: usize, output: usize| if output < outputs { weight(input, output) } else { 0.0 };
        let lanes = |panel: usize, input: usize| std::array::from_fn(|offset| lane(input, panel * PANEL + offset));
        let count = outputs.div_ceil(PANEL);
        let panels = (0..count).flat_map(|panel| (0..inputs).map(move |input| (panel, input)));
        Self {
            inputs,
            outputs,
            panels: panels.map(|(panel, input)| lanes(panel, input)).collect(),
            bias: vec![[0.0; PANEL]; count],
        }
    }

    /// Adds to the bias, one value for each output.
    pub fn add_bias(&mut self, bias: &[f32]) {
        self.bias.as_flattened_mut().iter_mut().zip(bias).for_each(|(sum, value)| *sum += value);
    }

    #[inline(always)]
    fn apply(&self, rows: usize, from: &[f32], to: &mut [f32]) {
        for (index, (panel, bias)) in self.panels.chunks_exact(self.inputs).zip(&self.bias).enumerate() {
            let at = Place { first: index * PANEL, row: 0 };
            for row in (0..rows - rows % ROWS).step_by(ROWS) {
                self.tile::<ROWS>((panel, bias), from, to, Place { row, ..at });
            }
            let last = Place { row: rows - rows % ROWS, ..at };
            match rows % ROWS {
                1 => self.tile::<1>((panel, bias), from, to, last),
                2 => self.tile::<2>((panel, bias), from, to, last),
                3 => self.tile::<3>((panel, bias), from, to, last),
                _ => {}
            }
        }
    }

    /// The outputs of one panel for a few rows.
    #[inline(always)]
    fn tile<const COUNT: usize>(
        &self,
        (panel, bias): (&[[f32; PANEL]], &[f32; PANEL]),
        from: &[f32],
        to: &mut [f32],
        at: Place,
    ) {
        let inputs = &from[at.row * self.inputs..][..COUNT * self.inputs];
        let rows: [&[f32]; COUNT] = std::array::from_fn(|row| &inputs[row * self.inputs..][..panel.len()]);
        let mut sums = [*bias; COUNT];
        for (input, weights) in panel.iter().enumerate() {
            for (sums, row) in sums.iter_mut().zip(&rows) {
                let value = row[input];
                for (sum, weight) in sums.iter_mut().zip(weights) {
                    *sum += value * weight;
                }
            }
        }
        let count = PANEL.min(self.outputs - at.first);
        for (row, sums) in sums.iter().enumerate() {
            to[(at.row + row) * self.outputs + at.first..][..count].copy_from_slice(&sums[..count]);
        }
    }
}

/// The first output and the first row of a tile.
#[derive(Clone, Copy)]
struct Place {
    first: usize,
    row: usize,
}

impl Operation {
    #[inline(always)]
    fn apply(self, row: &mut [f32], operands: &[f32]) {
        let pairs = row.iter_mut().zip(operands);
        match self {
            Self::Add => pairs.for_each(|(value, operand)| *value += operand),
            Self::Multiply => pairs.for_each(|(value, operand)| *value *= operand),
            Self::Divide => pairs.for_each(|(value, operand)| *value /= operand),
            Self::DivideInto => pairs.for_each(|(value, operand)| *value = operand / *value),
        }
    }
}

impl Activation {
    #[inline(always)]
    fn apply(self, values: &mut [f32]) {
        let values = values.iter_mut();
        match self {
            Self::Relu => values.for_each(|value| *value = if *value < 0.0 { 0.0 } else { *value }),
            Self::LeakyRelu(slope) => values.for_each(|value| *value *= if *value < 0.0 { slope } else { 1.0 }),
            Self::Elu(factor) => values.for_each(|value| {
                if *value < 0.0 {
                    *value = factor * value.exp_m1();
                }
            }),
            Self::Tanh => values.for_each(|value| *value = tanh(*value)),
            Self::Sigmoid => values.for_each(|value| *value = 0.5 + 0.5 * tanh(0.5 * *value)),
            Self::Softplus => values.for_each(|value| {
                let above = if *value < 0.0 { 0.0 } else { *value };
                *value = above + (-value.abs()).exp().ln_1p();
            }),
            Self::Clip(low, high) => values.for_each(|value| *value = clip(*value, low, high)),
        }
    }
}

/// A value within bounds; NaN stays NaN, unlike by `f32::min` and `f32::max`.
#[inline(always)]
fn clip(value: f32, low: f32, high: f32) -> f32 {
    let value = if value < low { low } else { value };
    if value > high { high } else { value }
}

/// tanh(x) as x P(x^2) / Q(x^2), within some units in the last place; the compiler vectorises it,
/// unlike `f32::tanh`.
///
/// Source: `generic_fast_tanh_float` of Eigen 3.4, Eigen/src/Core/MathFunctionsImpl.h. The argument
/// is limited to the bounds beyond which the fraction rounds to 1; rounding could exceed 1
/// otherwise.
#[inline(always)]
fn tanh(value: f32) -> f32 {
    const P: [f32; 7] =
        [-2.760_768_5e-16, 2.000_188e-13, -8.604_672e-11, 5.122_297e-8, 1.485_722_4e-5, 6.372_619_3e-4, 4.893_524_6e-3];
    const Q: [f32; 4] = [1.198_258_4e-6, 1.185_347_1e-4, 2.268_434_6e-3, 4.893_525e-3];
    const BOUND: f32 = 7.998_811_7;
    let value = clip(value, -BOUND, BOUND);
    let square = value * value;
    let p = P.iter().fold(0.0, |sum, coefficient| sum * square + coefficient);
    let q = Q.iter().fold(0.0, |sum, coefficient| sum * square + coefficient);
    clip(value * p / q, -1.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hyperbolic_tangent_is_that_of_64_bit_floats_and_keeps_nan() {
        let worst = (-120_000..=120_000)
            .map(|step| step as f32 * 1e-4)
            .map(|value| (f64::from(tanh(value)) - f64::from(value).tanh()).abs())
            .fold(0.0, f64::max);
        assert!(worst < 4e-7, "{worst}");
        assert!((tanh(1e-30) - 1e-30).abs() < 4e-37);
        assert!((-1.0..=-0.999_999).contains(&tanh(f32::NEG_INFINITY)) && tanh(9.0) <= 1.0 && tanh(f32::NAN).is_nan());
    }

    #[test]
    fn a_row_has_the_same_result_alone_and_among_others() {
        let linear = Linear::new([37, 21], |input, output| ((input * 21 + output) as f32 * 0.37).sin());
        let layer = Layer::Linear(linear);
        let mut rows: Vec<f32> = (0..9 * 37).map(|index| (index as f32 * 0.11).cos()).collect();
        let mut together = vec![0.0; 9 * 21];
        assert!(layer.apply(9, &mut rows, &mut together));
        for row in 0..9 {
            let mut alone = vec![0.0; 21];
            layer.apply(1, &mut rows[row * 37..][..37], &mut alone);
            assert_eq!(alone, together[row * 21..][..21], "row {row}");
        }
    }

    #[test]
    fn no_activation_hides_nan() {
        use Activation::{Clip, Elu, LeakyRelu, Relu, Sigmoid, Softplus, Tanh};
        for activation in [Relu, LeakyRelu(0.1), Elu(1.0), Tanh, Sigmoid, Softplus, Clip(-1.0, 1.0)] {
            let mut values = [f32::NAN, 0.5];
            activation.apply(&mut values);
            assert!(values[0].is_nan() && values[1].is_finite(), "{activation:?}");
        }
    }
}
