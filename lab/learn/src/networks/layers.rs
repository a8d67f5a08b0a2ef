//! The networks of actor and critic, and their initialisation.
//!
//! A [`Network`] reads one row of features for each user slot. [`Encoder::Mlp`] is the paper's
//! plain network over all slots in a row. [`Encoder::PerUser`] applies the same layers to each
//! user, so its output does not depend on the order or the number of users.
//!
//! Every random number comes from a generator that the caller passes; candle's own is never used.

use candle_core::{Device, Result, Tensor, Var};
use rand::{Rng, RngExt};

use crate::training::store::{Persistent, Store};

/// The way in which a network reads the users' slots.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Encoder {
    /// The same layers for each user. Other users enter through the features only.
    PerUser,
    /// The paper's two layers over the features of all slots.
    Mlp,
}

/// The size of a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// The way in which slots are read.
    pub encoder: Encoder,
    /// Slots for users.
    pub slots: usize,
    /// Inputs for each slot.
    pub inputs: usize,
    /// Widths of the two hidden layers.
    pub hidden: [usize; 2],
    /// Outputs of an [`Encoder::Mlp`]; [`Encoder::PerUser`] has one output for each slot.
    pub outputs: usize,
}

/// Largest magnitude of the initial weights of an output layer: first actions and first values are
/// near zero. DDPG's own choice (Lillicrap and others, 2015, section 7).
const HEAD_INITIAL: f32 = 3e-3;

/// One fully connected layer: `y = x W + b`, with W of shape (inputs, outputs).
#[derive(Clone, Debug)]
pub struct Linear {
    /// Its name in checkpoints and exported graphs.
    pub name: &'static str,
    /// W, (inputs, outputs).
    pub weight: Tensor,
    /// b, (outputs).
    pub bias: Tensor,
}

impl Linear {
    pub(super) fn new(name: &'static str, inputs: usize, outputs: usize, rng: &mut impl Rng) -> Result<Self> {
        let limit = if name == "head" { HEAD_INITIAL } else { 1.0 / (inputs as f32).sqrt() };
        let mut draw = |count: usize| -> Vec<f32> { (0..count).map(|_| rng.random_range(-limit..limit)).collect() };
        let weight = Var::from_vec(draw(inputs * outputs), (inputs, outputs), &Device::Cpu)?;
        let bias = Var::from_vec(draw(outputs), outputs, &Device::Cpu)?;
        Ok(Self { name, weight: weight.into_inner(), bias: bias.into_inner() })
    }

    pub(super) fn forward(&self, input: &Tensor) -> Result<Tensor> {
        input.matmul(&self.weight)?.broadcast_add(&self.bias)
    }
}

/// A network of two hidden layers over the users' slots.
#[derive(Clone, Debug)]
pub struct Network {
    shape: Shape,
    layers: Vec<Linear>,
}

impl Network {
    /// A network with newly drawn parameters.
    ///
    /// # Errors
    /// Errors of candle, when memory runs out.
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

    /// Its layers, from input to output.
    pub fn layers(&self) -> &[Linear] {
        &self.layers
    }

    /// The layer of that name.
    ///
    /// # Panics
    /// No layer has that name; [`Network::new`] defines the names.
    pub fn layer(&self, name: &str) -> &Linear {
        self.layers.iter().find(|layer| layer.name == name).expect("Network::new defines the layer names")
    }

    /// Its parameters, in a fixed order.
    pub fn parameters(&self) -> Vec<&Tensor> {
        parameters(&self.layers)
    }

    /// The same parameters without gradients. It shares its memory with the original, later changes
    /// included.
    pub fn frozen(&self) -> Self {
        let freeze =
            |layer: &Linear| Linear { name: layer.name, weight: layer.weight.detach(), bias: layer.bias.detach() };
        Self { shape: self.shape, layers: self.layers.iter().map(freeze).collect() }
    }

    /// A copy with its own parameters.
    ///
    /// # Errors
    /// Errors of candle, when memory runs out.
    pub fn copy(&self) -> Result<Self> {
        let owned =
            |tensor: &Tensor| Ok::<_, candle_core::Error>(Var::from_tensor(&tensor.detach().copy()?)?.into_inner());
        let layer =
            |layer: &Linear| Ok(Linear { name: layer.name, weight: owned(&layer.weight)?, bias: owned(&layer.bias)? });
        Ok(Self { shape: self.shape, layers: self.layers.iter().map(layer).collect::<Result<_>>()? })
    }

    /// Outputs before any activation. Shape: (batch, outputs) of [`Encoder::Mlp`]; (batch, slots)
    /// of [`Encoder::PerUser`], without meaning in empty slots.
    ///
    /// `input` is (batch, slots, inputs), zero in empty slots.
    ///
    /// # Errors
    /// Errors of candle, when shapes differ.
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

    /// Outputs of an [`Encoder::Mlp`] with one slot: (batch, inputs) to (batch, outputs).
    ///
    /// # Errors
    /// Errors of candle, when shapes differ.
    pub fn forward_rows(&self, rows: &Tensor) -> Result<Tensor> {
        self.forward(&rows.unsqueeze(1)?)
    }
}

/// The parameters of layers, in a fixed order.
pub fn parameters(layers: &[Linear]) -> Vec<&Tensor> {
    layers.iter().flat_map(|layer| [&layer.weight, &layer.bias]).collect()
}

impl AsRef<[Linear]> for Network {
    fn as_ref(&self) -> &[Linear] {
        &self.layers
    }
}

/// Moves `target` towards `source`: target <- tau source + (1 - tau) target.
///
/// # Errors
/// Errors of candle, when the networks differ in shape.
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
/// Errors of candle, when shapes differ.
pub fn assign(parameter: &Tensor, value: &Tensor) -> Result<()> {
    Var::from_tensor(parameter)?.set(value)
}

impl Persistent for Network {
    fn save(&self, name: &str, store: &mut Store) -> anyhow::Result<()> {
        save_layers(&self.layers, name, store);
        Ok(())
    }

    fn restore(&mut self, name: &str, store: &Store) -> anyhow::Result<()> {
        restore_layers(&self.layers, name, store)
    }
}

/// Writes the parameters of layers under a name.
pub(super) fn save_layers(layers: &[Linear], name: &str, store: &mut Store) {
    for (key, parameter) in named_parameters(name, layers) {
        store.put_tensor(key, parameter.detach());
    }
}

/// Reads the parameters of layers that [`save_layers`] wrote.
///
/// # Errors
/// The store lacks a parameter, or its shape differs.
pub(super) fn restore_layers(layers: &[Linear], name: &str, store: &Store) -> anyhow::Result<()> {
    for (key, parameter) in named_parameters(name, layers) {
        assign(parameter, store.tensor(&key)?)?;
    }
    Ok(())
}

fn named_parameters<'a>(name: &str, layers: &'a [Linear]) -> Vec<(String, &'a Tensor)> {
    let both = |layer: &'a Linear| {
        [("weight", &layer.weight), ("bias", &layer.bias)]
            .map(|(kind, tensor)| (format!("{name}.{}.{kind}", layer.name), tensor))
    };
    layers.iter().flat_map(both).collect()
}
