//! From the observation vector to the actor's inputs, and from its actions to the decoder weights.
//!
//! All features are dimensionless. Gains enter as amplitudes whose square is the effective
//! signal-to-noise ratio, so one actor serves any transmit power and noise. The observation encoder
//! computes the values ([`Summary`]); this module scales them. The exported graph scales them in
//! the weights of its first layer ([`crate::export`]).
//!
//! # Terms
//! - The actor outputs one **action** u_k in [-1, 1] per user.
//! - The **decoder weight** is w_k = b_k exp(c u_k).
//! - The **baseline weight** b_k is 1 (uniform) or q_k (balanced).
//!   [`heliostat_channel::sharing::balance`] computes q_k from the equal-share weights p_k.
//! - A **soft assignment** is the fraction of a mirror's light that user k receives.
//! - An **amplitude** is a user's signal amplitude; [`heliostat_channel::sharing::amplitudes`]
//!   computes it from weights and soft assignments.
//!
//! # Features of a user
//! 1. present
//! 2. x over half the room's extent
//! 3. y over half the room's extent
//! 4. ln(1 + direct amplitude)
//! 5. ln(1 + sum over mirrors of the steering amplitude)
//! 6. minimum rate in bit/s/Hz of the user's band
//! 7. number of users over the number of slots
//! 8. ln(1 + amplitude with the equal-share weights p)
//! 9. ln(1 + amplitude with the balanced weights q)
//! 10. ln(q_k) / 4
//!
//! All are zero in an empty slot.

use heliostat_core::observation::{ObservationEncoder, Summary, USERS_CAPACITY};
pub use heliostat_environment::action::{BaselineWeight, Head};
use heliostat_scenario::Scenario;

/// Features of one user.
pub const FEATURES: usize = 10;

/// Index of ln(1 + direct amplitude).
pub const LOG_DIRECT: usize = 3;

/// Index of ln(1 + amplitude with the balanced weights).
pub const LOG_BALANCED: usize = 8;

/// Index of ln(balanced weight) times [`WEIGHT_SCALE`].
pub const LOG_WEIGHT: usize = 9;

/// Scales the logarithms of weights to the magnitude of the other features.
pub const WEIGHT_SCALE: f32 = 0.25;

/// The layout of the observation vector, and the size of the room.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout {
    /// The range of each part of the vector.
    pub encoder: ObservationEncoder,
    /// Half the room's extent along x and y, in m.
    pub half_room_m: [f32; 2],
}

impl Layout {
    /// The layout for a scenario's array and room, with [`USERS_CAPACITY`] slots.
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

    /// The column of the summary and the factor that give each feature.
    pub fn sources(&self) -> [(usize, f32); FEATURES] {
        let [half_x, half_y] = self.half_room_m.map(|half| 1.0 / half);
        let place = Summary::Place as usize;
        [
            (Summary::Present as usize, 1.0),
            (place, half_x),
            (place + 1, half_y),
            (Summary::LogDirect as usize, 1.0),
            (Summary::LogSteering as usize, 1.0),
            (Summary::Need as usize, 1.0),
            (Summary::Users as usize, 1.0 / self.slots() as f32),
            (Summary::LogShared as usize, 1.0),
            (Summary::LogBalanced as usize, 1.0),
            (Summary::LogWeight as usize, WEIGHT_SCALE),
        ]
    }

    /// Features of all slots, (slots, [`FEATURES`]).
    ///
    /// # Panics
    /// A slice has another length than this layout gives.
    pub fn features(&self, observation: &[f32], out: &mut [f32]) {
        assert_eq!(observation.len(), self.encoder.len(), "the observation has another layout");
        assert_eq!(out.len(), self.slots() * FEATURES, "the features have another layout");
        for (slot, row) in out.chunks_exact_mut(FEATURES).enumerate() {
            for (feature, (column, factor)) in row.iter_mut().zip(self.sources()) {
                *feature = observation[self.encoder.column(column)][slot] * factor;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn layout() -> Layout {
        Layout { encoder: ObservationEncoder::new(3, 2), half_room_m: [2.5, 2.5] }
    }

    /// Two users, the second with a direct path; each mirror has the larger gain for one of them.
    fn observation() -> Vec<f32> {
        let layout = layout();
        let mut vector = vec![0.0; layout.encoder.len()];
        vector[layout.encoder.steering_amplitude()].copy_from_slice(&[0.4, 0.1, 0.2, 0.6, 0.0, 0.0]);
        let first = [1.0, 1.0, -2.0, 0.85, 0.25, 2.0, 0.1, 0.2, 0.3, 0.4, -1.0];
        let second = [1.0, 0.5, 2.0, 0.85, 0.25, 2.0, 1.1, 1.2, 1.3, 1.4, 2.0];
        for (column, values) in first.into_iter().zip(second).enumerate() {
            let slots = layout.encoder.column(column);
            vector[slots][..2].copy_from_slice(&[values.0, values.1]);
        }
        vector
    }

    #[test]
    fn features_have_the_listed_order_and_scale() {
        let layout = layout();
        let mut out = vec![9.0; 3 * FEATURES];
        layout.features(&observation(), &mut out);
        assert_eq!(out[..FEATURES], [1.0, 0.4, -0.8, 0.1, 0.2, 0.25, 2.0 / 3.0, 0.3, 0.4, -0.25]);
        let second = &out[FEATURES..];
        assert_eq!([second[LOG_DIRECT], second[LOG_BALANCED], second[LOG_WEIGHT]], [1.1, 1.4, 0.5]);
        assert_eq!(out[2 * FEATURES..], [0.0; FEATURES]);
    }

    #[test]
    fn weights_follow_the_baseline_weight_and_are_zero_in_empty_slots() {
        let weights = |baseline_weight: BaselineWeight, actions: [f32; 3]| {
            let head = Head { baseline_weight, range: 2.0 };
            head.weights(layout().encoder, &observation(), &actions).collect::<Vec<f32>>()
        };
        let uniform = weights(BaselineWeight::Uniform, [0.0, 1.0, 1.0]);
        assert_eq!(uniform[0], 1.0);
        assert!((uniform[1] - 2.0_f32.exp()).abs() < 1e-5);
        assert_eq!(uniform[2], 0.0);
        let balanced = weights(BaselineWeight::Balanced, [0.5; 3]);
        assert_eq!(balanced, [1.0, 3.0_f32.exp(), 0.0]);
    }
}
