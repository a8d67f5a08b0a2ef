//! TD3: twin delayed deep deterministic policy gradient.
//!
//! Source: Fujimoto, van Hoof, Meger, "Addressing function approximation error in actor-critic
//! methods", ICML 2018, algorithm 1. The methods `step` and `update` of [`Td3`] are the complete
//! algorithm. Action, state, reward, rooms, networks, exploration and learning rates are those of
//! [`super::ddpg`], preset `tuned`. The three changes of the source:
//!
//! 1. **Clipped double Q-learning.** The target is the smaller prediction of two critics.
//! 2. **Delayed update.** Actor and targets move once in `ACTOR_DELAY` updates of the critics.
//! 3. **Smoothed target.** The target's action has clipped noise (`smoothed`).
//!
//! # Deviations from the source
//! 1. **Values of each user.** The critics predict each user's part of the reward, and the smaller
//!    prediction counts user by user.
//! 2. **gamma = 0.5** in place of 0.99. The first and the third change act on discounted values
//!    only, so gamma is not 0 as in `ddpg`; an action does not influence later states here, so a
//!    larger one adds noise.
//! 3. **Exploration** decays from 0.4 to 0.05, and the first 500 transitions have the actor's
//!    actions with noise in place of random ones.
//! 4. **tau = 0.01, batches of 32**, as in `ddpg`, in place of 0.005 and 100; 120 episodes, because
//!    two critics take twice the time of one.

use candle_core::{Device, Result, Tensor};
use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_core::policy::PolicyKind;
use heliostat_scenario::{ChannelMode, Scenario};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::ddpg;
use crate::environment::features::{Head, Layout};
use crate::environment::room::{Environment, Outcome};
use crate::export::actor::export;
use crate::networks::actor::{Actor, States};
use crate::networks::adam::Adam;
use crate::networks::critic::TwinCritics;
use crate::networks::layers::{Encoder, soft_update};
use crate::training::algorithm::{Algorithm, start};
use crate::training::exploration::{Exploration, Kind, normal};
use crate::training::learner::{Episode, Learner, Part, part};
use crate::training::settings::RunSettings;
use crate::training::transitions::{Transition, Transitions};

/// The row in the table of algorithms.
pub const ALGORITHM: Algorithm = Algorithm {
    name: "td3",
    policy: PolicyKind::Td3,
    help: "TD3 with one weight per user as the action",
    summary: "TD3 with one weight a user; deviations from its source at the head of `lab/learn/src/learners/td3.rs`",
    has_paper_preset: false,
    start: |scenario, _, options| {
        let settings = Settings::new(scenario.seed, scenario.channel.mode);
        start(scenario, settings, options, Td3::new)
    },
};

/// Updates of the critics for one update of the actor.
pub(super) const ACTOR_DELAY: usize = 2;

/// Standard deviation and bound of the noise on the target's action.
const TARGET_NOISE: (f64, f64) = (0.2, 0.5);

/// Actions with clipped noise, within [-1, 1]: target policy smoothing (section 5.3 of the source).
///
/// # Errors
/// Errors of candle.
pub(super) fn smoothed(actions: &Tensor, rng: &mut impl Rng) -> Result<Tensor> {
    let (deviation, bound) = TARGET_NOISE;
    let mut draw = || (deviation * normal(rng)).clamp(-bound, bound) as f32;
    let noise: Vec<f32> = (0..actions.elem_count()).map(|_| draw()).collect();
    (actions + Tensor::from_vec(noise, actions.shape(), &Device::Cpu)?)?.clamp(-1.0, 1.0)
}

/// The hyperparameters of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// The map from actions to decoder weights.
    pub head: Head,
    /// Discount factor gamma.
    pub gamma: f64,
    /// Weight tau of the trained network in each update of its target network.
    pub tau: f64,
    /// Learning rate of the actor.
    pub actor_rate: f64,
    /// Learning rate of the critics.
    pub critic_rate: f64,
    /// Learning rates at the end of the run over those at its start.
    pub rate_end: f64,
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
    /// The hyperparameters of the built-in actors.
    pub fn new(seed: u64, mode: ChannelMode) -> Self {
        let ddpg::Settings {
            head,
            tau,
            actor_rate,
            critic_rate,
            rate_end,
            batch,
            replay,
            warm_up,
            exploration,
            run,
            ..
        } = ddpg::Settings::tuned(seed, mode);
        let run = RunSettings { episodes: 120, ..run };
        Self { head, gamma: 0.5, tau, actor_rate, critic_rate, rate_end, batch, replay, warm_up, exploration, run }
    }
}

impl AsRef<RunSettings> for Settings {
    fn as_ref(&self) -> &RunSettings {
        &self.run
    }
}

/// TD3 with its state between two steps.
pub struct Td3 {
    settings: Settings,
    actor: Actor,
    actor_target: Actor,
    actor_adam: Adam,
    critics: TwinCritics,
    transitions: Transitions,
    /// Updates of the critics.
    updates: usize,
}

impl Td3 {
    /// The learner before its first episode.
    ///
    /// # Errors
    /// A kind of exploration of other actions, or errors of candle.
    pub fn new(scenario: &Scenario, settings: Settings, rng: &mut ChaCha8Rng) -> anyhow::Result<Self> {
        anyhow::ensure!(
            settings.exploration.kind != Kind::Patterns,
            "exploration.kind = \"patterns\" applies to actions that are angles: expected additive or epsilon-greedy"
        );
        let (layout, head) = (Layout::of(scenario), settings.head);
        let actor = Actor::new(layout, Encoder::PerUser, (head, 1), rng)?;
        Ok(Self {
            critics: TwinCritics::new(layout, head.range, rng)?,
            actor_target: actor.copy()?,
            actor_adam: Adam::new(&actor.network),
            transitions: Transitions::new(
                (layout, head.baseline_weight),
                (settings.replay, settings.warm_up.max(settings.batch)),
                settings.gamma > 0.0,
            ),
            actor,
            settings,
            updates: 0,
        })
    }

    /// One update from a minibatch.
    fn update(&mut self, episode: &mut Episode<'_>) -> Result<()> {
        let Settings { batch, gamma, tau, actor_rate, critic_rate, rate_end, .. } = self.settings;
        // Both learning rates decay geometrically over the run.
        let decay = rate_end.powf(episode.progress());

        // Critics: towards y = r + gamma min_i Q'_i(s', mu'(s') + noise).
        let Transition { states, actions, rewards, next } = self.transitions.sample(batch, episode.rng)?;
        let mut target = rewards.mul(&states.present)?;
        if let Some(next) = next {
            let next_actions = smoothed(&self.actor_target.forward(&next)?, episode.rng)?.mul(&next.present)?;
            target = (target + (self.critics.target(&next, &next_actions)? * gamma)?)?;
        }
        self.critics.update(&states, &actions, &target, critic_rate * decay)?;
        self.updates += 1;
        if !self.updates.is_multiple_of(ACTOR_DELAY) {
            return Ok(());
        }

        // Actor: maximise the mean of Q_1(s, mu(s)).
        let value = self.critics.first().mean_value(&states, &self.actor.forward(&states)?)?;
        self.actor_adam.step(&self.actor.network, &value.mean_all()?.neg()?.backward()?, actor_rate * decay)?;
        soft_update(&self.actor_target.network, &self.actor.network, tau)?;
        self.critics.follow(tau)
    }
}

impl Learner for Td3 {
    fn step(&mut self, episode: &mut Episode<'_>) -> anyhow::Result<Vec<Outcome>> {
        let Settings { exploration, run, .. } = &self.settings;
        let room = &mut episode.rooms[0];
        let state = States::row(self.actor.layout, room.vector());
        let mut action = self.actor.actions(&state)?;
        let magnitude = exploration.magnitude(episode.index, episode.count);
        exploration.apply(magnitude, &mut action[..room.users()], episode.rng);
        let angles = self.actor.decode(room, &action);
        let outcome = self.transitions.act(room, (&state, &action, &angles), run)?;
        if self.transitions.is_ready() {
            self.update(episode)?;
        }
        Ok(vec![outcome])
    }

    fn act(&self, room: &Environment) -> anyhow::Result<MirrorAngles> {
        self.actor.act(room)
    }

    fn state(&mut self) -> Vec<Part<'_>> {
        let mut parts = vec![
            part("actor", &mut self.actor.network),
            part("actor_target", &mut self.actor_target.network),
            part("actor", &mut self.actor_adam),
            part("replay", &mut self.transitions),
            part("updates", &mut self.updates),
        ];
        parts.extend(self.critics.state());
        parts
    }

    fn export(&self, model: &ChannelModel, metadata: &[(String, String)]) -> anyhow::Result<Vec<u8>> {
        Ok(export(&self.actor, model, metadata)?)
    }
}
