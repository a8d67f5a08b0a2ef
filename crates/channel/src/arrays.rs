//! All mirrors of a room: one array or several, on any walls, with one index space.
//!
//! The mirrors of the first array come first, then those of the second, and so on. Within an array
//! the order is that of [`MirrorArray::new`]. Tables over mirrors, angles and commands use this index.
//! Light that meets two mirrors in turn is not modelled.
//!
//! ```
//! use heliostat_channel::{ArraySpec, MirrorArray, MirrorArrays, Wall};
//!
//! let spec = |wall| ArraySpec {
//!     rows: 2,
//!     columns: 3,
//!     mirror_width_m: 0.25,
//!     mirror_height_m: 0.10,
//!     gap_m: 0.02,
//!     centre_height_m: 2.0,
//!     wall,
//!     wall_distance_m: 2.5,
//!     reflectivity: 0.95,
//! };
//! let mirrors = MirrorArrays::new(vec![MirrorArray::new(&spec(Wall::PlusY))?, MirrorArray::new(&spec(Wall::MinusX))?])?;
//! assert_eq!(mirrors.len(), 12);
//! assert_eq!(mirrors.range(1), 6..12);
//! assert!(mirrors.positions()[7].x == -2.5);
//! # Ok::<(), heliostat_channel::ChannelError>(())
//! ```

use std::ops::Range;

use crate::error::ChannelError;
use crate::geometry::Vec3;
use crate::mirrors::{MIRRORS_MAX, MirrorArray};
use crate::trig::{Lanes, in_blocks};

/// Largest number of mirror arrays of a room.
pub const ARRAYS_MAX: usize = heliostat_proto::MAX_ARRAYS;

/// The mirror arrays of a room, with the position and the array of each mirror.
#[derive(Clone, Debug, PartialEq)]
pub struct MirrorArrays {
    arrays: Vec<MirrorArray>,
    /// Index of the first mirror of each array.
    firsts: Vec<usize>,
    /// Index of the first column of each array, counted over all arrays.
    column_firsts: Vec<usize>,
    /// Index of the array of each mirror. Shape: M.
    owners: Vec<usize>,
    /// Shape: M.
    positions: Vec<Vec3>,
    /// The same positions, as x, y and z in blocks of mirrors.
    blocks: [Vec<Lanes>; 3],
    /// One per block of mirrors.
    surfaces: Vec<Surfaces>,
}

/// Wall, size and reflectivity of each mirror of a block.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Surfaces {
    /// Cosine of the rotation from the wall frame to the room's frame.
    pub wall_cos: Lanes,
    /// Sine of that rotation.
    pub wall_sin: Lanes,
    /// Half of the width in m.
    pub half_width: Lanes,
    /// Half of the height in m.
    pub half_height: Lanes,
    /// Reflection coefficient rho_m, dimensionless.
    pub reflectivity: Lanes,
}

impl From<MirrorArray> for MirrorArrays {
    fn from(array: MirrorArray) -> Self {
        Self::of(vec![array])
    }
}

impl MirrorArrays {
    /// Joins arrays into one index space, in this order.
    ///
    /// # Errors
    /// [`ChannelError::Count`] for no array, for more than [`ARRAYS_MAX`], and for more than
    /// [`MIRRORS_MAX`] mirrors together.
    pub fn new(arrays: Vec<MirrorArray>) -> Result<Self, ChannelError> {
        if arrays.is_empty() || arrays.len() > ARRAYS_MAX {
            return Err(ChannelError::Count { things: "mirror arrays", count: arrays.len(), expected: "1 to 16" });
        }
        let count = arrays.iter().map(MirrorArray::len).sum();
        if count > MIRRORS_MAX {
            return Err(ChannelError::Count { things: "mirrors", count, expected: "1 to 16384" });
        }
        Ok(Self::of(arrays))
    }

    fn of(arrays: Vec<MirrorArray>) -> Self {
        let positions: Vec<Vec3> = arrays.iter().flat_map(|array| array.positions().iter().copied()).collect();
        let owners = arrays.iter().enumerate().flat_map(|(index, array)| std::iter::repeat_n(index, array.len()));
        let owners: Vec<usize> = owners.collect();
        let blocks_of =
            |value: &dyn Fn(&MirrorArray) -> f64| in_blocks(owners.iter().map(|owner| value(&arrays[*owner])));
        let (cos, sin) = (blocks_of(&|array| array.rotation().0), blocks_of(&|array| array.rotation().1));
        let half_width = blocks_of(&|array| 0.5 * array.spec().mirror_width_m);
        let half_height = blocks_of(&|array| 0.5 * array.spec().mirror_height_m);
        let reflectivity = blocks_of(&|array| array.spec().reflectivity);
        let surfaces = |block: usize| Surfaces {
            wall_cos: cos[block],
            wall_sin: sin[block],
            half_width: half_width[block],
            half_height: half_height[block],
            reflectivity: reflectivity[block],
        };
        Self {
            firsts: firsts(arrays.iter().map(MirrorArray::len)),
            column_firsts: firsts(arrays.iter().map(MirrorArray::columns)),
            blocks: [0, 1, 2].map(|axis| in_blocks(positions.iter().map(|position| position[axis]))),
            surfaces: (0..cos.len()).map(surfaces).collect(),
            positions,
            owners,
            arrays,
        }
    }

    /// The arrays, in the order of their mirrors.
    pub fn arrays(&self) -> &[MirrorArray] {
        &self.arrays
    }

    /// Number of mirrors M of all arrays.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Always false, as a room has at least one mirror.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Rows and columns of a table of all mirrors in index order: those of the only array, or one row
    /// for several arrays.
    pub fn grid(&self) -> (usize, usize) {
        match self.arrays.as_slice() {
            [array] => (array.rows(), array.columns()),
            _ => (1, self.len()),
        }
    }

    /// Number of columns of all arrays together.
    pub fn columns(&self) -> usize {
        self.arrays.iter().map(MirrorArray::columns).sum()
    }

    /// Indices of the mirrors of one array.
    ///
    /// # Panics
    /// When there is no such array.
    pub fn range(&self, array: usize) -> Range<usize> {
        self.firsts[array]..self.firsts[array] + self.arrays[array].len()
    }

    /// Each array with the indices of its mirrors.
    pub fn ranges(&self) -> impl Iterator<Item = (&MirrorArray, Range<usize>)> {
        self.arrays.iter().enumerate().map(|(index, array)| (array, self.range(index)))
    }

    /// Each array with the indices of its columns, counted over all arrays.
    pub fn column_ranges(&self) -> impl Iterator<Item = (&MirrorArray, Range<usize>)> {
        self.arrays.iter().zip(&self.column_firsts).map(|(array, first)| (array, *first..*first + array.columns()))
    }

    /// The array that holds a mirror.
    ///
    /// # Panics
    /// When there is no such mirror.
    #[inline(always)]
    pub fn array_of(&self, mirror: usize) -> &MirrorArray {
        &self.arrays[self.owners[mirror]]
    }

    /// Centre of each mirror in the room's frame, in m. Shape: M.
    pub fn positions(&self) -> &[Vec3] {
        &self.positions
    }

    /// Roll and yaw in radians that give a mirror this inward normal; see
    /// [`MirrorArray::angles_of`].
    ///
    /// # Panics
    /// When there is no such mirror.
    pub fn angles_of(&self, mirror: usize, normal: &Vec3) -> (f64, f64) {
        self.array_of(mirror).angles_of(normal)
    }

    /// Inward unit normal of a mirror at these angles in radians; see [`MirrorArray::normal`].
    ///
    /// # Panics
    /// When there is no such mirror.
    pub fn normal(&self, mirror: usize, (roll, yaw): (f64, f64)) -> Vec3 {
        self.array_of(mirror).normal(roll, yaw)
    }

    /// Reflection coefficient rho_m of a mirror, dimensionless.
    ///
    /// # Panics
    /// When there is no such mirror.
    #[inline(always)]
    pub fn reflectivity(&self, mirror: usize) -> f64 {
        self.array_of(mirror).spec().reflectivity
    }

    /// x, y and z of a block of mirrors in m; lanes past the last mirror repeat it.
    #[inline(always)]
    pub(crate) fn block(&self, index: usize) -> [&Lanes; 3] {
        [&self.blocks[0][index], &self.blocks[1][index], &self.blocks[2][index]]
    }

    /// Walls, sizes and reflectivities of a block of mirrors.
    #[inline(always)]
    pub(crate) fn surfaces(&self, index: usize) -> &Surfaces {
        &self.surfaces[index]
    }
}

/// The sum of all earlier counts, for each count.
fn firsts(counts: impl Iterator<Item = usize>) -> Vec<usize> {
    let mut next = 0;
    counts
        .map(|count| {
            next += count;
            next - count
        })
        .collect()
}
