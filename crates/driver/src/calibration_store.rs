//! Calibration files on disk.

use std::path::Path;

use anyhow::{Context, Result};
use heliostat_array::calibration_file::CalibrationFile;
use heliostat_service::{input, whole_file};

/// Reads a calibration file.
///
/// # Errors
/// A file that cannot be read, or is not a calibration.
pub fn load(file: &Path) -> Result<CalibrationFile> {
    let text = input::read(file)?;
    CalibrationFile::parse(&text).with_context(|| {
        format!(
            "in {}: expected a calibration of mirrors, as `heliostat calibrate --out FILE` writes it",
            file.display()
        )
    })
}

/// Writes a calibration file.
///
/// # Errors
/// A file that cannot be written.
pub fn save(calibration: &CalibrationFile, file: &Path) -> Result<()> {
    whole_file::write(file, calibration.to_toml().as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_of_another_kind_is_refused_with_what_is_expected() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("room.toml");
        std::fs::write(&file, "name = \"hall\"\n").expect("written");
        let refusal = format!("{:#}", load(&file).expect_err("a scenario"));
        assert!(refusal.contains("room.toml: expected a calibration of mirrors, as `heliostat calibrate"), "{refusal}");
        assert!(refusal.contains("unknown field `name`"), "{refusal}");
    }
}
