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
//! This learner is a reference for the paper's description; [`super::ddpg`] lists the changes that
//! help.

use candle_core::{Device, Tensor};
use heliostat_channel::MirrorAngles;
use heliostat_core::policy::PolicyKind;
use heliostat_core::policy::actor_file::{ActionKind, ObservationKind};
use heliostat_scenario::Scenario;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::environment::angle_state::AngleState;
use crate::environment::room::{Environment, Outcome, Rooms};
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

/// The hyperparameters of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Discount factor gamma.
    pub gamma: f64,
    /// Weight tau of the trained network in each update of its target network.
    pub tau: f64,
    /// Learning rate of the actor.
    pub actor_rate: f64,
    /// Learning rate of the critic.
    pub critic_rate: f64,
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
            gamma: 0.9,
            tau: 0.01,
            actor_rate: 1e-3,
            critic_rate: 1e-2,
            batch: 32,
            replay: 10_000,
            warm_up: 500,
            exploration: Exploration { kind: Kind::Additive, start: 0.4, end: 0.05 },
            run: RunSettings { rooms: Rooms::Fixed, ..RunSettings::paper(seed) },
        }
    }
}

/// DDPG on all angles with its state between two steps.
pub struct DdpgRaw {
    settings: Settings,
    layout: AngleState,
    actor: Network,
    actor_target: Network,
    actor_adam: Adam,
    critic: Network,
    critic_target: Network,
    critic_adam: Adam,
    replay: Replay,
}

impl DdpgRaw {
    /// The learner before its first episode.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn new(scenario: &Scenario, settings: Settings, rng: &mut ChaCha8Rng) -> anyhow::Result<Self> {
        let layout = AngleState::of(scenario, true);
        let (inputs, outputs) = (layout.inputs(), layout.outputs());
        let plain = |inputs, hidden, outputs| Shape { encoder: Encoder::Mlp, slots: 1, inputs, hidden, outputs };
        let actor = Network::new(plain(inputs, [128, 64], outputs), rng)?;
        let critic = Network::new(plain(inputs + outputs, [256, 128], 1), rng)?;
        let next = if settings.gamma > 0.0 { inputs } else { 0 };
        let needed = settings.warm_up.max(settings.batch);
        Ok(Self {
            actor_target: actor.copy()?,
            actor_adam: Adam::new(&actor),
            critic_target: critic.copy()?,
            critic_adam: Adam::new(&critic),
            replay: Replay::new(settings.replay, needed, [inputs, outputs, 1, next]),
            actor,
            critic,
            layout,
            settings,
        })
    }

    /// Actions in [-1, 1] for a batch of states.
    fn actions(network: &Network, states: &Tensor) -> candle_core::Result<Tensor> {
        network.forward_rows(states)?.tanh()
    }

    /// The action for one state, without exploration.
    fn action(&self, state: &[f32]) -> candle_core::Result<Vec<f32>> {
        let states = Tensor::from_slice(state, (1, state.len()), &Device::Cpu)?;
        Self::actions(&self.actor, &states)?.squeeze(0)?.to_vec1()
    }

    /// One update of critic, actor and targets from a minibatch.
    fn update(&mut self, episode: &mut Episode<'_>) -> candle_core::Result<()> {
        let Settings { batch, gamma, tau, actor_rate, critic_rate, .. } = self.settings;
        let inputs = self.layout.inputs();

        // Critic: minimise the mean of [Q(s, a) - r - gamma Q'(s', mu'(s'))]^2.
        let [states, actions, rewards, next] = self.replay.sample(batch, episode.rng);
        let states = Tensor::from_vec(states, (batch, inputs), &Device::Cpu)?;
        let actions = Tensor::from_vec(actions, (batch, self.layout.outputs()), &Device::Cpu)?;
        let mut target = Tensor::from_vec(rewards, batch, &Device::Cpu)?;
        if gamma > 0.0 {
            let next = Tensor::from_vec(next, (batch, inputs), &Device::Cpu)?;
            let next_value = value(&self.critic_target, &next, &Self::actions(&self.actor_target, &next)?)?;
            target = (target + (next_value.detach() * gamma)?)?;
        }
        let error = (value(&self.critic, &states, &actions)? - target)?;
        let gradients = error.sqr()?.mean_all()?.backward()?;
        self.critic_adam.step(&self.critic, &gradients, critic_rate)?;

        // Actor: maximise the mean of Q(s, mu(s)).
        let value = value(&self.critic.frozen(), &states, &Self::actions(&self.actor, &states)?)?.mean_all()?;
        self.actor_adam.step(&self.actor, &value.neg()?.backward()?, actor_rate)?;

        // Targets: without a discounted value they are not used.
        if gamma > 0.0 {
            soft_update(&self.actor_target, &self.actor, tau)?;
            soft_update(&self.critic_target, &self.critic, tau)?;
        }
        Ok(())
    }
}

/// The prediction of a critic, (batch).
fn value(critic: &Network, states: &Tensor, actions: &Tensor) -> candle_core::Result<Tensor> {
    critic.forward_rows(&Tensor::cat(&[states, actions], 1)?)?.squeeze(1)
}

impl Learner for DdpgRaw {
    fn step(&mut self, episode: &mut Episode<'_>) -> anyhow::Result<Vec<Outcome>> {
        let Settings { exploration, run, .. } = &self.settings;
        let room = &mut episode.rooms[0];
        let state = self.layout.state(room.vector());
        let mut action = self.action(&state)?;
        exploration.apply(exploration.magnitude(episode.index, episode.count), &mut action, episode.rng);
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
        vec![
            part("actor", &mut self.actor),
            part("actor_target", &mut self.actor_target),
            part("actor", &mut self.actor_adam),
            part("critic", &mut self.critic),
            part("critic_target", &mut self.critic_target),
            part("critic", &mut self.critic_adam),
            part("replay", &mut self.replay),
        ]
    }

    fn export(&self, metadata: &[(String, String)]) -> anyhow::Result<Vec<u8>> {
        let columns = all_columns(self.layout.inputs());
        let (observation, action) = (ObservationKind::Paper, ActionKind::Angles);
        let form = Form { observation, action, columns: &columns, metadata };
        Ok(export(&self.actor, &form, Tail::Tanh(self.layout.range_rad))?)
    }
}
