//! The file format of a calibration: TOML, one entry per mirror in index order.
//!
//! ```toml
//! rows = 1
//! columns = 2
//!
//! [roll]                       # drive angle = gain * angle + offset
//! offset_deg = [0.52, -0.1]
//! gain = [1.0, 1.0]
//!
//! [yaw]
//! offset_deg = [0.0, 0.25]
//! gain = [1.0, 0.99]
//! ```

use heliostat_files::{TomlError, from_toml};
use heliostat_proto::{Calibration, Capabilities, Stamp};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Why a text is not a calibration.
#[derive(Debug, Error)]
pub enum CalibrationFileError {
    /// A key is unknown, missing or of another type.
    #[error(transparent)]
    Toml(#[from] TomlError),
    /// The length of a list is not the number of mirrors.
    #[error("{list} has a length of {found}: expected {expected}, one entry per mirror")]
    Length {
        /// The list, for example `roll.gain`.
        list: String,
        /// Its entries.
        found: usize,
        /// The array's mirrors.
        expected: usize,
    },
    /// A list holds a value that is not a finite number.
    #[error("{list} has an entry that is not finite: expected a number")]
    NotFinite {
        /// The list.
        list: String,
    },
    /// The file is for an array of another shape.
    #[error(
        "{} x {} mirrors: expected {} x {} mirrors, as the array announces",
        .found[0], .found[1], .expected[0], .expected[1]
    )]
    Shape {
        /// Rows and columns of the file.
        found: [usize; 2],
        /// Those of the array.
        expected: [usize; 2],
    },
}

/// The corrections of every mirror of an array.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationFile {
    /// Rows of the array.
    pub rows: usize,
    /// Columns of the array.
    pub columns: usize,
    /// Corrections of the roll axes.
    pub roll: AxisCorrections,
    /// Corrections of the yaw axes.
    pub yaw: AxisCorrections,
}

/// Corrections of one axis of every mirror: drive angle = gain * angle + offset. Shape of both: M.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxisCorrections {
    /// Mechanical offsets in degrees.
    pub offset_deg: Vec<f64>,
    /// Gains, dimensionless.
    pub gain: Vec<f64>,
}

impl AxisCorrections {
    /// Corrections that change nothing.
    pub fn none(mirrors: usize) -> Self {
        Self { offset_deg: vec![0.0; mirrors], gain: vec![1.0; mirrors] }
    }
}

impl CalibrationFile {
    /// Reads a calibration from its TOML text.
    ///
    /// # Errors
    /// [`CalibrationFileError`] for a key that is unknown, missing or of another type, and for a
    /// list that does not fit the array.
    pub fn parse(text: &str) -> Result<Self, CalibrationFileError> {
        let read: Self = from_toml(text)?;
        read.check()?;
        Ok(read)
    }

    fn check(&self) -> Result<(), CalibrationFileError> {
        // A number that saturates is longer than any list.
        let expected = self.rows.saturating_mul(self.columns);
        for (axis, AxisCorrections { offset_deg, gain }) in [("roll", &self.roll), ("yaw", &self.yaw)] {
            for (name, values) in [("offset_deg", offset_deg), ("gain", gain)] {
                let (list, found) = (format!("{axis}.{name}"), values.len());
                if found != expected {
                    return Err(CalibrationFileError::Length { list, found, expected });
                }
                if !values.iter().all(|value| value.is_finite()) {
                    return Err(CalibrationFileError::NotFinite { list });
                }
            }
        }
        Ok(())
    }

    /// Checks that the file is for an array of this shape.
    ///
    /// # Errors
    /// [`CalibrationFileError::Shape`].
    pub fn check_array(&self, array: &Capabilities) -> Result<(), CalibrationFileError> {
        let (found, expected) = ([self.rows, self.columns], [array.rows as usize, array.columns as usize]);
        if found == expected { Ok(()) } else { Err(CalibrationFileError::Shape { found, expected }) }
    }

    /// The TOML text of the calibration.
    ///
    /// # Panics
    /// Never: every calibration can be written as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("numbers and lists of numbers can be written as TOML")
    }

    /// The corrections that have the effect of these, and then of those that a driver used while these
    /// were measured.
    ///
    /// drive angle = gain' (gain angle + offset) + offset', with the former driver's gain' and offset'.
    pub fn after(&self, former: &Self) -> Self {
        self.joined(former, |[offset, gain], [former_offset, former_gain]| {
            (former_gain * offset + former_offset, former_gain * gain)
        })
    }

    /// The corrections of an angle by which a driver that uses these turns a mirror as one that uses
    /// `other` turns it without: gain (gain' angle + offset') + offset is the drive angle of `other`.
    pub fn in_place_of(&self, other: &Self) -> Self {
        self.joined(other, |[offset, gain], [other_offset, other_gain]| {
            ((other_offset - offset) / gain, other_gain / gain)
        })
    }

    /// The offset and gain that `join` makes of those of this file and of `other`, for every axis.
    fn joined(&self, other: &Self, join: impl Fn([f64; 2], [f64; 2]) -> (f64, f64)) -> Self {
        let axis = |own: &AxisCorrections, other: &AxisCorrections| {
            let pairs = own.offset_deg.iter().zip(&own.gain).zip(other.offset_deg.iter().zip(&other.gain));
            let joined = pairs.map(|((a, b), (c, d))| join([*a, *b], [*c, *d]));
            let (offset_deg, gain) = joined.unzip();
            AxisCorrections { offset_deg, gain }
        };
        Self { roll: axis(&self.roll, &other.roll), yaw: axis(&self.yaw, &other.yaw), ..*self }
    }

    /// The message with the same meaning.
    pub fn message(&self, stamp: Stamp) -> Calibration {
        let radians = |list: &[f64]| list.iter().map(|value| value.to_radians() as f32).collect();
        let plain = |list: &[f64]| list.iter().map(|value| *value as f32).collect();
        Calibration {
            stamp,
            roll_offset_rad: radians(&self.roll.offset_deg),
            roll_gain: plain(&self.roll.gain),
            yaw_offset_rad: radians(&self.yaw.offset_deg),
            yaw_gain: plain(&self.yaw.gain),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joined_corrections_are_those_of_one_after_the_other() {
        let file = |offset_deg: f64, gain: f64| {
            let axis = AxisCorrections { offset_deg: vec![offset_deg], gain: vec![gain] };
            CalibrationFile { rows: 1, columns: 1, roll: axis.clone(), yaw: axis }
        };
        let (own, former) = (file(0.5, 1.1), file(-0.2, 0.9));
        let joined = own.after(&former);
        let between = former.in_place_of(&joined);
        let turn = |file: &CalibrationFile, angle: f64| file.yaw.gain[0] * angle + file.yaw.offset_deg[0];
        for angle in [-10.0, 0.0, 7.0] {
            assert!((turn(&joined, angle) - turn(&former, turn(&own, angle))).abs() < 1e-12);
            assert!((turn(&between, angle) - turn(&own, angle)).abs() < 1e-12);
        }
    }

    #[test]
    fn a_file_of_another_shape_names_both_shapes() {
        let axis = AxisCorrections::none(6);
        let file = CalibrationFile { rows: 2, columns: 3, roll: axis.clone(), yaw: axis };
        let array = |rows, columns| Capabilities { rows, columns, ..Capabilities::default() };
        assert!(file.check_array(&array(2, 3)).is_ok());
        let difference = file.check_array(&array(3, 2)).unwrap_err().to_string();
        assert_eq!(difference, "2 x 3 mirrors: expected 3 x 2 mirrors, as the array announces");
    }

    #[test]
    fn a_written_file_can_be_read_and_its_lists_must_fit_the_array() {
        let mut written = CalibrationFile {
            rows: 1,
            columns: 2,
            roll: AxisCorrections { offset_deg: vec![90.0, -0.25], gain: vec![1.0, 1.01] },
            yaw: AxisCorrections::none(2),
        };
        let read = CalibrationFile::parse(&written.to_toml()).unwrap();
        assert_eq!(read, written);
        let message = read.message(Stamp::default());
        assert!(
            (message.roll_offset_rad[0] - std::f32::consts::FRAC_PI_2).abs() < 1e-6 && message.roll_gain[1] == 1.01
        );
        written.yaw.gain.pop();
        let refusal = CalibrationFile::parse(&written.to_toml()).unwrap_err().to_string();
        assert_eq!(refusal, "yaw.gain has a length of 1: expected 2, one entry per mirror");
    }
}
