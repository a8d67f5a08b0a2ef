//! Each mirror serves the user with its largest steering gain.

use heliostat_channel::{ChannelModel, Mode, decode, mirrors::MirrorAngles};

use heliostat_proto::MAX_USERS;

use super::proposal::{Policy, PolicyResult};
use crate::observe::observation::Observation;

/// Mirror m is aimed at argmax_k a_km, the user with its largest steering gain, regardless of that
/// user's rate.
///
/// A simple policy; docs/evaluation.md compares it with the optimum.
pub struct Nearest {
    /// 1 for each user: all users have the same weight.
    weights: Vec<f64>,
}

impl Nearest {
    /// Without users yet.
    pub fn new() -> Self {
        Self { weights: Vec::with_capacity(MAX_USERS) }
    }
}

/// Turns each mirror straight towards the user it serves: the best that the paper's equations allow
/// for one user.
fn face_served(model: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) {
    let (users, mirrors) = (observation.users(), observation.mirrors());
    let gains = observation.scene.steering_gain();
    for mirror in 0..mirrors {
        let larger = |best: usize, user: usize| {
            let [gain, largest] = [user, best].map(|user| gains[user * mirrors + mirror]);
            // The first user wins a tie, as in the decoder.
            if gain > largest { user } else { best }
        };
        let served = (1..users).fold(0, larger);
        let direction = &observation.scene.directions()[served * mirrors + mirror];
        (out.roll[mirror], out.yaw[mirror]) = model.mirrors.angles_of(mirror, direction);
    }
}

impl Policy for Nearest {
    fn name(&self) -> &str {
        "nearest"
    }

    fn act(&mut self, model: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) -> PolicyResult {
        self.weights.resize(observation.users(), 1.0);
        match model.mode {
            Mode::Specular => decode::decode(model, &observation.scene, &self.weights, out),
            Mode::Paper { .. } => face_served(model, observation, out),
        }
        Ok(())
    }
}
