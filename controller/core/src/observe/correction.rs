//! The compact action: a correction of how each user is believed to hold the receiver, and its one
//! decoder.
//!
//! A network gives a row of [`Correction::VALUES`] numbers for each user, in the user's frame
//! ([`Frame`]). A row of zeros changes nothing.
//!
//! | value | meaning |
//! | --- | --- |
//! | 0, 1 | change of the horizontal components of the receiver's normal |
//! | 2 | [`LOG_VARIANCE_SCALE`] times it plus [`LOG_VARIANCE_OFFSET`] is the logarithm of the variance of that change |
//!
//! The change counts where its square exceeds its variance, and where the changed normal explains
//! the measured gains at least as well as the believed one ([`Explained`]). So a network that is
//! uncertain, or wrong in a way that shows, changes nothing.

use heliostat_channel::{Orientation, Vec3};

/// Factor on the output in the logarithm of the variance.
pub const LOG_VARIANCE_SCALE: f64 = 3.0;

/// Logarithm of the variance for an output of 0.
pub const LOG_VARIANCE_OFFSET: f64 = -2.0;

/// Bounds of the logarithm of the variance.
pub const LOG_VARIANCE: [f64; 2] = [-9.0, 2.0];

/// The horizontal part of a normal stays below this: an angle of 72 degrees from the vertical.
pub const TILT_MAX: f64 = 0.95;

/// Smallest cosine of an incidence angle in a ratio of expected gains.
pub const COSINE_MIN: f64 = 0.05;

/// The horizontal axes in which a user's features and corrections are given: towards the nearest
/// array, and to the left of it. Rooms that differ by a rotation give the same rows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Frame {
    cos: f64,
    sin: f64,
}

impl Frame {
    /// The frame with its first axis along the horizontal part of a direction; the room's axes
    /// where there is none.
    pub fn towards(direction: &Vec3) -> Self {
        let length = direction.x.hypot(direction.y);
        if length > 0.0 {
            Self { cos: direction.x / length, sin: direction.y / length }
        } else {
            Self { cos: 1.0, sin: 0.0 }
        }
    }

    /// The horizontal components of a vector of the room in this frame.
    pub fn of_room(&self, vector: &Vec3) -> [f64; 2] {
        [self.cos * vector.x + self.sin * vector.y, self.cos * vector.y - self.sin * vector.x]
    }

    /// The horizontal vector of the room with these components.
    pub fn to_room(&self, [along, left]: [f64; 2]) -> Vec3 {
        Vec3::new(self.cos * along - self.sin * left, self.sin * along + self.cos * left, 0.0)
    }
}

/// The measured gains of one user and the directions of the light, in the user's frame.
///
/// A tilt changes the gain of a path in proportion to the cosine of the incidence angle. The misfit
/// of a normal n is w_d (r_d - ln(n . d / n_0 . d))^2 + w_m (r_m - ln(n . m / n_0 . m))^2 with the
/// believed normal n_0, the directions d to the LED and m to the array, and the mean residuals r.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Explained {
    /// Directions to LED and array (unit vectors).
    pub directions: [Vec3; 2],
    /// Mean residuals of the direct path and of the mirrors.
    pub residuals: [f64; 2],
    /// Weights of the two.
    pub weights: [f64; 2],
}

impl Explained {
    fn misfit(&self, normal: &Vec3, believed: &Vec3) -> f64 {
        let cosine = |normal: &Vec3, direction: &Vec3| normal.dot(direction).max(COSINE_MIN);
        let paths = self.directions.iter().zip(self.residuals).zip(self.weights);
        paths
            .map(|((direction, residual), weight)| {
                let expected = (cosine(normal, direction) / cosine(believed, direction)).ln();
                weight * (residual - expected).powi(2)
            })
            .sum()
    }
}

/// The correction of the belief about one user, in the room's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correction {
    /// Change of the normal; zero where it does not count.
    tilt: Vec3,
}

impl Correction {
    /// Numbers of a network for each user.
    pub const VALUES: usize = 3;

    /// No change.
    pub const NONE: Self = Self { tilt: Vec3::new(0.0, 0.0, 0.0) };

    /// Decodes the row of a user; `believed` are the horizontal components of the believed normal.
    pub fn decode(row: &[f32; Self::VALUES], frame: &Frame, (believed, explained): ([f64; 2], &Explained)) -> Self {
        let [along, left, spread] = row.map(f64::from);
        if along.hypot(left).powi(2) <= log_variance(spread).exp() {
            return Self::NONE;
        }
        let before = upward(believed);
        let after = upward([believed[0] + along, believed[1] + left]);
        if explained.misfit(&after, &before) > explained.misfit(&before, &before) {
            return Self::NONE;
        }
        Self { tilt: frame.to_room([along, left]) }
    }

    /// The change of the normal, in the room's axes; zero where it does not count.
    pub fn tilt(&self) -> Vec3 {
        self.tilt
    }

    /// The orientation of a receiver.
    pub fn orientation(&self, believed: Orientation) -> Orientation {
        if self.tilt == Vec3::zeros() {
            return believed;
        }
        let normal = believed.normal() + self.tilt;
        let normal = upward([normal.x, normal.y]);
        Orientation::from_polar_azimuth(normal.x.hypot(normal.y).asin(), normal.y.atan2(normal.x))
    }
}

/// The unit vector that faces up with these horizontal components, which are shortened where they
/// are too long.
pub fn upward([x, y]: [f64; 2]) -> Vec3 {
    let length = x.hypot(y);
    let factor = if length > TILT_MAX { TILT_MAX / length } else { 1.0 };
    let (x, y) = (factor * x, factor * y);
    Vec3::new(x, y, (1.0 - x * x - y * y).max(0.0).sqrt())
}

/// Logarithm of the variance of a change of the normal for an output of the network.
pub fn log_variance(value: f64) -> f64 {
    let [least, most] = LOG_VARIANCE;
    (LOG_VARIANCE_SCALE * value + LOG_VARIANCE_OFFSET).clamp(least, most)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALONG_Y: Frame = Frame { cos: 0.0, sin: 1.0 };

    /// Light from above and from the array, with these residuals.
    fn explained(residuals: [f64; 2]) -> Explained {
        let directions = [Vec3::z(), Vec3::new(0.8, 0.0, 0.6)];
        Explained { directions, residuals, weights: [1.0, 1.0] }
    }

    fn turned(row: [f32; 3], residuals: [f64; 2]) -> Orientation {
        Correction::decode(&row, &ALONG_Y, ([0.0; 2], &explained(residuals))).orientation(Orientation::UPRIGHT)
    }

    #[test]
    fn a_row_of_zeros_changes_nothing() {
        let tilted = Orientation::from_polar_azimuth(0.4, 1.0);
        let none = Correction::decode(&[0.0; 3], &ALONG_Y, ([0.1, 0.2], &explained([0.3, 0.4])));
        assert_eq!(none, Correction::NONE);
        assert_eq!(none.orientation(tilted), tilted);
    }

    #[test]
    fn a_certain_tilt_turns_the_receiver_and_an_uncertain_one_does_not() {
        let gains = [0.75_f64.sqrt().ln(), ((0.4 + 0.6 * 0.75_f64.sqrt()) / 0.6).ln()];
        assert_eq!(turned([0.5, 0.0, 0.5], gains), Orientation::UPRIGHT);
        let normal = turned([0.5, 0.0, -1.0], gains).normal();
        // Along the frame's first axis, which is y of the room.
        assert!((normal - Vec3::new(0.0, 0.5, 0.75_f64.sqrt())).norm() < 1e-9, "{normal:?}");
    }

    #[test]
    fn a_tilt_that_the_measured_gains_contradict_does_not_count() {
        // Towards the array, but the mirrors give less than expected.
        assert_eq!(turned([0.5, 0.0, -1.0], [0.0, -1.5]), Orientation::UPRIGHT);
        assert_ne!(turned([-0.5, 0.0, -1.0], [0.0, -1.5]), Orientation::UPRIGHT);
    }

    #[test]
    fn a_receiver_faces_up_whatever_the_change() {
        // Towards LED and array, both of which give less than expected by the most that counts.
        let normal = turned([-9.0, 9.0, -1.0], [-1.5; 2]).normal();
        assert_ne!(normal, Vec3::z());
        assert!(normal.z >= 0.3 && (normal.norm() - 1.0).abs() < 1e-9, "{normal:?}");
        assert!(upward([9.0, 0.0]).z > 0.3);
    }

    #[test]
    fn frames_turn_vectors_there_and_back() {
        let frame = Frame::towards(&Vec3::new(3.0, -4.0, 7.0));
        let vector = Vec3::new(1.0, 2.0, 0.0);
        assert!((frame.to_room(frame.of_room(&vector)) - vector).norm() < 1e-12);
        assert!((frame.of_room(&Vec3::new(0.6, -0.8, 0.0))[0] - 1.0).abs() < 1e-12);
    }
}
