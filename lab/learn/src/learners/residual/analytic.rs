//! Fine-tuning of the corrections by the gradient of the true future rate through the channel.
//!
//! The paper has no such algorithm. Each episode draws new rooms, in which the present network
//! decides. For some of its decisions [`Outlook`] holds what the command would give in the true
//! room, in the middle of its time in force, if the receivers were believed to be held otherwise.
//! The method [`Batch::rewards`] follows these steps:
//!
//! 1. A changed normal n changes the believed amplitude of a path from direction d by (n . d) /
//!    (n_0 . d), with the normal n_0 that the command has assumed.
//! 2. The weights of the users are balanced for these amplitudes, in the steps of
//!    [`heliostat_channel::sharing::balance`], which stands for the solver.
//! 3. The assignment of the mirrors by weighted amplitudes is soft ([`crate::learners::analytic`]),
//!    with an exponent that rises over the run.
//! 4. The true amplitude of user k is the true direct one plus the amplitudes that each mirror
//!    gives user k, when it is aimed at the user to whom it is assigned.
//!
//! The condition that a change exceeds its uncertainty is softened too, so that the variance learns
//! when a correction is worth its risk. A decision in which the changes lower the reward counts
//! more than one in which they raise it. Rewards later than that of the command have no gradient
//! here.

use candle_core::{Device, Result, Tensor};
use heliostat_channel::{ChannelModel, MirrorAngles, sharing};
use heliostat_core::correction::{COSINE_MIN, TILT_MAX};
use heliostat_core::evidence::{FEATURES, NORMAL};
use heliostat_scenario::Scenario;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::actor;
use crate::environment::outlook::Outlook;
use crate::environment::reported::{Future, RoomChoice, decisions};
use crate::environment::room::{Environment, Outcome, Reward, RewardForm};
use crate::learners::analytic::{mean_reward, shares};
use crate::networks::actor::POWER_FLOOR;
use crate::networks::adam::Adam;
use crate::networks::layers::Network;
use crate::training::learner::{Episode, Learner, Part, part};
use crate::training::settings::RunSettings;

/// Added to the sum of a user's steering amplitudes, for users whom no mirror reaches.
const TOTAL_MIN: f64 = 1e-3;

/// Smallest amplitude below that of the minimum rate that counts.
const SHORT_MIN: f64 = 1e-4;

/// The hyperparameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// The fine-tuning, which a checkpoint names.
    pub fine_tune: String,
    /// The file of the first network; empty for the built-in actor of the seed.
    pub from: String,
    /// Learning rate at the start.
    pub rate: f64,
    /// Factor on the learning rate at the end.
    pub rate_end: f64,
    /// Decisions of a step of the optimiser.
    pub batch: usize,
    /// Decisions for one that is used.
    pub every: usize,
    /// Added to the weight 1 of a decision in which the changes lower the reward.
    pub caution: f64,
    /// Exponent of the soft assignment in the first episode and in the last.
    pub exponent: [f64; 2],
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
            fine_tune: "analytic".into(),
            from: String::new(),
            rate: 3e-4,
            rate_end: 0.1,
            batch: 32,
            every: 3,
            caution: 2.0,
            exponent: [8.0, 64.0],
            room_count: 24,
            room_s: 10.0,
            choice,
            run: RunSettings { reward, episodes: 30, steps: 1, ..RunSettings::paper(seed) },
        }
    }
}

impl AsRef<RunSettings> for Settings {
    fn as_ref(&self) -> &RunSettings {
        &self.run
    }
}

/// The learner with its state between two episodes.
pub struct Analytic {
    settings: Settings,
    scenario: Scenario,
    network: Network,
    adam: Adam,
    /// Mean reward of the last episode in bit/s/Hz, by the soft assignment.
    reward: f64,
}

impl Analytic {
    /// The learner before its first episode.
    ///
    /// # Errors
    /// The first network cannot be read, or the reward has no gradient.
    pub fn new(scenario: &Scenario, settings: Settings, rng: &mut ChaCha8Rng) -> anyhow::Result<Self> {
        anyhow::ensure!(
            settings.run.reward.form == RewardForm::Shortfall,
            "reward.form: the printed form jumps where a minimum rate is met and has no gradient: expected shortfall"
        );
        let network = actor::trained(&settings.from, scenario, settings.run.seed, rng)?;
        let adam = Adam::new(&network).clipped(1.0);
        Ok(Self { adam, network, scenario: scenario.clone(), settings, reward: 0.0 })
    }

    /// Decisions of the present network in newly drawn rooms, in random order.
    fn outlooks(&self, rng: &mut ChaCha8Rng) -> anyhow::Result<Vec<Outlook>> {
        let Settings { choice, room_count, room_s, every, .. } = &self.settings;
        let file = actor::present(&self.network)?;
        let run = |room: &Scenario, seed| {
            let (mut all, mut count, model) = (Vec::new(), 0, room.channel_model()?);
            decisions(room, seed, (actor::policy(&file, room)?, *room_s), &mut |decided| {
                count += 1;
                if count % every.max(&1) == 0 {
                    all.extend(Future::of(decided).map(|future| Outlook::of(&future, &model)));
                }
            })?;
            Ok(all)
        };
        let mut all = choice.in_rooms((&self.scenario, *room_count), rng, run)?.concat();
        for last in (1..all.len()).rev() {
            all.swap(last, rng.random_range(0..=last));
        }
        Ok(all)
    }
}

/// Decisions as tensors, with empty slots after the users of each.
pub struct Batch {
    slots: usize,
    /// Rows of all slots, zero in empty ones.
    rows: Vec<[f32; FEATURES]>,
    /// 1 for a present user; (batch, slots), as the next ones.
    present: Tensor,
    direct: Tensor,
    min_rate: Tensor,
    true_direct: Tensor,
    assumed: [Tensor; 3],
    to_led: [Tensor; 3],
    /// (batch, slots, mirrors), as the next ones.
    to_mirrors: [Tensor; 3],
    steering: Tensor,
    /// (batch, slots, slots * mirrors).
    crossed: Tensor,
}

impl Batch {
    /// The reward of each decision in bit/s/Hz with these changes of the normals that were
    /// believed, as a function of the changes: (batch). The module has the steps. `change` is
    /// (batch * slots, 2).
    ///
    /// # Errors
    /// Errors of candle.
    pub fn rewards(&self, change: &Tensor, exponent: f64, reward: Reward) -> Result<Tensor> {
        let believed = self.values()?.narrow(1, NORMAL, 2)?;
        let normal = self.users(&upward(&(believed + change)?)?)?;

        // Step 1.
        let to_led = cosine(&normal, &self.to_led)?;
        let direct = (&self.direct * to_led.div(&cosine(&self.assumed, &self.to_led)?)?)?;
        let each = &self.to_mirrors;
        let ratio = cosine(&spread(&normal)?, each)?.div(&cosine(&spread(&self.assumed)?, each)?)?;
        let steering = (&self.steering * &ratio)?;

        // Step 2.
        let total = (steering.sum(2)? + TOTAL_MIN)?;
        let log_steering = (&steering + f64::from(POWER_FLOOR))?.log()?;
        let mut log_weight = total.log()?.neg()?;
        for step in sharing::STEPS {
            let weighted = log_steering.broadcast_add(&log_weight.unsqueeze(2)?)?;
            let shared = shares(&weighted, f64::from(sharing::EXPONENT))?;
            let amplitude = (&direct + shared.mul(&steering)?.sum(2)?)?;
            let step = f64::from(step);
            log_weight = ((log_weight * (1.0 - step))? + (log_slope(&amplitude, &self.min_rate)? * step)?)?;
        }

        // Steps 3 and 4.
        let assignment = shares(&log_steering.broadcast_add(&log_weight.unsqueeze(2)?)?, exponent)?;
        let given = self.crossed.matmul(&assignment.flatten_from(1)?.unsqueeze(2)?)?.squeeze(2)?;
        let amplitude = (&self.true_direct + given)?;
        mean_reward(&amplitude, (&self.present, &self.min_rate), reward)
    }

    /// The rows of all slots, (batch * slots, [`FEATURES`]).
    fn values(&self) -> Result<Tensor> {
        Tensor::from_vec(self.rows.concat(), (self.rows.len(), FEATURES), &Device::Cpu)
    }

    /// Decisions in rooms with the same number of mirrors.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn new(all: &[Outlook]) -> Result<Self> {
        let slots = all.iter().map(Outlook::users).max().unwrap_or(0);
        let mirrors = all.first().map_or(0, Outlook::mirrors);
        // Values of each user of each decision, and zeros for the empty slots.
        let padded = |value: &dyn Fn(&Outlook, usize) -> f32| -> Result<Tensor> {
            let slot = |one: &Outlook, slot| if slot < one.users() { value(one, slot) } else { 0.0 };
            let values = all.iter().flat_map(|one| (0..slots).map(move |index| slot(one, index))).collect();
            Tensor::from_vec(values, (all.len(), slots), &Device::Cpu)
        };
        let of_mirrors = |value: &dyn Fn(&Outlook, usize) -> f32| -> Result<Tensor> {
            let mut values = vec![0.0; all.len() * slots * mirrors];
            for (one, values) in all.iter().zip(values.chunks_exact_mut(slots * mirrors)) {
                (0..one.users() * mirrors).for_each(|pair| values[pair] = value(one, pair));
            }
            Tensor::from_vec(values, (all.len(), slots, mirrors), &Device::Cpu)
        };
        let axes = |values: &dyn Fn(&Outlook) -> &[[f64; 3]]| -> Result<[Tensor; 3]> {
            let axis = |axis: usize| padded(&|one, slot| values(one)[slot][axis] as f32);
            Ok([axis(0)?, axis(1)?, axis(2)?])
        };
        let towards = |axis: usize| of_mirrors(&|one, pair| one.to_mirrors[pair][axis] as f32);
        let mut crossed = vec![0.0; all.len() * slots * slots * mirrors];
        for (one, table) in all.iter().zip(crossed.chunks_exact_mut((slots * slots * mirrors).max(1))) {
            let width = one.users() * mirrors;
            for (row, found) in table.chunks_exact_mut(slots * mirrors).zip(one.crossed.chunks_exact(width.max(1))) {
                row[..width].copy_from_slice(found);
            }
        }
        let rows = all.iter().flat_map(|one| (0..slots).map(|slot| one.rows.get(slot).copied()));
        Ok(Self {
            slots,
            rows: rows.map(|row| row.unwrap_or([0.0; FEATURES])).collect(),
            present: padded(&|_, _| 1.0)?,
            direct: padded(&|one, slot| one.direct[slot])?,
            min_rate: padded(&|one, slot| one.min_rate[slot])?,
            true_direct: padded(&|one, slot| one.true_direct[slot])?,
            assumed: axes(&|one| &one.assumed)?,
            to_led: axes(&|one| &one.to_led)?,
            to_mirrors: [towards(0)?, towards(1)?, towards(2)?],
            steering: of_mirrors(&|one, pair| one.steering[pair])?,
            crossed: Tensor::from_vec(crossed, (all.len(), slots, slots * mirrors), &Device::Cpu)?,
        })
    }

    /// The components of vectors, from (rows, 1) to (batch, slots).
    fn users(&self, components: &[Tensor; 3]) -> Result<[Tensor; 3]> {
        let [x, y, z] = components;
        let shape = (x.dim(0)? / self.slots.max(1), self.slots);
        Ok([x.reshape(shape)?, y.reshape(shape)?, z.reshape(shape)?])
    }
}

/// The unit vectors that face up with these horizontal components, which are shortened where they
/// are too long: (rows, 2) to (rows, 1) each.
fn upward(horizontal: &Tensor) -> Result<[Tensor; 3]> {
    let length = (horizontal.sqr()?.sum_keepdim(1)? + 1e-9)?.sqrt()?;
    let short = horizontal.broadcast_mul(&(length.recip()? * TILT_MAX)?.clamp(0.0, 1.0)?)?;
    let z = short.sqr()?.sum_keepdim(1)?.affine(-1.0, 1.0)?.sqrt()?;
    Ok([short.narrow(1, 0, 1)?, short.narrow(1, 1, 1)?, z])
}

/// Components of users for each of their mirrors.
fn spread(components: &[Tensor; 3]) -> Result<[Tensor; 3]> {
    let [x, y, z] = components;
    Ok([x.unsqueeze(2)?, y.unsqueeze(2)?, z.unsqueeze(2)?])
}

/// Cosine of the incidence angle of light from a direction at a receiver with a normal.
fn cosine(normal: &[Tensor; 3], direction: &[Tensor; 3]) -> Result<Tensor> {
    let part = |axis: usize| direction[axis].broadcast_mul(&normal[axis]);
    ((part(0)? + part(1)?)? + part(2)?)?.maximum(COSINE_MIN)
}

/// Logarithm of the derivative of the utility of [`heliostat_channel::solver`] by the amplitude,
/// with lambda of [`sharing::QOS_PENALTY`]: 2 x / (1 + x^2), and below the minimum rate the slope
/// of the line to the utility at it. Both arguments are (batch, slots).
fn log_slope(amplitude: &Tensor, min_rate: &Tensor) -> Result<Tensor> {
    let amplitude = amplitude.maximum(f64::from(sharing::AMPLITUDE_MIN))?;
    let nats = (amplitude.sqr()? + 1.0)?.log()?;
    let met = ((&amplitude * 2.0)?.log()? - &nats)?;
    let min_nats = (min_rate * std::f64::consts::LN_2)?;
    let threshold = (min_nats.exp()? - 1.0)?.maximum(0.0)?.sqrt()?;
    let missing = (&threshold - &amplitude)?;
    let short = missing.gt(SHORT_MIN)?;
    let rise = (min_nats - nats)?.maximum(SHORT_MIN)?.log()?;
    let line = (rise - missing.maximum(SHORT_MIN)?.log()?)?.affine(1.0, sharing::QOS_PENALTY.ln_1p())?;
    short.where_cond(&line, &met)
}

impl Learner for Analytic {
    fn rooms(&self) -> usize {
        0
    }

    fn is_scored(&self) -> bool {
        false
    }

    fn step(&mut self, episode: &mut Episode<'_>) -> anyhow::Result<Vec<Outcome>> {
        let Settings { rate, rate_end, exponent: [first, last], batch, caution, .. } = self.settings;
        let all = self.outlooks(episode.rng)?;
        let rate = rate * rate_end.powf(episode.progress());
        let exponent = first * (last / first).powf(episode.progress());
        let (mut sum, mut count) = (0.0, 0.0);
        for batch in all.chunks_exact(batch.min(all.len()).max(1)) {
            let batch = Batch::new(batch)?;
            let change = actor::smooth_change(&self.network.forward_rows(&batch.values()?)?, &batch.rows)?;
            let rewards = batch.rewards(&change, exponent, self.settings.run.reward)?;
            let unchanged = batch.rewards(&change.zeros_like()?, exponent, self.settings.run.reward)?;
            let lost = (unchanged - &rewards)?.relu()?;
            let loss = ((lost * caution)? - &rewards)?.mean_all()?;
            self.adam.step(&self.network, &loss.backward()?, rate)?;
            sum += f64::from(rewards.mean_all()?.to_scalar::<f32>()?);
            count += 1.0;
        }
        self.reward = sum / f64::max(count, 1.0);
        Ok(Vec::new())
    }

    fn act(&self, room: &Environment) -> anyhow::Result<MirrorAngles> {
        Ok(actor::act_on_truth(room))
    }

    fn notes(&self) -> Vec<(&'static str, String)> {
        vec![("reward of the last episode (bit/s/Hz, soft assignment)", format!("{:.4}", self.reward))]
    }

    fn state(&mut self) -> Vec<Part<'_>> {
        vec![part("corrections", &mut self.network), part("corrections", &mut self.adam)]
    }

    fn export(&self, _: &ChannelModel, entries: &[(String, String)]) -> anyhow::Result<Vec<u8>> {
        Ok(actor::file(&self.network, entries)?)
    }
}
