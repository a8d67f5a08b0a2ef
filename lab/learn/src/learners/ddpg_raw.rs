//! Algorithm 1 of the paper as printed: DDPG whose action is the roll and yaw of every mirror.
//!
//! The methods `step` and `update` of [`DdpgRaw`] are the complete algorithm. State, networks of
//! 128/64 and 256/128, gamma 0.9, tau 0.01, batches of 32, replay of 10000, learning rates of 1e-3
//! and 1e-2, additive noise and 1000 episodes are the paper's. The actor's output is tanh times the
//! range of an axis.
//!
//! # Deviations from the paper
//! 1. **Reward.** The printed penalty applies to users whose minimum rate is met. Here the
//!    shortfall is penalised; option `reward.form` has the printed form. The reward is divided by
//!    the bandwidth, so that values are of order one.
//! 2. **Steps.** The paper gives no number of steps; here there are 40, of one second each.
//! 3. **Gains in the state.** The gain of the direct path enters as ln(1 + amplitude). The gain
//!    over the mirrors is no component, because positions and current angles determine it.
//! 4. **Slots.** The state has ten slots for users; a room's users take the first ones.
//! 5. **Exploration.** Additive noise, as in Algorithm 1, where the text names epsilon-greedy from
//!    0.995 to 1e-4. The paper gives no standard deviation; here it decays from 0.4 to 0.05 of the
//!    range. The first update waits for 500 transitions.
//!
//! Almost all outputs saturate at their bounds, and the sum rate is below that of flat mirrors.
//! This learner is a reference for the paper's description; [`super::ddpg_basis`] and
//! [`super::ddpg`] list the changes that help.
//!
//! Option `td3` adds the three changes of TD3 (Fujimoto and others, 2018): the smaller of two
//! critics as the target, noise on the target's action, and a delayed update of the actor.

use candle_core::{Device, Tensor};
use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_core::policy::PolicyKind;
use heliostat_core::policy::actor_file::{INPUT_NAME, OUTPUT_NAME};
use heliostat_onnx::graph::{Ends, Graph};
use heliostat_scenario::{Mirrors, Scenario};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::td3::{ACTOR_DELAY, smoothed};
use crate::environment::angle_state::AngleState;
use crate::environment::room::{Environment, Outcome, Rooms};
use crate::export::network::{Column, NetworkNodes};
use crate::networks::adam::Adam;
use crate::networks::layers::{Encoder, Network, Shape, soft_update};
use crate::networks::patterns::Basis;
use crate::training::algorithm::{Algorithm, start};
use crate::training::exploration::{Exploration, Kind, normal};
use crate::training::learner::{Episode, Learner, Part, part};
use crate::training::replay::Replay;
use crate::training::settings::RunSettings;

/// The row in the table of algorithms.
pub const ALGORITHM: Algorithm = Algorithm {
    name: "ddpg-raw",
    policy: PolicyKind::DdpgRaw,
    help: "Algorithm 1 as printed: the angles of all mirrors as the action",
    summary: "DDPG on all angles, as in the paper; deviations at the head of `lab/learn/src/learners/ddpg_raw.rs`",
    has_paper_preset: false,
    start: |scenario, _, options| {
        let settings = Settings::new(scenario.seed);
        start(scenario, settings, options, DdpgRaw::new)
    },
};

/// The critic's view of an action.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sight {
    /// All angles.
    Angles,
    /// The coefficients of smooth patterns of angles ([`Basis`]).
    Patterns,
}

/// The hyperparameters of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// The critic's view of an action.
    pub sight: Sight,
    /// Patterns along each side of the array, for critic and exploration.
    pub patterns: usize,
    /// Whether the current angles are part of the state.
    pub angles_in_state: bool,
    /// Discount factor gamma.
    pub gamma: f64,
    /// Weight tau of the trained network in each update of its target network.
    pub tau: f64,
    /// Learning rate of the actor.
    pub actor_rate: f64,
    /// Learning rate of the critic.
    pub critic_rate: f64,
    /// Learning rates at the end of the run over those at its start.
    pub rate_end: f64,
    /// Largest norm of a gradient; 0 is no limit.
    pub clip: f64,
    /// Weight of the mean squared output before tanh in the actor's loss; it keeps outputs off
    /// their bounds.
    pub saturation: f64,
    /// The three changes of TD3.
    pub td3: bool,
    /// Transitions in a minibatch.
    pub batch: usize,
    /// Capacity of the replay buffer.
    pub replay: usize,
    /// Transitions before the first update.
    pub warm_up: usize,
    /// Exploration.
    pub exploration: Exploration,
    /// The hyperparameters that every run has.
    #[serde(flatten)]
    pub run: RunSettings,
}

impl Settings {
    /// The paper's hyperparameters.
    pub fn new(seed: u64) -> Self {
        Self {
            sight: Sight::Angles,
            patterns: 3,
            angles_in_state: true,
            gamma: 0.9,
            tau: 0.01,
            actor_rate: 1e-3,
            critic_rate: 1e-2,
            rate_end: 1.0,
            clip: 0.0,
            saturation: 0.0,
            td3: false,
            batch: 32,
            replay: 10_000,
            warm_up: 500,
            exploration: Exploration { kind: Kind::Additive, start: 0.4, end: 0.05 },
            run: RunSettings { rooms: Rooms::Fixed, ..RunSettings::paper(seed) },
        }
    }
}

impl AsRef<RunSettings> for Settings {
    fn as_ref(&self) -> &RunSettings {
        &self.run
    }
}

/// DDPG on all angles with its state between two steps; also the learner of [`super::ddpg_basis`].
pub struct DdpgRaw {
    settings: Settings,
    layout: AngleState,
    basis: Basis,
    actor: Network,
    actor_target: Network,
    actor_adam: Adam,
    critics: Vec<Critic>,
    replay: Replay,
    /// Updates of the critics.
    updates: usize,
}

/// One of one or two critics.
struct Critic {
    network: Network,
    target: Network,
    adam: Adam,
}

impl DdpgRaw {
    /// The learner before its first episode.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn new(scenario: &Scenario, settings: Settings, rng: &mut ChaCha8Rng) -> anyhow::Result<Self> {
        let layout = AngleState::of(scenario, settings.angles_in_state);
        let Mirrors { rows, columns, .. } = *scenario.mirrors.first();
        let basis = Basis::new(rows, columns, settings.patterns)?;
        let (inputs, outputs) = (layout.inputs(), layout.outputs());
        let plain = |inputs, hidden, outputs| Shape { encoder: Encoder::Mlp, slots: 1, inputs, hidden, outputs };
        let actor = Network::new(plain(inputs, [128, 64], outputs), rng)?;
        let seen = if settings.sight == Sight::Angles { outputs } else { basis.modes() };
        let critic = |rng: &mut ChaCha8Rng| {
            let network = Network::new(plain(inputs + seen, [256, 128], 1), rng)?;
            let adam = Adam::new(&network).clipped(settings.clip);
            Ok::<_, candle_core::Error>(Critic { target: network.copy()?, network, adam })
        };
        let critics = (0..if settings.td3 { 2 } else { 1 }).map(|_| critic(rng)).collect::<Result<_, _>>()?;
        let next = if settings.gamma > 0.0 { inputs } else { 0 };
        let needed = settings.warm_up.max(settings.batch);
        Ok(Self {
            actor_target: actor.copy()?,
            actor_adam: Adam::new(&actor).clipped(settings.clip),
            critics,
            replay: Replay::new(settings.replay, needed, [inputs, outputs, 1, next]),
            actor,
            layout,
            basis,
            settings,
            updates: 0,
        })
    }

    /// Actions in [-1, 1] for a batch of states, and the outputs before tanh.
    fn actions(network: &Network, states: &Tensor) -> candle_core::Result<(Tensor, Tensor)> {
        let raw = network.forward_rows(states)?;
        Ok((raw.tanh()?, raw))
    }

    /// The action for one state, without exploration.
    fn action(&self, state: &[f32]) -> candle_core::Result<Vec<f32>> {
        let states = Tensor::from_slice(state, (1, state.len()), &Device::Cpu)?;
        Self::actions(&self.actor, &states)?.0.squeeze(0)?.to_vec1()
    }

    fn explore(&self, magnitude: f64, action: &mut [f32], rng: &mut impl Rng) -> candle_core::Result<()> {
        if self.settings.exploration.kind != Kind::Patterns {
            self.settings.exploration.apply(magnitude, action, rng);
            return Ok(());
        }
        let each = magnitude / ((self.basis.modes() / 2) as f64).sqrt();
        let coefficients: Vec<f32> = (0..self.basis.modes()).map(|_| (each * normal(rng)) as f32).collect();
        for (value, noise) in action.iter_mut().zip(self.basis.sum(&coefficients)?) {
            *value = (*value + noise).clamp(-1.0, 1.0);
        }
        Ok(())
    }

    /// One update of critics, actor and targets from a minibatch.
    fn update(&mut self, episode: &mut Episode<'_>) -> candle_core::Result<()> {
        let Settings { batch, gamma, tau, actor_rate, critic_rate, rate_end, saturation, td3, .. } = self.settings;
        let inputs = self.layout.inputs();
        // Both learning rates decay geometrically over the run.
        let decay = rate_end.powf(episode.progress());

        // Critics: minimise the mean of [Q(s, a) - r - gamma Q'(s', mu'(s'))]^2.
        let [states, actions, rewards, next] = self.replay.sample(batch, episode.rng);
        let states = Tensor::from_vec(states, (batch, inputs), &Device::Cpu)?;
        let actions = Tensor::from_vec(actions, (batch, self.layout.outputs()), &Device::Cpu)?;
        let mut target = Tensor::from_vec(rewards, batch, &Device::Cpu)?;
        if gamma > 0.0 {
            let next = self.next_value(&Tensor::from_vec(next, (batch, inputs), &Device::Cpu)?, episode.rng)?;
            target = (target + (next.detach() * gamma)?)?;
        }
        for index in 0..self.critics.len() {
            let error = (self.value(&self.critics[index].network, &states, &actions)? - &target)?;
            let gradients = error.sqr()?.mean_all()?.backward()?;
            let Critic { network, adam, .. } = &mut self.critics[index];
            adam.step(network, &gradients, critic_rate * decay)?;
        }
        self.updates += 1;
        if td3 && !self.updates.is_multiple_of(ACTOR_DELAY) {
            return Ok(());
        }

        // Actor: maximise the mean of Q(s, mu(s)).
        let (actions, raw) = Self::actions(&self.actor, &states)?;
        let value = self.value(&self.critics[0].network.frozen(), &states, &actions)?.mean_all()?;
        let loss = ((raw.sqr()?.mean_all()? * saturation)? - value)?;
        self.actor_adam.step(&self.actor, &loss.backward()?, actor_rate * decay)?;

        // Targets: without a discounted value they are not used.
        if gamma > 0.0 {
            soft_update(&self.actor_target, &self.actor, tau)?;
            for Critic { network, target, .. } in &self.critics {
                soft_update(target, network, tau)?;
            }
        }
        Ok(())
    }

    /// The prediction of a critic, (batch).
    fn value(&self, critic: &Network, states: &Tensor, actions: &Tensor) -> candle_core::Result<Tensor> {
        let seen = match self.settings.sight {
            Sight::Angles => actions.clone(),
            Sight::Patterns => self.basis.project(actions)?,
        };
        critic.forward_rows(&Tensor::cat(&[states, &seen], 1)?)?.squeeze(1)
    }

    /// The value of the next states by the target networks, (batch).
    fn next_value(&self, next: &Tensor, rng: &mut impl Rng) -> candle_core::Result<Tensor> {
        let mut actions = Self::actions(&self.actor_target, next)?.0;
        if self.settings.td3 {
            actions = smoothed(&actions, rng)?;
        }
        let mut values = self.critics.iter().map(|critic| self.value(&critic.target, next, &actions));
        let first = values.next().expect("there is a critic")?;
        values.try_fold(first, |least, value| least.minimum(&value?))
    }
}

impl Learner for DdpgRaw {
    fn step(&mut self, episode: &mut Episode<'_>) -> anyhow::Result<Vec<Outcome>> {
        let Settings { exploration, run, .. } = &self.settings;
        let room = &mut episode.rooms[0];
        let state = self.layout.state(room.vector());
        let mut action = self.action(&state)?;
        self.explore(exploration.magnitude(episode.index, episode.count), &mut action, episode.rng)?;
        let users = room.users();
        let mut rewards = vec![0.0; users];
        let outcome = room.act(&self.layout.angles(&action), run.reward, &mut rewards);
        let reward = rewards.iter().sum::<f32>() / users as f32;
        room.step(run.step_s)?;
        let next = if self.settings.gamma > 0.0 { self.layout.state(room.vector()) } else { Vec::new() };
        self.replay.push([&state, &action, &[reward], &next]);
        if self.replay.is_ready() {
            self.update(episode)?;
        }
        Ok(vec![outcome])
    }

    fn act(&self, room: &Environment) -> anyhow::Result<MirrorAngles> {
        Ok(self.layout.angles(&self.action(&self.layout.state(room.vector()))?))
    }

    fn state(&mut self) -> Vec<Part<'_>> {
        let mut parts = vec![
            part("actor", &mut self.actor),
            part("actor_target", &mut self.actor_target),
            part("actor", &mut self.actor_adam),
        ];
        for (index, Critic { network, target, adam }) in self.critics.iter_mut().enumerate() {
            parts.push(part(&format!("critic.{index}"), network));
            parts.push(part(&format!("critic_target.{index}"), target));
            parts.push(part(&format!("critic.{index}"), adam));
        }
        parts.extend([part("replay", &mut self.replay), part("updates", &mut self.updates)]);
        parts
    }

    /// In the graph: the state, the network, and the angles.
    fn export(&self, _: &ChannelModel, metadata: &[(String, String)]) -> anyhow::Result<Vec<u8>> {
        let mut graph = Graph::default();
        let state = self.layout.state_nodes(&mut graph);
        let nodes = NetworkNodes::new(&mut graph, &self.actor)?;
        let columns: Vec<Column> = (0..self.layout.inputs()).map(|input| vec![(input, 1.0)]).collect();
        let entry = nodes.entry(&mut graph, &columns)?;
        let raw = nodes.plain(&mut graph, &entry, &state);
        let action = graph.node("Tanh", &[&raw]);
        let range = graph.scalar(self.layout.range_rad);
        graph.node("Mul", &[&action, &range]);
        let (input, output) = ((INPUT_NAME, self.layout.encoder().len()), (OUTPUT_NAME, self.layout.outputs()));
        Ok(graph.finish(&Ends { name: "heliostat-raw-actor", input, output }, metadata))
    }
}
