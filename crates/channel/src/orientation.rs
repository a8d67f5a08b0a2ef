//! How a user holds the receiver: a rotation of all its branches.
//!
//! The branches of a [`Receiver`](crate::Receiver) are those of an upright device. An
//! [`Orientation`] turns their normals; the position of the detectors does not change. The gain
//! functions of one path take any branch, so [`Receiver::turned`](crate::Receiver::turned) gives
//! the tilted receiver for them. [`Scene::update_turned`](crate::Scene::update_turned) takes one
//! orientation per user.
//!
//! ```
//! use heliostat_channel::{Orientation, Vec3};
//!
//! // Tilted by 30 degrees towards +x.
//! let orientation = Orientation::from_polar_azimuth(30.0_f64.to_radians(), 0.0);
//! assert!((orientation.normal() - Vec3::new(0.5, 0.0, 0.75_f64.sqrt())).norm() < 1e-15);
//! ```

use heliostat_proto::LENGTH_TOLERANCE;

use crate::geometry::{GeometryError, Vec3};

/// A rotation from the upright device to the device as it is held, as a unit quaternion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orientation {
    scalar: f64,
    vector: Vec3,
}

impl Orientation {
    /// The device faces up, and its branches have the directions of the receiver.
    pub const UPRIGHT: Self = Self { scalar: 1.0, vector: Vec3::new(0.0, 0.0, 0.0) };

    /// The smallest rotation that gives the device's normal this direction.
    ///
    /// The normal becomes (sin polar cos azimuth, sin polar sin azimuth, cos polar); the axis
    /// (-sin azimuth, cos azimuth, 0) is perpendicular to it and to the vertical.
    ///
    /// `polar`: angle between normal and vertical; `azimuth`: about z, from +x towards +y. Both in
    /// radians.
    pub fn from_polar_azimuth(polar: f64, azimuth: f64) -> Self {
        let (sin_half, cos_half) = (0.5 * polar).sin_cos();
        let (sin_azimuth, cos_azimuth) = azimuth.sin_cos();
        Self { scalar: cos_half, vector: Vec3::new(-sin_half * sin_azimuth, sin_half * cos_azimuth, 0.0) }
    }

    /// The rotation about an axis by its length in radians.
    pub fn from_rotation_vector(rotation: [f64; 3]) -> Self {
        let rotation = Vec3::from(rotation);
        let angle = rotation.norm();
        let (sin_half, cos_half) = (0.5 * angle).sin_cos();
        let share = if angle > 0.0 { sin_half / angle } else { 0.0 };
        Self { scalar: cos_half, vector: share * rotation }
    }

    /// The rotation of a quaternion w + x i + y j + z k, which is normalised.
    ///
    /// # Errors
    /// [`GeometryError::NotUnit`] for a length that differs from 1 by more than 0.001, and for a
    /// component that is not finite.
    pub fn from_quaternion([w, x, y, z]: [f64; 4]) -> Result<Self, GeometryError> {
        let length = (w * w + x * x + y * y + z * z).sqrt();
        // A NaN fails the comparison.
        if (length - 1.0).abs() <= LENGTH_TOLERANCE {
            Ok(Self { scalar: w / length, vector: Vec3::new(x, y, z) / length })
        } else {
            Err(GeometryError::NotUnit { what: "the quaternion of an orientation" })
        }
    }

    /// The unit quaternion w + x i + y j + z k.
    pub fn quaternion(&self) -> [f64; 4] {
        [self.scalar, self.vector.x, self.vector.y, self.vector.z]
    }

    /// This rotation, followed by another one in the room's frame.
    pub fn then(&self, next: &Self) -> Self {
        Self {
            scalar: next.scalar * self.scalar - next.vector.dot(&self.vector),
            vector: next.scalar * self.vector + self.scalar * next.vector + next.vector.cross(&self.vector),
        }
    }

    /// The direction of a vector of the upright device as the device is held.
    ///
    /// v' = v + 2 w (q x v) + 2 q x (q x v) with the scalar part w and the vector part q.
    #[inline]
    pub fn turn(&self, v: &Vec3) -> Vec3 {
        let twice = 2.0 * self.vector.cross(v);
        v + self.scalar * twice + self.vector.cross(&twice)
    }

    /// The device's unit normal, which is the vertical for an upright device.
    pub fn normal(&self) -> Vec3 {
        self.turn(&Vec3::z())
    }
}

impl Default for Orientation {
    fn default() -> Self {
        Self::UPRIGHT
    }
}
