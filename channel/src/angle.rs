//! Angles whose kind matters: how far a mirror turns, and how far the light turns.
//!
//! A mirror that turns by one degree turns the reflected ray by two. Data sheets quote either, so each has its type here
//! and the factor is applied in one place. Everything in this crate that holds a plain `f64` angle of a mirror (a
//! [`MirrorAngles`](crate::mirrors::MirrorAngles), for one) is mechanical, in radians.

/// Angle by which a mirror is turned, in radians.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
pub struct Mechanical(pub f64);

/// Angle by which a reflected ray is turned, in radians: twice the mechanical angle.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
pub struct Optical(pub f64);

impl Mechanical {
    /// A mechanical angle given in degrees.
    pub fn from_degrees(degrees: f64) -> Self {
        Self(degrees.to_radians())
    }

    /// The angle in radians.
    pub fn radians(self) -> f64 {
        self.0
    }

    /// The angle in degrees.
    pub fn degrees(self) -> f64 {
        self.0.to_degrees()
    }

    /// How far the reflected ray turns.
    pub fn optical(self) -> Optical {
        Optical(2.0 * self.0)
    }
}

impl Optical {
    /// An optical angle given in degrees.
    pub fn from_degrees(degrees: f64) -> Self {
        Self(degrees.to_radians())
    }

    /// The angle in radians.
    pub fn radians(self) -> f64 {
        self.0
    }

    /// The angle in degrees.
    pub fn degrees(self) -> f64 {
        self.0.to_degrees()
    }

    /// How far the mirror turns for it.
    pub fn mechanical(self) -> Mechanical {
        Mechanical(0.5 * self.0)
    }
}

impl From<Mechanical> for Optical {
    fn from(angle: Mechanical) -> Self {
        angle.optical()
    }
}

impl From<Optical> for Mechanical {
    fn from(angle: Optical) -> Self {
        angle.mechanical()
    }
}
