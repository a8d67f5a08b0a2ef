//! Training without reinforcement: gradient ascent of the reward through the channel.
//!
//! The paper has no such algorithm. This learner shows what the network can reach without trial and
//! error. Features, weights and decoder are those of [`super::ddpg`]; critic, exploration
//! and replay do not exist. The methods `step` and `update` of [`Analytic`] are the complete
//! algorithm. Each step takes a batch of rooms, computes the reward as a differentiable function of
//! the actions, and follows its gradient. [`crate::environment::features`] defines the terms.
//!
//! # The channel as a function of the weights
//! - **Paper modes**: eqs. (2) and (3) as printed. The decoder's normal is n_m ~ sum_k w_k a_km
//!   e_km, with the unit vector e_km from mirror m to user k, and user k receives sum_m a_km max(0,
//!   n_m . e_km). This is smooth except for the kink at zero.
//! - **`specular`**: a mirror serves one user, and this choice has no gradient. A soft assignment
//!   replaces it: s_jm = (w_j a_jm)^beta / sum_i (w_i a_im)^beta. User k receives sum_j,m s_jm
//!   g_jkm. Here g_jkm is the channel's amplitude for user k when mirror m is aimed at user j. It
//!   includes the edges of the mirror, the spill onto others, the LED's panel and all shadows. beta
//!   rises from 8 to 64 over the run, towards the true decoder. The edges of the mirrors are not
//!   softened. With free angles as outputs nearly every mirror misses every user, and the gradient
//!   is zero.
//!
//! # Hyperparameters that differ from [`super::ddpg`]
//! - A batch has 16 rooms, and each episode draws new rooms.
//! - The learning rate is 1e-3, decaying to 5e-5 over the run of 60 episodes.
//! - lambda is 30, and minimum rates are multiplied by 1.5. A policy trained on the minimum rates
//!   themselves misses them in about half of the states.
//! - Half of the rooms have no bodies, so that more minimum rates are feasible. Infeasible minimum
//!   rates would train the policy to ignore those users.

use candle_core::{Device, Result, Tensor};
use heliostat_channel::{MirrorAngles, Mode, decode};
use heliostat_core::observation::Summary;
use heliostat_core::policy::PolicyKind;
use heliostat_scenario::{ChannelMode, Scenario};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::ddpg;
use crate::environment::features::{BaselineWeight, Head, Layout};
use crate::environment::room::{Environment, Outcome, Reward, RewardForm, Rooms};
use crate::export::actor::export;
use crate::networks::actor::{Actor, POWER_FLOOR, States};
use crate::networks::adam::Adam;
use crate::training::algorithm::{Algorithm, start};
use crate::training::learner::{Episode, Learner, Part, part};
use crate::training::settings::RunSettings;

/// The row in the table of algorithms.
pub const ALGORITHM: Algorithm = Algorithm {
    name: "analytic",
    policy: PolicyKind::Analytic,
    help: "The network of ddpg, trained by the gradient through the channel",
    summary: "the network of ddpg, trained by the gradient through the channel; see the head of `lab/learn/src/learners/analytic.rs`",
    has_paper_preset: false,
    start: |scenario, _, options| {
        let settings = Settings::new(scenario.seed, scenario.channel.mode);
        start(scenario, settings, options, Analytic::new)
    },
};

/// The hyperparameters of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// The map from actions to decoder weights.
    pub head: Head,
    /// Learning rate of the first episode.
    pub rate: f64,
    /// Learning rate at the end of the run over that at its start.
    pub rate_end: f64,
    /// Rooms in an update.
    pub batch: usize,
    /// Exponent beta of the soft assignment in the first episode and in the last.
    pub exponent: [f64; 2],
    /// The hyperparameters that every run has.
    #[serde(flatten)]
    pub run: RunSettings,
}

impl Settings {
    /// The hyperparameters of the shipped actors.
    pub fn new(seed: u64, mode: ChannelMode) -> Self {
        let ddpg::Settings { head, run, .. } = ddpg::Settings::tuned(seed, mode);
        let reward = Reward { form: RewardForm::Shortfall, lambda: 30.0, margin: 1.5 };
        let run = RunSettings { reward, rooms: Rooms::Mixed, episodes: 60, ..run };
        Self { head, rate: 1e-3, rate_end: 0.05, batch: 16, exponent: [8.0, 64.0], run }
    }
}

/// The learner with its state between two steps.
pub struct Analytic {
    settings: Settings,
    actor: Actor,
    adam: Adam,
}

impl Analytic {
    /// The learner before its first episode.
    ///
    /// # Errors
    /// The reward or the reading of the paper's equations has no gradient.
    pub fn new(scenario: &Scenario, settings: Settings, rng: &mut ChaCha8Rng) -> anyhow::Result<Self> {
        anyhow::ensure!(
            settings.run.reward.form == RewardForm::Shortfall,
            "reward.form: the printed form jumps where a minimum rate is met and has no gradient: expected shortfall"
        );
        anyhow::ensure!(
            !scenario.channel.literal,
            "channel.literal = true has no gradient in analytic: expected channel.literal = false"
        );
        let layout = Layout::of(scenario);
        let tuned = ddpg::Settings::tuned(settings.run.seed, scenario.channel.mode);
        let actor = Actor::new(layout, tuned.encoder, settings.head, rng)?;
        Ok(Self { adam: Adam::new(&actor.network), actor, settings })
    }

    /// One step up the gradient of the mean reward in the rooms; returns the actions before the
    /// step, room by room.
    fn update(&mut self, rooms: &[Environment], progress: f64) -> Result<Vec<Vec<f32>>> {
        let Settings { rate, rate_end, exponent: [first, last], .. } = self.settings;
        let exponent = first * (last / first).powf(progress);
        let layout = self.actor.layout;
        let rows = rooms.iter().flat_map(|room| States::row(layout, room.vector())).collect();
        let states = States::new(rows, rooms.len(), layout, self.settings.head.baseline_weight)?;
        let channel = Channel::new(rooms, layout)?;
        let actions = self.actor.forward(&states)?;
        let amplitude = channel.amplitude(&actions, self.settings.head, exponent)?;
        let reward = channel.reward(&amplitude, self.settings.run.reward)?;
        let gradients = reward.mean_all()?.neg()?.backward()?;
        self.adam.step(&self.actor.network, &gradients, rate * rate_end.powf(progress))?;
        actions.to_vec2()
    }
}

impl Learner for Analytic {
    fn rooms(&self) -> usize {
        self.settings.batch
    }

    fn step(&mut self, episode: &mut Episode<'_>) -> anyhow::Result<Vec<Outcome>> {
        let actions = self.update(&episode.rooms, episode.progress())?;
        let run = &self.settings.run;
        let mut outcomes = Vec::with_capacity(actions.len());
        for (room, actions) in episode.rooms.iter_mut().zip(&actions) {
            let angles = self.actor.decode(room, actions);
            let mut rewards = vec![0.0; room.users()];
            outcomes.push(room.act(&angles, run.reward, &mut rewards));
            room.step(run.step_s)?;
        }
        Ok(outcomes)
    }

    fn act(&self, room: &Environment) -> anyhow::Result<MirrorAngles> {
        self.actor.act(room)
    }

    fn state(&mut self) -> Vec<Part<'_>> {
        vec![part("actor", &mut self.actor.network), part("actor", &mut self.adam)]
    }

    fn export(&self, metadata: &[(String, String)]) -> anyhow::Result<Vec<u8>> {
        Ok(export(&self.actor, metadata)?)
    }
}

/// The channels of a batch of rooms as tensors.
pub struct Channel {
    /// 1 for a present user, 0 in an empty slot; (batch, slots).
    present: Tensor,
    /// Amplitude of the direct path, (batch, slots).
    direct: Tensor,
    /// Minimum rates in bit/s/Hz of a user's band, (batch, slots).
    min_rate: Tensor,
    /// Balanced weights, (batch, slots).
    balanced: Tensor,
    /// Amplitude of each mirror when it is aimed at the user, (batch, slots, mirrors).
    steering: Tensor,
    mirrors: Mirrors,
}

/// The gains of the mirrors, by channel mode.
enum Mirrors {
    /// Amplitude for user k of mirror m when it is aimed at user j, (batch, k, j * mirrors + m).
    Specular(Tensor),
    /// x, y and z of the unit vectors from mirror to user, (batch, slots, mirrors) each.
    Paper([Tensor; 3]),
}

impl Channel {
    /// The channels of rooms with the same array.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn new(rooms: &[Environment], layout: Layout) -> Result<Self> {
        let (batch, slots, encoder) = (rooms.len(), layout.slots(), layout.encoder);
        let part = |range: std::ops::Range<usize>| {
            let width = range.len();
            let values = rooms.iter().flat_map(|room| room.vector()[range.clone()].iter().copied()).collect();
            Tensor::from_vec(values, (batch, width), &Device::Cpu)
        };
        let all = (batch, slots, encoder.mirrors());
        let specular = rooms.iter().all(|room| room.model().mode == Mode::Specular);
        let mirrors = if specular {
            let tables = rooms.iter().flat_map(|room| crossed(room, slots)).collect();
            Mirrors::Specular(Tensor::from_vec(tables, (batch, slots, slots * encoder.mirrors()), &Device::Cpu)?)
        } else {
            let along = |axis: usize| {
                let values = rooms.iter().flat_map(|room| directions(room, slots, axis)).collect();
                Tensor::from_vec(values, all, &Device::Cpu)
            };
            Mirrors::Paper([along(0)?, along(1)?, along(2)?])
        };
        Ok(Self {
            present: part(encoder.mask())?,
            direct: part(encoder.los_amplitude())?,
            min_rate: part(encoder.min_rate())?,
            balanced: part(encoder.column(Summary::LogWeight as usize))?.exp()?,
            steering: part(encoder.steering_amplitude())?.reshape(all)?,
            mirrors,
        })
    }

    /// Amplitude of each user under these actions, (batch, slots); `exponent` is beta of the
    /// soft assignment.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn amplitude(&self, actions: &Tensor, head: Head, exponent: f64) -> Result<Tensor> {
        let given = match &self.mirrors {
            Mirrors::Specular(crossed) => {
                let assignment = self.soft_assignment(actions, head, exponent)?;
                crossed.matmul(&assignment.flatten_from(1)?.unsqueeze(2)?)?.squeeze(2)?
            }
            Mirrors::Paper(directions) => {
                let weight = (actions * f64::from(head.range))?.exp()?.mul(&self.present)?;
                let weighted = self.steering.broadcast_mul(&self.weighted(head, &weight)?.unsqueeze(2)?)?;
                let normal: Vec<Tensor> =
                    directions.iter().map(|along| along.mul(&weighted)?.sum_keepdim(1)).collect::<Result<_>>()?;
                let squared = ((normal[0].sqr()? + normal[1].sqr()?)? + normal[2].sqr()?)?;
                // Far below any weighted coefficient that matters. A mirror without one gives no
                // amplitude either.
                let length = (squared + 1e-24)?.sqrt()?;
                let mut tilt = self.steering.zeros_like()?;
                for (along, normal) in directions.iter().zip(&normal) {
                    tilt = (tilt + along.broadcast_mul(&normal.broadcast_div(&length)?)?)?;
                }
                self.steering.mul(&tilt.relu()?)?.sum(2)?
            }
        };
        &self.direct + given
    }

    /// The reward in bit/s/Hz, averaged over the present users: (batch).
    ///
    /// # Errors
    /// Errors of candle.
    pub fn reward(&self, amplitude: &Tensor, reward: Reward) -> Result<Tensor> {
        mean_reward(amplitude, (&self.present, &self.min_rate), reward)
    }

    /// Soft assignment of each mirror to each user, (batch, slots, mirrors).
    fn soft_assignment(&self, actions: &Tensor, head: Head, exponent: f64) -> Result<Tensor> {
        // In logarithms, because the powers leave the range of f32.
        let baseline = self.weighted(head, &self.present)?;
        let weighted = self.steering.broadcast_mul(&baseline.unsqueeze(2)?)?;
        let log_weighted = ((weighted + f64::from(POWER_FLOOR))?.log()?)
            .broadcast_add(&(actions * f64::from(head.range))?.unsqueeze(2)?)?;
        shares(&log_weighted, exponent)
    }

    /// Values times the baseline weights of the head, (batch, slots).
    fn weighted(&self, head: Head, weight: &Tensor) -> Result<Tensor> {
        match head.baseline_weight {
            BaselineWeight::Uniform => Ok(weight.clone()),
            BaselineWeight::Balanced => weight.mul(&self.balanced),
        }
    }
}

/// The mean reward of the present users with these amplitudes in bit/s/Hz: (batch). `present` and
/// the minimum rates are (batch, slots).
///
/// # Errors
/// Errors of candle.
pub fn mean_reward(amplitude: &Tensor, (present, min_rate): (&Tensor, &Tensor), reward: Reward) -> Result<Tensor> {
    let rate = ((amplitude.sqr()? + 1.0)?.log()? * std::f64::consts::LOG2_E)?;
    let shortfall = ((min_rate * reward.margin)? - &rate)?.relu()?;
    let part = (rate - (shortfall * reward.lambda)?)?.mul(present)?;
    part.sum(1)?.div(&present.sum(1)?)
}

/// The soft assignment of each mirror by logarithms of weighted gains, (batch, slots, mirrors):
/// their powers with this exponent over the sum of the powers of all users.
///
/// # Errors
/// Errors of candle.
pub fn shares(log_weighted: &Tensor, exponent: f64) -> Result<Tensor> {
    let log_weighted = (log_weighted * exponent)?;
    let power = log_weighted.broadcast_sub(&log_weighted.max_keepdim(1)?.detach())?.exp()?;
    power.broadcast_div(&power.sum_keepdim(1)?)
}

/// Amplitude of user k from each mirror when it is aimed at user j, by the channel: (k, j,
/// mirrors), zero in empty slots.
fn crossed(room: &Environment, slots: usize) -> Vec<f32> {
    let (model, scene) = (room.model(), &room.observation().scene);
    let (users, mirrors, scale) = (room.users(), model.mirrors.len(), model.budget.amplitude_scale());
    let mut angles = MirrorAngles::flat(mirrors);
    let mut gains = vec![0.0; users * mirrors];
    let mut table = vec![0.0; slots * slots * mirrors];
    for target in 0..users {
        decode::aim(model, scene, &vec![target; mirrors], &mut angles);
        scene.irs_gain_each(model, &angles, &mut gains);
        for (user, gains) in gains.chunks_exact(mirrors).enumerate() {
            let row = &mut table[(user * slots + target) * mirrors..][..mirrors];
            row.iter_mut().zip(gains).for_each(|(value, gain)| *value = (scale * gain) as f32);
        }
    }
    table
}

/// One coordinate of the unit vectors from mirror to user: (slots, mirrors), zero in empty slots.
fn directions(room: &Environment, slots: usize, axis: usize) -> Vec<f32> {
    let mut values: Vec<f32> =
        room.observation().scene.directions().iter().map(|direction| direction[axis] as f32).collect();
    values.resize(slots * room.model().mirrors.len(), 0.0);
    values
}
