//! The file that holds a calibration between its making and its use: TOML, one entry a mirror in index order.
//!
//! ```toml
//! rows = 1
//! columns = 2
//!
//! [roll]                       # the drive is told gain * angle + offset
//! offset_deg = [0.52, -0.1]
//! gain = [1.0, 1.0]
//!
//! [yaw]
//! offset_deg = [0.0, 0.25]
//! gain = [1.0, 0.99]
//! ```

use std::path::Path;

use anyhow::{Context, Result, ensure};
use heliostat_proto::{Calibration, Stamp};
use serde::{Deserialize, Serialize};

/// Corrections of every mirror of an array.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationFile {
    /// Rows of the array.
    pub rows: usize,
    /// Columns of the array.
    pub columns: usize,
    /// Of the roll axes.
    pub roll: AxisCorrections,
    /// Of the yaw axes.
    pub yaw: AxisCorrections,
}

/// Corrections of one axis of every mirror: the drive is told gain * angle + offset. Shape of both: M.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxisCorrections {
    /// Mechanical, in degrees.
    pub offset_deg: Vec<f64>,
    /// Dimensionless.
    pub gain: Vec<f64>,
}

impl AxisCorrections {
    /// Corrections that change nothing.
    pub fn none(mirrors: usize) -> Self {
        Self { offset_deg: vec![0.0; mirrors], gain: vec![1.0; mirrors] }
    }
}

impl CalibrationFile {
    /// Reads a file.
    ///
    /// # Errors
    /// A file that cannot be read, a key that is unknown, missing or of another type, a list that is not as long as the array has mirrors.
    pub fn load(file: &Path) -> Result<Self> {
        let in_file = || format!("in {}", file.display());
        let text = std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
        let read: Self = toml::from_str(&text).with_context(in_file)?;
        read.check().with_context(in_file)?;
        Ok(read)
    }

    fn check(&self) -> Result<()> {
        let mirrors = self.rows * self.columns;
        for (axis, AxisCorrections { offset_deg, gain }) in [("roll", &self.roll), ("yaw", &self.yaw)] {
            for (list, values) in [("offset_deg", offset_deg), ("gain", gain)] {
                let found = values.len();
                ensure!(found == mirrors, "{axis}.{list} has {found} entries; wanted {mirrors}, one a mirror");
                ensure!(values.iter().all(|value| value.is_finite()), "{axis}.{list} has an entry that is not finite");
            }
        }
        Ok(())
    }

    /// Writes the file.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn save(&self, file: &Path) -> Result<()> {
        let text = toml::to_string(self).context("a calibration has a TOML form")?;
        std::fs::write(file, text).with_context(|| format!("cannot write {}", file.display()))
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
    fn a_file_reads_back_and_lists_must_fit_the_array() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("wall.toml");
        let mut written = CalibrationFile {
            rows: 1,
            columns: 2,
            roll: AxisCorrections { offset_deg: vec![90.0, -0.25], gain: vec![1.0, 1.01] },
            yaw: AxisCorrections::none(2),
        };
        written.save(&file).unwrap();
        let read = CalibrationFile::load(&file).unwrap();
        assert_eq!(read, written);
        let message = read.message(Stamp::default());
        assert!(
            (message.roll_offset_rad[0] - std::f32::consts::FRAC_PI_2).abs() < 1e-6 && message.roll_gain[1] == 1.01
        );
        written.yaw.gain.pop();
        written.save(&file).unwrap();
        let refusal = format!("{:#}", CalibrationFile::load(&file).unwrap_err());
        assert!(refusal.contains("wall.toml") && refusal.contains("yaw.gain has 1 entries; wanted 2"), "{refusal}");
    }
}
