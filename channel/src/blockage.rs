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
/// The segment is cut to the part that is above the cylinder's disc in plan; it is blocked when that part comes down to the
/// cylinder's height (and is not below the floor). A segment that only touches the side passes. Symmetric in `a` and `b`.
#[inline]
pub fn blocks(cylinder: &Cylinder, a: &Vec3, b: &Vec3) -> bool {
    plan_chord(cylinder, (a.x, a.y), (b.x, b.y)).is_some_and(|chord| dips(cylinder, a.z, b.z, chord))
}

/// The part of a segment that runs inside the cylinder's disc in plan, as two shares of its length; `None` where it passes by.
///
/// Does not depend on heights, so one chord serves all mirrors of a column.
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
    if discriminant.is_nan() || discriminant <= 0.0 {
        return None;
    }
    let half = discriminant.sqrt();
    let enter = ((nearest - half) / squared_length).max(0.0);
    let leave = ((nearest + half) / squared_length).min(1.0);
    (enter < leave).then_some((enter, leave))
}

/// Whether a segment between two heights is inside the cylinder's height somewhere along the chord.
#[inline]
pub(crate) fn dips(cylinder: &Cylinder, from_z: f64, to_z: f64, (enter, leave): (f64, f64)) -> bool {
    let (first, last) = (from_z + enter * (to_z - from_z), from_z + leave * (to_z - from_z));
    // Without a branch, and without the care for what is no number that a minimum takes: such a chord compares with nothing.
    ((first <= cylinder.height_m) | (last <= cylinder.height_m)) & ((first >= 0.0) | (last >= 0.0))
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
