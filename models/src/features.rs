//! From the controller's observation vector to the actor's inputs, and from its logits to the decoder's weights.
//!
//! Everything is dimensionless: gains enter as amplitudes whose square is the effective signal-to-noise ratio, so one actor
//! serves any transmit power and noise. The exported graph computes the same in the same order ([`crate::export`]).
//!
//! # Features of a user
//! 1. present
//! 2. x over half the room
//! 3. y over half the room
//! 4. ln(1 + direct amplitude)
//! 5. ln(1 + sum over mirrors of the steering amplitude)
//! 6. minimum rate in bit/s/Hz of the user's band
//! 7. number of users over the number of slots
//!
//! All are zero in an absent slot.

use heliostat_controller::observation::{ObservationEncoder, USERS_CAPACITY};
use heliostat_scenario::Scenario;
use serde::{Deserialize, Serialize};

/// Features of one user.
pub const FEATURES: usize = 7;

/// The place of what is 1 for every user present, and 0 in an absent slot, among them.
pub const PRESENT: usize = 0;

/// The place of ln(1 + direct amplitude) among them.
pub const LOG_DIRECT: usize = 3;

/// Keeps quotients finite where a user sees no mirror; far below any amplitude that carries data.
pub const TINY: f32 = 1e-6;

/// What the weights are at logits of zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Prior {
    /// One: w_k = exp(c u_k).
    Uniform,
    /// Inverse to the user's total steering amplitude, an equal share for all: w_k = exp(c u_k) / sum_m a_km.
    EqualShare,
}

/// How logits in [-1, 1] become weights.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Head {
    /// The weights at zero.
    pub prior: Prior,
    /// The constant c.
    pub range: f32,
}

/// The observation vector as the actor reads it: the controller's layout and the size of the room.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout {
    /// Where each part of the vector lies.
    pub encoder: ObservationEncoder,
    /// Half the room's extent along x and y in m.
    pub half_room_m: [f32; 2],
}

impl Layout {
    /// The layout for a scenario's array and room, with the shipped actors' number of slots.
    pub fn of(scenario: &Scenario) -> Self {
        Self {
            encoder: ObservationEncoder::new(USERS_CAPACITY, scenario.mirror_count()),
            half_room_m: [scenario.room.length_x_m, scenario.room.length_y_m].map(|extent| (0.5 * extent) as f32),
        }
    }

    /// Slots for users.
    pub fn slots(&self) -> usize {
        self.encoder.users_max()
    }

    /// Features of all slots, (slots, [`FEATURES`]).
    ///
    /// # Panics
    /// When a slice has another length than this layout says.
    pub fn features(&self, observation: &[f32], out: &mut [f32]) {
        let slots = self.slots();
        assert_eq!(observation.len(), self.encoder.len(), "observation of another layout");
        assert_eq!(out.len(), slots * FEATURES, "features of another layout");
        let users: f32 = observation[self.encoder.present()].iter().sum();
        for (slot, row) in out.chunks_exact_mut(FEATURES).enumerate() {
            let present = observation[slot];
            let position = &observation[self.encoder.positions()][3 * slot..][..3];
            let direct = observation[self.encoder.los_amplitude()][slot];
            row.copy_from_slice(&[
                present,
                position[0] / self.half_room_m[0],
                position[1] / self.half_room_m[1],
                (1.0 + direct).ln(),
                (1.0 + self.steering_of(observation, slot).iter().sum::<f32>()).ln(),
                observation[self.encoder.need()][slot],
                present * users / slots as f32,
            ]);
        }
    }

    /// The weights of all slots; zero where no user is.
    pub fn weights(&self, observation: &[f32], logits: &[f32], head: Head) -> Vec<f32> {
        let weight = |(slot, logit): (usize, &f32)| {
            let weight = (head.range * logit).exp() * observation[slot];
            match head.prior {
                Prior::Uniform => weight,
                Prior::EqualShare => weight / (self.steering_of(observation, slot).iter().sum::<f32>() + TINY),
            }
        };
        logits.iter().enumerate().map(weight).collect()
    }

    /// The steering amplitude of each mirror towards the user in a slot.
    pub fn steering_of<'a>(&self, observation: &'a [f32], slot: usize) -> &'a [f32] {
        let mirrors = self.encoder.mirrors();
        &observation[self.encoder.steering_amplitude()][slot * mirrors..][..mirrors]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn layout() -> Layout {
        Layout { encoder: ObservationEncoder::new(3, 2), half_room_m: [2.5, 2.5] }
    }

    /// Two users, the second in the direct light; each mirror suits one of them.
    fn observation() -> Vec<f32> {
        let mut vector =
            vec![1.0, 1.0, 0.0, 1.0, -2.0, 0.85, 0.5, 2.0, 0.85, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0, 0.25, 0.25, 0.0];
        vector.extend([0.4, 0.1, 0.2, 0.6, 0.0, 0.0]);
        vector.extend([0.0; 4]);
        vector
    }

    #[test]
    fn features_are_what_the_table_says() {
        let layout = layout();
        let mut out = vec![9.0; 3 * FEATURES];
        layout.features(&observation(), &mut out);
        let first = &out[..FEATURES];
        assert_eq!(first[..4], [1.0, 0.4, -0.8, 0.0]);
        assert!((first[4] - 1.5_f32.ln()).abs() < 1e-6);
        assert_eq!(first[5], 0.25);
        assert!((first[6] - 2.0 / 3.0).abs() < 1e-6);
        assert!((out[FEATURES + 3] - 4.0_f32.ln()).abs() < 1e-6);
        assert_eq!(out[2 * FEATURES..], [0.0; FEATURES]);
    }

    #[test]
    fn weights_follow_the_prior_and_vanish_in_absent_slots() {
        let layout = layout();
        let uniform = layout.weights(&observation(), &[0.0, 1.0, 1.0], Head { prior: Prior::Uniform, range: 2.0 });
        assert_eq!(uniform[0], 1.0);
        assert!((uniform[1] - 2.0_f32.exp()).abs() < 1e-5);
        assert_eq!(uniform[2], 0.0);
        let equal = layout.weights(&observation(), &[0.0; 3], Head { prior: Prior::EqualShare, range: 2.0 });
        assert!((equal[0] * 0.5 - 1.0).abs() < 1e-4);
        assert!((equal[1] * 0.8 - 1.0).abs() < 1e-4);
        assert_eq!(equal[2], 0.0);
    }
}
