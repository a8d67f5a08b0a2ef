//! The network of [`crate::ddpg`] trained without reinforcement: by the gradient of the reward through the channel itself.
//!
//! The paper has no such algorithm. It is here as the measure of what the network can do when nothing has to be found out by trial: the same
//! features, rounds, weights and decoder, but no critic, no exploration and no replay. Each step takes a batch of rooms, computes the reward
//! as a differentiable function of the network's answers, and goes up its gradient.
//!
//! # The channel as a function of the weights
//! - **Paper modes**: eqs. (2) and (3) as they stand. The decoder's normal is n_m ~ sum_k w_k c_km u_km, user k gets
//!   sum_m c_km max(0, n_m . u_km), and all of it is smooth but for the kink at zero.
//! - **`specular`**: a mirror serves one user, and no gradient passes a choice. The choice is softened: user j has the share
//!   (w_j a_jm)^beta / sum_i (w_i a_im)^beta of mirror m, and user k gets sum_j share_jm g_jkm, where g_jkm is what the channel gives to k
//!   when m is aimed at j: with the true edges of the mirror's rectangle, the spill onto others, the light's panel and all shadows. beta
//!   rises from 8 to 64 over the run, towards the true decoder. What is soft is the edge between two users' claims to a mirror, not the
//!   edge of the mirror: with all angles free, as outputs, nearly every mirror misses everybody and there is no gradient to follow.
//!
//! Differences from [`crate::ddpg`] in the numbers: batches of 16 rooms, all new in each episode; a rate of 1e-3 that falls to a twentieth; 60
//! episodes; lambda = 30 on needs half as large again, and half of the rooms without bodies: needs that nobody can meet teach to
//! give users up, and an answer that aims at the need itself misses it half of the time.

use candle_core::{Device, Result, Tensor};
use heliostat_channel::{MirrorAngles, Mode, decode};
use heliostat_decide::observation::Summary;
use heliostat_scenario::{ChannelMode, Scenario};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::actor::{ACTOR_INPUTS, Actor, NO_CLAIM, States};
use crate::checkpoint::Store;
use crate::ddpg;
use crate::env::{Environment, Reward, RewardForm, Rooms};
use crate::export::export;
use crate::features::{Head, Layout, Prior};
use crate::learner::{Episode, Learner, RunSettings};
use crate::networks::{Adam, Network, Shape};

/// Every number of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// From logits to weights.
    pub head: Head,
    /// How often the network is applied.
    pub rounds: usize,
    /// Learning rate.
    pub rate: f64,
    /// Learning rate at the end of the run, relative to the start.
    pub rate_end: f64,
    /// Rooms in an update.
    pub batch: usize,
    /// Exponent of the softened choice in the first episode and in the last.
    pub exponent: [f64; 2],
    /// What every algorithm has.
    #[serde(flatten)]
    pub run: RunSettings,
}

impl Settings {
    /// The numbers of the shipped actors.
    pub fn new(seed: u64, mode: ChannelMode) -> Self {
        let ddpg::Settings { head, rounds, run, .. } = ddpg::Settings::tuned(seed, mode);
        let reward = Reward { form: RewardForm::Shortfall, lambda: 30.0, margin: 1.5 };
        let run = RunSettings { reward, rooms: Rooms::Mixed, episodes: 60, ..run };
        Self { head, rounds, rate: 1e-3, rate_end: 0.05, batch: 16, exponent: [8.0, 64.0], run }
    }
}

/// A training run between two episodes.
pub struct Trainer {
    settings: Settings,
    scenario: Scenario,
    actor: Actor,
    adam: Adam,
    rng: ChaCha8Rng,
    episode: usize,
}

impl Trainer {
    /// A run at its beginning.
    ///
    /// # Errors
    /// Settings without sense, or a reading of the paper's equations that has no gradient here.
    pub fn new(scenario: Scenario, settings: Settings) -> anyhow::Result<Self> {
        anyhow::ensure!(
            settings.run.reward.form == RewardForm::Shortfall,
            "reward.form: the printed form jumps where a need is met, so it has no gradient; analytic knows shortfall only"
        );
        anyhow::ensure!(!scenario.channel.literal, "channel.literal: analytic knows the sensible reading only");
        let mut rng = ChaCha8Rng::seed_from_u64(settings.run.seed);
        let layout = Layout::of(&scenario);
        let slots = layout.slots();
        let tuned = ddpg::Settings::tuned(settings.run.seed, scenario.channel.mode);
        let shape = Shape { encoder: tuned.encoder, slots, inputs: ACTOR_INPUTS, hidden: [128, 64], outputs: slots };
        let network = Network::new(shape, &mut rng)?;
        let actor = Actor { network, layout, head: settings.head, rounds: settings.rounds };
        Ok(Self { adam: Adam::new(&actor.network, settings.rate), actor, rng, scenario, settings, episode: 0 })
    }

    /// Goes up the gradient of the mean reward in the rooms as they are; the logits before the step, room by room.
    fn update(&mut self, rooms: &[Environment], exponent: f64) -> Result<Vec<Vec<f32>>> {
        let layout = self.actor.layout;
        let rows = rooms.iter().flat_map(|room| States::row(layout, room.vector())).collect();
        let states = States::new(rows, rooms.len(), layout, self.settings.head.prior)?;
        let channel = Channel::new(rooms, layout)?;
        let logits = self.actor.forward(&states)?;
        let amplitude = channel.amplitude(&logits, self.settings.head, exponent)?;
        let reward = channel.reward(&amplitude, self.settings.run.reward)?;
        self.adam.step(&self.actor.network, &reward.mean_all()?.neg()?.backward()?)?;
        logits.to_vec2()
    }
}

/// The channels of a batch of rooms, as tensors: what each mirror can do for each user.
pub struct Channel {
    /// Who is there, (batch, slots).
    present: Tensor,
    /// Amplitude of the direct path, (batch, slots).
    direct: Tensor,
    /// Needs in bit/s/Hz of a user's band, (batch, slots).
    need: Tensor,
    /// Balanced weights, (batch, slots).
    balanced: Tensor,
    /// Amplitude of each mirror when it is aimed at the user, (batch, slots, mirrors).
    steering: Tensor,
    mirrors: Mirrors,
}

/// What becomes of the light of a mirror.
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
    /// Those of candle.
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
            present: part(encoder.present())?,
            direct: part(encoder.los_amplitude())?,
            need: part(encoder.need())?,
            balanced: part(encoder.column(Summary::LogWeight as usize))?.exp()?,
            steering: part(encoder.steering_amplitude())?.reshape(all)?,
            mirrors,
        })
    }

    /// Amplitude of each user under these logits, (batch, slots); `exponent` is that of the softened choice.
    ///
    /// # Errors
    /// Those of candle.
    pub fn amplitude(&self, logits: &Tensor, head: Head, exponent: f64) -> Result<Tensor> {
        let given = match &self.mirrors {
            Mirrors::Specular(crossed) => {
                let share = self.shares(logits, head, exponent)?;
                crossed.matmul(&share.flatten_from(1)?.unsqueeze(2)?)?.squeeze(2)?
            }
            Mirrors::Paper(directions) => {
                let weight = (logits * f64::from(head.range))?.exp()?.mul(&self.present)?;
                let pull = self.steering.broadcast_mul(&self.prior(head, &weight)?.unsqueeze(2)?)?;
                let normal: Vec<Tensor> =
                    directions.iter().map(|along| along.mul(&pull)?.sum_keepdim(1)).collect::<Result<_>>()?;
                let squared = ((normal[0].sqr()? + normal[1].sqr()?)? + normal[2].sqr()?)?;
                // Far below any pull that carries data; a mirror that nobody pulls gives nothing to anybody either.
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

    /// Each user's part of the reward in bit/s/Hz, averaged over the users present: (batch).
    ///
    /// # Errors
    /// Those of candle.
    pub fn reward(&self, amplitude: &Tensor, reward: Reward) -> Result<Tensor> {
        let rate = ((amplitude.sqr()? + 1.0)?.log()? * std::f64::consts::LOG2_E)?;
        let short = ((&self.need * reward.margin)? - &rate)?.relu()?;
        let part = (rate - (short * reward.lambda)?)?.mul(&self.present)?;
        part.sum(1)?.div(&self.present.sum(1)?)
    }

    /// Each user's share of each mirror, (batch, slots, mirrors).
    fn shares(&self, logits: &Tensor, head: Head, exponent: f64) -> Result<Tensor> {
        // Claims by their logarithms, since powers of them leave the range of f32.
        let flat = self.prior(head, &self.present)?;
        let claim = self.steering.broadcast_mul(&flat.unsqueeze(2)?)?;
        let claim =
            ((claim + f64::from(NO_CLAIM))?.log()?).broadcast_add(&(logits * f64::from(head.range))?.unsqueeze(2)?)?;
        let claim = (claim * exponent)?;
        let power = claim.broadcast_sub(&claim.max_keepdim(1)?.detach())?.exp()?;
        power.broadcast_div(&power.sum_keepdim(1)?)
    }

    /// Weights with the head's prior on them, (batch, slots).
    fn prior(&self, head: Head, weight: &Tensor) -> Result<Tensor> {
        match head.prior {
            Prior::Uniform => Ok(weight.clone()),
            Prior::Balanced => weight.mul(&self.balanced),
        }
    }
}

/// What each mirror gives each user k when it is aimed at user j, by the channel: (k, j, mirrors), zero in absent slots.
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

/// One coordinate of the unit vectors from mirror to user: (slots, mirrors), zero in absent slots.
fn directions(room: &Environment, slots: usize, axis: usize) -> Vec<f32> {
    let mut values: Vec<f32> =
        room.observation().scene.directions().iter().map(|direction| direction[axis] as f32).collect();
    values.resize(slots * room.model().mirrors.len(), 0.0);
    values
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
        let Settings { rate, rate_end, exponent: [soft, sharp], batch, run, .. } = self.settings.clone();
        let progress = self.episode as f64 / run.episodes.max(1) as f64;
        self.adam.set_learning_rate(rate * rate_end.powf(progress));
        let exponent = soft * (sharp / soft).powf(progress);
        let draw = |_| Environment::new(&run.rooms.draw(&self.scenario, &mut self.rng), self.rng.random());
        let mut rooms = (0..batch).map(draw).collect::<anyhow::Result<Vec<_>>>()?;
        let mut summary = Episode::default();
        let share = 1.0 / (run.steps * batch) as f64;
        for _ in 0..run.steps {
            let logits = self.update(&rooms, exponent)?;
            for (room, logits) in rooms.iter_mut().zip(&logits) {
                let angles = self.actor.decode(room, logits);
                let mut rewards = vec![0.0; room.users()];
                let outcome = room.act(&angles, run.reward, &mut rewards);
                summary.reward_mbps += share * outcome.reward_mbps;
                summary.sum_rate_mbps += share * outcome.sum_rate_mbps;
                room.step(run.step_s)?;
            }
        }
        self.episode += 1;
        Ok(Episode { number: self.episode, steps: self.episode * run.steps, ..summary })
    }

    fn act(&self, environment: &Environment) -> anyhow::Result<MirrorAngles> {
        let logits = self.actor.logits(&States::row(self.actor.layout, environment.vector()))?;
        Ok(self.actor.decode(environment, &logits))
    }

    fn save(&self, store: &mut Store) -> anyhow::Result<()> {
        store.put_network("actor", &self.actor.network);
        store.put_adam("actor", &self.adam)?;
        store.put_generator(&self.rng)?;
        store.put("episode", &self.episode)
    }

    fn restore(&mut self, store: &Store) -> anyhow::Result<()> {
        store.restore_network("actor", &self.actor.network)?;
        store.restore_adam("actor", &mut self.adam)?;
        self.rng = store.generator()?;
        self.episode = store.get("episode")?;
        Ok(())
    }

    fn export(&self, metadata: &[(String, String)]) -> anyhow::Result<Vec<u8>> {
        Ok(export(&self.actor, &self.scenario.channel_model()?, metadata)?)
    }
}
