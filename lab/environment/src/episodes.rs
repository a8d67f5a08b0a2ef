//! The episodes of a comparison in closed loop: rooms that training never uses, and the times at
//! which they are sampled.
//!
//! An episode is a separate room in which users have walked for a while. Its sampling times have
//! equal mean spacing, each at a random offset within its interval, so that they fall anywhere
//! between two reports.
//!
//! A recorded walk begins at another time in each episode of a seed: the starts are spread over the
//! recording less the length of an episode, each at a random place of its part.

use std::time::Duration;

use heliostat_channel::MirrorAngles;
use heliostat_channel::solver::Solver;
use heliostat_room::SimulatedRoom;
use heliostat_room::episode::Episode;
use heliostat_room::world::{World, WorldError};
use heliostat_scenario::Scenario;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::held_out::{SETTLE_S, best_angles, held_out_seed};

/// Sampling times of an episode.
pub const INSTANTS: usize = 20;

/// The usual time from the controller's start to the first sampling interval.
pub const WARM: Duration = Duration::from_secs(1);

/// Time between two observations of outages in ns.
pub const OUTAGE_STEP_NS: u64 = 20_000_000;

/// Separates the random place in a recorded walk from the other random choices of an episode.
const RECORDING_STREAM: u64 = 0x7ace_0000_0000_0000;

/// Mean time between two samples in ns.
const SPACING_NS: u64 = 250_000_000;

/// Duration of this number of sampling times of an episode in s.
pub fn sampled_s(instants: usize) -> f64 {
    instants as f64 * SPACING_NS as f64 * 1e-9
}

/// One room and its sampling times.
#[derive(Clone, Debug)]
pub struct HeldOutEpisode {
    /// Seed of the room.
    pub seed: u64,
    /// Index of its seed among those compared.
    pub set: u64,
    /// The sampling times in ns, in ascending order.
    pub instants_ns: Vec<u64>,
    /// The time in a recorded walk at time 0 of the episode, in s.
    recording_from_s: f64,
}

/// The episodes with `states` sampling times of each of `seeds` room seeds.
///
/// `trace`: the text of the file `users.trace`. `warm`: from the controller's start to the first
/// sampling interval.
///
/// # Errors
/// The scenario describes no room.
pub fn held_out_episodes(
    scenario: &Scenario,
    trace: Option<&str>,
    (states, seeds): (usize, usize),
    warm: Duration,
) -> Result<Vec<HeldOutEpisode>, WorldError> {
    let recording_s = World::new(scenario, trace, scenario.seed)?.recording_s();
    let count = states.div_ceil(INSTANTS);
    let mut episodes = Vec::new();
    for set in 0..seeds as u64 {
        for (index, first) in (0..states).step_by(INSTANTS).enumerate() {
            let seed = held_out_seed(scenario.seed.wrapping_add(set), index as u64);
            let episode = HeldOutEpisode::new(seed, set, INSTANTS.min(states - first), warm);
            episodes.push(match recording_s {
                Some(recording_s) => episode.in_recording(recording_s, index, count),
                None => episode,
            });
        }
    }
    Ok(episodes)
}

/// The controller's start in ns, after the users have walked for [`SETTLE_S`].
pub fn start_ns() -> u64 {
    (SETTLE_S * 1e9) as u64
}

impl HeldOutEpisode {
    /// An episode with this number of sampling times.
    pub fn new(seed: u64, set: u64, instants: usize, warm: Duration) -> Self {
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        let first_ns = start_ns() + warm.as_nanos() as u64;
        let share = |index: u64| first_ns + index * SPACING_NS + generator.random_range(0..SPACING_NS);
        Self { seed, set, instants_ns: (0..instants as u64).map(share).collect(), recording_from_s: 0.0 }
    }

    /// The same with a recorded walk of this length, of which it is the part `index` of `count`:
    /// the controller starts within this part of the walk. A walk that is shorter than an episode
    /// repeats.
    fn in_recording(self, recording_s: f64, index: usize, count: usize) -> Self {
        let last_ns = self.instants_ns.last().map_or(0, |last| last + SPACING_NS);
        let episode_s = last_ns.saturating_sub(start_ns()) as f64 * 1e-9;
        let spread_s = if recording_s > episode_s { recording_s - episode_s } else { recording_s };
        // Another stream than that of the instants, which stay those of a random walk.
        let place = ChaCha8Rng::seed_from_u64(self.seed ^ RECORDING_STREAM).random_range(0.0..1.0);
        let start_s = spread_s * (index as f64 + place) / count as f64;
        Self { recording_from_s: start_s - SETTLE_S, ..self }
    }

    /// The sampling times, and those at which outages are observed between the first and the last.
    pub fn looks_ns(&self) -> Vec<u64> {
        let [first, .., last] = self.instants_ns[..] else { return self.instants_ns.clone() };
        let mut looks: Vec<u64> =
            (first.next_multiple_of(OUTAGE_STEP_NS)..last).step_by(OUTAGE_STEP_NS as usize).collect();
        looks.extend(&self.instants_ns);
        looks.sort_unstable();
        looks.dedup();
        looks
    }

    /// The room of the episode with its reports, at the controller's start.
    ///
    /// # Errors
    /// The scenario describes no room.
    pub fn begun(&self, scenario: &Scenario, trace: Option<&str>) -> Result<Episode, WorldError> {
        let mut room = SimulatedRoom::new(scenario, trace, self.seed)?;
        room.world_mut().seek_recording(self.recording_from_s);
        Ok(Episode::of_room(room, scenario, self.seed, start_ns()))
    }

    /// Users and obstacles of the episode at time 0.
    ///
    /// # Errors
    /// The scenario describes no room.
    pub fn world(&self, scenario: &Scenario, trace: Option<&str>) -> Result<World, WorldError> {
        let mut world = World::new(scenario, trace, self.seed)?;
        world.seek_recording(self.recording_from_s);
        Ok(world)
    }

    /// Calls `look` with the world at each sampling time and with the angles of the oracle, which
    /// observes the true state and whose mirrors turn at once.
    ///
    /// # Errors
    /// The scenario describes no room.
    pub fn solve(
        &self,
        scenario: &Scenario,
        trace: Option<&str>,
        mut look: impl FnMut(&World, &MirrorAngles),
    ) -> Result<(), WorldError> {
        let mut world = self.world(scenario, trace)?;
        let mut solver = Solver::new(scenario.users.count, scenario.mirror_count());
        let mut now_ns = 0;
        for instant_ns in &self.instants_ns {
            world.step((instant_ns - now_ns) as f64 * 1e-9);
            now_ns = *instant_ns;
            let angles = best_angles(&mut solver, world.model(), world.scene(), world.min_rate_bps());
            look(&world, &angles);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn episodes_start_in_different_parts_of_a_recording_and_end_within_it() {
        let count = 10;
        let starts = |seed: u64, recording_s: f64| -> Vec<f64> {
            let episode = |index: usize| {
                HeldOutEpisode::new(held_out_seed(seed, index as u64), 0, INSTANTS, WARM).in_recording(
                    recording_s,
                    index,
                    count,
                )
            };
            (0..count).map(|index| episode(index).recording_from_s + SETTLE_S).collect()
        };
        let (warm_and_instants_s, recording_s) = (6.0, 106.0);
        let found = starts(3, recording_s);
        for (index, start_s) in found.iter().enumerate() {
            // An episode ends up to 0.25 s after its last instant.
            let part = 9.97 * index as f64..10.0 * (index + 1) as f64;
            assert!(part.contains(start_s), "episode {index} starts at {start_s} s");
            assert!(start_s + warm_and_instants_s <= recording_s, "episode {index} starts at {start_s} s");
        }
        assert_eq!(found, starts(3, recording_s));
        assert_ne!(found, starts(4, recording_s));
        // A recording that is shorter than an episode repeats; the starts differ all the same.
        assert!(starts(3, 2.0).windows(2).all(|pair| pair[0] < pair[1] && pair[1] < 2.0));
    }

    #[test]
    fn instants_do_not_depend_on_the_recording() {
        let episode = || HeldOutEpisode::new(7, 0, 5, WARM);
        assert_eq!(episode().instants_ns, episode().in_recording(60.0, 1, 2).instants_ns);
    }
}
