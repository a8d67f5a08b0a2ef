//! The floor of the room, and one user's receiver on it.

use heliostat_channel::Vec3;

/// The rectangle in which users walk, centred on the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Floor {
    /// Extent along x in m.
    pub length_x_m: f64,
    /// Extent along y in m.
    pub length_y_m: f64,
}

impl Floor {
    /// Whether a point lies on the floor.
    pub fn contains(&self, x: f64, y: f64) -> bool {
        x.abs() <= 0.5 * self.length_x_m && y.abs() <= 0.5 * self.length_y_m
    }
}

/// One user's receiver: its position, the heading of the user who holds it, and its velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Walker {
    /// Position of the detector in m, in the room frame.
    pub position: Vec3,
    /// Unit vector on the floor in which the user faces; the user's body is behind the receiver.
    pub direction: [f64; 2],
    /// Velocity on the floor in m/s.
    pub velocity: [f64; 2],
}

impl Walker {
    /// The direction in which the user faces, in radians from +x towards +y.
    pub fn heading(&self) -> f64 {
        self.direction[1].atan2(self.direction[0])
    }
}
