//! Each mirror for itself: it serves the user to whom it can give the most light.

use heliostat_channel::{ChannelModel, Mode, decode, mirrors::MirrorAngles};

use super::{Policy, PolicyError};
use crate::observation::Observation;

/// Mirror m is aimed at argmax_k a_km, the user with its largest steering gain, whatever that user's rate is already.
///
/// A baseline: about .86 of the optimum with two blocked users of five and .74 with five.
pub struct Nearest {
    served: Vec<usize>,
}

impl Nearest {
    /// For an array of `mirrors` mirrors.
    pub fn new(mirrors: usize) -> Self {
        Self { served: vec![0; mirrors] }
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
        let steering = observation.scene.steering_gain();
        let mirrors = self.served.len();
        for (mirror, served) in self.served.iter_mut().enumerate() {
            let gain = |user: usize| steering[user * mirrors + mirror];
            // The first user wins a tie, as in the decoder.
            *served = (1..observation.users()).fold(0, |best, user| if gain(user) > gain(best) { user } else { best });
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
