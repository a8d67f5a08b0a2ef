//! The difference between the angle of a drive and the angle of its mirror: scale, offset, drift
//! and jitter.
//!
//! The mirror is at scale * angle + offset + drift + jitter. Scale and offset are drawn once, drift
//! is Brownian motion, and jitter is drawn at each step. The drive's own sensor measures none of
//! them.

use heliostat_scenario::ActuatorParameters;

use crate::random::{self, RoomRng};

/// The mounting of every axis of an array.
#[derive(Clone, Debug)]
pub(super) struct Mounting {
    jitter_rad: f64,
    drift_rad_per_sqrt_s: f64,
    /// Roll of every mirror, then yaw of every mirror; so are the lists below.
    scale: Vec<f64>,
    offset: Vec<f64>,
    drift: Vec<f64>,
    rng: RoomRng,
}

impl Mounting {
    /// Draws the offsets from `rng`, which drift and jitter then use, and the scales from its next
    /// stream.
    pub fn new(parameters: &ActuatorParameters, axes: usize, mut rng: RoomRng) -> Self {
        let offset = (0..axes).map(|_| parameters.offset_rad * random::normal(&mut rng)).collect();
        let mut scales = rng.clone();
        scales.set_stream(rng.get_stream() + 1);
        let scale = (0..axes).map(|_| 1.0 + parameters.scale_error_relative * random::normal(&mut scales)).collect();
        Self {
            jitter_rad: parameters.jitter_rad,
            drift_rad_per_sqrt_s: parameters.drift_rad_per_sqrt_s,
            scale,
            offset,
            drift: vec![0.0; axes],
            rng,
        }
    }

    /// Advances the drift by `dt_s` seconds.
    pub fn step(&mut self, dt_s: f64) {
        if self.drift_rad_per_sqrt_s > 0.0 {
            let scale = self.drift_rad_per_sqrt_s * dt_s.max(0.0).sqrt();
            for drift in &mut self.drift {
                *drift += scale * random::normal(&mut self.rng);
            }
        }
    }

    /// The angle of the mirror on `axis` when its drive is at `angle`, both in rad; draws the
    /// jitter.
    pub fn mirror_angle(&mut self, axis: usize, angle: f64) -> f64 {
        let jitter = if self.jitter_rad > 0.0 { self.jitter_rad * random::normal(&mut self.rng) } else { 0.0 };
        self.scale[axis] * angle + self.offset[axis] + self.drift[axis] + jitter
    }
}
