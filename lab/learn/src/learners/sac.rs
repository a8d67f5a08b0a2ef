//! SAC: soft actor-critic, which maximises the reward and the entropy of its actions.
//!
//! Source: Haarnoja, Zhou, Abbeel, Levine, "Soft actor-critic: off-policy maximum entropy deep
//! reinforcement learning with a stochastic actor", ICML 2018; the temperature and the two critics
//! without a value network: Haarnoja and others, "Soft actor-critic algorithms and applications",
//! arXiv 1812.05905, algorithm 1. The methods `step` and `update` of [`Sac`] are the complete
//! algorithm. Action, state, reward, rooms and learning rates are those of [`super::ddpg`], preset
//! `tuned`. The exported actor is the mean of the distribution.
//!
//! # Deviations from the source
//! 1. **Values of each user.** The critics predict each user's part of the reward, and entropies
//!    and values are means over the users. The target entropy of -1 for each dimension of the
//!    action is that of the source.
//! 2. **gamma = 0**, because an action does not influence later states here. The two critics act in
//!    the actor's loss; option `gamma` has the soft Bellman target.
//! 3. **Temperature.** Its logarithm follows the gradient of eq. (18) without Adam.
//! 4. **Two networks** of 128/64 give mean and standard deviation, in place of one with two heads.
//! 5. **tau = 0.01, batches of 32 and learning rates** as in `ddpg`, in place of 0.005, 256 and
//!    3e-4; 120 episodes.

use candle_core::Result;
use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_core::policy::PolicyKind;
use heliostat_scenario::{ChannelMode, Scenario};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::ddpg;
use crate::environment::features::{Head, Layout};
use crate::environment::room::{Environment, Outcome};
use crate::export::actor::export;
use crate::networks::actor::States;
use crate::networks::adam::Adam;
use crate::networks::critic::TwinCritics;
use crate::networks::gaussian::GaussianActor;
use crate::training::algorithm::{Algorithm, start};
use crate::training::learner::{Episode, Learner, Part, part};
use crate::training::settings::RunSettings;
use crate::training::transitions::{Transition, Transitions};

/// The row in the table of algorithms.
pub const ALGORITHM: Algorithm = Algorithm {
    name: "sac",
    policy: PolicyKind::Sac,
    help: "SAC with one weight per user as the action",
    summary: "SAC with one weight a user; deviations from its source at the head of `lab/learn/src/learners/sac.rs`",
    has_paper_preset: false,
    start: |scenario, _, options| {
        let settings = Settings::new(scenario.seed, scenario.channel.mode);
        start(scenario, settings, options, Sac::new)
    },
};

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
    /// Temperature alpha at the start: the weight of the entropy.
    pub temperature: f64,
    /// Learning rate of the logarithm of the temperature; 0 keeps the temperature.
    pub temperature_rate: f64,
    /// Entropy of each user's action towards which the temperature moves.
    pub target_entropy: f64,
    /// Transitions in a minibatch.
    pub batch: usize,
    /// Capacity of the replay buffer.
    pub replay: usize,
    /// Transitions before the first update.
    pub warm_up: usize,
    /// The hyperparameters that every run has.
    #[serde(flatten)]
    pub run: RunSettings,
}

impl Settings {
    /// The hyperparameters of the built-in actors.
    pub fn new(seed: u64, mode: ChannelMode) -> Self {
        let ddpg::Settings { head, gamma, tau, actor_rate, critic_rate, rate_end, batch, replay, warm_up, run, .. } =
            ddpg::Settings::tuned(seed, mode);
        Self {
            head,
            gamma,
            tau,
            actor_rate,
            critic_rate,
            rate_end,
            temperature: 0.1,
            temperature_rate: 1e-3,
            target_entropy: -1.0,
            batch,
            replay,
            warm_up,
            run: RunSettings { episodes: 120, ..run },
        }
    }
}

impl AsRef<RunSettings> for Settings {
    fn as_ref(&self) -> &RunSettings {
        &self.run
    }
}

/// SAC with its state between two steps.
pub struct Sac {
    settings: Settings,
    actor: GaussianActor,
    mean_adam: Adam,
    spread_adam: Adam,
    critics: TwinCritics,
    /// ln alpha.
    log_temperature: f64,
    transitions: Transitions,
}

impl Sac {
    /// The learner before its first episode.
    ///
    /// # Errors
    /// Errors of candle, or a temperature that is not positive.
    pub fn new(scenario: &Scenario, settings: Settings, rng: &mut ChaCha8Rng) -> anyhow::Result<Self> {
        let temperature = settings.temperature;
        anyhow::ensure!(temperature > 0.0, "temperature = {temperature}: expected above 0, for example 0.1");
        let (layout, head) = (Layout::of(scenario), settings.head);
        let actor = GaussianActor::new(layout, head, rng)?;
        Ok(Self {
            mean_adam: Adam::new(&actor.mean.network),
            spread_adam: Adam::new(&actor.spread),
            critics: TwinCritics::new(layout, head.range, rng)?,
            log_temperature: temperature.ln(),
            transitions: Transitions::new(
                (layout, head.baseline_weight),
                (settings.replay, settings.warm_up.max(settings.batch)),
                settings.gamma > 0.0,
            ),
            actor,
            settings,
        })
    }

    /// One update from a minibatch.
    fn update(&mut self, episode: &mut Episode<'_>) -> Result<()> {
        let Settings { batch, gamma, tau, actor_rate, critic_rate, rate_end, .. } = self.settings;
        // Both learning rates decay geometrically over the run.
        let decay = rate_end.powf(episode.progress());
        let temperature = self.log_temperature.exp();

        // Critics: towards y = r + gamma [min_i Q'_i(s', a') - alpha ln pi(a' | s')], a' ~ pi.
        let Transition { states, actions, rewards, next } = self.transitions.sample(batch, episode.rng)?;
        let mut target = rewards.mul(&states.present)?;
        if let Some(next) = next {
            let distribution = self.actor.distribution(&next)?;
            let raw = distribution.draw(episode.rng)?;
            let surprise = (distribution.log_density_of_action(&raw)? * temperature)?;
            let value = self.critics.target(&next, &raw.tanh()?.mul(&next.present)?)?;
            let soft = (value - surprise)?.mul(&next.present)?.detach();
            target = (target + (soft * gamma)?)?;
        }
        self.critics.update(&states, &actions, &target, critic_rate * decay)?;

        // Actor: minimise the mean of alpha ln pi(a | s) - min_i Q_i(s, a), a ~ pi.
        let distribution = self.actor.distribution(&states)?;
        let raw = distribution.draw(episode.rng)?;
        let log_density = states.mean_present(&distribution.log_density_of_action(&raw)?)?;
        let value = self.critics.least_mean(&states, &raw.tanh()?.mul(&states.present)?)?;
        let gradients = ((&log_density * temperature)? - value)?.mean_all()?.backward()?;
        self.mean_adam.step(&self.actor.mean.network, &gradients, actor_rate * decay)?;
        self.spread_adam.step(&self.actor.spread, &gradients, actor_rate * decay)?;

        // Temperature: more of it where the entropy is below its target.
        let entropy = -f64::from(log_density.mean_all()?.to_scalar::<f32>()?);
        self.log_temperature += self.settings.temperature_rate * (self.settings.target_entropy - entropy);

        // Targets: without a discounted value they are not used.
        if gamma > 0.0 { self.critics.follow(tau) } else { Ok(()) }
    }
}

impl Learner for Sac {
    fn step(&mut self, episode: &mut Episode<'_>) -> anyhow::Result<Vec<Outcome>> {
        let room = &mut episode.rooms[0];
        let state = States::row(self.actor.mean.layout, room.vector());
        let mut action = self.actor.draw(&state, episode.rng)?;
        let users = room.users();
        action[..users].iter_mut().for_each(|raw| *raw = raw.tanh());
        action[users..].fill(0.0);
        let angles = self.actor.mean.decode(room, &action);
        let outcome = self.transitions.act(room, (&state, &action, &angles), &self.settings.run)?;
        if self.transitions.is_ready() {
            self.update(episode)?;
        }
        Ok(vec![outcome])
    }

    fn act(&self, room: &Environment) -> anyhow::Result<MirrorAngles> {
        self.actor.mean.act(room)
    }

    fn notes(&self) -> Vec<(&'static str, String)> {
        vec![("temperature at the end", format!("{:.4}", self.log_temperature.exp()))]
    }

    fn state(&mut self) -> Vec<Part<'_>> {
        let mut parts = vec![
            part("actor", &mut self.actor.mean.network),
            part("actor", &mut self.mean_adam),
            part("spread", &mut self.actor.spread),
            part("spread", &mut self.spread_adam),
            part("log_temperature", &mut self.log_temperature),
            part("replay", &mut self.transitions),
        ];
        parts.extend(self.critics.state());
        parts
    }

    fn export(&self, model: &ChannelModel, metadata: &[(String, String)]) -> anyhow::Result<Vec<u8>> {
        Ok(export(&self.actor.mean, model, metadata)?)
    }
}
