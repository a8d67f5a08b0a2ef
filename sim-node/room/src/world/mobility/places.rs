//! Places on the free floor of a room.

use heliostat_channel::Cylinder;

use crate::random::{self, RoomRng};
use crate::world::walker::Floor;

/// Places that are tried before the best of them is taken, in a room without a free place.
const ATTEMPTS: usize = 200;
/// Share of the floor's extents that remains where the clearance of the walls exceeds it.
const LEAST_SHARE: f64 = 0.2;

/// A round obstacle on the floor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disc {
    /// Its axis in m.
    pub at: [f64; 2],
    /// Its radius in m.
    pub radius_m: f64,
}

/// The floor and the obstacles on it.
#[derive(Clone, Debug, PartialEq)]
pub struct Places {
    /// The floor.
    pub floor: Floor,
    /// The obstacles.
    pub obstacles: Vec<Disc>,
}

impl Places {
    /// The places of a room.
    pub fn new(floor: Floor, obstacles: &[Cylinder]) -> Self {
        let disc = |obstacle: &Cylinder| Disc { at: [obstacle.x_m, obstacle.y_m], radius_m: obstacle.radius_m };
        Self { floor, obstacles: obstacles.iter().map(disc).collect() }
    }

    /// A place drawn uniformly from the free floor.
    ///
    /// It is `clearance_m` from walls and obstacles and `spacing_m` from the places that are taken.
    /// In a room without such a place it is the one of 200 places with the least violation.
    pub fn draw(
        &self,
        rng: &mut RoomRng,
        clearance_m: f64,
        taken: impl Iterator<Item = [f64; 2]> + Clone,
        spacing_m: f64,
    ) -> [f64; 2] {
        let half = self.half_extents_m(clearance_m);
        let (mut best, mut best_slack_m) = ([0.0; 2], f64::NEG_INFINITY);
        for _ in 0..ATTEMPTS {
            let at = half.map(|half| random::uniform_in(rng, -half, half));
            let to_obstacle = |disc: &Disc| distance_m(disc.at, at) - disc.radius_m - clearance_m;
            let to_taken = taken.clone().map(|other| distance_m(other, at) - spacing_m);
            let slack_m = self.obstacles.iter().map(to_obstacle).chain(to_taken).fold(f64::INFINITY, f64::min);
            if slack_m >= 0.0 {
                return at;
            }
            if slack_m > best_slack_m {
                (best, best_slack_m) = (at, slack_m);
            }
        }
        best
    }

    /// Half of the floor's extents in m, less a clearance of the walls.
    pub fn half_extents_m(&self, clearance_m: f64) -> [f64; 2] {
        [self.floor.length_x_m, self.floor.length_y_m]
            .map(|length_m| (0.5 * length_m - clearance_m).max(0.5 * LEAST_SHARE * length_m))
    }
}

/// A point drawn uniformly on the floor.
pub fn draw_point(floor: &Floor, rng: &mut RoomRng) -> [f64; 2] {
    [0.5 * floor.length_x_m, 0.5 * floor.length_y_m].map(|half| random::uniform_in(rng, -half, half))
}

/// Distance of two places in m.
pub fn distance_m(a: [f64; 2], b: [f64; 2]) -> f64 {
    let [x, y] = [a[0] - b[0], a[1] - b[1]];
    (x * x + y * y).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    const FLOOR: Floor = Floor { length_x_m: 4.0, length_y_m: 2.0 };

    #[test]
    fn a_place_is_clear_of_walls_obstacles_and_other_places() {
        let obstacle = Cylinder { x_m: 0.0, y_m: 0.0, radius_m: 0.3, height_m: 1.0 };
        let places = Places::new(FLOOR, &[obstacle]);
        let mut rng = stream(1, Purpose::Walk, 0);
        for _ in 0..1000 {
            let at = places.draw(&mut rng, 0.2, [[1.5, 0.5]].into_iter(), 1.0);
            assert!(at[0].abs() <= 1.8 && at[1].abs() <= 0.8, "{at:?}");
            assert!(distance_m(at, [0.0; 2]) >= 0.5 && distance_m(at, [1.5, 0.5]) >= 1.0, "{at:?}");
        }
    }

    #[test]
    fn a_full_room_still_gives_a_place_on_the_floor() {
        let obstacle = Cylinder { x_m: 0.0, y_m: 0.0, radius_m: 5.0, height_m: 1.0 };
        let places = Places::new(FLOOR, &[obstacle]);
        let at = places.draw(&mut stream(1, Purpose::Walk, 0), 3.0, std::iter::empty(), 0.0);
        assert!(FLOOR.contains(at[0], at[1]), "{at:?}");
    }
}
