//! Deep Q-learning on a codebook: the paper's baseline.
//!
//! The methods `step` and `update` of [`Dql`] are the complete algorithm. The paper states that DQL
//! quantises the angles and uses replay and a target network, and gives no hyperparameters for it.
//! The hyperparameters here are those of the paper's own algorithm: replay of 10000, batches of 32,
//! tau 0.01, Adam with a learning rate of 1e-3, two hidden layers of 128 and 64 with ReLU, 1000
//! episodes, and epsilon-greedy exploration that decays from 0.995 to 0.0001.
//!
//! # Deviations from the paper
//! 1. **Action.** The action is one codeword, which sets the angles of all mirrors
//!    ([`crate::environment::codebook`]). The quantised angles of each mirror would be 25^100
//!    actions.
//! 2. **Network.** The network takes state and codeword as input and returns Q(s, a), as the
//!    paper's critic does. The first layer is linear in state and codeword, so all codewords are
//!    evaluated at once. A value learned for one codeword then carries over to codewords nearby.
//! 3. **State.** The position of the [target user](crate::environment::target_user) in the
//!    codebook's steps, then presence, positions, direct gains and minimum rates
//!    ([`CodewordState`]). The state does not include the current angles. Without
//!    actuator dynamics the optimal action does not depend on them.
//! 4. **Reward.** The reward minus that of flat mirrors, over the bandwidth. The shortfall is
//!    penalised instead of the met minimum rate, as in [`super::ddpg`].
//! 5. **gamma = 0.3** instead of 0.9. An action does not influence later states here, so their
//!    values are only noise in the target.
//! 6. **Steps.** An episode has 40 steps of one second. Every eighth step is followed by an update,
//!    because each update evaluates all codewords in all next states.

use candle_core::{Device, Result, Tensor};
use heliostat_channel::MirrorAngles;
use heliostat_core::codeword_state::{CodewordState, POSITION};
use heliostat_core::policy::PolicyKind;
use heliostat_core::policy::actor_file::{ActionKind, ObservationKind};
use heliostat_scenario::Scenario;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::environment::codebook::Codebook;
use crate::environment::room::{Environment, Outcome};
use crate::export::dense::{Form, Tail, all_columns, export};
use crate::networks::adam::Adam;
use crate::networks::layers::{Encoder, Network, Shape, soft_update};
use crate::training::algorithm::{Algorithm, start};
use crate::training::exploration::{Exploration, Kind};
use crate::training::learner::{Episode, Learner, Part, part};
use crate::training::replay::Replay;
use crate::training::settings::RunSettings;

/// The row in the table of algorithms.
pub const ALGORITHM: Algorithm = Algorithm {
    name: "dql",
    policy: PolicyKind::Dql,
    help: "Deep Q-learning on a codebook of angles",
    summary: "deep Q-learning on a codebook; deviations from the paper at the head of `lab/learn/src/learners/dql.rs`",
    has_paper_preset: false,
    start: |scenario, _, options| {
        let settings = Settings::new(scenario.seed);
        start(scenario, settings, options, Dql::new)
    },
};

/// The hyperparameters of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Widths of the two hidden layers.
    pub hidden: [usize; 2],
    /// Discount factor gamma.
    pub gamma: f64,
    /// Weight tau of the trained network in each update of the target network.
    pub tau: f64,
    /// Learning rate.
    pub rate: f64,
    /// Steps between two updates.
    pub steps_per_update: usize,
    /// Transitions in a minibatch.
    pub batch: usize,
    /// Capacity of the replay buffer.
    pub replay: usize,
    /// Transitions before the first update.
    pub warm_up: usize,
    /// Exploration: the probability of a random codeword.
    pub exploration: Exploration,
    /// The hyperparameters that every run has.
    #[serde(flatten)]
    pub run: RunSettings,
}

impl Settings {
    /// The hyperparameters of the shipped actors.
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
            run: RunSettings::paper(seed),
        }
    }
}

/// Deep Q-learning with its state between two steps.
pub struct Dql {
    settings: Settings,
    codebook: Codebook,
    layout: CodewordState,
    /// Coordinates of the codewords in the codebook's grid, (codewords, 2).
    coordinates: Tensor,
    network: Network,
    target: Network,
    adam: Adam,
    replay: Replay,
}

impl Dql {
    /// The learner before its first episode.
    ///
    /// # Errors
    /// The scenario describes no channel, or a setting is invalid.
    pub fn new(scenario: &Scenario, settings: Settings, rng: &mut ChaCha8Rng) -> anyhow::Result<Self> {
        settings.exploration.check_choices()?;
        anyhow::ensure!(settings.steps_per_update > 0, "steps_per_update = 0: expected 1 or more");
        let (codebook, layout) = (Codebook::of(scenario)?, CodewordState::of(scenario));
        let inputs = layout.inputs() + POSITION;
        let shape = Shape { encoder: Encoder::Mlp, slots: 1, inputs, hidden: settings.hidden, outputs: 1 };
        let network = Network::new(shape, rng)?;
        let rows = codebook.coordinates();
        let needed = settings.warm_up.max(settings.batch);
        Ok(Self {
            coordinates: Tensor::from_slice(rows.as_flattened(), (rows.len(), POSITION), &Device::Cpu)?,
            target: network.copy()?,
            adam: Adam::new(&network),
            replay: Replay::new(settings.replay, needed, [layout.inputs(), POSITION, 1, layout.inputs()]),
            network,
            codebook,
            layout,
            settings,
        })
    }

    /// The codeword with the largest value in a state.
    fn best(&self, state: &[f32]) -> Result<usize> {
        let state = Tensor::from_slice(state, (1, state.len()), &Device::Cpu)?;
        let values = self.values(&self.network, &state)?.squeeze(0)?.to_vec1::<f32>()?;
        Ok((1..values.len()).fold(0, |best, codeword| if values[codeword] > values[best] { codeword } else { best }))
    }

    /// A codeword by the epsilon-greedy rule.
    fn choose(&self, epsilon: f64, state: &[f32], rng: &mut impl Rng) -> Result<usize> {
        match Exploration::draw(epsilon, self.codebook.codewords().len(), rng) {
            Some(codeword) => Ok(codeword),
            None => self.best(state),
        }
    }

    /// The values of all codewords in each of some states: (batch, inputs) to (batch, codewords).
    fn values(&self, network: &Network, states: &Tensor) -> Result<Tensor> {
        let (first, second, head) = (network.layer("first"), network.layer("second"), network.layer("head"));
        let (batch, inputs) = states.dims2()?;
        let codewords = self.coordinates.dim(0)?;
        let of_state = states.matmul(&first.weight.narrow(0, 0, inputs)?)?.broadcast_add(&first.bias)?;
        let of_codeword = self.coordinates.matmul(&first.weight.narrow(0, inputs, POSITION)?)?;
        let hidden = of_state.unsqueeze(1)?.broadcast_add(&of_codeword.unsqueeze(0)?)?.relu()?;
        let hidden =
            hidden.reshape((batch * codewords, ()))?.matmul(&second.weight)?.broadcast_add(&second.bias)?.relu()?;
        hidden.matmul(&head.weight)?.broadcast_add(&head.bias)?.reshape((batch, codewords))
    }

    /// One update from a minibatch: Q(s, a) towards r + gamma max_b Q'(s', b), with the target
    /// network Q'.
    fn update(&mut self, rng: &mut impl Rng) -> Result<()> {
        let (batch, inputs) = (self.settings.batch, self.layout.inputs());
        let [states, actions, rewards, next] = self.replay.sample(batch, rng);
        let matrix = |values: Vec<f32>, width: usize| Tensor::from_vec(values, (batch, width), &Device::Cpu);
        let next = self.values(&self.target, &matrix(next, inputs)?)?.max_keepdim(1)?.detach();
        let target = (matrix(rewards, 1)? + (next * self.settings.gamma)?)?;
        let pairs = Tensor::cat(&[&matrix(states, inputs)?, &matrix(actions, POSITION)?], 1)?;
        let error = (self.network.forward_rows(&pairs)? - target)?;
        self.adam.step(&self.network, &error.sqr()?.mean_all()?.backward()?, self.settings.rate)?;
        soft_update(&self.target, &self.network, self.settings.tau)
    }
}

impl Learner for Dql {
    fn step(&mut self, episode: &mut Episode<'_>) -> anyhow::Result<Vec<Outcome>> {
        let Settings { exploration, run, .. } = &self.settings;
        let room = &mut episode.rooms[0];
        let state = self.layout.state(room.vector());
        let epsilon = exploration.magnitude(episode.index, episode.count);
        let codeword = self.choose(epsilon, &state, episode.rng)?;
        let (reward, outcome) = self.codebook.act(room, codeword, run.reward);
        room.step(run.step_s)?;
        let next = self.layout.state(room.vector());
        self.replay.push([&state, &self.codebook.coordinates()[codeword], &[reward], &next]);
        if self.replay.is_ready() && episode.step.is_multiple_of(self.settings.steps_per_update) {
            self.update(episode.rng)?;
        }
        Ok(vec![outcome])
    }

    fn act(&self, room: &Environment) -> anyhow::Result<MirrorAngles> {
        let best = self.best(&self.layout.state(room.vector()))?;
        Ok(self.codebook.codewords()[best].clone())
    }

    fn best_action(&self, room: &Environment) -> Option<MirrorAngles> {
        Some(self.codebook.best(room.model(), room.observation()).clone())
    }

    fn notes(&self) -> Vec<(&'static str, String)> {
        vec![("codebook", format!("{} codewords: {}", self.codebook.codewords().len(), self.codebook.kind()))]
    }

    fn state(&mut self) -> Vec<Part<'_>> {
        vec![
            part("network", &mut self.network),
            part("target", &mut self.target),
            part("network", &mut self.adam),
            part("replay", &mut self.replay),
        ]
    }

    fn export(&self, metadata: &[(String, String)]) -> anyhow::Result<Vec<u8>> {
        let columns = all_columns(self.layout.inputs() + POSITION);
        let (observation, action) = (ObservationKind::Codewords, ActionKind::Codebook);
        Ok(export(&self.network, &Form { observation, action, columns: &columns, metadata }, Tail::Plain)?)
    }
}
