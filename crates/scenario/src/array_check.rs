//! Checks of the mirror arrays: each value against its domain, and the arrays against the walls and
//! each other.

use heliostat_channel::{arrays::ARRAYS_MAX, mirrors::MIRRORS_MAX};

use crate::check::{count, invalid, within};
use crate::error::ScenarioError;
use crate::scenario::Scenario;
use crate::tables::{Mirrors, Wall};

/// Most mirrors in a row or a column, however small they are.
const SIDE_MAX: usize = 1024;
/// Largest width and height of a mirror in m.
const SIZE_MAX_M: f64 = 5.0;

impl Scenario {
    /// The scenario, if it has one mirror array.
    ///
    /// # Errors
    /// [`ScenarioError::SeveralArrays`] for more.
    pub fn require_one_array(self) -> Result<Self, ScenarioError> {
        match self.mirrors.arrays().len() {
            1 => Ok(self),
            count => Err(ScenarioError::SeveralArrays { count }),
        }
    }

    /// The same room with one of its mirror arrays alone, by index from 0.
    ///
    /// # Errors
    /// [`ScenarioError::NoSuchArray`].
    pub fn with_array_alone(&self, index: usize) -> Result<Self, ScenarioError> {
        let count = self.mirrors.arrays().len();
        let mirrors = self.mirrors.alone(index).ok_or(ScenarioError::NoSuchArray { index, count })?;
        Ok(Self { mirrors, ..self.clone() })
    }

    pub(crate) fn check_arrays(&self) -> Result<(), ScenarioError> {
        let arrays = self.mirrors.arrays();
        count("mirrors (arrays)", arrays.len(), 1..=ARRAYS_MAX)?;
        for (index, mirrors) in arrays.iter().enumerate() {
            self.check_array(&self.mirrors.key(index), mirrors)?;
        }
        count("mirrors (of all arrays)", self.mirrors.count(), 1..=MIRRORS_MAX)?;
        for (index, mirrors) in arrays.iter().enumerate() {
            if let Some(other) = arrays[..index].iter().position(|other| overlap(mirrors, other)) {
                let expected = format!(
                    "expected another wall or height, since the array overlaps that of {}: both are at the middle of the wall",
                    self.mirrors.key(other)
                );
                let key = format!("{}.centre_height_m", self.mirrors.key(index));
                return invalid(&key, mirrors.centre_height_m, &expected);
            }
        }
        Ok(())
    }

    fn check_array(&self, table: &str, mirrors: &Mirrors) -> Result<(), ScenarioError> {
        let key = |name: &str| format!("{table}.{name}");
        let ceiling = self.room.height_m;
        let wall = match mirrors.wall {
            Wall::PlusY | Wall::MinusY => self.room.length_x_m,
            Wall::PlusX | Wall::MinusX => self.room.length_y_m,
        };
        within(&key("width_m"), mirrors.width_m, 1e-4..=SIZE_MAX_M.min(wall))?;
        within(&key("height_m"), mirrors.height_m, 1e-4..=SIZE_MAX_M.min(ceiling))?;
        within(&key("gap_m"), mirrors.gap_m, 0.0..=5.0)?;
        within(&key("reflectivity"), mirrors.reflectivity, 0.0..=1.0)?;
        let centres_m = |rows| {
            let half_m = extent(rows, mirrors.height_m, mirrors.gap_m) / 2.0;
            half_m..=ceiling - half_m
        };
        within(&key("centre_height_m"), mirrors.centre_height_m, centres_m(1))?;
        let (columns, rows) = (mirrors.columns, mirrors.rows);
        let is_within_wall = |columns| extent(columns, mirrors.width_m, mirrors.gap_m) <= wall;
        check_side(&key("columns"), columns, is_within_wall, || format!("on its wall of {wall} m"))?;
        let is_within_room = |rows| centres_m(rows).contains(&mirrors.centre_height_m);
        let centre = || format!("between floor and ceiling about the centre at {} m", mirrors.centre_height_m);
        check_side(&key("rows"), rows, is_within_room, centre)?;
        count(&format!("{table}.rows x {table}.columns"), rows * columns, 1..=MIRRORS_MAX)
    }
}

/// Accepts a number of mirrors in a line that fit into a place; a refusal states how many do.
fn check_side(
    key: &str,
    found: usize,
    fits: impl Fn(usize) -> bool,
    place: impl FnOnce() -> String,
) -> Result<(), ScenarioError> {
    if (1..=SIDE_MAX).contains(&found) && fits(found) {
        return Ok(());
    }
    let most = (1..=SIDE_MAX).rev().find(|count| fits(*count)).unwrap_or(1);
    let expected = format!("expected an integer from 1 to {most}: so many mirrors of this size fit {}", place());
    invalid(key, found, &expected)
}

/// Length of so many mirrors in a line, with the gaps between them, in m.
fn extent(count: usize, size_m: f64, gap_m: f64) -> f64 {
    count as f64 * size_m + (count - 1) as f64 * gap_m
}

/// Heights of the lower and the upper edge above the floor in m.
fn heights(mirrors: &Mirrors) -> [f64; 2] {
    let half = extent(mirrors.rows, mirrors.height_m, mirrors.gap_m) / 2.0;
    [mirrors.centre_height_m - half, mirrors.centre_height_m + half]
}

/// Whether two arrays cover the same part of a wall. Every array is at the middle of its wall.
fn overlap(a: &Mirrors, b: &Mirrors) -> bool {
    let ([low_a, high_a], [low_b, high_b]) = (heights(a), heights(b));
    a.wall == b.wall && low_a < high_b && low_b < high_a
}
