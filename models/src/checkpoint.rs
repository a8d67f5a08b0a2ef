//! Checkpoints: one safetensors file with everything that a run needs to go on as if it had never stopped.
//!
//! Networks, targets, optimiser moments and replay are tensors of that file; counters, the generator's place and the settings are
//! JSON in a tensor of bytes named `state`. The file is written beside the old one and renamed over it, so a crash while writing loses
//! nothing. Resuming under other settings or in another scenario is refused.

use std::collections::HashMap;
use std::path::Path;

use anyhow::{Context, bail, ensure};
use candle_core::{Device, Tensor, safetensors};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::ddpg::Trainer;
use crate::networks::{Adam, Network, assign};

/// Raised when the content of a checkpoint changes; 1 is the first.
const VERSION: u32 = 1;

/// What is not a tensor of numbers.
#[derive(Serialize, Deserialize)]
struct State {
    version: u32,
    settings: String,
    scenario: String,
    episode: usize,
    generator_seed: [u8; 32],
    generator_place: String,
    replay_next: usize,
    actor_steps: u64,
    critic_steps: u64,
}

type Tensors = HashMap<String, Tensor>;

impl Trainer {
    /// Writes the run's state to a file.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn save(&self, path: &Path) -> anyhow::Result<()> {
        let (columns, replay_next) = self.replay.state();
        let state = State {
            version: VERSION,
            settings: serde_json::to_string(&self.settings)?,
            scenario: self.scenario.hash(),
            episode: self.episode,
            generator_seed: self.rng.get_seed(),
            generator_place: self.rng.get_word_pos().to_string(),
            replay_next,
            actor_steps: self.actor_adam.state().0,
            critic_steps: self.critic_adam.state().0,
        };
        let mut tensors = Tensors::new();
        for (name, network) in self.networks() {
            put_network(&mut tensors, name, network);
        }
        put_moments(&mut tensors, "actor", &self.actor_adam)?;
        put_moments(&mut tensors, "critic", &self.critic_adam)?;
        for (index, column) in columns.iter().enumerate() {
            put(&mut tensors, format!("replay.{index}"), column)?;
        }
        let bytes = serde_json::to_vec(&state)?;
        tensors.insert("state".into(), Tensor::from_slice(&bytes, bytes.len(), &Device::Cpu)?);

        let beside = path.with_extension("part");
        safetensors::save(&tensors, &beside).with_context(|| format!("cannot write {}", beside.display()))?;
        std::fs::rename(&beside, path).with_context(|| format!("cannot replace {}", path.display()))
    }

    /// Takes the place of the run that wrote the file.
    ///
    /// # Errors
    /// A file that is missing, damaged, of another version, or of a run with other settings or another scenario.
    pub fn load(&mut self, path: &Path) -> anyhow::Result<()> {
        let tensors = safetensors::load(path, &Device::Cpu)
            .with_context(|| format!("cannot read the checkpoint {}", path.display()))?;
        let state: State = serde_json::from_slice(&get(&tensors, "state")?.to_vec1::<u8>()?)
            .with_context(|| format!("{} holds no state of a run", path.display()))?;
        self.check(&state)?;
        for (name, network) in self.networks() {
            for (key, parameter) in named_parameters(name, network) {
                assign(parameter, get(&tensors, &key)?)?;
            }
        }
        for (name, adam, steps) in
            [("actor", &mut self.actor_adam, state.actor_steps), ("critic", &mut self.critic_adam, state.critic_steps)]
        {
            let count = adam.state().1.len();
            let moments =
                |kind| (0..count).map(|index| values(&tensors, &format!("adam.{name}.{kind}.{index}"))).collect();
            let (first, second): (anyhow::Result<_>, anyhow::Result<_>) = (moments("first"), moments("second"));
            adam.restore(steps, first?, second?).map_err(anyhow::Error::msg)?;
        }
        let [features, logits, rewards, next] = [0, 1, 2, 3].map(|index| values(&tensors, &format!("replay.{index}")));
        self.replay.restore([features?, logits?, rewards?, next?], state.replay_next).map_err(anyhow::Error::msg)?;
        self.rng = ChaCha8Rng::from_seed(state.generator_seed);
        self.rng.set_word_pos(state.generator_place.parse().context("the generator's place is no number")?);
        self.episode = state.episode;
        Ok(())
    }

    fn networks(&self) -> [(&'static str, &Network); 4] {
        [
            ("actor", &self.actor.network),
            ("critic", &self.critic),
            ("actor_target", &self.actor_target.network),
            ("critic_target", &self.critic_target),
        ]
    }

    fn check(&self, state: &State) -> anyhow::Result<()> {
        ensure!(state.version == VERSION, "checkpoint version {}, but this program writes {VERSION}", state.version);
        let settings = serde_json::to_string(&self.settings)?;
        if state.settings != settings {
            bail!("the run to resume had other settings:\n  then {}\n  now  {settings}", state.settings);
        }
        let scenario = self.scenario.hash();
        ensure!(state.scenario == scenario, "the run to resume was in scenario {}, this is {scenario}", state.scenario);
        Ok(())
    }
}

fn named_parameters<'a>(name: &str, network: &'a Network) -> Vec<(String, &'a Tensor)> {
    let both = |layer: &'a crate::networks::Linear| {
        [("weight", &layer.weight), ("bias", &layer.bias)]
            .map(|(kind, tensor)| (format!("{name}.{}.{kind}", layer.name), tensor))
    };
    network.layers().iter().flat_map(both).collect()
}

fn put_network(tensors: &mut Tensors, name: &str, network: &Network) {
    for (key, parameter) in named_parameters(name, network) {
        tensors.insert(key, parameter.detach());
    }
}

fn put_moments(tensors: &mut Tensors, name: &str, adam: &Adam) -> anyhow::Result<()> {
    let (_, first, second) = adam.state();
    for (kind, moments) in [("first", first), ("second", second)] {
        for (index, moment) in moments.iter().enumerate() {
            put(tensors, format!("adam.{name}.{kind}.{index}"), moment)?;
        }
    }
    Ok(())
}

fn put(tensors: &mut Tensors, name: String, values: &[f32]) -> anyhow::Result<()> {
    tensors.insert(name, Tensor::from_slice(values, values.len(), &Device::Cpu)?);
    Ok(())
}

fn get<'a>(tensors: &'a Tensors, name: &str) -> anyhow::Result<&'a Tensor> {
    tensors.get(name).with_context(|| format!("the checkpoint lacks {name}"))
}

fn values(tensors: &Tensors, name: &str) -> anyhow::Result<Vec<f32>> {
    Ok(get(tensors, name)?.to_vec1()?)
}
