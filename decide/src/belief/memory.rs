//! The state of a belief, as a recording holds it.

use heliostat_proto::Nanos;
use serde::{Deserialize, Serialize};

use super::{Belief, NoiseLevel, Track, angle_history::AngleMemory, occupancy::Occupancy, occupancy::OccupancyMemory};

/// Everything that a belief has learned. Settings of the scenario are not in it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct BeliefMemory {
    position_noise: NoiseLevel,
    velocity_noise: NoiseLevel,
    tracks: Vec<Track>,
    last_ns: Nanos,
    history: AngleMemory,
    map: Option<OccupancyMemory>,
}

impl Belief {
    /// The present state. Measurements at `oldest_ns` or later may still arrive.
    pub fn memory(&self, oldest_ns: Nanos) -> BeliefMemory {
        BeliefMemory {
            position_noise: self.position_noise,
            velocity_noise: self.velocity_noise,
            tracks: self.tracks.clone(),
            last_ns: self.last_ns,
            history: self.history.memory(oldest_ns),
            map: self.map.as_ref().map(Occupancy::memory),
        }
    }

    /// Replaces the state; false where it is not one of this scenario.
    pub fn restore(&mut self, memory: &BeliefMemory) -> bool {
        let BeliefMemory { position_noise, velocity_noise, tracks, last_ns, history, map } = memory;
        let [position_first, velocity_first] = &self.first_noise;
        let is_sound = |track: &Track| track.height.is_sound() && track.covered.is_sound();
        let fits = position_first.is_like(position_noise)
            && velocity_first.is_like(velocity_noise)
            && tracks.len() <= self.tracks.capacity()
            && tracks.iter().all(is_sound)
            && match (&mut self.map, map) {
                (Some(own), Some(map)) => own.restore(map),
                (own, map) => own.is_none() && map.is_none(),
            }
            && self.history.restore(history);
        if fits {
            (self.position_noise, self.velocity_noise, self.last_ns) = (*position_noise, *velocity_noise, *last_ns);
            self.tracks.clone_from(tracks);
        }
        fits
    }
}
