//! Cylinders that stand in the light: people, furniture, the users' own bodies.
//!
//! A path is a straight segment and an obstacle a solid upright cylinder that stands on the floor. The test is exact, in
//! three dimensions. The shadow length of the paper's eq. (5) is kept as a cross-check only: it describes the shadow's
//! axis and says nothing of its width.

use crate::Vec3;
use crate::error::{ChannelError, finite, not_negative, positive};

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
    /// A cylinder whose numbers have been checked.
    ///
    /// # Errors
    /// [`ChannelError::OutOfRange`] for a position that is not finite or a radius or height that is not positive.
    pub fn new(x_m: f64, y_m: f64, radius_m: f64, height_m: f64) -> Result<Self, ChannelError> {
        Ok(Self {
            x_m: finite("x of a cylinder in m", x_m)?,
            y_m: finite("y of a cylinder in m", y_m)?,
            radius_m: positive("radius of a cylinder in m", radius_m)?,
            height_m: positive("height of a cylinder in m", height_m)?,
        })
    }
}

/// Whether the cylinder interrupts the segment from `a` to `b` (both in m).
///
/// The part of the segment between the floor and the cylinder's top is found first; the segment is blocked when the
/// point of that part that is nearest to the axis, in plan, is nearer than the radius. A segment that only touches the
/// surface passes. Symmetric in `a` and `b`.
#[inline]
pub fn blocks(cylinder: &Cylinder, a: &Vec3, b: &Vec3) -> bool {
    let rise = b.z - a.z;
    let (mut from, mut to) = (0.0_f64, 1.0_f64);
    if rise == 0.0 {
        if a.z < 0.0 || a.z > cylinder.height_m {
            return false;
        }
    } else {
        let floor = -a.z / rise;
        let top = (cylinder.height_m - a.z) / rise;
        from = from.max(floor.min(top));
        to = to.min(floor.max(top));
        if from > to {
            return false;
        }
    }
    let (along_x, along_y) = (b.x - a.x, b.y - a.y);
    let (to_axis_x, to_axis_y) = (cylinder.x_m - a.x, cylinder.y_m - a.y);
    let plan_length_squared = along_x * along_x + along_y * along_y;
    let nearest = if plan_length_squared > 0.0 {
        ((to_axis_x * along_x + to_axis_y * along_y) / plan_length_squared).clamp(from, to)
    } else {
        from
    };
    let (miss_x, miss_y) = (to_axis_x - nearest * along_x, to_axis_y - nearest * along_y);
    miss_x * miss_x + miss_y * miss_y < cylinder.radius_m * cylinder.radius_m
}

/// Length of the shadow behind a blocker on the receiver plane, in m: d_B h_B / (h_l - h_B).
///
/// Infinite when the blocker is as tall as the LED. This is eq. (5) solved for the quantity it defines: as printed,
/// d_L - d_B = h_B d_L / h_l, the unknown d_L stands on both sides.
///
/// `distance_m`: horizontal distance d_B from the LED to the blocker; `blocker_height_m` and `led_height_m`: h_B and h_l,
/// both above the receiver plane and not above the floor.
///
/// # Errors
/// [`ChannelError::OutOfRange`] for a negative distance or blocker height or an LED that is not above the plane.
pub fn shadow_length(distance_m: f64, blocker_height_m: f64, led_height_m: f64) -> Result<f64, ChannelError> {
    let distance = not_negative("distance of a blocker in m", distance_m)?;
    let blocker = not_negative("height of a blocker above the receivers in m", blocker_height_m)?;
    let led = positive("height of an LED above the receivers in m", led_height_m)?;
    if blocker >= led { Ok(f64::INFINITY) } else { Ok(distance * blocker / (led - blocker)) }
}
