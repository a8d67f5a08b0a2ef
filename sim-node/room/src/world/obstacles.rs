//! Positions of the obstacles: a Matérn hard-core process of type II.
//!
//! Parent points form a Poisson process, each with a random mark. A point is kept when no other
//! point within the minimum distance has a lower mark. The parents cover the room and a margin of
//! the minimum distance around it, so that the density is the same up to the walls. The configured
//! intensity is the one after thinning, lambda = (1 - exp(-p pi d^2)) / (pi d^2) for parents of
//! intensity p.
//!
//! Source: Chiu, Stoyan, Kendall and Mecke, Stochastic Geometry and its Applications, section 5.4.

use std::f64::consts::PI;

use thiserror::Error;

use crate::random::{self, RoomRng};
use crate::world::walker::Floor;

/// Why obstacles cannot be placed.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ObstacleError {
    /// The intensity after thinning stays below 1 / (pi d^2) for any intensity of the parents.
    #[error(
        "blockage.obstacles_per_m2: {intensity} at a minimum distance of {min_distance_m} m is too dense: \
         expected less than {limit:.4}, or a shorter distance"
    )]
    TooDense {
        /// Configured intensity in 1/m2.
        intensity: f64,
        /// Minimum distance in m.
        min_distance_m: f64,
        /// The bound in 1/m2.
        limit: f64,
    },
    /// A negative or infinite setting.
    #[error(
        "invalid obstacles: intensity {intensity} 1/m2, minimum distance {min_distance_m} m: expected finite numbers, not negative"
    )]
    Invalid {
        /// Configured intensity in 1/m2.
        intensity: f64,
        /// Minimum distance in m.
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
    /// A process of `intensity` points per m2 on average, no two closer than `min_distance_m`.
    ///
    /// # Errors
    /// [`ObstacleError`] for settings that no such process has.
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
        // Near the limit the number of parents diverges, and nearly all of them would be removed.
        if intensity > 0.99 * limit {
            return Err(ObstacleError::TooDense { intensity, min_distance_m, limit });
        }
        Ok(Self { parent_intensity: -(-intensity * disc).ln_1p() / disc, min_distance_m })
    }

    /// Draws the points on a floor.
    pub fn sample(&self, floor: &Floor, rng: &mut RoomRng) -> Vec<[f64; 2]> {
        let half_x = 0.5 * floor.length_x_m + self.min_distance_m;
        let half_y = 0.5 * floor.length_y_m + self.min_distance_m;
        let count = random::poisson(rng, self.parent_intensity * 4.0 * half_x * half_y);
        let mut draw = |half: f64| random::uniform_in(rng, -half, half);
        let parents: Vec<Parent> =
            (0..count).map(|_| Parent { at: [draw(half_x), draw(half_y)], mark: draw(1.0) }).collect();
        let kept = |parent: &&Parent| {
            floor.contains(parent.at[0], parent.at[1])
                && parents.iter().all(|other| other.mark >= parent.mark || !self.too_close(other, parent))
        };
        parents.iter().filter(kept).map(|parent| parent.at).collect()
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
    fn no_two_points_are_closer_than_the_minimum_distance() {
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
    fn impossible_settings_are_refused() {
        let text = |intensity, distance| HardCore::new(intensity, distance).unwrap_err().to_string();
        assert!(text(0.4, 1.0).contains("expected less than 0.3183"));
        assert!(text(-1.0, 1.0).contains("not negative"));
        assert!(HardCore::new(0.0, 1.0).unwrap().sample(&FLOOR, &mut stream(1, Purpose::Obstacles, 0)).is_empty());
        assert!(!HardCore::new(3.0, 0.0).unwrap().sample(&FLOOR, &mut stream(1, Purpose::Obstacles, 0)).is_empty());
    }
}
