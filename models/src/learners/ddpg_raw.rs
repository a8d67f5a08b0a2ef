//! Algorithm 1 of the paper to the letter: DDPG whose action is the roll and yaw of every mirror.
//!
//! State, networks of 128/64 and 256/128, gamma 0.9, tau 0.01, batches of 32, replay of 10000, rates of 1e-3 and 1e-2, additive noise and 1000
//! episodes are the paper's. The actor's last layer is tanh times the range of an axis.
//!
//! # Departures from the paper, and why
//! 1. **Reward.** The printed penalty falls on users whose need is met; the shortfall is punished instead (`--option reward.form=as-printed` has the printed form).
//!    It is divided by the bandwidth, so that values are of order one.
//! 2. **Steps.** Their number in an episode is not given in the paper: 40, of one second each.
//! 3. **Gains of the state.** The gain of the direct path, as ln(1 + amplitude); the gain over the mirrors follows from positions and current
//!    angles, which are both there.
//! 4. **Slots.** The state has places for ten users; a room's users take the first ones.
//! 5. **Exploration.** Additive noise, as Algorithm 1 says, where the text says epsilon-greedy from 0.995 to 1e-4; its deviation, which the paper does not
//!    give, falls from 0.4 to 0.05 of the range. The first update waits for 500 transitions.
//!
//! Nearly all outputs end at their bounds, and the result is below that of mirrors that nobody turns. This is what the paper describes, and it
//! is here to be seen, not to be used; [`crate::ddpg_basis`] and [`crate::ddpg`] say what helps.
//!
//! Option `td3` adds the three changes of TD3 (Fujimoto and others, 2018): the smaller of two critics as target, noise on the target's action, and an
//! actor that is updated every second time.

use candle_core::{Device, Tensor};
use heliostat_channel::MirrorAngles;
use heliostat_scenario::Scenario;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::checkpoint::Store;
use crate::env::{Environment, Reward, RewardForm, Rooms};
use crate::explore::{Exploration, Kind, normal};
use crate::learner::{Episode, Learner, RunSettings};
use crate::networks::{Adam, Encoder, Network, Shape, soft_update};
use crate::raw::{Basis, RawLayout};
use crate::replay::Replay;

/// TD3: standard deviation and bound of the noise on the target's action, and updates of the critic for one of the actor.
const TARGET_NOISE: (f64, f64) = (0.2, 0.5);
const ACTOR_DELAY: usize = 2;

/// What the critic sees of an action.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sight {
    /// Every angle.
    Angles,
    /// The strengths of smooth patterns of angles ([`Basis`]).
    Patterns,
}

/// Every number of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// What the critic sees of an action.
    pub sight: Sight,
    /// Patterns along each side of the array, where the critic or the exploration uses them.
    pub patterns: usize,
    /// Whether the current angles are part of the state.
    pub angles_in_state: bool,
    /// Discount factor.
    pub gamma: f64,
    /// Share of the new parameters in each update of a target network.
    pub tau: f64,
    /// Learning rate of the actor.
    pub actor_rate: f64,
    /// Learning rate of the critic.
    pub critic_rate: f64,
    /// Learning rates at the end of the run, relative to the start.
    pub rate_end: f64,
    /// Largest norm of a gradient; 0 is no limit.
    pub clip: f64,
    /// Weight of the mean squared output before tanh in the actor's loss; keeps outputs off their bounds.
    pub saturation: f64,
    /// The three changes of TD3.
    pub td3: bool,
    /// Transitions in an update.
    pub batch: usize,
    /// Transitions kept.
    pub replay: usize,
    /// Transitions before the first update.
    pub warm_up: usize,
    /// How actions are disturbed.
    pub exploration: Exploration,
    /// What every algorithm has.
    #[serde(flatten)]
    pub run: RunSettings,
}

impl Settings {
    /// The paper's numbers.
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
            run: RunSettings {
                reward: Reward { form: RewardForm::Shortfall, lambda: 1.0, margin: 1.0 },
                rooms: Rooms::Fixed,
                episodes: 1000,
                steps: 40,
                step_s: 1.0,
                seed,
            },
        }
    }
}

/// A training run; also that of [`crate::ddpg_basis`].
pub struct Trainer {
    settings: Settings,
    scenario: Scenario,
    layout: RawLayout,
    basis: Basis,
    actor: Network,
    actor_target: Network,
    actor_adam: Adam,
    critics: Vec<Critic>,
    replay: Replay,
    rng: ChaCha8Rng,
    updates: usize,
    episode: usize,
}

/// One critic of one or two.
struct Critic {
    network: Network,
    target: Network,
    adam: Adam,
}

impl Trainer {
    /// A run at its beginning.
    ///
    /// # Errors
    /// Those of candle.
    pub fn new(scenario: Scenario, settings: Settings) -> anyhow::Result<Self> {
        let mut rng = ChaCha8Rng::seed_from_u64(settings.run.seed);
        let layout = RawLayout::of(&scenario, settings.angles_in_state);
        let basis = Basis::new(scenario.mirrors.rows, scenario.mirrors.columns, settings.patterns)?;
        let (inputs, outputs) = (layout.inputs(), layout.outputs());
        let plain = |inputs, hidden, outputs| Shape { encoder: Encoder::Mlp, slots: 1, inputs, hidden, outputs };
        let actor = Network::new(plain(inputs, [128, 64], outputs), &mut rng)?;
        let seen = if settings.sight == Sight::Angles { outputs } else { basis.modes() };
        let critic = |rng: &mut ChaCha8Rng| {
            let network = Network::new(plain(inputs + seen, [256, 128], 1), rng)?;
            let adam = Adam::new(&network, settings.critic_rate).clipped(settings.clip);
            Ok::<_, candle_core::Error>(Critic { target: network.copy()?, network, adam })
        };
        let critics = (0..if settings.td3 { 2 } else { 1 }).map(|_| critic(&mut rng)).collect::<Result<_, _>>()?;
        let next = if settings.gamma > 0.0 { inputs } else { 0 };
        Ok(Self {
            actor_target: actor.copy()?,
            actor_adam: Adam::new(&actor, settings.actor_rate).clipped(settings.clip),
            critics,
            replay: Replay::new(settings.replay, [inputs, outputs, 1, next]),
            actor,
            layout,
            basis,
            rng,
            scenario,
            settings,
            updates: 0,
            episode: 0,
        })
    }

    /// Actions in [-1, 1] from a batch of states, and the outputs before tanh.
    fn actions(network: &Network, states: &Tensor) -> candle_core::Result<(Tensor, Tensor)> {
        let raw = network.forward_rows(states)?;
        Ok((raw.tanh()?, raw))
    }

    fn answer(&self, state: &[f32]) -> candle_core::Result<Vec<f32>> {
        let states = Tensor::from_slice(state, (1, state.len()), &Device::Cpu)?;
        Self::actions(&self.actor, &states)?.0.squeeze(0)?.to_vec1()
    }

    fn explore(&mut self, action: &mut [f32]) -> candle_core::Result<()> {
        let exploration = self.settings.exploration;
        let magnitude = exploration.magnitude(self.episode, self.settings.run.episodes);
        if exploration.kind != Kind::Patterns {
            exploration.disturb(magnitude, action, &mut self.rng);
            return Ok(());
        }
        let each = magnitude / ((self.basis.modes() / 2) as f64).sqrt();
        let strengths: Vec<f32> = (0..self.basis.modes()).map(|_| (each * normal(&mut self.rng)) as f32).collect();
        for (value, noise) in action.iter_mut().zip(self.basis.sum(&strengths)?) {
            *value = (*value + noise).clamp(-1.0, 1.0);
        }
        Ok(())
    }

    /// What a critic makes of actions: (batch).
    fn value(&self, critic: &Network, states: &Tensor, actions: &Tensor) -> candle_core::Result<Tensor> {
        let seen = match self.settings.sight {
            Sight::Angles => actions.clone(),
            Sight::Patterns => self.basis.project(actions)?,
        };
        critic.forward_rows(&Tensor::cat(&[states, &seen], 1)?)?.squeeze(1)
    }

    /// The value of the next states, (batch).
    fn next_value(&mut self, next: &Tensor) -> candle_core::Result<Tensor> {
        let mut actions = Self::actions(&self.actor_target, next)?.0;
        if self.settings.td3 {
            let (spread, bound) = TARGET_NOISE;
            let mut draw = || (spread * normal(&mut self.rng)).clamp(-bound, bound) as f32;
            let noise: Vec<f32> = (0..actions.elem_count()).map(|_| draw()).collect();
            actions = (&actions + Tensor::from_vec(noise, actions.shape(), &Device::Cpu)?)?.clamp(-1.0, 1.0)?;
        }
        let mut values = self.critics.iter().map(|critic| self.value(&critic.target, next, &actions));
        let first = values.next().expect("there is a critic")?;
        values.try_fold(first, |least, value| least.minimum(&value?))
    }

    /// One update of critics, actor and targets from a minibatch.
    fn update(&mut self) -> candle_core::Result<()> {
        let (batch, inputs) = (self.settings.batch, self.layout.inputs());
        let [states, actions, rewards, next] = self.replay.sample(batch, &mut self.rng);
        let states = Tensor::from_vec(states, (batch, inputs), &Device::Cpu)?;
        let actions = Tensor::from_vec(actions, (batch, self.layout.outputs()), &Device::Cpu)?;
        let mut target = Tensor::from_vec(rewards, batch, &Device::Cpu)?;
        if self.settings.gamma > 0.0 {
            let next = self.next_value(&Tensor::from_vec(next, (batch, inputs), &Device::Cpu)?)?;
            target = (target + (next.detach() * self.settings.gamma)?)?;
        }
        for index in 0..self.critics.len() {
            let error = (self.value(&self.critics[index].network, &states, &actions)? - &target)?;
            let gradients = error.sqr()?.mean_all()?.backward()?;
            let Critic { network, adam, .. } = &mut self.critics[index];
            adam.step(network, &gradients)?;
        }
        self.updates += 1;
        if self.settings.td3 && !self.updates.is_multiple_of(ACTOR_DELAY) {
            return Ok(());
        }
        let (actions, raw) = Self::actions(&self.actor, &states)?;
        let value = self.value(&self.critics[0].network.frozen(), &states, &actions)?.mean_all()?;
        let loss = ((raw.sqr()?.mean_all()? * self.settings.saturation)? - value)?;
        self.actor_adam.step(&self.actor, &loss.backward()?)?;
        if self.settings.gamma > 0.0 {
            soft_update(&self.actor_target, &self.actor, self.settings.tau)?;
            for Critic { network, target, .. } in &self.critics {
                soft_update(target, network, self.settings.tau)?;
            }
        }
        Ok(())
    }

    fn set_learning_rates(&mut self) {
        let progress = self.episode as f64 / self.settings.run.episodes.max(1) as f64;
        let factor = self.settings.rate_end.powf(progress);
        self.actor_adam.set_learning_rate(self.settings.actor_rate * factor);
        let rate = self.settings.critic_rate * factor;
        self.critics.iter_mut().for_each(|critic| critic.adam.set_learning_rate(rate));
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

    fn episodes_done(&self) -> usize {
        self.episode
    }

    fn run_episode(&mut self) -> anyhow::Result<Episode> {
        let run = self.settings.run.clone();
        let room = run.rooms.draw(&self.scenario, &mut self.rng);
        let mut environment = Environment::new(&room, self.rng.random())?;
        self.set_learning_rates();
        let (mut summary, users) = (Episode::default(), environment.users());
        let mut rewards = vec![0.0; users];
        let mut state = self.layout.state(environment.vector());
        for _ in 0..run.steps {
            let mut action = self.answer(&state)?;
            self.explore(&mut action)?;
            let outcome = environment.act(&self.layout.angles(&action), run.reward, &mut rewards);
            let reward = rewards.iter().sum::<f32>() / users as f32;
            environment.step(run.step_s)?;
            let next = self.layout.state(environment.vector());
            self.replay.push([&state, &action, &[reward], if self.settings.gamma > 0.0 { &next[..] } else { &[] }]);
            state = next;
            if self.replay.len() >= self.settings.warm_up.max(self.settings.batch) {
                self.update()?;
            }
            summary.reward_mbps += outcome.reward_mbps / run.steps as f64;
            summary.sum_rate_mbps += outcome.sum_rate_mbps / run.steps as f64;
        }
        self.episode += 1;
        Ok(Episode { number: self.episode, steps: self.episode * run.steps, ..summary })
    }

    fn act(&self, environment: &Environment) -> anyhow::Result<MirrorAngles> {
        Ok(self.layout.angles(&self.answer(&self.layout.state(environment.vector()))?))
    }

    fn save(&self, store: &mut Store) -> anyhow::Result<()> {
        store.put_network("actor", &self.actor);
        store.put_network("actor_target", &self.actor_target);
        store.put_adam("actor", &self.actor_adam)?;
        for (index, Critic { network, target, adam }) in self.critics.iter().enumerate() {
            store.put_network(&format!("critic.{index}"), network);
            store.put_network(&format!("critic_target.{index}"), target);
            store.put_adam(&format!("critic.{index}"), adam)?;
        }
        store.put_replay(&self.replay)?;
        store.put_generator(&self.rng)?;
        store.put("updates", &self.updates)?;
        store.put("episode", &self.episode)
    }

    fn restore(&mut self, store: &Store) -> anyhow::Result<()> {
        store.restore_network("actor", &self.actor)?;
        store.restore_network("actor_target", &self.actor_target)?;
        store.restore_adam("actor", &mut self.actor_adam)?;
        for (index, Critic { network, target, adam }) in self.critics.iter_mut().enumerate() {
            store.restore_network(&format!("critic.{index}"), network)?;
            store.restore_network(&format!("critic_target.{index}"), target)?;
            store.restore_adam(&format!("critic.{index}"), adam)?;
        }
        store.restore_replay(&mut self.replay)?;
        self.rng = store.generator()?;
        self.updates = store.get("updates")?;
        self.episode = store.get("episode")?;
        Ok(())
    }

    fn export(&self, metadata: &[(String, String)]) -> anyhow::Result<Vec<u8>> {
        Ok(self.layout.export(&self.actor, metadata)?)
    }
}
