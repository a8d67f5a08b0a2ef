//! Where obstacles stand: a Matérn hard-core process of type II.
//!
//! Points are thrown as a Poisson process, each with a random mark; a point stays when no other within the least distance has a
//! lower mark. The parents are thrown over the room and a margin of the least distance around it, so that the density is the same
//! up to the walls. The intensity asked for is the one after thinning, lambda = (1 - exp(-p pi d^2)) / (pi d^2) for parents of
//! intensity p (Chiu, Stoyan, Kendall and Mecke, Stochastic Geometry and its Applications, section 5.4).

use std::f64::consts::PI;

use thiserror::Error;

use crate::mobility::Floor;
use crate::random::{self, RoomRng};

/// Why obstacles cannot be placed.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ObstacleError {
    /// The process cannot be denser than 1 / (pi d^2), however many parents are thrown.
    #[error(
        "{intensity} obstacles a m2 at least {min_distance_m} m apart: a hard-core process stays below {limit:.4} a m2"
    )]
    TooDense {
        /// Intensity asked for, in 1/m2.
        intensity: f64,
        /// Least distance in m.
        min_distance_m: f64,
        /// The bound in 1/m2.
        limit: f64,
    },
    /// A negative or infinite setting.
    #[error("obstacles: intensity {intensity} and least distance {min_distance_m} must be finite and not negative")]
    Invalid {
        /// Intensity asked for, in 1/m2.
        intensity: f64,
        /// Least distance in m.
        min_distance_m: f64,
    },
}

/// A Matérn hard-core process of type II.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HardCore {
    parent_intensity: f64,
    min_distance_m: f64,
}

#[derive(Clone, Copy, Debug)]
struct Parent {
    at: [f64; 2],
    mark: f64,
}

impl HardCore {
    /// A process that leaves `intensity` points a square metre on average, no two closer than `min_distance_m`.
    ///
    /// # Errors
    /// [`ObstacleError`] for settings that no process meets.
    pub fn new(intensity: f64, min_distance_m: f64) -> Result<Self, ObstacleError> {
        let valid = |value: f64| value.is_finite() && value >= 0.0;
        if !valid(intensity) || !valid(min_distance_m) {
            return Err(ObstacleError::Invalid { intensity, min_distance_m });
        }
        let disc = PI * min_distance_m * min_distance_m;
        if disc == 0.0 {
            return Ok(Self { parent_intensity: intensity, min_distance_m });
        }
        let limit = 1.0 / disc;
        // The last per cent would ask for hundreds of parents that are thrown only to be removed.
        if intensity > 0.99 * limit {
            return Err(ObstacleError::TooDense { intensity, min_distance_m, limit });
        }
        Ok(Self { parent_intensity: -(-intensity * disc).ln_1p() / disc, min_distance_m })
    }

    /// Throws the points on a floor.
    pub fn sample(&self, floor: &Floor, rng: &mut RoomRng) -> Vec<[f64; 2]> {
        let half_x = 0.5 * floor.length_x_m + self.min_distance_m;
        let half_y = 0.5 * floor.length_y_m + self.min_distance_m;
        let count = random::poisson(rng, self.parent_intensity * 4.0 * half_x * half_y);
        let mut throw = |half: f64| random::uniform_in(rng, -half, half);
        let parents: Vec<Parent> =
            (0..count).map(|_| Parent { at: [throw(half_x), throw(half_y)], mark: throw(1.0) }).collect();
        let stays = |parent: &&Parent| {
            floor.contains(parent.at[0], parent.at[1])
                && parents.iter().all(|other| other.mark >= parent.mark || !self.too_close(other, parent))
        };
        parents.iter().filter(stays).map(|parent| parent.at).collect()
    }

    fn too_close(&self, a: &Parent, b: &Parent) -> bool {
        let (dx, dy) = (a.at[0] - b.at[0], a.at[1] - b.at[1]);
        dx * dx + dy * dy < self.min_distance_m * self.min_distance_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    const FLOOR: Floor = Floor { length_x_m: 5.0, length_y_m: 4.0 };

    #[test]
    fn keeps_the_least_distance() {
        let process = HardCore::new(0.25, 1.0).unwrap();
        let mut pairs = 0;
        for seed in 0..300 {
            let points = process.sample(&FLOOR, &mut stream(seed, Purpose::Obstacles, 0));
            for (i, a) in points.iter().enumerate() {
                assert!(FLOOR.contains(a[0], a[1]));
                for b in &points[..i] {
                    pairs += 1;
                    assert!((a[0] - b[0]).hypot(a[1] - b[1]) >= 1.0, "{a:?} {b:?}");
                }
            }
        }
        assert!(pairs > 1000, "only {pairs} pairs were seen");
    }

    #[test]
    fn has_the_intensity_after_thinning_up_to_the_walls() {
        for intensity in [0.08, 0.25] {
            let process = HardCore::new(intensity, 1.0).unwrap();
            let (mut all, mut rim) = (0, 0);
            let rooms: u32 = 20_000;
            for seed in 0..rooms {
                let points = process.sample(&FLOOR, &mut stream(u64::from(seed), Purpose::Obstacles, 0));
                all += points.len();
                rim += points.iter().filter(|at| at[0].abs() > 2.25 || at[1].abs() > 1.75).count();
            }
            let density = |count: usize, area: f64| count as f64 / f64::from(rooms) / area / intensity;
            assert!((density(all, 20.0) - 1.0).abs() < 0.015, "{}", density(all, 20.0));
            assert!((density(rim, 20.0 - 4.5 * 3.5) - 1.0).abs() < 0.03, "{}", density(rim, 20.0 - 4.5 * 3.5));
        }
    }

    #[test]
    fn refuses_what_cannot_be() {
        let text = |intensity, distance| HardCore::new(intensity, distance).unwrap_err().to_string();
        assert!(text(0.4, 1.0).contains("stays below 0.3183"));
        assert!(text(-1.0, 1.0).contains("not negative"));
        assert!(HardCore::new(0.0, 1.0).unwrap().sample(&FLOOR, &mut stream(1, Purpose::Obstacles, 0)).is_empty());
        assert!(!HardCore::new(3.0, 0.0).unwrap().sample(&FLOOR, &mut stream(1, Purpose::Obstacles, 0)).is_empty());
    }
}
