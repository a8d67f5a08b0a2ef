//! The state of a belief, as a recording holds it.

use heliostat_proto::{MAX_STATE, Nanos};
use serde::{Deserialize, Serialize};

use crate::belief::{
    Belief, angle_history,
    noise::NoiseLevel,
    occupancy::{Occupancy, OccupancyMemory},
    track::Track,
};

/// Commands whose validity ended at most this long before the last position report, in ns, are always
/// in a state.
const COMMANDS_NS: Nanos = 2_000_000_000;

/// Earlier commands that may explain a measurement are in a state if all commands take at most this
/// many bytes: two thirds of the largest state.
const COMMANDS_BYTES: usize = MAX_STATE / 3 * 2;

/// Everything that a belief has learned. Settings of the scenario are not in it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct BeliefMemory {
    position_noise: NoiseLevel,
    velocity_noise: NoiseLevel,
    tracks: Vec<Track>,
    /// How many of the tracks, the last ones, are of users who are absent from the last report.
    absent: usize,
    last_ns: Nanos,
    commands: Vec<angle_history::Entry>,
    map: Option<OccupancyMemory>,
}

impl Belief {
    /// The present state.
    pub fn memory(&self) -> BeliefMemory {
        BeliefMemory {
            position_noise: self.position_noise,
            velocity_noise: self.velocity_noise,
            tracks: self.tracks.all().to_vec(),
            absent: self.tracks.absent(),
            last_ns: self.last_ns,
            commands: self.commands(),
            map: self.map.as_ref().map(Occupancy::memory),
        }
    }

    /// The commands that may explain a measurement, as far as a state has room for them.
    fn commands(&self) -> Vec<angle_history::Entry> {
        let since = |span_ns: Nanos| self.history.since(self.last_ns.saturating_sub(span_ns));
        // No report is accepted at twice the largest age.
        let commands = since(COMMANDS_NS.max(self.report_age_max_ns.saturating_mul(2)));
        let bytes: usize = commands.iter().map(angle_history::Entry::bytes).sum();
        if bytes <= COMMANDS_BYTES { commands } else { since(COMMANDS_NS) }
    }

    /// Replaces the state; false, with parts of it replaced, where it is not one of this scenario.
    pub fn restore(&mut self, memory: &BeliefMemory) -> bool {
        let BeliefMemory { position_noise, velocity_noise, tracks, absent, last_ns, commands, map } = memory;
        let [position_first, velocity_first] = &self.first_noise;
        let fits = position_first.is_like(position_noise)
            && velocity_first.is_like(velocity_noise)
            && tracks.iter().all(Track::is_sound)
            && self.tracks.restore(tracks, *absent)
            && self.history.restore(commands)
            && match (&mut self.map, map) {
                (Some(map), Some(memory)) => map.restore(memory),
                (None, None) => true,
                _ => false,
            };
        if fits {
            (self.position_noise, self.velocity_noise, self.last_ns) = (*position_noise, *velocity_noise, *last_ns);
            self.posture.decide(tracks.iter().map(|track| track.tilt));
        }
        fits
    }
}
