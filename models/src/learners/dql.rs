//! Deep Q-learning on a codebook of quantised angles: what the paper compares itself with.
//!
//! The paper says that DQL quantises the angles, and that replay and a target network belong to it. Of its numbers it states none by itself; taken
//! over from its own algorithm are replay of 10000, batches of 32, tau 0.01, a rate of 1e-3 with Adam, two hidden layers of 128 and 64 with ReLU, 1000
//! episodes, and epsilon-greedy exploration that falls from 0.995 to 0.0001.
//!
//! # Departures from the paper, and why
//! 1. **Action.** An entry of the [codebook](crate::codebook), for the whole array: each mirror's own quantised angles would be 25^100 actions.
//! 2. **Network.** The entry is an input, as in the paper's critic, and the value Q(s, a) the only output; all entries are valued at once, since the
//!    first layer is linear in state and entry. So what is learned about aiming beside somebody holds everywhere, and not for one entry at a time.
//! 3. **State.** Presence, positions, direct gains and needs as in [`crate::raw`], and in front of them where the user stands whom the mirrors could
//!    help most ([`crate::needy`]), in the codebook's steps. The current angles are left out: without actuator dynamics the best entry does
//!    not depend on them.
//! 4. **Reward.** What the entry brings beyond mirrors that face straight into the room; the shortfall is punished instead of the met need, as in
//!    [`crate::ddpg`]; divided by the bandwidth.
//! 5. **gamma = 0.3** in place of 0.9: an action does not influence later states here, whose values are only noise in the target.
//! 6. **Steps.** 40 of one second in an episode, and an update after every eighth: all entries of all next states have to be valued for each.

use candle_core::{Device, Result, Tensor};
use heliostat_channel::MirrorAngles;
use heliostat_decide::policy::actor_file::{INPUT_NAME, OUTPUT_NAME};
use heliostat_scenario::Scenario;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::checkpoint::Store;
use crate::codebook::{Codebook, GRID};
use crate::env::{Environment, Reward, RewardForm, Rooms};
use crate::explore::{Exploration, Kind};
use crate::learner::{Episode, Learner, RunSettings};
use crate::needy::Needy;
use crate::networks::{Adam, Encoder, Network, Shape, soft_update};
use crate::onnx::{Ends, Graph};
use crate::raw::RawLayout;
use crate::replay::Replay;

/// Every number of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Widths of the two hidden layers.
    pub hidden: [usize; 2],
    /// Discount factor.
    pub gamma: f64,
    /// Share of the new parameters in each update of the target network.
    pub tau: f64,
    /// Learning rate.
    pub rate: f64,
    /// Steps for each update.
    pub steps_per_update: usize,
    /// Transitions in an update.
    pub batch: usize,
    /// Transitions kept.
    pub replay: usize,
    /// Transitions before the first update.
    pub warm_up: usize,
    /// How often an entry is drawn.
    pub exploration: Exploration,
    /// What every algorithm has.
    #[serde(flatten)]
    pub run: RunSettings,
}

impl Settings {
    /// The numbers of the shipped actors.
    pub fn new(seed: u64) -> Self {
        Self {
            hidden: [128, 64],
            gamma: 0.3,
            tau: 0.01,
            rate: 1e-3,
            steps_per_update: 8,
            batch: 32,
            replay: 10_000,
            warm_up: 500,
            exploration: Exploration { kind: Kind::EpsilonGreedy, start: 0.995, end: 1e-4 },
            run: RunSettings {
                reward: Reward { form: RewardForm::Shortfall, lambda: 1.0, margin: 1.0 },
                rooms: Rooms::Randomised,
                episodes: 1000,
                steps: 40,
                step_s: 1.0,
                seed,
            },
        }
    }
}

/// A training run between two episodes.
pub struct Trainer {
    settings: Settings,
    scenario: Scenario,
    codebook: Codebook,
    layout: StateLayout,
    /// Places of the entries, (entries, 2).
    places: Tensor,
    network: Network,
    target: Network,
    adam: Adam,
    replay: Replay,
    rng: ChaCha8Rng,
    episode: usize,
}

impl Trainer {
    /// A run at its beginning.
    ///
    /// # Errors
    /// A scenario that makes no channel, or a setting without sense.
    pub fn new(scenario: Scenario, settings: Settings) -> anyhow::Result<Self> {
        settings.exploration.check_choices()?;
        anyhow::ensure!(settings.steps_per_update > 0, "steps_per_update = 0: wanted 1 or more");
        let mut rng = ChaCha8Rng::seed_from_u64(settings.run.seed);
        let (codebook, layout) = (Codebook::of(&scenario)?, StateLayout::of(&scenario));
        let inputs = layout.inputs() + PLACE;
        let shape = Shape { encoder: Encoder::Mlp, slots: 1, inputs, hidden: settings.hidden, outputs: 1 };
        let network = Network::new(shape, &mut rng)?;
        let places = codebook.places();
        Ok(Self {
            places: Tensor::from_slice(places.as_flattened(), (places.len(), PLACE), &Device::Cpu)?,
            target: network.copy()?,
            adam: Adam::new(&network, settings.rate),
            replay: Replay::new(settings.replay, [layout.inputs(), PLACE, 1, layout.inputs()]),
            network,
            codebook,
            layout,
            rng,
            scenario,
            settings,
            episode: 0,
        })
    }

    /// The entry that the network prefers in a state.
    fn best(&self, state: &[f32]) -> Result<usize> {
        let state = Tensor::from_slice(state, (1, state.len()), &Device::Cpu)?;
        let values = self.values(&self.network, &state)?.squeeze(0)?.to_vec1::<f32>()?;
        Ok((1..values.len()).fold(0, |best, entry| if values[entry] > values[best] { entry } else { best }))
    }

    fn choose(&mut self, epsilon: f64, state: &[f32]) -> Result<usize> {
        match Exploration::draw(epsilon, self.codebook.entries().len(), &mut self.rng) {
            Some(entry) => Ok(entry),
            None => self.best(state),
        }
    }

    /// The values of all entries in each of some states: (batch, inputs) to (batch, entries).
    fn values(&self, network: &Network, states: &Tensor) -> Result<Tensor> {
        let (first, second, head) = (network.layer("first"), network.layer("second"), network.layer("head"));
        let (batch, inputs) = states.dims2()?;
        let entries = self.places.dim(0)?;
        let of_state = states.matmul(&first.weight.narrow(0, 0, inputs)?)?.broadcast_add(&first.bias)?;
        let of_entry = self.places.matmul(&first.weight.narrow(0, inputs, PLACE)?)?;
        let hidden = of_state.unsqueeze(1)?.broadcast_add(&of_entry.unsqueeze(0)?)?.relu()?;
        let hidden =
            hidden.reshape((batch * entries, ()))?.matmul(&second.weight)?.broadcast_add(&second.bias)?.relu()?;
        hidden.matmul(&head.weight)?.broadcast_add(&head.bias)?.reshape((batch, entries))
    }

    /// One update from a minibatch: Q(s, a) towards r + gamma max_b Q'(s', b), Q' being the target network.
    fn update(&mut self) -> Result<()> {
        let (batch, inputs) = (self.settings.batch, self.layout.inputs());
        let [states, actions, rewards, next] = self.replay.sample(batch, &mut self.rng);
        let matrix = |values: Vec<f32>, width: usize| Tensor::from_vec(values, (batch, width), &Device::Cpu);
        let next = self.values(&self.target, &matrix(next, inputs)?)?.max_keepdim(1)?.detach();
        let target = (matrix(rewards, 1)? + (next * self.settings.gamma)?)?;
        let pairs = Tensor::cat(&[&matrix(states, inputs)?, &matrix(actions, PLACE)?], 1)?;
        let error = (self.network.forward_rows(&pairs)? - target)?;
        self.adam.step(&self.network, &error.sqr()?.mean_all()?.backward()?)?;
        soft_update(&self.target, &self.network, self.settings.tau)
    }
}

impl Learner for Trainer {
    fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    fn run(&self) -> &RunSettings {
        &self.settings.run
    }

    fn settings(&self) -> serde_json::Value {
        serde_json::json!(self.settings)
    }

    fn notes(&self) -> Vec<(&'static str, String)> {
        vec![("codebook", format!("{} entries: {}", self.codebook.entries().len(), self.codebook.kind()))]
    }

    fn episodes_done(&self) -> usize {
        self.episode
    }

    fn run_episode(&mut self) -> anyhow::Result<Episode> {
        let run = self.settings.run.clone();
        let room = run.rooms.draw(&self.scenario, &mut self.rng);
        let mut environment = Environment::new(&room, self.rng.random())?;
        let epsilon = self.settings.exploration.magnitude(self.episode, run.episodes);
        let mut summary = Episode::default();
        let mut state = self.layout.state(environment.vector());
        for step in 0..run.steps {
            let entry = self.choose(epsilon, &state)?;
            let (reward, outcome) = self.codebook.act(&mut environment, entry, run.reward);
            environment.step(run.step_s)?;
            let next = self.layout.state(environment.vector());
            self.replay.push([&state, &self.codebook.places()[entry], &[reward], &next]);
            state = next;
            let ready = self.replay.len() >= self.settings.warm_up.max(self.settings.batch);
            if ready && step % self.settings.steps_per_update == 0 {
                self.update()?;
            }
            summary.reward_mbps += outcome.reward_mbps / run.steps as f64;
            summary.sum_rate_mbps += outcome.sum_rate_mbps / run.steps as f64;
        }
        self.episode += 1;
        Ok(Episode { number: self.episode, steps: self.episode * run.steps, ..summary })
    }

    fn act(&self, environment: &Environment) -> anyhow::Result<MirrorAngles> {
        let best = self.best(&self.layout.state(environment.vector()))?;
        Ok(self.codebook.entries()[best].clone())
    }

    fn best_possible(&self, environment: &Environment) -> Option<MirrorAngles> {
        Some(self.codebook.best(environment.model(), environment.observation()).clone())
    }

    fn save(&self, store: &mut Store) -> anyhow::Result<()> {
        store.put_network("network", &self.network);
        store.put_network("target", &self.target);
        store.put_adam("network", &self.adam)?;
        store.put_replay(&self.replay)?;
        store.put_generator(&self.rng)?;
        store.put("episode", &self.episode)
    }

    fn restore(&mut self, store: &Store) -> anyhow::Result<()> {
        store.restore_network("network", &self.network)?;
        store.restore_network("target", &self.target)?;
        store.restore_adam("network", &mut self.adam)?;
        store.restore_replay(&mut self.replay)?;
        self.rng = store.generator()?;
        self.episode = store.get("episode")?;
        Ok(())
    }

    /// In the graph: the state, the value of every entry, the largest value's place, that entry's angles.
    fn export(&self, metadata: &[(String, String)]) -> anyhow::Result<Vec<u8>> {
        let (mut graph, inputs) = (Graph::default(), self.layout.inputs());
        let state = self.layout.state_nodes(&mut graph);
        let constant = |graph: &mut Graph, name: &str, tensor: &Tensor| -> Result<String> {
            let shape = if tensor.rank() == 1 { vec![1, tensor.elem_count()] } else { tensor.dims().to_vec() };
            Ok(graph.constant(name, &shape, &tensor.flatten_all()?.to_vec1::<f32>()?))
        };
        let first = self.network.layer("first");
        let weight = constant(&mut graph, "first.weight", &first.weight.narrow(0, 0, inputs)?)?;
        // What an entry adds to the first layer does not depend on the state.
        let of_entry = self.places.matmul(&first.weight.narrow(0, inputs, PLACE)?)?.broadcast_add(&first.bias)?;
        let of_entry = constant(&mut graph, "first.entries", &of_entry)?;
        let of_state = graph.node("MatMul", &[&state, &weight]);
        let mut values = graph.node("Add", &[&of_entry, &of_state]);
        for name in ["second", "head"] {
            let layer = self.network.layer(name);
            let weight = constant(&mut graph, &format!("{name}.weight"), &layer.weight)?;
            let bias = constant(&mut graph, &format!("{name}.bias"), &layer.bias)?;
            let hidden = graph.node("Relu", &[&values]);
            let product = graph.node("MatMul", &[&hidden, &weight]);
            values = graph.node("Add", &[&product, &bias]);
        }
        let values = graph.reshape(&values, &[1, self.codebook.entries().len()]);
        self.codebook.choose_nodes(&mut graph, &values);
        let encoder = self.layout.needy.encoder();
        let (input, output) = ((INPUT_NAME, encoder.len()), (OUTPUT_NAME, 2 * encoder.mirrors()));
        Ok(graph.finish(&Ends { name: "heliostat-deep-q", input, output }, metadata))
    }
}

/// Numbers that place an entry in its codebook, and a user on the floor.
const PLACE: usize = 2;

/// How an observation vector becomes a state.
#[derive(Clone, Copy, Debug)]
struct StateLayout {
    needy: Needy,
    raw: RawLayout,
    /// Steps of the codebook's grid in a metre, along x and y.
    steps_per_m: [f32; 2],
}

impl StateLayout {
    fn of(scenario: &Scenario) -> Self {
        let extents_m = [scenario.room.length_x_m, scenario.room.length_y_m];
        Self {
            needy: Needy::of(scenario),
            raw: RawLayout::of(scenario, false),
            steps_per_m: extents_m.map(|extent_m| (GRID as f64 / extent_m) as f32),
        }
    }

    fn inputs(&self) -> usize {
        PLACE + self.raw.inputs()
    }

    fn state(&self, vector: &[f32]) -> Vec<f32> {
        let [x, y] = self.needy.place(vector);
        let mut state = vec![x * self.steps_per_m[0], y * self.steps_per_m[1]];
        state.extend(self.raw.state(vector));
        state
    }

    fn state_nodes(&self, graph: &mut Graph) -> String {
        let place = self.needy.place_nodes(graph);
        let steps = graph.constant("steps_per_m", &[1, PLACE], &self.steps_per_m);
        let place = graph.node("Mul", &[&place, &steps]);
        let raw = self.raw.state_nodes(graph);
        graph.concat(&[&place, &raw], 1)
    }
}
