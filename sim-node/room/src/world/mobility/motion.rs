//! Place, velocity and heading of one user on the floor, and what all models do with them.

use crate::random::{self, RoomRng};
use crate::world::walker::{Floor, Walker};

/// Time in s between two instants at which a crowd is computed.
pub const GRID_S: f64 = 0.02;

/// Where a user is, how fast, and the direction in which it faces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Place on the floor in m.
    pub at: [f64; 2],
    /// Velocity in m/s.
    pub velocity: [f64; 2],
    /// Unit vector in which the user faces.
    pub facing: [f64; 2],
}

impl Motion {
    /// A user who stands.
    pub fn standing(at: [f64; 2], facing: [f64; 2]) -> Self {
        Self { at, velocity: [0.0; 2], facing }
    }

    /// The motion after `dt_s` seconds at a velocity.
    pub fn moved_by(&self, velocity: [f64; 2], facing: [f64; 2], dt_s: f64) -> Self {
        Self { at: [0, 1].map(|axis| self.at[axis] + velocity[axis] * dt_s), velocity, facing }
    }

    /// Writes the motion to a receiver; its height does not change.
    pub fn write(&self, walker: &mut Walker) {
        walker.position.x = self.at[0];
        walker.position.y = self.at[1];
        walker.direction = self.facing;
        walker.velocity = self.velocity;
    }
}

/// A direction drawn uniformly, as a unit vector.
pub fn draw_direction(rng: &mut RoomRng) -> [f64; 2] {
    loop {
        let [x, y] = [0; 2].map(|_| random::uniform_in(rng, -1.0, 1.0));
        let length = (x * x + y * y).sqrt();
        if length > 0.01 && length < 1.0 {
            return [x / length, y / length];
        }
    }
}

/// Mirrors a place beyond a wall back into the room, and the direction with it.
///
/// Returns for each axis whether the direction was mirrored.
pub fn reflect(floor: &Floor, at: &mut [f64; 2], direction: &mut [f64; 2]) -> [bool; 2] {
    let half = [0.5 * floor.length_x_m, 0.5 * floor.length_y_m];
    let mut mirrored = [false; 2];
    for axis in [0, 1] {
        while at[axis].abs() > half[axis] {
            at[axis] = 2.0 * half[axis].copysign(at[axis]) - at[axis];
            direction[axis] = -direction[axis];
            mirrored[axis] = !mirrored[axis];
        }
    }
    mirrored
}

/// The unit vector that turns from one direction towards another by at most an angle in rad.
pub fn turned(from: [f64; 2], towards: [f64; 2], most: f64) -> [f64; 2] {
    let angle = angle_between(from, towards);
    if angle.abs() <= most { towards } else { rotated(from, most.copysign(angle)) }
}

/// The unit vector that turns from one direction towards another by a share of the angle.
pub fn turned_by_share(from: [f64; 2], towards: [f64; 2], share: f64) -> [f64; 2] {
    if share >= 1.0 || from == towards { towards } else { rotated(from, share * angle_between(from, towards)) }
}

/// The angle in rad from one unit vector to another, from -pi to pi.
fn angle_between(from: [f64; 2], towards: [f64; 2]) -> f64 {
    let cross = from[0] * towards[1] - from[1] * towards[0];
    let dot = from[0] * towards[0] + from[1] * towards[1];
    cross.atan2(dot)
}

fn rotated(direction: [f64; 2], angle: f64) -> [f64; 2] {
    let (sin, cos) = angle.sin_cos();
    let [x, y] = [direction[0] * cos - direction[1] * sin, direction[0] * sin + direction[1] * cos];
    // Rounding would add up over many turns.
    let length = (x * x + y * y).sqrt();
    [x / length, y / length]
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use super::*;

    #[test]
    fn a_place_beyond_a_wall_is_mirrored_with_its_direction() {
        let floor = Floor { length_x_m: 4.0, length_y_m: 2.0 };
        let (mut at, mut direction) = ([2.5, -0.5], [0.6, -0.8]);
        assert_eq!(reflect(&floor, &mut at, &mut direction), [true, false]);
        assert_eq!((at, direction), ([1.5, -0.5], [-0.6, -0.8]));
        // 2.5 m beyond a wall of a room of 2 m: mirrored at both walls.
        let (mut at, mut direction) = ([0.0, -3.5], [0.6, -0.8]);
        assert_eq!(reflect(&floor, &mut at, &mut direction), [false, false]);
        assert_eq!((at, direction), ([0.0, 0.5], [0.6, -0.8]));
    }

    #[test]
    fn a_turn_takes_the_shorter_side_and_ends_at_its_target() {
        let unit = |angle: f64| [angle.cos(), angle.sin()];
        let close = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) < 1e-12;
        assert!(close(turned(unit(3.0), unit(-3.0), 0.1), unit(3.1)));
        assert_eq!(turned(unit(3.0), unit(-3.0), 0.3), unit(-3.0));
        assert!(close(turned_by_share(unit(0.0), unit(-FRAC_PI_2), 0.5), unit(-PI / 4.0)));
        assert_eq!(turned_by_share(unit(0.0), unit(2.0), 1.0), unit(2.0));
    }
}
