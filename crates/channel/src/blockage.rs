//! Blockage of paths by cylinders: obstacles and the users' own bodies.
//!
//! A path is a straight segment, and an obstacle is a solid upright cylinder on the floor. The test
//! is exact in three dimensions. The tests compare it with the shadow length of the paper's eq. (5),
//! which describes the axis of the shadow, not its width.
//!
//! ```
//! use heliostat_channel::{Cylinder, blockage, geometry::Vec3};
//!
//! let obstacle = Cylinder::new(0.5, 0.0, 0.25, 1.75)?;
//! let (led, detector) = (Vec3::new(0.0, 0.0, 3.0), Vec3::new(2.0, 0.0, 0.85));
//! assert!(!blockage::blocks(&obstacle, &led, &detector), "the path passes above the obstacle");
//! assert!(blockage::blocks(&obstacle, &Vec3::new(0.0, 0.0, 1.0), &detector));
//! # Ok::<(), heliostat_channel::ChannelError>(())
//! ```

use heliostat_proto::Obstacle;

use crate::domain::{finite, positive};
use crate::error::ChannelError;
use crate::geometry::Vec3;

/// A solid upright cylinder that stands on the floor (z = 0).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cylinder {
    /// x of the axis in m.
    pub x_m: f64,
    /// y of the axis in m.
    pub y_m: f64,
    /// Radius in m.
    pub radius_m: f64,
    /// Height in m.
    pub height_m: f64,
}

impl Cylinder {
    /// A cylinder with checked position and dimensions, all in m.
    ///
    /// # Errors
    /// [`ChannelError::OutOfRange`] for a position that is not finite or a radius or height that is
    /// not positive.
    pub fn new(x_m: f64, y_m: f64, radius_m: f64, height_m: f64) -> Result<Self, ChannelError> {
        Ok(Self {
            x_m: finite("x of a cylinder in m", x_m)?,
            y_m: finite("y of a cylinder in m", y_m)?,
            radius_m: positive("radius of a cylinder in m", radius_m)?,
            height_m: positive("height of a cylinder in m", height_m)?,
        })
    }
}

/// The cylinder of a surveyed obstacle.
impl From<&Obstacle> for Cylinder {
    fn from(obstacle: &Obstacle) -> Self {
        let Obstacle { x_m, y_m, radius_m, height_m } = *obstacle;
        let [x_m, y_m, radius_m, height_m] = [x_m, y_m, radius_m, height_m].map(f64::from);
        Self { x_m, y_m, radius_m, height_m }
    }
}

/// The body of a user, who stands behind the device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// Radius in m.
    pub radius_m: f64,
    /// Height in m.
    pub height_m: f64,
    /// Distance of the axis behind the device in m.
    pub offset_m: f64,
}

impl Body {
    /// The smallest cylinder that holds the body of a user whose device is here, for every heading.
    #[inline]
    pub fn around(&self, device: &Vec3) -> Cylinder {
        let Self { radius_m, height_m, offset_m } = *self;
        Cylinder { x_m: device.x, y_m: device.y, radius_m: radius_m + offset_m, height_m }
    }

    /// The body of a user whose device is here, and who faces this direction (a unit vector).
    #[inline]
    pub fn behind(&self, device: &Vec3, heading: &Vec3) -> Cylinder {
        let Self { radius_m, height_m, offset_m } = *self;
        Cylinder { x_m: device.x - offset_m * heading.x, y_m: device.y - offset_m * heading.y, radius_m, height_m }
    }
}

/// Whether the cylinder blocks the segment from `a` to `b`.
///
/// In plan view, the cylinder's disc cuts a chord from the segment. The segment is blocked if some
/// point above the chord has a height within [0, cylinder height]. A segment that only touches the
/// side is not blocked. The result is symmetric in `a` and `b`. Units: m.
#[inline]
pub fn blocks(cylinder: &Cylinder, a: &Vec3, b: &Vec3) -> bool {
    plan_chord(cylinder, (a.x, a.y), (b.x, b.y)).is_some_and(|chord| dips(cylinder, a.z, b.z, chord))
}

/// The chord that the cylinder's disc cuts from a segment in plan view, as two fractions of its
/// length; `None` without one.
///
/// The chord does not depend on heights, so all mirrors of a column share it.
#[inline]
pub(crate) fn plan_chord(cylinder: &Cylinder, from: (f64, f64), to: (f64, f64)) -> Option<(f64, f64)> {
    let (along_x, along_y) = (to.0 - from.0, to.1 - from.1);
    let (off_x, off_y) = (cylinder.x_m - from.0, cylinder.y_m - from.1);
    let squared_length = along_x * along_x + along_y * along_y;
    let outside = off_x * off_x + off_y * off_y - cylinder.radius_m * cylinder.radius_m;
    if squared_length == 0.0 {
        return (outside < 0.0).then_some((0.0, 1.0));
    }
    let nearest = off_x * along_x + off_y * along_y;
    let discriminant = nearest * nearest - squared_length * outside;
    // With radius 0 a rounding error could make the discriminant positive.
    if discriminant.is_nan() || discriminant <= 0.0 || cylinder.radius_m == 0.0 {
        return None;
    }
    let half = discriminant.sqrt();
    let enter = ((nearest - half) / squared_length).max(0.0);
    let leave = ((nearest + half) / squared_length).min(1.0);
    (enter < leave).then_some((enter, leave))
}

/// Whether a segment between two heights is within the cylinder's height at some point of the
/// chord.
#[inline]
pub(crate) fn dips(cylinder: &Cylinder, from_z: f64, to_z: f64, (enter, leave): (f64, f64)) -> bool {
    let (first, last) = (from_z + enter * (to_z - from_z), from_z + leave * (to_z - from_z));
    // Without branches, so that the loop over mirrors vectorises; a chord of NaN fails all
    // comparisons.
    ((first <= cylinder.height_m) | (last <= cylinder.height_m)) & ((first >= 0.0) | (last >= 0.0))
}
