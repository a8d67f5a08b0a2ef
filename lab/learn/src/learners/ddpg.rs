//! Algorithm 1 of the paper: DDPG, with one action u_k per user instead of all mirror angles.
//!
//! The methods `step` and `update` of [`Ddpg`] are the complete algorithm.
//! [`crate::environment::features`] defines action, decoder weight and baseline weight.
//!
//! # Deviations from the paper
//!
//! Both presets:
//! 1. **Action.** The actor outputs one action u_k in [-1, 1] per user. The decoder weight is w_k =
//!    b_k exp(c u_k). In `specular` the decoder assigns each mirror to the user with the largest
//!    product of weight and gain. In the paper's modes it turns each mirror to the weighted sum of
//!    the users' directions. The paper's action is 200 raw angles, almost all of which saturate at
//!    their bounds during training.
//! 2. **State.** Features of positions, direct gains, steering gains, minimum rates, and the
//!    amplitudes with equal-share and balanced weights ([`crate::environment::features`]). The
//!    state does not include the current angles. Without actuator dynamics the optimal action does
//!    not depend on them.
//! 3. **Reward.** The printed penalty applies to users whose minimum rate is met. Here the
//!    shortfall is penalised; option `reward.form` has the printed form. The reward is divided by
//!    the bandwidth, so that values are of order one.
//! 4. **Exploration.** Additive noise, as in Algorithm 1, with a standard deviation that decays
//!    from 0.4 to 0.05. The paper's text names epsilon-greedy; option `exploration.kind` has it.
//! 5. **Episodes.** The paper gives no number of steps; here there are 40, of one second each.
//!    Every episode has a new room with another number of users, blockage, noise and minimum rates
//!    (`rooms=fixed` has the scenario's). The first update waits for 500 transitions.
//! 6. **Several users.** The state has slots for 1 to 10 users and a mask, so that one actor serves
//!    any of these numbers.
//!
//! Preset `paper` has no further deviation. Its networks have hidden layers of 128/64 (actor) and
//! 256/128 (critic). Its hyperparameters are gamma 0.9, tau 0.01, batches of 32, replay of 10000,
//! learning rates of 1e-3 (actor) and 1e-2 (critic), and 1000 episodes. Preset `tuned`, the
//! default, also deviates in these points; `lab/learn/experiments.md` has the effect of each:
//!
//! 7. **One network per user.** The networks have the same widths and are shared by all users, so
//!    that the output does not depend on the order of users. Users interact through the amplitudes
//!    and weights of the observation, and through the decoder.
//! 8. **Value of each user.** The critic predicts each user's part of the reward, and the value is
//!    their mean. Each transition then gives several training targets.
//! 9. **gamma = 0.** An action does not influence later states here, so their values are only noise
//!    in the target. With gamma = 0 this is a contextual bandit.
//! 10. **Balanced baseline weights.** The baseline weight b_k is q_k: four damped steps of a
//!     model-based fixed point compute it ([`heliostat_channel::sharing`]). The network learns a
//!     correction.
//! 11. **Critic with decoded actions.** In addition to the actions, the critic reads the amplitude
//!     that each user has under them, by the smooth decoder ([`crate::networks::actor`]). The
//!     effect of weights on amplitudes is known and need not be learned.
//! 12. **Centred actions** in the critic: weights that differ by a common factor decode to the same
//!     angles.
//! 13. **lambda = 10.** In `specular` lambda is 30, minimum rates are multiplied by 1.25, and half
//!     of the rooms have no bodies. With the paper's lambda of 1 the policy does not serve users in
//!     deep shadow.
//! 14. **Learning rates.** 5e-4 (actor) and 1e-3 (critic), decaying to 5e-5 and 1e-4 over the run
//!     of 300 episodes.

use heliostat_channel::MirrorAngles;
use heliostat_core::policy::PolicyKind;
use heliostat_scenario::{ChannelMode, Scenario};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::environment::features::{BaselineWeight, Head, Layout};
use crate::environment::room::{Environment, Outcome, Reward, RewardForm, Rooms};
use crate::export::actor::export;
use crate::networks::actor::{Actor, States};
use crate::networks::adam::Adam;
use crate::networks::critic::{Critic, Sight, Value};
use crate::networks::layers::{Encoder, soft_update};
use crate::training::algorithm::{Algorithm, Preset, start};
use crate::training::exploration::{Exploration, Kind};
use crate::training::learner::{Episode, Learner, Part, part};
use crate::training::settings::RunSettings;
use crate::training::transitions::{Transition, Transitions};

/// The row in the table of algorithms.
pub const ALGORITHM: Algorithm = Algorithm {
    name: "ddpg",
    policy: PolicyKind::Ddpg,
    help: "Algorithm 1 of the paper with one weight per user as the action",
    summary: "DDPG with one weight a user; deviations from the paper at the head of `lab/learn/src/learners/ddpg.rs`",
    has_paper_preset: true,
    start: |scenario, preset, options| {
        let settings = match preset {
            Preset::Tuned => Settings::tuned(scenario.seed, scenario.channel.mode),
            Preset::Paper => Settings::paper(scenario.seed),
        };
        start(scenario, settings, options, Ddpg::new)
    },
};

/// The hyperparameters of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// The way in which the networks read the users.
    pub encoder: Encoder,
    /// The map from actions to decoder weights.
    pub head: Head,
    /// The quantity that the critic predicts.
    pub value: Value,
    /// The critic's inputs that depend on the action.
    pub sight: Sight,
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
    pub fn paper(seed: u64) -> Self {
        Self {
            encoder: Encoder::Mlp,
            head: Head { baseline_weight: BaselineWeight::Uniform, range: 4.0 },
            value: Value::Total,
            sight: Sight::Actions,
            gamma: 0.9,
            tau: 0.01,
            actor_rate: 1e-3,
            critic_rate: 1e-2,
            rate_end: 1.0,
            batch: 32,
            replay: 10_000,
            warm_up: 500,
            exploration: Exploration { kind: Kind::Additive, start: 0.4, end: 0.05 },
            run: RunSettings::paper(seed),
        }
    }

    /// The hyperparameters of the shipped actors.
    pub fn tuned(seed: u64, mode: ChannelMode) -> Self {
        let (lambda, margin, rooms) = match mode {
            ChannelMode::Specular => (30.0, 1.25, Rooms::Mixed),
            _ => (10.0, 1.0, Rooms::Randomised),
        };
        let paper = Self::paper(seed);
        Self {
            encoder: Encoder::PerUser,
            head: Head { baseline_weight: BaselineWeight::Balanced, range: 2.0 },
            value: Value::EachUser,
            sight: Sight::Decoded,
            gamma: 0.0,
            actor_rate: 5e-4,
            critic_rate: 1e-3,
            rate_end: 0.1,
            run: RunSettings {
                reward: Reward { form: RewardForm::Shortfall, lambda, margin },
                rooms,
                episodes: 300,
                ..paper.run
            },
            ..paper
        }
    }
}

/// DDPG with its state between two steps.
pub struct Ddpg {
    settings: Settings,
    actor: Actor,
    critic: Critic,
    actor_target: Actor,
    critic_target: Critic,
    actor_adam: Adam,
    critic_adam: Adam,
    transitions: Transitions,
}

impl Ddpg {
    /// The learner before its first episode.
    ///
    /// # Errors
    /// Two settings contradict each other.
    pub fn new(scenario: &Scenario, settings: Settings, rng: &mut ChaCha8Rng) -> anyhow::Result<Self> {
        let Settings { encoder, head, value, sight, .. } = settings;
        let layout = Layout::of(scenario);
        let actor = Actor::new(layout, encoder, head, rng)?;
        let critic = Critic::new(layout, encoder, (value, sight, head.range), rng)?;
        Ok(Self {
            actor_target: actor.copy()?,
            critic_target: critic.copy()?,
            actor_adam: Adam::new(&actor.network),
            critic_adam: Adam::new(&critic.network),
            transitions: Transitions::new(
                (layout, head.baseline_weight),
                (settings.replay, settings.warm_up.max(settings.batch)),
                settings.gamma > 0.0,
            ),
            actor,
            critic,
            settings,
        })
    }

    /// The actor in its present state.
    pub fn actor(&self) -> &Actor {
        &self.actor
    }

    /// One update of critic, actor and targets from a minibatch.
    fn update(&mut self, episode: &mut Episode<'_>) -> candle_core::Result<()> {
        let Settings { batch, gamma, tau, actor_rate, critic_rate, rate_end, .. } = self.settings;
        // Both learning rates decay geometrically over the run.
        let decay = rate_end.powf(episode.progress());

        // Critic: minimise the mean of [Q(s, a) - r - gamma Q'(s', mu'(s'))]^2.
        let Transition { states, actions, rewards, next } = self.transitions.sample(batch, episode.rng)?;
        let mut target = self.critic.reduce(&states, &rewards)?;
        if let Some(next) = next {
            let next_value = self.critic_target.value(&next, &self.actor_target.forward(&next)?)?;
            target = (target + (next_value.detach() * gamma)?)?;
        }
        let error = (self.critic.value(&states, &actions)? - target)?;
        let gradients = error.sqr()?.mean_all()?.backward()?;
        self.critic_adam.step(&self.critic.network, &gradients, critic_rate * decay)?;

        // Actor: maximise the mean of Q(s, mu(s)).
        let value = self.critic.frozen().mean_value(&states, &self.actor.forward(&states)?)?;
        let gradients = value.mean_all()?.neg()?.backward()?;
        self.actor_adam.step(&self.actor.network, &gradients, actor_rate * decay)?;

        // Targets: without a discounted value they are not used.
        if gamma > 0.0 {
            soft_update(&self.actor_target.network, &self.actor.network, tau)?;
            soft_update(&self.critic_target.network, &self.critic.network, tau)?;
        }
        Ok(())
    }
}

impl Learner for Ddpg {
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
        vec![
            part("actor", &mut self.actor.network),
            part("critic", &mut self.critic.network),
            part("actor_target", &mut self.actor_target.network),
            part("critic_target", &mut self.critic_target.network),
            part("actor", &mut self.actor_adam),
            part("critic", &mut self.critic_adam),
            part("replay", &mut self.transitions),
        ]
    }

    fn export(&self, metadata: &[(String, String)]) -> anyhow::Result<Vec<u8>> {
        Ok(export(&self.actor, metadata)?)
    }
}
