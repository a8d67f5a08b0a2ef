//! The speeds of users who walk.

use thiserror::Error;

use crate::random::{self, RoomRng};

/// Why a walk cannot be made.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum MobilityError {
    /// At zero speed a segment never ends: the minimum must be positive, or both speeds zero.
    #[error(
        "invalid speeds {min} to {max} m/s: expected a minimum above 0 and at most the maximum, \
         or both 0 for users who stand still"
    )]
    Speed {
        /// Minimum speed in m/s.
        min: f64,
        /// Maximum speed in m/s.
        max: f64,
    },
}

/// The speeds of the segments, uniform between two bounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Speeds {
    min: f64,
    max: f64,
}

impl Speeds {
    /// Speeds from `min` to `max` in m/s; with both 0 all users stand still.
    ///
    /// # Errors
    /// [`MobilityError::Speed`] for a negative, zero, infinite or inverted pair.
    pub fn new(min: f64, max: f64) -> Result<Self, MobilityError> {
        let standing = min == 0.0 && max == 0.0;
        if standing || (min > 0.0 && min <= max && max.is_finite()) {
            Ok(Self { min, max })
        } else {
            Err(MobilityError::Speed { min, max })
        }
    }

    /// Minimum and maximum in m/s.
    pub fn bounds_m_s(&self) -> [f64; 2] {
        [self.min, self.max]
    }

    /// Whether all users stand still.
    pub fn are_zero(&self) -> bool {
        self.max == 0.0
    }

    pub(super) fn draw(&self, rng: &mut RoomRng) -> f64 {
        random::uniform_in(rng, self.min, self.max)
    }

    /// The speed of the segment that is under way at a random time.
    ///
    /// A segment lasts in proportion to 1/v, so the density is uniform times 1/v.
    pub(super) fn draw_under_way(&self, rng: &mut RoomRng) -> f64 {
        loop {
            let speed = self.draw(rng);
            if random::uniform(rng) * speed <= self.min {
                return speed;
            }
        }
    }
}
