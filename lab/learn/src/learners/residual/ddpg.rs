//! Fine-tuning of the corrections by DDPG, with a critic that knows the true room.
//!
//! The paper has no such algorithm. The actor is the network of `residual`, which reads reports
//! only. The critic is not part of the result and may know more: it also reads the truth about each
//! user (asymmetric actor-critic, Pinto and others, 2018). The method `update` of [`Ddpg`] follows
//! these choices:
//!
//! 1. **Action.** The change of each receiver's normal that counts, so that the critic need not
//!    learn the conditions under which a change counts. The actor's gradient passes a soft form of
//!    them.
//! 2. **Reward.** The mean over the users of (K / B) (rate - penalty) in the true room with the
//!    true angles, at the next decision, times 1 - gamma. Values are then of the order of a reward.
//! 3. **Discount.** gamma is above 0, because a correction also changes what later reports show.
//! 4. **Critic.** The value is the mean over the users of one network's output for each of them
//!    (value decomposition, Sunehag and others, 2018).
//! 5. **Exploration.** Noise on the change of each user, with correlation over time. It counts
//!    where the measured gains do not contradict it, whatever its variance.
//! 6. **Episodes.** As in the supervised training, the present network decides in newly drawn
//!    rooms, and learns after that. The critic learns alone until the buffer holds `warm_up`
//!    decisions.

use anyhow::ensure;
use candle_core::{Device, Result, Tensor};
use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_core::evidence::FEATURES;
use heliostat_room::SimulatedRoom;
use heliostat_scenario::Scenario;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::actor;
use super::explorer::{CHANGE, Explorer};
use crate::environment::reported::{Future, RoomChoice, decisions};
use crate::environment::room::{Environment, Outcome, Reward, RewardForm};
use crate::networks::actor::mean_present;
use crate::networks::adam::Adam;
use crate::networks::layers::{Encoder, Network, Shape, soft_update};
use crate::training::learner::{Episode, Learner, Part, part};
use crate::training::replay::Replay;
use crate::training::settings::RunSettings;

/// Slots for users: the largest number in a training room.
const SLOTS: usize = RoomChoice::USERS_MAX as usize;

/// What the critic knows of a user besides the row: change to the true normal (2), error of the
/// place (2), logarithms of believed and true amplitudes of the direct path and of all mirrors (4),
/// minimum rate, share of a user in the number of all.
const TRUTH: usize = 10;

/// Values of a user in a state: presence, row, truth.
const WIDTH: usize = 1 + FEATURES + TRUTH;

/// The hyperparameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// The fine-tuning, which a checkpoint names.
    pub fine_tune: String,
    /// The file of the first network; empty for the built-in actor of the seed.
    pub from: String,
    /// Discount factor gamma of the time between two decisions.
    pub gamma: f64,
    /// Weight tau of the trained network in each update of its target network.
    pub tau: f64,
    /// Learning rate of the actor.
    pub actor_rate: f64,
    /// Learning rate of the critic.
    pub critic_rate: f64,
    /// Learning rates at the end of the run over those at its start.
    pub rate_end: f64,
    /// Decisions in a minibatch.
    pub batch: usize,
    /// Capacity of the replay buffer.
    pub replay: usize,
    /// Decisions before the first update of the actor.
    pub warm_up: usize,
    /// Updates after the rooms of an episode.
    pub updates: usize,
    /// Standard deviation of the noise on a component of a normal, in the first episode and in the
    /// last.
    pub noise: [f64; 2],
    /// Rooms of an episode.
    pub room_count: usize,
    /// Time in each room in s.
    pub room_s: f64,
    /// The rooms.
    #[serde(flatten)]
    pub choice: RoomChoice,
    /// The hyperparameters that every run has; those of static rooms are not used.
    #[serde(flatten)]
    pub run: RunSettings,
}

impl Settings {
    /// The hyperparameters of the comparison in the results.
    pub fn new(seed: u64, choice: RoomChoice) -> Self {
        let reward = Reward { form: RewardForm::Shortfall, lambda: 10.0, margin: 1.0 };
        Self {
            fine_tune: "ddpg".into(),
            from: String::new(),
            gamma: 0.9,
            tau: 0.01,
            actor_rate: 1e-4,
            critic_rate: 1e-3,
            rate_end: 0.1,
            batch: 64,
            replay: 30_000,
            warm_up: 15_000,
            updates: 200,
            noise: [0.2, 0.05],
            room_count: 24,
            room_s: 10.0,
            choice,
            run: RunSettings { reward, episodes: 25, steps: 1, ..RunSettings::paper(seed) },
        }
    }
}

impl AsRef<RunSettings> for Settings {
    fn as_ref(&self) -> &RunSettings {
        &self.run
    }
}

/// One decision: state, changes that counted, and the reward that followed. Empty slots are zero.
#[derive(Clone, Debug)]
struct Step {
    state: Vec<f32>,
    change: Vec<f32>,
    reward: f32,
}

/// DDPG with its state between two episodes.
pub struct Ddpg {
    settings: Settings,
    scenario: Scenario,
    actor: Network,
    critic: Network,
    actor_target: Network,
    critic_target: Network,
    actor_adam: Adam,
    critic_adam: Adam,
    replay: Replay,
    /// Mean reward of the decisions of the last episode in bit/s/Hz, exploration included.
    reward: f64,
    /// Root of the mean squared error of the critic in the last episode in bit/s/Hz.
    error: f64,
}

impl Ddpg {
    /// The learner before its first episode.
    ///
    /// # Errors
    /// The first network cannot be read, or the scenario has more users than the critic has slots.
    pub fn new(scenario: &Scenario, settings: Settings, rng: &mut ChaCha8Rng) -> anyhow::Result<Self> {
        let users = scenario.users.arrivals.as_ref().map_or(scenario.users.count, |arrivals| arrivals.max_users);
        ensure!(
            !settings.choice.scenario_only || users <= SLOTS,
            "scenario_only = true: the scenario has up to {users} users; the critic of ddpg has slots for at most {SLOTS}"
        );
        let actor = actor::trained(&settings.from, scenario, settings.run.seed, rng)?;
        let inputs = WIDTH - 1 + CHANGE;
        let shape = Shape { encoder: Encoder::PerUser, slots: SLOTS, inputs, hidden: [128, 64], outputs: 1 };
        let critic = Network::new(shape, rng)?;
        let widths = [SLOTS * WIDTH, SLOTS * CHANGE, 1, SLOTS * WIDTH];
        Ok(Self {
            actor_target: actor.copy()?,
            critic_target: critic.copy()?,
            actor_adam: Adam::new(&actor).clipped(1.0),
            critic_adam: Adam::new(&critic).clipped(1.0),
            replay: Replay::new(settings.replay, settings.batch, widths),
            actor,
            critic,
            scenario: scenario.clone(),
            settings,
            reward: 0.0,
            error: 0.0,
        })
    }

    /// The decisions of the present network, with noise, in newly drawn rooms, in runs without a
    /// gap.
    fn explore(&self, noise: f64, rng: &mut ChaCha8Rng) -> anyhow::Result<Vec<Vec<Step>>> {
        let Settings { choice, room_count, room_s, run, .. } = &self.settings;
        let run = |room: &Scenario, seed| {
            let explorer = Explorer::new(self.actor.frozen(), room, (noise, seed))?;
            let model = room.channel_model()?;
            let mut runs: Vec<Vec<Step>> = vec![Vec::new()];
            decisions(room, seed, (Box::new(explorer), *room_s), &mut |decided| {
                if let Some(last) = runs.last_mut().and_then(|steps| steps.last_mut()) {
                    last.reward = reward(decided.room(), run.reward);
                }
                match (Future::of(decided), runs.last_mut()) {
                    (Some(future), Some(steps)) => steps.push(step(&future, &model)),
                    _ => runs.push(Vec::new()),
                }
            })?;
            Ok(runs)
        };
        Ok(choice.in_rooms((&self.scenario, *room_count), rng, run)?.concat())
    }

    /// One update of critic, actor and targets from a minibatch; the critic's squared error.
    fn update(&mut self, decay: f64, rng: &mut ChaCha8Rng) -> Result<f64> {
        let Settings { batch, gamma, tau, actor_rate, critic_rate, .. } = self.settings;
        let [state, change, rewards, next] = self.replay.sample(batch, rng);
        let (state, next) = (States::new(&state, batch)?, States::new(&next, batch)?);
        let change = Tensor::from_vec(change, (batch, SLOTS, CHANGE), &Device::Cpu)?;
        let rewards = Tensor::from_vec(rewards, batch, &Device::Cpu)?;

        // Critic: minimise the mean of [Q(s, c) - (1 - gamma) r - gamma Q'(s', mu'(s'))]^2.
        let later = next.value(&self.critic_target, &next.changes(&self.actor_target)?)?.detach();
        let target = ((rewards * (1.0 - gamma))? + (later * gamma)?)?;
        let error = (state.value(&self.critic, &change)? - target)?.sqr()?.mean_all()?;
        self.critic_adam.step(&self.critic, &error.backward()?, critic_rate * decay)?;

        // Actor: maximise the mean of Q(s, mu(s)).
        if self.replay.len() >= self.settings.warm_up.min(self.settings.replay) {
            let value = state.value(&self.critic.frozen(), &state.changes(&self.actor)?)?;
            self.actor_adam.step(&self.actor, &value.mean_all()?.neg()?.backward()?, actor_rate * decay)?;
        }
        soft_update(&self.actor_target, &self.actor, tau)?;
        soft_update(&self.critic_target, &self.critic, tau)?;
        Ok(f64::from(error.to_scalar::<f32>()?))
    }
}

impl Learner for Ddpg {
    fn rooms(&self) -> usize {
        0
    }

    fn is_scored(&self) -> bool {
        false
    }

    fn step(&mut self, episode: &mut Episode<'_>) -> anyhow::Result<Vec<Outcome>> {
        let [first, last] = self.settings.noise;
        let noise = first * (last / first).powf(episode.progress());
        let (mut sum, mut count) = (0.0, 0.0);
        for steps in self.explore(noise, episode.rng)? {
            for pair in steps.windows(2) {
                let [Step { state, change, reward }, next] = pair else { continue };
                self.replay.push([state, change, &[*reward], &next.state]);
                sum += f64::from(*reward);
                count += 1.0;
            }
        }
        self.reward = sum / f64::max(count, 1.0);
        let decay = self.settings.rate_end.powf(episode.progress());
        let mut error = 0.0;
        for _ in 0..self.settings.updates {
            if self.replay.is_ready() {
                error += self.update(decay, episode.rng)? / self.settings.updates as f64;
            }
        }
        self.error = error.sqrt();
        Ok(Vec::new())
    }

    fn act(&self, room: &Environment) -> anyhow::Result<MirrorAngles> {
        Ok(actor::act_on_truth(room))
    }

    fn notes(&self) -> Vec<(&'static str, String)> {
        vec![
            ("reward of the last episode (bit/s/Hz)", format!("{:.4}", self.reward)),
            ("error of the critic (bit/s/Hz)", format!("{:.4}", self.error)),
        ]
    }

    fn state(&mut self) -> Vec<Part<'_>> {
        vec![
            part("corrections", &mut self.actor),
            part("critic", &mut self.critic),
            part("corrections_target", &mut self.actor_target),
            part("critic_target", &mut self.critic_target),
            part("corrections", &mut self.actor_adam),
            part("critic", &mut self.critic_adam),
            part("replay", &mut self.replay),
        ]
    }

    fn export(&self, _: &ChannelModel, entries: &[(String, String)]) -> anyhow::Result<Vec<u8>> {
        Ok(actor::file(&self.actor, entries)?)
    }
}

/// States of a minibatch.
struct States {
    /// (batch, slots).
    present: Tensor,
    /// Rows and truth, (batch, slots, WIDTH - 1).
    seen: Tensor,
    /// The rows alone. Shape: batch * slots.
    rows: Vec<[f32; FEATURES]>,
}

impl States {
    fn new(values: &[f32], batch: usize) -> Result<Self> {
        let all = Tensor::from_slice(values, (batch, SLOTS, WIDTH), &Device::Cpu)?;
        let row = |user: &[f32]| std::array::from_fn(|index| user[1 + index]);
        Ok(Self {
            present: all.narrow(2, 0, 1)?.squeeze(2)?.contiguous()?,
            seen: all.narrow(2, 1, WIDTH - 1)?.contiguous()?,
            rows: values.chunks_exact(WIDTH).map(row).collect(),
        })
    }

    /// The changes of an actor, (batch, slots, [`CHANGE`]).
    fn changes(&self, actor: &Network) -> Result<Tensor> {
        let rows = Tensor::from_vec(self.rows.concat(), (self.rows.len(), FEATURES), &Device::Cpu)?;
        let change = actor::smooth_change(&actor.forward_rows(&rows)?, &self.rows)?;
        change.reshape((self.rows.len() / SLOTS, SLOTS, CHANGE))
    }

    /// The value of changes by a critic, (batch).
    fn value(&self, critic: &Network, change: &Tensor) -> Result<Tensor> {
        mean_present(&critic.forward(&Tensor::cat(&[&self.seen, change], 2)?)?, &self.present)
    }
}

/// The state after a decision with the changes that counted in it; the reward follows later.
fn step(future: &Future<'_>, model: &ChannelModel) -> Step {
    let seen = future.room.observation();
    let (scale, users) = (model.budget.amplitude_scale(), seen.users());
    let sum = |gains: &[f64], mirrors: usize, user: usize| gains[user * mirrors..][..mirrors].iter().sum::<f64>();
    let (believed, truth) = (&seen.scene, future.world.scene());
    let rate_scale = users as f64 / model.budget.bandwidth_hz;
    let mut step = Step { state: vec![0.0; SLOTS * WIDTH], change: vec![0.0; SLOTS * CHANGE], reward: 0.0 };
    let slots = step.state.chunks_exact_mut(WIDTH).zip(step.change.chunks_exact_mut(CHANGE));
    for (user, ((row, tilt), (state, change))) in future.users().zip(slots).enumerate() {
        let (index, frame) = (future.indices[user], &future.evidence.frames()[user]);
        let error = frame.of_room(&(future.world.positions()[index] - seen.positions[user]));
        let log = |gain: f64| (scale * gain).ln_1p();
        let truth = [
            f64::from(tilt[0]),
            f64::from(tilt[1]),
            5.0 * error[0],
            5.0 * error[1],
            log(believed.los_gain()[user]),
            log(truth.los_gain()[index]),
            log(sum(believed.steering_gain(), seen.mirrors(), user)),
            log(sum(truth.steering_gain(), seen.mirrors(), index)),
            rate_scale * seen.min_rate_bps[user],
            1.0 / users as f64,
        ];
        let values = [1.0].into_iter().chain(row).chain(truth.map(|value| value as f32));
        state.iter_mut().zip(values).for_each(|(to, value)| *to = value);
        let counted = frame.of_room(&future.evidence.corrections()[user].tilt());
        change.copy_from_slice(&counted.map(|value| value as f32));
    }
    step
}

/// The mean over the users of a room's reward now, in bit/s/Hz.
fn reward(room: &SimulatedRoom, reward: Reward) -> f32 {
    let world = room.world();
    let mut rates = vec![0.0; world.users().len()];
    world.scene().rates_bps(world.model(), room.angles(), &mut rates);
    let outcome = reward.outcome(&rates, world.min_rate_bps(), |_| {});
    (1e6 * outcome.reward_mbps / world.model().budget.bandwidth_hz) as f32
}
