//! Mechanical and optical angles as different types, and the conversion between degrees and
//! radians.
//!
//! A mirror that turns by one degree turns the reflected ray by two degrees. Data sheets quote
//! either angle, so each has its own type, and the factor is applied here only. A plain `f64` angle
//! of a mirror elsewhere in this crate, for example in
//! [`MirrorAngles`](crate::mirrors::MirrorAngles), is mechanical and in radians.
//!
//! ```
//! use heliostat_channel::{Mechanical, Optical};
//!
//! let range = Optical::from_degrees(20.0);
//! assert!((range.mechanical().degrees() - 10.0).abs() < 1e-12);
//! assert_eq!(Mechanical(0.1).optical(), Optical(0.2));
//! ```

/// Angle by which a mirror turns, in radians.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
pub struct Mechanical(pub f64);

/// Angle by which the reflected ray turns, in radians: optical = 2 mechanical, in the plane of
/// incidence.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
pub struct Optical(pub f64);

impl Mechanical {
    /// Converts a mechanical angle from degrees.
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

    /// The angle by which the reflected ray turns: twice this angle.
    pub fn optical(self) -> Optical {
        Optical(2.0 * self.0)
    }
}

impl Optical {
    /// Converts an optical angle from degrees.
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

    /// The angle by which the mirror turns: half of this angle.
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
