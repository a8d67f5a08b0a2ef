//! The room as a learner sees it: a simulated world, the controller's observation, the decoder and the reward.
//!
//! No transport, delay, noise or actuator is in between: an action is judged in the very state in which it was chosen. The
//! reward is computed from the true evaluation of the decoded angles, with the spill of each spot onto other users and the average over
//! the light's panel, not from the steering table that the decoder chooses by.

use heliostat_channel::mirrors::MirrorAngles;
use heliostat_channel::{ChannelModel, Vec3};
use heliostat_decide::observation::{Observation, ObservationEncoder, USERS_CAPACITY};
use heliostat_scenario::{ChannelMode, MinRate, Scenario};
use heliostat_sim::world::World;
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

/// How a missed or met minimum rate enters the reward.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RewardForm {
    /// sum_k [R_k - lambda max(0, R_min,k - R_k)]: the shortfall is punished.
    Shortfall,
    /// As printed: lambda counts for users whose need **is** met. What it multiplies is not defined there; R_min,k is taken.
    AsPrinted,
}

/// The reward, in units of the bandwidth so that it is of order one: user k's part is (K / B) [R_k - penalty].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reward {
    /// Which penalty.
    pub form: RewardForm,
    /// Its weight lambda.
    pub lambda: f64,
    /// Factor on the minimum rates in the penalty; 1 is the paper's. A user who falls short by a little is not served either, so a policy that
    /// aims at the need itself, as well as it can, misses it half of the time.
    pub margin: f64,
}

impl Reward {
    fn of(&self, rate_bps: f64, min_rate_bps: f64) -> f64 {
        let min_rate_bps = self.margin * min_rate_bps;
        let penalty = match self.form {
            RewardForm::Shortfall => (min_rate_bps - rate_bps).max(0.0),
            RewardForm::AsPrinted if rate_bps >= min_rate_bps => min_rate_bps,
            RewardForm::AsPrinted => 0.0,
        };
        rate_bps - self.lambda * penalty
    }
}

/// What came of an action.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// sum_k [R_k - penalty] in Mbit/s.
    pub reward_mbps: f64,
    /// sum_k R_k in Mbit/s.
    pub sum_rate_mbps: f64,
}

/// A simulated room with the learner's buffers.
pub struct Environment {
    world: World,
    encoder: ObservationEncoder,
    observation: Observation,
    vector: Vec<f32>,
    rates_bps: Vec<f64>,
}

impl Environment {
    /// A fresh room, already observed.
    ///
    /// # Errors
    /// A scenario that makes no room, or one with more than [`USERS_CAPACITY`] users.
    pub fn new(scenario: &Scenario, seed: u64) -> anyhow::Result<Self> {
        let world = World::new(scenario, scenario.read_trace()?.as_deref(), seed)?;
        let users = scenario.users.count;
        let mut observation = Observation::new(world.model(), users);
        observation.min_rate_bps.copy_from_slice(world.min_rate_bps());
        let encoder = ObservationEncoder::new(USERS_CAPACITY, scenario.mirror_count());
        let mut environment =
            Self { encoder, observation, vector: vec![0.0; encoder.len()], rates_bps: vec![0.0; users], world };
        environment.observe()?;
        Ok(environment)
    }

    /// Users in the room.
    pub fn users(&self) -> usize {
        self.rates_bps.len()
    }

    /// The channel of this room.
    pub fn model(&self) -> &ChannelModel {
        self.world.model()
    }

    /// What a policy sees now.
    pub fn observation(&self) -> &Observation {
        &self.observation
    }

    /// The same as a network's input vector.
    pub fn vector(&self) -> &[f32] {
        &self.vector
    }

    /// Lets time pass and looks again.
    ///
    /// # Errors
    /// As [`Environment::new`].
    pub fn step(&mut self, dt_s: f64) -> anyhow::Result<()> {
        self.world.step(dt_s);
        self.observe()
    }

    /// Turns the mirrors; the users' true rates in bit/s.
    pub fn rates_bps(&mut self, angles: &MirrorAngles) -> &[f64] {
        self.observation.set_angles(angles);
        self.observation.scene.rates_bps(self.world.model(), angles, &mut self.rates_bps);
        &self.rates_bps
    }

    /// The same, judged: `rewards` takes each user's part, 0 in absent slots.
    pub fn act(&mut self, angles: &MirrorAngles, reward: Reward, rewards: &mut [f32]) -> Outcome {
        self.rates_bps(angles);
        rewards.fill(0.0);
        let scale = self.rates_bps.len() as f64 / self.world.model().budget.bandwidth_hz;
        let mut outcome = Outcome::default();
        for ((slot, rate), need) in rewards.iter_mut().zip(&self.rates_bps).zip(&self.observation.min_rate_bps) {
            let part = reward.of(*rate, *need);
            *slot = (scale * part) as f32;
            outcome.reward_mbps += 1e-6 * part;
            outcome.sum_rate_mbps += 1e-6 * rate;
        }
        outcome
    }

    fn observe(&mut self) -> anyhow::Result<()> {
        observe(&self.world, &mut self.observation);
        Ok(self.encoder.encode(self.world.model(), &self.observation, &mut self.vector)?)
    }
}

/// Takes over the true state of a world of the same size.
pub(crate) fn observe(world: &World, seen: &mut Observation) {
    for (user, walker) in world.users().iter().enumerate() {
        seen.positions[user] = walker.position;
        seen.velocities[user] = Vec3::new(walker.velocity[0], walker.velocity[1], 0.0);
    }
    seen.scene.clone_from(world.scene());
}

/// Which rooms an actor is trained in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rooms {
    /// Always the scenario as it stands; only walks and obstacles are drawn anew each episode.
    Fixed,
    /// Users, forced blockage, noise and needs are drawn anew each episode around the scenario.
    Randomised,
    /// The same, and bodies block light in half of the rooms only, with up to twice the scenario's obstacles: there are rooms in which everybody
    /// can be served.
    Mixed,
}

/// Most users whose direct path is forced off in a randomised room.
const FORCED_MAX: usize = 5;

impl Rooms {
    /// The scenario of one episode.
    ///
    /// Randomised: in half the episodes as many users as the scenario has, otherwise 1 to [`USERS_CAPACITY`]; 0 to 5 of them forced off;
    /// noise log-uniform from 0.5 to 25 times the scenario's (2e-15 to 1e-13 A2 by default; from 0.25 to 4 times in the paper's
    /// modes, where more noise leaves nothing to see); needs uniform from 0 to twice the scenario's.
    pub fn draw(self, scenario: &Scenario, rng: &mut impl Rng) -> Scenario {
        let mut room = scenario.clone();
        if self == Self::Fixed {
            return room;
        }
        let count = scenario.users.count.min(USERS_CAPACITY);
        room.users.count = if rng.random_bool(0.5) { count } else { rng.random_range(1..=USERS_CAPACITY) };
        room.blockage.forced_users = rng.random_range(0..=room.users.count.min(FORCED_MAX));
        if self == Self::Mixed {
            room.blockage.bodies &= rng.random_bool(0.5);
            room.blockage.obstacles_per_m2 *= rng.random_range(0.0..2.0);
        }
        let (low, high) = match scenario.channel.mode {
            ChannelMode::Specular => (0.5_f64, 25.0_f64),
            ChannelMode::Paper | ChannelMode::PaperCalibrated => (0.25, 4.0),
        };
        let factor = low * (high / low).powf(rng.random::<f64>());
        room.noise.variance_a2 = Some(noise_variance_a2(scenario) * factor);
        let need = match &scenario.users.min_rate_mbps {
            MinRate::All(rate) => *rate,
            MinRate::Each(rates) => rates.iter().copied().fold(0.0, f64::max),
        };
        room.users.min_rate_mbps = MinRate::All(need * rng.random_range(0.0..2.0));
        room
    }
}

fn noise_variance_a2(scenario: &Scenario) -> f64 {
    let noise = &scenario.noise;
    let density = noise.background_shot_a2_per_hz + noise.thermal_a2_per_hz + noise.preamplifier_a2_per_hz;
    noise.variance_a2.unwrap_or(density * 1e6 * scenario.link.bandwidth_mhz)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_printed_the_penalty_falls_on_users_whose_need_is_met() {
        let reward = |form, rate_bps| Reward { form, lambda: 1.0, margin: 1.0 }.of(rate_bps, 1e6);
        let [starved, served] = [0.4e6, 3e6];
        assert_eq!(reward(RewardForm::AsPrinted, starved), starved);
        assert_eq!(reward(RewardForm::AsPrinted, served), served - 1e6);
        assert_eq!(reward(RewardForm::Shortfall, starved), starved - 0.6e6);
        assert_eq!(reward(RewardForm::Shortfall, served), served);
    }
}
