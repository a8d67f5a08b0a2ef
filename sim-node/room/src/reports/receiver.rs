//! How a receiver measures a gain: noise, and the resolution of its converter.

use heliostat_scenario::ChannelStream;

use crate::random::{self, Purpose, RoomRng};

/// The receivers of all users, which measure alike.
#[derive(Clone, Debug)]
pub struct Receivers {
    noise_relative: f64,
    noise_gain: f64,
    /// The difference between two values of the converter; 0 without quantisation.
    step_gain: f64,
    full_scale_gain: f64,
    relative_noise: RoomRng,
    receiver_noise: RoomRng,
}

impl Receivers {
    /// The receivers of a scenario, with generators of these purposes for the relative noise and
    /// for that of the receiver.
    pub fn new(settings: &ChannelStream, seed: u64, [relative, receiver]: [Purpose; 2]) -> Self {
        Self {
            noise_relative: settings.noise_relative,
            noise_gain: settings.noise_gain,
            step_gain: settings.step_gain(),
            full_scale_gain: settings.full_scale_gain,
            relative_noise: random::stream(seed, relative, 0),
            receiver_noise: random::stream(seed, receiver, 0),
        }
    }

    /// The reading of a gain.
    ///
    /// q(max(0, gain max(0, 1 + `noise_relative` n1) + `noise_gain` n2)) with independent standard
    /// normal n1 and n2, and the uniform mid-tread quantiser q(x) = step round(min(x, full scale) /
    /// step).
    pub fn measure(&mut self, gain: f64) -> f64 {
        let mut measured = gain * (1.0 + self.noise_relative * random::normal(&mut self.relative_noise)).max(0.0);
        if self.noise_gain > 0.0 {
            measured = (measured + self.noise_gain * random::normal(&mut self.receiver_noise)).max(0.0);
        }
        if self.step_gain > 0.0 {
            measured = self.step_gain * (measured.min(self.full_scale_gain) / self.step_gain).round();
        }
        measured
    }
}
