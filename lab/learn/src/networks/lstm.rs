//! A long short-term memory over a fixed number of steps, and two layers on its last state.
//!
//! With h and c zero before the first step, each input x(t) gives
//!
//! - the gates i, f, o = sigmoid and the candidate g = tanh of W (x(t), h(t-1)) + b,
//! - the cell c(t) = f c(t-1) + i g and the state h(t) = o tanh(c(t)).
//!
//! Sources: Hochreiter and Schmidhuber, Long short-term memory, Neural Computation 9(8), 1997; with
//! the forget gate f of Gers, Schmidhuber and Cummins, Learning to forget, Neural Computation
//! 12(10), 2000.

use candle_core::{DType, Device, Result, Tensor};
use rand::Rng;

use super::layers::{Linear, assign, restore_layers, save_layers};
use crate::training::store::{Persistent, Store};

/// Initial bias of the forget gate, so that a new network remembers: Jozefowicz, Zaremba and
/// Sutskever, An empirical exploration of recurrent network architectures, ICML 2015.
const FORGET_BIAS: f32 = 1.0;

/// The size of a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LstmShape {
    /// Number of steps.
    pub steps: usize,
    /// Inputs of a step.
    pub inputs: usize,
    /// Inputs behind those of the steps, which the layers on the last state read.
    pub further: usize,
    /// Width of the state, and of the layer on it.
    pub hidden: usize,
    /// Outputs.
    pub outputs: usize,
}

impl LstmShape {
    /// Inputs of the network: those of the steps, the oldest first, and the further ones.
    pub fn row(&self) -> usize {
        self.steps * self.inputs + self.further
    }
}

/// The network. Its layers are the gates, in the order i, f, o, g, then the first layer and the
/// head on the last state.
#[derive(Clone, Debug)]
pub struct Lstm {
    shape: LstmShape,
    layers: [Linear; 3],
}

impl Lstm {
    /// A network with newly drawn parameters and a head of zeros.
    ///
    /// # Errors
    /// Errors of candle, when memory runs out.
    pub fn new(shape: LstmShape, rng: &mut impl Rng) -> Result<Self> {
        let LstmShape { inputs, further, hidden, outputs, .. } = shape;
        let layers = [
            Linear::new("gates", inputs + hidden, 4 * hidden, rng)?,
            Linear::new("first", hidden + further, hidden, rng)?,
            Linear::new("head", hidden, outputs, rng)?,
        ];
        let [gates, _, head] = &layers;
        let mut bias = gates.bias.to_vec1::<f32>()?;
        bias[hidden..2 * hidden].fill(FORGET_BIAS);
        assign(&gates.bias, &Tensor::from_vec(bias, 4 * hidden, &Device::Cpu)?)?;
        assign(&head.weight, &head.weight.zeros_like()?)?;
        assign(&head.bias, &head.bias.zeros_like()?)?;
        Ok(Self { shape, layers })
    }

    /// Its size.
    pub fn shape(&self) -> LstmShape {
        self.shape
    }

    /// Gates, first layer and head.
    pub fn layers(&self) -> &[Linear; 3] {
        &self.layers
    }

    /// Outputs, (batch, outputs), for rows of inputs, (batch, [`LstmShape::row`]).
    ///
    /// # Errors
    /// Errors of candle, when shapes differ.
    pub fn forward(&self, rows: &Tensor) -> Result<Tensor> {
        let LstmShape { steps, inputs, further, hidden, .. } = self.shape;
        let [gates, first, head] = &self.layers;
        let mut state = Tensor::zeros((rows.dim(0)?, hidden), DType::F32, &Device::Cpu)?;
        let mut cell = state.clone();
        for step in 0..steps {
            let input = rows.narrow(1, step * inputs, inputs)?;
            let raw = gates.forward(&Tensor::cat(&[&input, &state], 1)?)?;
            let open = sigmoid(&raw.narrow(1, 0, 3 * hidden)?)?;
            let gate = |index: usize| open.narrow(1, index * hidden, hidden);
            let candidate = raw.narrow(1, 3 * hidden, hidden)?.tanh()?;
            cell = ((gate(1)? * cell)? + (gate(0)? * candidate)?)?;
            state = (gate(2)? * cell.tanh()?)?;
        }
        let further = rows.narrow(1, steps * inputs, further)?;
        head.forward(&first.forward(&Tensor::cat(&[&state, &further], 1)?)?.relu()?)
    }
}

fn sigmoid(values: &Tensor) -> Result<Tensor> {
    ((values * 0.5)?.tanh()? + 1.0)? * 0.5
}

impl AsRef<[Linear]> for Lstm {
    fn as_ref(&self) -> &[Linear] {
        &self.layers
    }
}

impl Persistent for Lstm {
    fn save(&self, name: &str, store: &mut Store) -> anyhow::Result<()> {
        save_layers(&self.layers, name, store);
        Ok(())
    }

    fn restore(&mut self, name: &str, store: &Store) -> anyhow::Result<()> {
        restore_layers(&self.layers, name, store)
    }
}
