//! The file of readings, from which an interrupted calibration continues.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use heliostat_array::calibration_file::CalibrationFile;
use heliostat_calibrate::{Log, Session};
use heliostat_scenario::Scenario;
use heliostat_service::exit::UnusableInput;
use heliostat_service::whole_file;
use serde::{Deserialize, Serialize};

/// What readings belong to: with another room, array or calibration they would be misread.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Origin {
    scenario: String,
    array: usize,
    base: Option<CalibrationFile>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Saved {
    of: Origin,
    log: Log,
}

/// The file of readings, if one is given.
pub struct Readings<'a> {
    file: Option<&'a Path>,
    of: Origin,
}

impl<'a> Readings<'a> {
    /// The file for readings of this room, and of this array with the calibration that it uses.
    pub fn new(file: Option<&'a Path>, scenario: &Scenario, (array, base): (usize, Option<&CalibrationFile>)) -> Self {
        Self { file, of: Origin { scenario: scenario.hash(), array, base: base.cloned() } }
    }

    /// The readings of the file, if it exists.
    ///
    /// # Errors
    /// A file that holds no readings, or those of another room, array or calibration.
    pub fn load(&self) -> Result<Option<Log>> {
        let Some(file) = self.file.filter(|file| file.exists()) else { return Ok(None) };
        let text = std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
        let unusable = || UnusableInput::new(format!("{} holds no readings of a calibration", file.display()));
        let Saved { of, log } = serde_json::from_str(&text).with_context(unusable)?;
        let name = file.display();
        for (what, is_same) in [
            ("scenario", of.scenario == self.of.scenario),
            ("--array", of.array == self.of.array),
            ("--base", of.base == self.of.base),
        ] {
            ensure!(
                is_same,
                UnusableInput::new(format!(
                    "{name} has readings with another {what}: expected the same, or a new file"
                ))
            );
        }
        Ok(Some(log))
    }

    /// Saves what is known so far: a complete file or the former one, because the process may end at
    /// any time.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn save(&self, session: &Session) -> Result<()> {
        let Some(file) = self.file else { return Ok(()) };
        #[derive(Serialize)]
        struct Saving<'a> {
            of: &'a Origin,
            log: Log,
        }
        whole_file::write(file, &serde_json::to_vec(&Saving { of: &self.of, log: session.log() })?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readings_of_another_room_array_or_calibration_are_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("readings.json");
        let hall = Scenario::builtin("hall").expect("a scenario");
        let lab = Scenario::builtin("lab").expect("a scenario");
        let axis = heliostat_array::calibration_file::AxisCorrections { offset_deg: vec![0.1], gain: vec![1.0] };
        let base = CalibrationFile { rows: 1, columns: 1, roll: axis.clone(), yaw: axis };
        let open = |scenario, array, base| Readings::new(Some(&file), scenario, (array, base));
        assert!(open(&hall, 0, None).load().expect("no file").is_none());
        let saved = Saved { of: open(&hall, 0, None).of, log: Log { mirrors: 100, ..Log::default() } };
        std::fs::write(&file, serde_json::to_vec(&saved).expect("JSON")).expect("a file");
        assert_eq!(open(&hall, 0, None).load().expect("the same").map(|log| log.mirrors), Some(100));
        for (other, what) in [
            (open(&lab, 0, None), "scenario"),
            (open(&hall, 1, None), "--array"),
            (open(&hall, 0, Some(&base)), "--base"),
        ] {
            let refusal = other.load().expect_err(what).to_string();
            assert!(refusal.contains(&format!("another {what}")), "{refusal}");
        }
    }
}
