//! The state of a belief, as a recording holds it.

use heliostat_proto::{MAX_STATE, Nanos};
use serde::{Deserialize, Serialize};

use crate::belief::{
    Belief, angle_history,
    device::Device,
    noise::NoiseLevel,
    occupancy::{Occupancy, OccupancyMemory},
    posture::TiltEvidence,
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
    last_ns: Nanos,
    commands: Vec<angle_history::Entry>,
    map: Option<OccupancyMemory>,
}

/// What a belief has learned about how users hold their receivers, which older recordings lack.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct TiltMemory {
    /// Logarithms of likelihood ratios, in the order of the tracks; empty: without measurements.
    log_ratios: Vec<f64>,
}

/// What orientation reports have shown of devices, which older recordings lack.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct DeviceMemory {
    /// In the order of the tracks; empty: without reports.
    devices: Vec<Device>,
}

/// How many users are absent from the last report, which older recordings lack.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct AbsentMemory {
    /// The last ones of the tracks.
    count: usize,
}

impl DeviceMemory {
    /// Gives each track its part; false where this is no memory of these tracks.
    fn restore(&self, tracks: &mut [Track]) -> bool {
        if self.devices.is_empty() {
            tracks.iter_mut().for_each(|track| track.device = Device::default());
            return true;
        }
        let fits = self.devices.len() == tracks.len() && self.devices.iter().all(Device::is_sound);
        if fits {
            tracks.iter_mut().zip(&self.devices).for_each(|(track, device)| track.device = *device);
        }
        fits
    }
}

/// What a belief has learned beyond [`BeliefMemory`]; all parts follow all earlier fields of a
/// recorded state.
#[derive(Clone, Copy, Debug)]
pub struct LaterMemories<'a> {
    /// How users hold their receivers, by gains.
    pub tilt: &'a TiltMemory,
    /// The same by orientation reports.
    pub devices: &'a DeviceMemory,
    /// Which users are absent.
    pub absent: AbsentMemory,
}

impl TiltMemory {
    /// Gives each track its part; false where this is no memory of these tracks.
    fn restore(&self, tracks: &mut [Track]) -> bool {
        if self.log_ratios.is_empty() {
            tracks.iter_mut().for_each(|track| track.tilt = TiltEvidence::default());
            return true;
        }
        let fits = self.log_ratios.len() == tracks.len();
        fits && tracks.iter_mut().zip(&self.log_ratios).all(|(track, log_ratio)| {
            let evidence = TiltEvidence::from_log_ratio(*log_ratio);
            track.tilt = evidence.unwrap_or_default();
            evidence.is_some()
        })
    }
}

impl Belief {
    /// The present state of the belief about tilted receivers.
    pub fn tilt_memory(&self) -> TiltMemory {
        TiltMemory { log_ratios: self.tracks.all().iter().map(|track| track.tilt.log_ratio()).collect() }
    }

    /// The present state of the belief about reported devices.
    pub fn device_memory(&self) -> DeviceMemory {
        DeviceMemory { devices: self.tracks.all().iter().map(|track| track.device).collect() }
    }

    /// How many users are absent.
    pub fn absent_memory(&self) -> AbsentMemory {
        AbsentMemory { count: self.tracks.absent() }
    }

    /// The present state.
    pub fn memory(&self) -> BeliefMemory {
        BeliefMemory {
            position_noise: self.position_noise,
            velocity_noise: self.velocity_noise,
            tracks: self.tracks.all().to_vec(),
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
    pub fn restore(&mut self, memory: &BeliefMemory, later: LaterMemories<'_>) -> bool {
        let BeliefMemory { position_noise, velocity_noise, tracks, last_ns, commands, map } = memory;
        let [position_first, velocity_first] = &self.first_noise;
        let is_sound = |track: &Track| track.motion.is_sound() && track.height.is_sound() && track.covered.is_sound();
        let fits = position_first.is_like(position_noise)
            && velocity_first.is_like(velocity_noise)
            && tracks.iter().all(is_sound)
            && self.tracks.restore(tracks, later.absent.count)
            && self.history.restore(commands)
            && match (&mut self.map, map) {
                (Some(map), Some(memory)) => map.restore(memory),
                (None, None) => true,
                _ => false,
            };
        if fits {
            (self.position_noise, self.velocity_noise, self.last_ns) = (*position_noise, *velocity_noise, *last_ns);
        }
        let tracks = self.tracks.all_mut();
        let fits = fits && later.tilt.restore(tracks) && later.devices.restore(tracks);
        self.posture.decide(tracks.iter().map(|track| track.tilt));
        fits
    }
}
