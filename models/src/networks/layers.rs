//! The networks of actor and critic, their initialisation, and the optimiser.
//!
//! A [`Network`] reads one row of features for each user slot. [`Encoder::Mlp`] is the paper's plain network over all slots in a row;
//! [`Encoder::PerUser`] applies the same layers to each user, so its answer does not depend on the users' order and holds for any number of them.
//!
//! Every random number comes from a generator that the caller passes in; candle's own is never used.

use anyhow::Context;
use candle_core::{Device, Result, Tensor, Var, backprop::GradStore};
use rand::{Rng, RngExt};

/// How a network reads the users' slots.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Encoder {
    /// The same layers for each user, who see nothing of the others but what the features tell.
    PerUser,
    /// The paper's two layers over all slots side by side.
    Mlp,
}

/// The size of a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// How the slots are read.
    pub encoder: Encoder,
    /// Slots for users.
    pub slots: usize,
    /// Inputs for each slot.
    pub inputs: usize,
    /// Widths of the two hidden layers.
    pub hidden: [usize; 2],
    /// Outputs of an [`Encoder::Mlp`]; a network for each user has one output for each slot.
    pub outputs: usize,
}

/// The largest magnitude of a fresh output layer, so that the first actions are near zero and the first values too.
const HEAD_INITIAL: f32 = 3e-3;

/// One fully connected layer: `y = x W + b`, with W of shape (inputs, outputs).
#[derive(Clone, Debug)]
pub struct Linear {
    /// The name under which checkpoints and exported graphs hold it.
    pub name: &'static str,
    /// W, (inputs, outputs).
    pub weight: Tensor,
    /// b, (outputs).
    pub bias: Tensor,
}

impl Linear {
    fn new(name: &'static str, inputs: usize, outputs: usize, rng: &mut impl Rng) -> Result<Self> {
        let limit = if name == "head" { HEAD_INITIAL } else { 1.0 / (inputs as f32).sqrt() };
        let mut draw = |count: usize| -> Vec<f32> { (0..count).map(|_| rng.random_range(-limit..limit)).collect() };
        let weight = Var::from_vec(draw(inputs * outputs), (inputs, outputs), &Device::Cpu)?;
        let bias = Var::from_vec(draw(outputs), outputs, &Device::Cpu)?;
        Ok(Self { name, weight: weight.into_inner(), bias: bias.into_inner() })
    }

    fn forward(&self, input: &Tensor) -> Result<Tensor> {
        input.matmul(&self.weight)?.broadcast_add(&self.bias)
    }
}

/// Does the work on one thread of its own, with all of candle's.
///
/// candle shares each larger product out over all cores. Ours are so small that waiting for a core that is busy elsewhere takes far longer
/// than computing: minutes in place of seconds on a loaded machine.
///
/// # Errors
/// A thread that the system refuses.
pub fn on_one_thread<T: Send>(work: impl FnOnce() -> T + Send) -> anyhow::Result<T> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().context("cannot start a thread")?;
    Ok(pool.install(work))
}

/// A network of two hidden layers over the users' slots.
#[derive(Clone, Debug)]
pub struct Network {
    shape: Shape,
    layers: Vec<Linear>,
}

impl Network {
    /// A network with fresh parameters.
    ///
    /// # Errors
    /// Those of candle, when memory runs out.
    pub fn new(shape: Shape, rng: &mut impl Rng) -> Result<Self> {
        let [first, second] = shape.hidden;
        let (inputs, outputs) = match shape.encoder {
            Encoder::PerUser => (shape.inputs, 1),
            Encoder::Mlp => (shape.slots * shape.inputs, shape.outputs),
        };
        let layers = vec![
            Linear::new("first", inputs, first, rng)?,
            Linear::new("second", first, second, rng)?,
            Linear::new("head", second, outputs, rng)?,
        ];
        Ok(Self { shape, layers })
    }

    /// Its size.
    pub fn shape(&self) -> Shape {
        self.shape
    }

    /// Its layers, in the order in which data passes them.
    pub fn layers(&self) -> &[Linear] {
        &self.layers
    }

    /// The layer of that name.
    ///
    /// # Panics
    /// When there is none: the names are fixed by [`Network::new`].
    pub fn layer(&self, name: &str) -> &Linear {
        self.layers.iter().find(|layer| layer.name == name).expect("layer names are fixed by the encoder")
    }

    /// Its parameters, in a fixed order.
    pub fn parameters(&self) -> Vec<&Tensor> {
        self.layers.iter().flat_map(|layer| [&layer.weight, &layer.bias]).collect()
    }

    /// The same parameters, through which no gradient flows. Later changes of the original show here too.
    pub fn frozen(&self) -> Self {
        let freeze =
            |layer: &Linear| Linear { name: layer.name, weight: layer.weight.detach(), bias: layer.bias.detach() };
        Self { shape: self.shape, layers: self.layers.iter().map(freeze).collect() }
    }

    /// A copy with parameters of its own.
    ///
    /// # Errors
    /// Those of candle, when memory runs out.
    pub fn copy(&self) -> Result<Self> {
        let own =
            |tensor: &Tensor| Ok::<_, candle_core::Error>(Var::from_tensor(&tensor.detach().copy()?)?.into_inner());
        let layer =
            |layer: &Linear| Ok(Linear { name: layer.name, weight: own(&layer.weight)?, bias: own(&layer.bias)? });
        Ok(Self { shape: self.shape, layers: self.layers.iter().map(layer).collect::<Result<_>>()? })
    }

    /// Outputs before any activation: (batch, slots) of a network for each user, of no meaning in absent slots; (batch, outputs) of the plain one.
    ///
    /// `input` is (batch, slots, inputs), zero in absent slots.
    ///
    /// # Errors
    /// Those of candle, when shapes do not fit.
    pub fn forward(&self, input: &Tensor) -> Result<Tensor> {
        let (batch, slots, inputs) = input.dims3()?;
        let mut rows = match self.shape.encoder {
            Encoder::Mlp => input.reshape((batch, slots * inputs))?,
            Encoder::PerUser => input.reshape((batch * slots, inputs))?,
        };
        for name in ["first", "second"] {
            rows = self.layer(name).forward(&rows)?.relu()?;
        }
        let outputs = self.layer("head").forward(&rows)?;
        match self.shape.encoder {
            Encoder::Mlp => Ok(outputs),
            Encoder::PerUser => outputs.reshape((batch, slots)),
        }
    }
}

impl Network {
    /// Outputs of the plain network with one slot from rows of inputs: (batch, inputs) to (batch, outputs).
    ///
    /// # Errors
    /// Those of candle, when shapes do not fit.
    pub fn forward_rows(&self, rows: &Tensor) -> Result<Tensor> {
        self.forward(&rows.unsqueeze(1)?)
    }
}

/// Moves `target` towards `source`: target <- tau source + (1 - tau) target.
///
/// # Errors
/// Those of candle, when the networks differ in shape.
pub fn soft_update(target: &Network, source: &Network, tau: f64) -> Result<()> {
    for (target, source) in target.parameters().into_iter().zip(source.parameters()) {
        let moved = ((source.detach() * tau)? + (target.detach() * (1.0 - tau))?)?;
        assign(target, &moved)?;
    }
    Ok(())
}

/// Overwrites a parameter in place.
///
/// # Errors
/// Those of candle, when shapes differ.
pub fn assign(parameter: &Tensor, value: &Tensor) -> Result<()> {
    Var::from_tensor(parameter)?.set(value)
}

/// Adam, with its state in plain vectors so that a checkpoint holds all of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Adam {
    learning_rate: f64,
    clip: f64,
    step: u64,
    first_moment: Vec<Vec<f32>>,
    second_moment: Vec<Vec<f32>>,
}

impl Adam {
    const BETA: [f64; 2] = [0.9, 0.999];
    const EPSILON: f32 = 1e-8;

    /// An optimiser for the parameters of one network.
    pub fn new(network: &Network, learning_rate: f64) -> Self {
        let zeros: Vec<Vec<f32>> = network.parameters().iter().map(|tensor| vec![0.0; tensor.elem_count()]).collect();
        Self { learning_rate, clip: 0.0, step: 0, first_moment: zeros.clone(), second_moment: zeros }
    }

    /// The same, with gradients cut to this norm over all parameters; 0 is no limit.
    pub fn clipped(self, clip: f64) -> Self {
        Self { clip, ..self }
    }

    /// Sets the learning rate of the steps to come.
    pub fn set_learning_rate(&mut self, learning_rate: f64) {
        self.learning_rate = learning_rate;
    }

    /// Steps taken, first moments and second moments.
    pub fn state(&self) -> (u64, &[Vec<f32>], &[Vec<f32>]) {
        (self.step, &self.first_moment, &self.second_moment)
    }

    /// Takes the place of a state that [`Adam::state`] gave; refuses vectors of other lengths.
    ///
    /// # Errors
    /// A message when the lengths differ.
    pub fn restore(
        &mut self,
        step: u64,
        first: Vec<Vec<f32>>,
        second: Vec<Vec<f32>>,
    ) -> std::result::Result<(), String> {
        let lengths = |moments: &[Vec<f32>]| moments.iter().map(Vec::len).collect::<Vec<_>>();
        let wanted = lengths(&self.first_moment);
        if lengths(&first) != wanted || lengths(&second) != wanted {
            return Err(format!(
                "optimiser state does not fit: wanted lengths {wanted:?}, found {:?}",
                lengths(&first)
            ));
        }
        (self.step, self.first_moment, self.second_moment) = (step, first, second);
        Ok(())
    }

    /// One step down the gradient.
    ///
    /// # Errors
    /// Those of candle.
    pub fn step(&mut self, network: &Network, gradients: &GradStore) -> Result<()> {
        self.step += 1;
        let power = |beta: f64| 1.0 - beta.powf(self.step as f64);
        let [beta1, beta2] = Self::BETA;
        let rate = (self.learning_rate * power(beta2).sqrt() / power(beta1)) as f32;
        let (beta1, beta2) = (beta1 as f32, beta2 as f32);
        let factor = self.factor(network, gradients)?;
        for (index, parameter) in network.parameters().into_iter().enumerate() {
            let Some(gradient) = gradients.get(parameter) else { continue };
            let gradient = gradient.flatten_all()?.to_vec1::<f32>()?;
            let mut value = parameter.flatten_all()?.to_vec1::<f32>()?;
            let moments = self.first_moment[index].iter_mut().zip(&mut self.second_moment[index]);
            for ((value, gradient), (first, second)) in value.iter_mut().zip(&gradient).zip(moments) {
                let gradient = factor * gradient;
                *first = beta1 * *first + (1.0 - beta1) * gradient;
                *second = beta2 * *second + (1.0 - beta2) * gradient * gradient;
                *value -= rate * *first / (second.sqrt() + Self::EPSILON);
            }
            assign(parameter, &Tensor::from_vec(value, parameter.shape(), &Device::Cpu)?)?;
        }
        Ok(())
    }

    /// What cuts the gradients to the norm allowed.
    fn factor(&self, network: &Network, gradients: &GradStore) -> Result<f32> {
        if self.clip == 0.0 {
            return Ok(1.0);
        }
        let mut squared = 0.0;
        for gradient in network.parameters().into_iter().filter_map(|parameter| gradients.get(parameter)) {
            squared += f64::from(gradient.sqr()?.sum_all()?.to_scalar::<f32>()?);
        }
        Ok((self.clip / squared.sqrt().max(self.clip)) as f32)
    }
}
