//! One mirror array: positions of the mirrors, and normals from roll and yaw.
//!
//! [`MirrorArrays`](crate::MirrorArrays) joins the arrays of a room.
//!
//! Mirror quantities are defined in the *wall frame*: the array is on the wall y = +L/2, and its
//! inward direction is -y. For the three other walls, [`MirrorArray::room_from_wall`] rotates that
//! frame about z.
//!
//! Angles are mechanical and in radians. Yaw phi turns a mirror about z and roll theta tilts it;
//! section II of the paper and its eq. (3) swap the two names. At zero angles a mirror faces
//! straight into the room; at positive roll it faces down.
//!
//! ```
//! use heliostat_channel::{ArraySpec, MirrorArray, Wall};
//!
//! let array = MirrorArray::new(&ArraySpec {
//!     rows: 2,
//!     columns: 3,
//!     mirror_width_m: 0.25,
//!     mirror_height_m: 0.10,
//!     gap_m: 0.02,
//!     centre_height_m: 2.0,
//!     wall: Wall::PlusY,
//!     wall_distance_m: 2.5,
//!     reflectivity: 0.95,
//! })?;
//! assert_eq!(array.len(), 6);
//! let (roll, yaw) = array.angles_of(&array.normal(0.1, -0.2));
//! assert!((roll - 0.1).abs() < 1e-12 && (yaw + 0.2).abs() < 1e-12);
//! # Ok::<(), heliostat_channel::ChannelError>(())
//! ```

use serde::{Deserialize, Serialize};

use crate::domain::{finite, not_negative, positive, require};
use crate::error::ChannelError;
use crate::geometry::Vec3;

/// Largest number of mirrors of an array.
pub const MIRRORS_MAX: usize = heliostat_proto::MAX_MIRRORS;

/// The wall that carries the array.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Wall {
    /// The wall at the largest y.
    #[serde(rename = "+y")]
    PlusY,
    /// The wall at the largest x.
    #[serde(rename = "+x")]
    PlusX,
    /// The wall at the smallest y.
    #[serde(rename = "-y")]
    MinusY,
    /// The wall at the smallest x.
    #[serde(rename = "-x")]
    MinusX,
}

impl Wall {
    /// Cosine and sine of the rotation about z from the wall frame to the room's frame.
    fn rotation(self) -> (f64, f64) {
        match self {
            Self::PlusY => (1.0, 0.0),
            Self::PlusX => (0.0, -1.0),
            Self::MinusY => (-1.0, 0.0),
            Self::MinusX => (0.0, 1.0),
        }
    }
}

/// Dimensions, position and reflectivity of an array.
#[derive(Clone, Debug, PartialEq)]
pub struct ArraySpec {
    /// Number of rows; row 0 is the lowest.
    pub rows: usize,
    /// Number of columns; column 0 is at the smallest x of the wall frame.
    pub columns: usize,
    /// Width w_m of a mirror in m.
    pub mirror_width_m: f64,
    /// Height h_m of a mirror in m.
    pub mirror_height_m: f64,
    /// Gap q_m between neighbouring mirrors in m.
    pub gap_m: f64,
    /// Height of the array's centre above the floor in m.
    pub centre_height_m: f64,
    /// The wall that carries the array.
    pub wall: Wall,
    /// Distance of the wall from the room's centre in m.
    pub wall_distance_m: f64,
    /// Reflection coefficient rho_m, dimensionless, within [0, 1].
    pub reflectivity: f64,
}

impl ArraySpec {
    fn check(&self) -> Result<(), ChannelError> {
        let count = self.rows.saturating_mul(self.columns);
        if count == 0 || count > MIRRORS_MAX {
            return Err(ChannelError::Count { things: "mirrors", count, expected: "1 to 16384" });
        }
        positive("width of a mirror in m", self.mirror_width_m)?;
        positive("height of a mirror in m", self.mirror_height_m)?;
        not_negative("gap between mirrors in m", self.gap_m)?;
        finite("height of the array's centre in m", self.centre_height_m)?;
        positive("distance of the mirror wall from the room's centre in m", self.wall_distance_m)?;
        require((0.0..=1.0).contains(&self.reflectivity), "reflectivity", self.reflectivity, "a number from 0 to 1")?;
        Ok(())
    }
}

/// Roll and yaw of each mirror: mechanical, in radians, in index order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MirrorAngles {
    /// Roll (tilt) of each mirror; at positive roll a mirror faces down. Shape: M.
    pub roll: Vec<f64>,
    /// Yaw of each mirror, about the vertical. Shape: M.
    pub yaw: Vec<f64>,
}

impl MirrorAngles {
    /// Zero angles: every mirror faces straight into the room.
    pub fn flat(mirrors: usize) -> Self {
        Self { roll: vec![0.0; mirrors], yaw: vec![0.0; mirrors] }
    }

    /// Takes other angles. Does not allocate.
    ///
    /// # Panics
    /// If the number of mirrors differs.
    pub fn copy_from(&mut self, other: &Self) {
        self.roll.copy_from_slice(&other.roll);
        self.yaw.copy_from_slice(&other.yaw);
    }

    /// Roll of each mirror, then yaw of each. Shape: 2 M.
    pub fn axes(&self) -> impl Iterator<Item = &f64> {
        self.roll.iter().chain(&self.yaw)
    }

    /// The mutable form of [`axes`](Self::axes).
    pub fn axes_mut(&mut self) -> impl Iterator<Item = &mut f64> {
        self.roll.iter_mut().chain(&mut self.yaw)
    }

    /// Number of mirrors M.
    pub fn len(&self) -> usize {
        self.roll.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.roll.is_empty()
    }
}

/// Copies angles that are 32-bit floats in a message or in the output of a network.
pub fn copy_widened(from: &[f32], to: &mut [f64]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = f64::from(*from);
    }
}

/// A mirror array on one wall, with the position of each mirror.
#[derive(Clone, Debug, PartialEq)]
pub struct MirrorArray {
    spec: ArraySpec,
    positions: Vec<Vec3>,
}

impl MirrorArray {
    /// Computes the position of each mirror; index = row * columns + column.
    ///
    /// Row 0 is the lowest. Column 0 is at the smallest x of the wall frame. In the room's frame
    /// that is the smallest x on the +y wall, the largest y on +x, the largest x on -y, and the
    /// smallest y on -x.
    ///
    /// # Errors
    /// [`ChannelError`] for no mirrors, for more than [`MIRRORS_MAX`], or for a value outside its
    /// domain.
    pub fn new(spec: &ArraySpec) -> Result<Self, ChannelError> {
        spec.check()?;
        let (pitch_x, pitch_z) = (spec.mirror_width_m + spec.gap_m, spec.mirror_height_m + spec.gap_m);
        let mut array = Self { spec: spec.clone(), positions: Vec::with_capacity(spec.rows * spec.columns) };
        for row in 0..spec.rows {
            for column in 0..spec.columns {
                let x = (column as f64 - 0.5 * (spec.columns - 1) as f64) * pitch_x;
                let z = spec.centre_height_m + (row as f64 - 0.5 * (spec.rows - 1) as f64) * pitch_z;
                let position = array.room_from_wall(&Vec3::new(x, spec.wall_distance_m, z));
                array.positions.push(position);
            }
        }
        Ok(array)
    }

    /// Dimensions, position and reflectivity.
    pub fn spec(&self) -> &ArraySpec {
        &self.spec
    }

    /// Number of mirrors M.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Always false, as an array has at least one mirror.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.spec.rows
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.spec.columns
    }

    /// Centre of each mirror in the room's frame, in m. Shape: M.
    pub fn positions(&self) -> &[Vec3] {
        &self.positions
    }

    /// Area dA_m of one mirror in m2.
    pub fn mirror_area_m2(&self) -> f64 {
        self.spec.mirror_width_m * self.spec.mirror_height_m
    }

    /// Unit vector from the wall into the room.
    pub fn inward(&self) -> Vec3 {
        self.room_from_wall(&-Vec3::y())
    }

    /// Rotates a vector or a point from the wall frame to the room's frame; both have the centre of
    /// the floor as origin.
    pub fn room_from_wall(&self, v: &Vec3) -> Vec3 {
        let (cos, sin) = self.rotation();
        Vec3::new(cos * v.x - sin * v.y, sin * v.x + cos * v.y, v.z)
    }

    /// Rotates a vector or a point from the room's frame to the wall frame: the inverse of
    /// [`MirrorArray::room_from_wall`].
    pub fn wall_from_room(&self, v: &Vec3) -> Vec3 {
        let (cos, sin) = self.rotation();
        Vec3::new(cos * v.x + sin * v.y, cos * v.y - sin * v.x, v.z)
    }

    /// Inward unit normal of a mirror at these angles, in the room's frame.
    ///
    /// n = -(sin yaw cos roll, cos yaw cos roll, sin roll) in the wall frame, for any angles in
    /// radians.
    ///
    /// Source: paper eq. (3), whose right-hand side is the dot product of n and the direction from
    /// the mirror to the user.
    pub fn normal(&self, roll: f64, yaw: f64) -> Vec3 {
        let (sin_roll, cos_roll) = roll.sin_cos();
        let (sin_yaw, cos_yaw) = yaw.sin_cos();
        self.room_from_wall(&-Vec3::new(sin_yaw * cos_roll, cos_yaw * cos_roll, sin_roll))
    }

    /// Roll and yaw in radians that give an inward normal.
    ///
    /// yaw = atan(n_x / n_y), roll = atan(-n_z / hypot(n_x, n_y)) in the wall frame. This is the
    /// inverse of [`MirrorArray::normal`] for a normal that points into the room, that is for a yaw
    /// strictly within 90 degrees. The normal may have any length above 0. A vertical normal gives
    /// yaw 0.
    pub fn angles_of(&self, normal: &Vec3) -> (f64, f64) {
        let n = self.wall_from_room(normal);
        let yaw = if n.x == 0.0 { 0.0 } else { (n.x / n.y).atan() };
        let roll = (-n.z).atan2(n.x.hypot(n.y));
        (roll, yaw)
    }

    pub(crate) fn rotation(&self) -> (f64, f64) {
        self.spec.wall.rotation()
    }
}
