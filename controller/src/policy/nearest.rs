//! Each mirror for itself: it serves the user to whom it can give the most light.

use heliostat_channel::{ChannelModel, Mode, decode, mirrors::MirrorAngles};

use super::{Policy, PolicyError};
use crate::observation::Observation;

/// Mirror m is aimed at argmax_k a_km, the user with its largest steering gain, whatever that user's rate is already.
///
/// A baseline: about .86 of the optimum with two blocked users of five and .74 with five.
pub struct Nearest {
    served: Vec<usize>,
    /// The gain of each mirror to the user it serves.
    largest: Vec<f64>,
}

impl Nearest {
    /// For an array of `mirrors` mirrors.
    pub fn new(mirrors: usize) -> Self {
        Self { served: vec![0; mirrors], largest: vec![0.0; mirrors] }
    }
}

impl Nearest {
    /// Turns each mirror straight towards the user it serves: the best that the paper's equations allow for one user.
    fn face_served(&self, model: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) {
        let mirrors = self.served.len();
        for (mirror, user) in self.served.iter().enumerate() {
            let direction = &observation.scene.directions()[user * mirrors + mirror];
            (out.roll[mirror], out.yaw[mirror]) = model.mirrors.angles_of(direction);
        }
    }
}

impl Policy for Nearest {
    fn name(&self) -> &str {
        "nearest"
    }

    fn act(
        &mut self,
        model: &ChannelModel,
        observation: &Observation,
        out: &mut MirrorAngles,
    ) -> Result<(), PolicyError> {
        let rows = observation.scene.steering_gain().chunks_exact(self.served.len());
        self.largest.fill(f64::NEG_INFINITY);
        for (user, row) in rows.enumerate() {
            for ((served, largest), &gain) in self.served.iter_mut().zip(&mut self.largest).zip(row) {
                // The first user wins a tie, as in the decoder. Written so that no mirror takes a branch.
                let larger = gain > *largest;
                *largest = if larger { gain } else { *largest };
                *served = if larger { user } else { *served };
            }
        }
        match model.mode {
            Mode::Specular => decode::aim(model, &observation.scene, &self.served, out),
            Mode::Paper { .. } => self.face_served(model, observation, out),
        }
        Ok(())
    }

    fn rehearse(&mut self, model: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) {
        // It remembers nothing, and a failure shows when it matters.
        let _ = self.act(model, observation, out);
    }
}
