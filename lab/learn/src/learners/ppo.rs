//! PPO: proximal policy optimisation with a clipped ratio of probabilities.
//!
//! Source: Schulman, Wolski, Dhariwal, Radford, Klimov, "Proximal policy optimization algorithms",
//! arXiv 1707.06347, eq. (7) and algorithm 1; advantages by eqs. (11) and (12). The methods `step`
//! and `update` of [`Ppo`] are the complete algorithm. Action, state, reward and rooms are those of
//! [`super::ddpg`], preset `tuned`. The exported actor is the mean of the distribution.
//!
//! # Deviations from the source
//! 1. **Rooms.** An episode has 16 rooms of 40 steps, which are the actors of algorithm 1; then the
//!    networks learn from these 640 transitions in 4 passes. A run has 50 episodes.
//! 2. **Values of each user.** The value network predicts each user's part of the reward. The
//!    advantage of an action is the mean over the users, because each weight changes the rates of
//!    all.
//! 3. **gamma = 0** in place of 0.99, because an action does not influence later states here.
//!    Options `gamma` and `smoothing` (lambda of eq. 11) have discounted advantages.
//! 4. **Separate networks** for policy and value, as in the source for continuous control; the
//!    rates decay as those of `ddpg`.

use candle_core::{Device, Result, Tensor};
use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_core::policy::PolicyKind;
use heliostat_scenario::{ChannelMode, Scenario};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::ddpg;
use crate::environment::features::{Head, Layout};
use crate::environment::room::{Environment, Outcome};
use crate::export::actor::export;
use crate::networks::actor::{ACTOR_INPUTS, HIDDEN, States};
use crate::networks::adam::Adam;
use crate::networks::gaussian::GaussianActor;
use crate::networks::layers::{Encoder, Network, Shape};
use crate::training::algorithm::{Algorithm, start};
use crate::training::learner::{Episode, Learner, Part, part};
use crate::training::settings::RunSettings;

/// The row in the table of algorithms.
pub const ALGORITHM: Algorithm = Algorithm {
    name: "ppo",
    policy: PolicyKind::Ppo,
    help: "PPO with one weight per user as the action",
    summary: "PPO with one weight a user; deviations from its source at the head of `lab/learn/src/learners/ppo.rs`",
    has_paper_preset: false,
    start: |scenario, _, options| {
        let settings = Settings::new(scenario.seed, scenario.channel.mode);
        start(scenario, settings, options, Ppo::new)
    },
};

/// The hyperparameters of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// The map from actions to decoder weights.
    pub head: Head,
    /// Discount factor gamma.
    pub gamma: f64,
    /// Weight lambda of later steps in the advantage.
    pub smoothing: f64,
    /// Learning rate of policy and value.
    pub rate: f64,
    /// Learning rate at the end of the run over that at its start.
    pub rate_end: f64,
    /// Largest change of the ratio of probabilities that the loss rewards.
    pub clip: f64,
    /// Weight of the entropy in the loss.
    pub entropy: f64,
    /// Rooms in which each step acts.
    pub room_count: usize,
    /// Passes over the transitions of an episode.
    pub epochs: usize,
    /// Transitions in a minibatch.
    pub batch: usize,
    /// The hyperparameters that every run has.
    #[serde(flatten)]
    pub run: RunSettings,
}

impl Settings {
    /// The hyperparameters of the built-in actors.
    pub fn new(seed: u64, mode: ChannelMode) -> Self {
        let ddpg::Settings { head, gamma, run, .. } = ddpg::Settings::tuned(seed, mode);
        Self {
            head,
            gamma,
            smoothing: 0.95,
            rate: 1e-3,
            rate_end: 0.1,
            clip: 0.2,
            entropy: 0.0,
            room_count: 16,
            epochs: 4,
            batch: 64,
            run: RunSettings { episodes: 50, ..run },
        }
    }
}

impl AsRef<RunSettings> for Settings {
    fn as_ref(&self) -> &RunSettings {
        &self.run
    }
}

/// The transitions of an episode, row by row in the order of steps and then of rooms.
#[derive(Default)]
struct Rollout {
    /// One more step than actions: the states after the last one.
    states: Vec<Vec<f32>>,
    /// Values before tanh.
    raw: Vec<Vec<f32>>,
    rewards: Vec<Vec<f32>>,
}

/// Transitions as tensors.
struct Minibatch {
    states: States,
    raw: Tensor,
    /// ln pi(a | s) of the policy that acted, summed over the users: (batch).
    log_density: Tensor,
    /// (batch)
    advantage: Tensor,
    /// Targets of the value network, (batch, slots).
    returns: Tensor,
}

/// PPO with its state between two episodes.
pub struct Ppo {
    settings: Settings,
    actor: GaussianActor,
    value: Network,
    mean_adam: Adam,
    spread_adam: Adam,
    value_adam: Adam,
    rollout: Rollout,
}

impl Ppo {
    /// The learner before its first episode.
    ///
    /// # Errors
    /// A setting without effect, or errors of candle.
    pub fn new(scenario: &Scenario, settings: Settings, rng: &mut ChaCha8Rng) -> anyhow::Result<Self> {
        for (name, count) in [("room_count", settings.room_count), ("epochs", settings.epochs)] {
            anyhow::ensure!(count > 0, "{name} = 0: expected 1 or more");
        }
        let layout = Layout::of(scenario);
        let actor = GaussianActor::new(layout, settings.head, rng)?;
        let slots = layout.slots();
        let shape = Shape { encoder: Encoder::PerUser, slots, inputs: ACTOR_INPUTS, hidden: HIDDEN, outputs: slots };
        let value = Network::new(shape, rng)?;
        Ok(Self {
            mean_adam: Adam::new(&actor.mean.network),
            spread_adam: Adam::new(&actor.spread),
            value_adam: Adam::new(&value),
            rollout: Rollout::default(),
            actor,
            value,
            settings,
        })
    }

    fn states(&self, rows: Vec<f32>, count: usize) -> Result<States> {
        States::new(rows, count, self.actor.mean.layout, self.settings.head.baseline_weight)
    }

    /// ln pi(a | s) summed over the present users, (batch). The terms of tanh do not depend on the
    /// policy and cancel in the ratio.
    fn log_density(&self, states: &States, raw: &Tensor) -> Result<Tensor> {
        self.actor.distribution(states)?.log_density(raw)?.mul(&states.present)?.sum(1)
    }

    /// The values V(s) of each user in rows of states, zero in empty slots.
    fn values(&self, rows: &[Vec<f32>]) -> Result<Vec<Vec<f32>>> {
        let states = self.states(rows.concat(), rows.len())?;
        self.value.forward(&states.first_round()?)?.mul(&states.present)?.to_vec2()
    }

    /// Advantages of each user by eqs. (11) and (12), in the order of the rollout:
    /// delta_t = r_t + gamma V(s_t+1) - V(s_t), A_t = delta_t + gamma lambda A_t+1.
    fn advantages(&self, values: &[Vec<f32>]) -> Vec<Vec<f32>> {
        let Settings { gamma, smoothing, room_count, .. } = self.settings;
        let (gamma, decay) = (gamma as f32, (gamma * smoothing) as f32);
        let mut advantages = self.rollout.rewards.clone();
        for index in (0..advantages.len()).rev() {
            let later = advantages.get(index + room_count).cloned();
            for (slot, advantage) in advantages[index].iter_mut().enumerate() {
                *advantage += gamma * values[index + room_count][slot] - values[index][slot];
                *advantage += decay * later.as_ref().map_or(0.0, |later| later[slot]);
            }
        }
        advantages
    }

    /// All transitions of the episode as parts of minibatches, and forgets them.
    fn learn(&mut self, episode: &mut Episode<'_>) -> anyhow::Result<()> {
        let values = self.values(&self.rollout.states)?;
        let advantages = self.advantages(&values);
        let Rollout { states, raw, rewards } = std::mem::take(&mut self.rollout);
        let count = rewards.len();
        let slots = self.actor.mean.layout.slots();
        let of_users = |rows: &[Vec<f32>]| Tensor::from_vec(rows.concat(), (rows.len(), slots), &Device::Cpu);
        let all = self.states(states[..count].concat(), count)?;
        let advantage = all.mean_present(&of_users(&advantages)?)?.to_vec1::<f32>()?;
        let log_density = self.log_density(&all, &of_users(&raw)?)?.to_vec1::<f32>()?;
        let rate = self.settings.rate * self.settings.rate_end.powf(episode.progress());
        let mut order: Vec<usize> = (0..count).collect();
        for _ in 0..self.settings.epochs {
            for last in (1..count).rev() {
                order.swap(last, episode.rng.random_range(0..=last));
            }
            for chosen in order.chunks(self.settings.batch) {
                let rows = |from: &[Vec<f32>]| chosen.iter().map(|index| from[*index].clone()).collect::<Vec<_>>();
                let numbers = |from: &[f32]| {
                    Tensor::from_vec(chosen.iter().map(|index| from[*index]).collect(), chosen.len(), &Device::Cpu)
                };
                let advantages = of_users(&rows(&advantages))?;
                self.update(
                    &Minibatch {
                        states: self.states(rows(&states).concat(), chosen.len())?,
                        raw: of_users(&rows(&raw))?,
                        log_density: numbers(&log_density)?,
                        advantage: normalised(&numbers(&advantage)?)?,
                        returns: (advantages + of_users(&rows(&values))?)?,
                    },
                    rate,
                )?;
            }
        }
        Ok(())
    }

    /// One step of policy and value.
    fn update(&mut self, batch: &Minibatch, rate: f64) -> Result<()> {
        let Settings { clip, entropy, .. } = self.settings;
        let Minibatch { states, raw, log_density, advantage, returns } = batch;

        // Policy: maximise the mean of min(q A, clip(q, 1 - epsilon, 1 + epsilon) A) + c S, q the
        // ratio of the probabilities by the new and the old policy.
        let distribution = self.actor.distribution(states)?;
        let new = distribution.log_density(raw)?.mul(&states.present)?.sum(1)?;
        let ratio = (new - log_density)?.exp()?;
        let gain = ratio.mul(advantage)?.minimum(&ratio.clamp(1.0 - clip, 1.0 + clip)?.mul(advantage)?)?;
        let bonus = (states.mean_present(&distribution.entropy()?)? * entropy)?;
        let gradients = (gain + bonus)?.mean_all()?.neg()?.backward()?;
        self.mean_adam.step(&self.actor.mean.network, &gradients, rate)?;
        self.spread_adam.step(&self.actor.spread, &gradients, rate)?;

        // Value: minimise the mean of [V(s) - V_target]^2.
        let error = (self.value.forward(&states.first_round()?)? - returns)?.mul(&states.present)?;
        self.value_adam.step(&self.value, &error.sqr()?.mean_all()?.backward()?, rate)
    }
}

/// Numbers less their mean, over their standard deviation.
fn normalised(values: &Tensor) -> Result<Tensor> {
    let centred = values.broadcast_sub(&values.mean_all()?)?;
    let deviation = centred.sqr()?.mean_all()?.sqrt()?;
    centred.broadcast_div(&(deviation + 1e-8)?)
}

impl Learner for Ppo {
    fn rooms(&self) -> usize {
        self.settings.room_count
    }

    fn step(&mut self, episode: &mut Episode<'_>) -> anyhow::Result<Vec<Outcome>> {
        let (layout, is_last) = (self.actor.mean.layout, episode.step + 1 == self.settings.run.steps);
        let mut outcomes = Vec::with_capacity(episode.rooms.len());
        let mut after = Vec::new();
        for room in &mut episode.rooms {
            let state = States::row(layout, room.vector());
            let raw = self.actor.draw(&state, episode.rng)?;
            let actions: Vec<f32> = raw.iter().map(|raw| raw.tanh()).collect();
            let angles = self.actor.mean.decode(room, &actions);
            let mut rewards = vec![0.0; layout.slots()];
            outcomes.push(room.act(&angles, self.settings.run.reward, &mut rewards));
            room.step(self.settings.run.step_s)?;
            self.rollout.states.push(state);
            self.rollout.raw.push(raw);
            self.rollout.rewards.push(rewards);
            if is_last {
                after.push(States::row(layout, room.vector()));
            }
        }
        if is_last {
            self.rollout.states.extend(after);
            self.learn(episode)?;
        }
        Ok(outcomes)
    }

    fn act(&self, room: &Environment) -> anyhow::Result<MirrorAngles> {
        self.actor.mean.act(room)
    }

    /// An episode ends with an update, so no transition is left.
    fn state(&mut self) -> Vec<Part<'_>> {
        vec![
            part("actor", &mut self.actor.mean.network),
            part("actor", &mut self.mean_adam),
            part("spread", &mut self.actor.spread),
            part("spread", &mut self.spread_adam),
            part("value", &mut self.value),
            part("value", &mut self.value_adam),
        ]
    }

    fn export(&self, model: &ChannelModel, metadata: &[(String, String)]) -> anyhow::Result<Vec<u8>> {
        Ok(export(&self.actor.mean, model, metadata)?)
    }
}
