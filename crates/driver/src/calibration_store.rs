//! Calibration files on disk.

use std::path::Path;

use anyhow::{Context, Result};
use heliostat_array::calibration_file::CalibrationFile;
use heliostat_files::read_text;
use heliostat_service::whole_file;

/// Reads a calibration file.
///
/// # Errors
/// A file that cannot be read, or is not a calibration.
pub fn load(file: &Path) -> Result<CalibrationFile> {
    let text = read_text(file).with_context(|| format!("cannot read {}", file.display()))?;
    CalibrationFile::parse(&text).with_context(|| format!("in {}", file.display()))
}

/// Writes a calibration file.
///
/// # Errors
/// A file that cannot be written.
pub fn save(calibration: &CalibrationFile, file: &Path) -> Result<()> {
    whole_file::write(file, calibration.to_toml().as_bytes())
}
