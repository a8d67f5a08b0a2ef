//! The simulated room in which a learner acts: world, observation, decoder and reward.
//!
//! An action is evaluated in the state in which it was chosen, without transport, delay, noise or
//! actuator dynamics. The reward comes from the true evaluation of the decoded angles. It includes
//! the spill of each spot onto other users and the average over the LED's panel, which the steering
//! table of the decoder ignores.

use heliostat_channel::mirrors::MirrorAngles;
use heliostat_channel::{ChannelModel, Vec3};
use heliostat_core::observation::{Observation, ObservationEncoder, USERS_CAPACITY};
use heliostat_room::world::World;
use heliostat_scenario::{ChannelMode, MinRate, Scenario};
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

use crate::error::EnvironmentError;

/// The penalty for minimum rates in the reward.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RewardForm {
    /// sum_k [R_k - lambda max(0, R_min,k - R_k)]: a shortfall is penalised.
    Shortfall,
    /// As printed: the penalty applies to users whose minimum rate **is** met. The paper does not
    /// define the quantity that lambda multiplies; here it is R_min,k.
    AsPrinted,
}

/// The reward over the bandwidth B, which makes it of order one: user k's part is (K / B) [R_k -
/// penalty].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reward {
    /// The penalty.
    pub form: RewardForm,
    /// The penalty's weight lambda.
    pub lambda: f64,
    /// Factor on the minimum rates in the penalty; 1 is the paper's. A policy that aims at the
    /// minimum rate itself, with a small error, misses it in about half of the states.
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

    /// The outcome of rates in bit/s under minimum rates in bit/s; `each` receives each user's part
    /// R_k - penalty in bit/s.
    pub fn outcome(&self, rates_bps: &[f64], min_rate_bps: &[f64], mut each: impl FnMut(f64)) -> Outcome {
        let mut outcome = Outcome::default();
        for (rate, min_rate) in rates_bps.iter().zip(min_rate_bps) {
            let part = self.of(*rate, *min_rate);
            each(part);
            outcome.reward_mbps += 1e-6 * part;
            outcome.sum_rate_mbps += 1e-6 * rate;
        }
        outcome
    }
}

/// The result of an action.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// sum_k [R_k - penalty] in Mbit/s.
    pub reward_mbps: f64,
    /// sum_k R_k in Mbit/s.
    pub sum_rate_mbps: f64,
}

/// A simulated room with the learner's buffers.
#[derive(Clone)]
pub struct Environment {
    world: World,
    encoder: ObservationEncoder,
    observation: Observation,
    vector: Vec<f32>,
    rates_bps: Vec<f64>,
}

impl Environment {
    /// A new room with its first observation; `trace` is the text of the file `users.trace`.
    ///
    /// # Errors
    /// The scenario describes no room, it has more than [`USERS_CAPACITY`] users, or its users or
    /// its equipment are not those that a learner may know ([`check_known`]).
    pub fn new(scenario: &Scenario, trace: Option<&str>, seed: u64) -> Result<Self, EnvironmentError> {
        check_known(scenario)?;
        let world = World::new(scenario, trace, seed)?;
        let users = scenario.users.count;
        let mut observation = Observation::new(world.model(), users);
        observation.min_rate_bps.copy_from_slice(world.min_rate_bps());
        let encoder = ObservationEncoder::new(USERS_CAPACITY, scenario.mirror_count());
        let mut environment =
            Self { encoder, observation, vector: vec![0.0; encoder.len()], rates_bps: vec![0.0; users], world };
        environment.observe()?;
        Ok(environment)
    }

    /// Restarts with another seed and the mirrors flat: new walks and obstacles in the same room. A
    /// recorded walk continues.
    ///
    /// # Errors
    /// As [`Environment::new`].
    pub fn restart(&mut self, seed: u64) -> Result<(), EnvironmentError> {
        self.world.restart(seed);
        self.observation.angles.roll.fill(0.0);
        self.observation.angles.yaw.fill(0.0);
        self.observe()
    }

    /// The world of the room.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Users in the room.
    pub fn users(&self) -> usize {
        self.rates_bps.len()
    }

    /// The channel of this room.
    pub fn model(&self) -> &ChannelModel {
        self.world.model()
    }

    /// The present observation.
    pub fn observation(&self) -> &Observation {
        &self.observation
    }

    /// The present observation as a network's input vector.
    pub fn vector(&self) -> &[f32] {
        &self.vector
    }

    /// Advances the world by `dt_s` seconds and observes it.
    ///
    /// # Errors
    /// As [`Environment::new`].
    pub fn step(&mut self, dt_s: f64) -> Result<(), EnvironmentError> {
        self.world.step(dt_s);
        self.observe()
    }

    /// Turns the mirrors; the users' true rates in bit/s.
    pub fn rates_bps(&mut self, angles: &MirrorAngles) -> &[f64] {
        self.observation.angles.copy_from(angles);
        self.observation.scene.rates_bps(self.world.model(), angles, &mut self.rates_bps);
        &self.rates_bps
    }

    /// Turns the mirrors and evaluates the result; `rewards` receives each user's part, 0 in empty
    /// slots.
    pub fn act(&mut self, angles: &MirrorAngles, reward: Reward, rewards: &mut [f32]) -> Outcome {
        self.rates_bps(angles);
        rewards.fill(0.0);
        let scale = self.rates_bps.len() as f64 / self.world.model().budget.bandwidth_hz;
        let mut slots = rewards.iter_mut();
        reward.outcome(&self.rates_bps, &self.observation.min_rate_bps, |part| {
            slots.next().into_iter().for_each(|slot| *slot = (scale * part) as f32);
        })
    }

    /// The rates of the last action in bit/s.
    pub fn last_rates_bps(&self) -> &[f64] {
        &self.rates_bps
    }

    fn observe(&mut self) -> Result<(), EnvironmentError> {
        observe(&self.world, &mut self.observation);
        Ok(self.encoder.encode(self.world.model(), &self.observation, &mut self.vector)?)
    }
}

/// Checks that the number of users is fixed and that the true equipment is the assumed one, as
/// training and held-out states need.
///
/// # Errors
/// [`EnvironmentError::Arrivals`] or [`EnvironmentError::Mismatch`].
pub fn check_known(scenario: &Scenario) -> Result<(), EnvironmentError> {
    if scenario.users.arrivals.is_some() {
        return Err(EnvironmentError::Arrivals);
    }
    scenario.mismatch.key().map_or(Ok(()), |key| Err(EnvironmentError::Mismatch(key)))
}

/// Copies the true state of a world into an observation of the same size.
pub fn observe(world: &World, seen: &mut Observation) {
    for (user, walker) in world.users().iter().enumerate() {
        seen.positions[user] = walker.position;
        seen.velocities[user] = Vec3::new(walker.velocity[0], walker.velocity[1], 0.0);
    }
    seen.scene.clone_from(world.scene());
}

/// The rooms in which a policy is trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rooms {
    /// The scenario as it stands; each episode draws new walks and obstacles.
    Fixed,
    /// Each episode also draws users, forced blockage, noise and minimum rates around the
    /// scenario's.
    Randomised,
    /// As `Randomised`, but bodies block light in half of the rooms only, and obstacles are up to
    /// twice as dense as the scenario's. Some of these rooms allow all minimum rates to be met.
    Mixed,
}

/// Most users whose direct path is forced off in a randomised room.
const FORCED_MAX: usize = 5;

impl Rooms {
    /// The scenario of one episode.
    ///
    /// `Randomised` draws:
    /// - users: the scenario's number in half of the episodes, otherwise 1 to [`USERS_CAPACITY`];
    /// - users with the direct path forced off: 0 to 5;
    /// - noise: log-uniform, 0.5 to 25 times the scenario's. In the paper's modes 0.25 to 4 times,
    ///   because more noise leaves no measurable gain there;
    /// - minimum rates: uniform, 0 to twice the scenario's.
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
        let min_rate_mbps = match &scenario.users.min_rate_mbps {
            MinRate::All(rate) => *rate,
            MinRate::Each(rates) => rates.iter().copied().fold(0.0, f64::max),
        };
        room.users.min_rate_mbps = MinRate::All(min_rate_mbps * rng.random_range(0.0..2.0));
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
    fn the_printed_penalty_applies_to_users_whose_minimum_rate_is_met() {
        let reward = |form, rate_bps| Reward { form, lambda: 1.0, margin: 1.0 }.of(rate_bps, 1e6);
        let [below, above] = [0.4e6, 3e6];
        assert_eq!(reward(RewardForm::AsPrinted, below), below);
        assert_eq!(reward(RewardForm::AsPrinted, above), above - 1e6);
        assert_eq!(reward(RewardForm::Shortfall, below), below - 0.6e6);
        assert_eq!(reward(RewardForm::Shortfall, above), above);
    }
}
