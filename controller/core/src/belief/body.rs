//! The body of a user, who stands behind the device.

use heliostat_channel::{Vec3, blockage::Cylinder};
use heliostat_scenario::Blockage;

/// Dimensions of a body, and its distance from the device.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Body {
    radius_m: f64,
    height_m: f64,
    offset_m: f64,
}

impl Body {
    /// The bodies of a scenario; `None` where bodies block no light.
    pub fn new(blockage: &Blockage) -> Option<Self> {
        blockage.bodies.then_some(Self {
            radius_m: blockage.body_radius_m,
            height_m: blockage.body_height_m,
            offset_m: blockage.body_offset_m,
        })
    }

    /// The smallest cylinder that holds the body of a user whose device is here, for every heading.
    pub fn around(&self, device: &Vec3) -> Cylinder {
        let Self { radius_m, height_m, offset_m } = *self;
        Cylinder { x_m: device.x, y_m: device.y, radius_m: radius_m + offset_m, height_m }
    }

    /// The body of a user whose device is here, and who faces this direction (a unit vector).
    pub fn behind(&self, device: &Vec3, heading: &Vec3) -> Cylinder {
        let Self { radius_m, height_m, offset_m } = *self;
        Cylinder { x_m: device.x - offset_m * heading.x, y_m: device.y - offset_m * heading.y, radius_m, height_m }
    }
}
