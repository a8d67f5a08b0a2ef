//! Checkpoints: one safetensors file with everything that a run needs to go on as if it had never stopped.
//!
//! Networks, optimiser moments and replay are tensors of that file; whatever else a run keeps is JSON in a tensor of bytes named
//! `state`. The file is written beside the old one and renamed over it, so a crash while writing loses nothing. Resuming under
//! other settings or in another scenario is refused.

use std::collections::HashMap;
use std::path::Path;

use anyhow::{Context, bail, ensure};
use candle_core::{Device, Tensor, safetensors};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Serialize, de::DeserializeOwned};
use serde_json::{Map, Value};

use crate::learner::Learner;
use crate::networks::{Adam, Linear, Network, assign};
use crate::replay::Replay;

/// Raised when the content of a checkpoint changes.
const VERSION: u32 = 2;

/// The state of a run as named parts.
#[derive(Debug, Default)]
pub struct Store {
    tensors: HashMap<String, Tensor>,
    values: Map<String, Value>,
}

/// Writes a run's state to a file.
///
/// # Errors
/// A file that cannot be written; numbers that are none, and then the file stays as it was.
pub fn save(learner: &dyn Learner, path: &Path) -> anyhow::Result<()> {
    let mut store = Store::default();
    learner.save(&mut store)?;
    if let Some(name) = store.not_finite()? {
        bail!(
            "after {} episodes {name} holds values that are not finite: the training has diverged, and nothing is written; try lower \
             learning rates or a smaller reward.lambda",
            learner.episodes_done()
        );
    }
    store.put("version", &VERSION)?;
    store.put("settings", &learner.settings())?;
    store.put("scenario", &learner.scenario().hash())?;
    let bytes = serde_json::to_vec(&store.values)?;
    store.tensors.insert("state".into(), Tensor::from_slice(&bytes, bytes.len(), &Device::Cpu)?);
    let beside = path.with_extension("part");
    safetensors::save(&store.tensors, &beside).with_context(|| format!("cannot write {}", beside.display()))?;
    std::fs::rename(&beside, path).with_context(|| format!("cannot replace {}", path.display()))
}

/// Puts a run where the one that wrote the file was.
///
/// # Errors
/// A file that is missing, damaged, of another version, or of a run with other settings or another scenario.
pub fn load(learner: &mut dyn Learner, path: &Path) -> anyhow::Result<()> {
    let tensors = safetensors::load(path, &Device::Cpu)
        .with_context(|| format!("cannot read the checkpoint {}", path.display()))?;
    let state = tensors.get("state").with_context(|| format!("{} holds no state of a run", path.display()))?;
    let values = serde_json::from_slice(&state.to_vec1::<u8>()?)
        .with_context(|| format!("{} holds no state of a run", path.display()))?;
    let store = Store { tensors, values };
    let version: u32 = store.get("version")?;
    ensure!(version == VERSION, "checkpoint version {version}, but this program writes {VERSION}");
    let (then, now): (Value, Value) = (store.get("settings")?, learner.settings());
    if then != now {
        bail!("the run to resume had other settings:\n  then {then}\n  now  {now}");
    }
    let (then, now): (String, String) = (store.get("scenario")?, learner.scenario().hash());
    ensure!(then == now, "the run to resume was in scenario {then}, this is {now}");
    learner.restore(&store)
}

impl Store {
    /// The name of a tensor that holds a value which is not finite, where one does.
    fn not_finite(&self) -> anyhow::Result<Option<&str>> {
        for (name, tensor) in &self.tensors {
            if tensor.dtype().is_float()
                && !tensor.flatten_all()?.to_vec1::<f32>()?.iter().all(|value| value.is_finite())
            {
                return Ok(Some(name));
            }
        }
        Ok(None)
    }

    /// Keeps a value as JSON.
    ///
    /// # Errors
    /// A value that JSON cannot hold.
    pub fn put(&mut self, name: &str, value: &impl Serialize) -> anyhow::Result<()> {
        self.values.insert(name.into(), serde_json::to_value(value)?);
        Ok(())
    }

    /// The value of that name.
    ///
    /// # Errors
    /// One that is missing or of another type.
    pub fn get<T: DeserializeOwned>(&self, name: &str) -> anyhow::Result<T> {
        let value = self.values.get(name).with_context(|| format!("the checkpoint lacks {name}"))?;
        serde_json::from_value(value.clone()).with_context(|| format!("{name} in the checkpoint"))
    }

    /// Keeps real numbers.
    ///
    /// # Errors
    /// Those of candle.
    pub fn put_floats(&mut self, name: &str, values: &[f32]) -> anyhow::Result<()> {
        self.tensors.insert(name.into(), Tensor::from_slice(values, values.len(), &Device::Cpu)?);
        Ok(())
    }

    /// The real numbers of that name.
    ///
    /// # Errors
    /// Numbers that are missing.
    pub fn floats(&self, name: &str) -> anyhow::Result<Vec<f32>> {
        Ok(self.tensor(name)?.to_vec1()?)
    }

    /// Keeps a network's parameters.
    pub fn put_network(&mut self, name: &str, network: &Network) {
        for (key, parameter) in named_parameters(name, network) {
            self.tensors.insert(key, parameter.detach());
        }
    }

    /// Gives a network the parameters kept under that name.
    ///
    /// # Errors
    /// Parameters that are missing or of another shape.
    pub fn restore_network(&self, name: &str, network: &Network) -> anyhow::Result<()> {
        for (key, parameter) in named_parameters(name, network) {
            assign(parameter, self.tensor(&key)?)?;
        }
        Ok(())
    }

    /// Keeps an optimiser's steps and moments.
    ///
    /// # Errors
    /// Those of candle.
    pub fn put_adam(&mut self, name: &str, adam: &Adam) -> anyhow::Result<()> {
        let (steps, first, second) = adam.state();
        self.put(&format!("adam.{name}.steps"), &steps)?;
        for (kind, moments) in [("first", first), ("second", second)] {
            for (index, moment) in moments.iter().enumerate() {
                self.put_floats(&format!("adam.{name}.{kind}.{index}"), moment)?;
            }
        }
        Ok(())
    }

    /// Gives an optimiser the steps and moments kept under that name.
    ///
    /// # Errors
    /// Moments that are missing or of another shape.
    pub fn restore_adam(&self, name: &str, adam: &mut Adam) -> anyhow::Result<()> {
        let count = adam.state().1.len();
        let moments = |kind| (0..count).map(|index| self.floats(&format!("adam.{name}.{kind}.{index}"))).collect();
        let (first, second): (anyhow::Result<_>, anyhow::Result<_>) = (moments("first"), moments("second"));
        adam.restore(self.get(&format!("adam.{name}.steps"))?, first?, second?).map_err(anyhow::Error::msg)
    }

    /// Keeps the transitions of a replay buffer.
    ///
    /// # Errors
    /// Those of candle.
    pub fn put_replay(&mut self, replay: &Replay) -> anyhow::Result<()> {
        let (columns, next) = replay.state();
        for (index, column) in columns.iter().enumerate() {
            self.put_floats(&format!("replay.{index}"), column)?;
        }
        self.put("replay.next", &next)
    }

    /// Fills a replay buffer with the transitions kept.
    ///
    /// # Errors
    /// Transitions that are missing or of another shape.
    pub fn restore_replay(&self, replay: &mut Replay) -> anyhow::Result<()> {
        let [state, action, rewards, next] = [0, 1, 2, 3].map(|index| self.floats(&format!("replay.{index}")));
        replay.restore([state?, action?, rewards?, next?], self.get("replay.next")?).map_err(anyhow::Error::msg)
    }

    /// Keeps a generator's place.
    ///
    /// # Errors
    /// None that can happen: the place is plain numbers.
    pub fn put_generator(&mut self, generator: &ChaCha8Rng) -> anyhow::Result<()> {
        self.put("generator", &(generator.get_seed(), generator.get_word_pos().to_string()))
    }

    /// A generator at the place kept.
    ///
    /// # Errors
    /// A place that is missing or none.
    pub fn generator(&self) -> anyhow::Result<ChaCha8Rng> {
        let (seed, place): ([u8; 32], String) = self.get("generator")?;
        let mut generator = ChaCha8Rng::from_seed(seed);
        generator.set_word_pos(place.parse().context("the generator's place is no number")?);
        Ok(generator)
    }

    fn tensor(&self, name: &str) -> anyhow::Result<&Tensor> {
        self.tensors.get(name).with_context(|| format!("the checkpoint lacks {name}"))
    }
}

fn named_parameters<'a>(name: &str, network: &'a Network) -> Vec<(String, &'a Tensor)> {
    let both = |layer: &'a Linear| {
        [("weight", &layer.weight), ("bias", &layer.bias)]
            .map(|(kind, tensor)| (format!("{name}.{}.{kind}", layer.name), tensor))
    };
    network.layers().iter().flat_map(both).collect()
}
