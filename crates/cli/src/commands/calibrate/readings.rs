//! The file of readings, from which an interrupted calibration continues.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use heliostat_array::calibration_file::CalibrationFile;
use heliostat_calibrate::{Log, Session};
use heliostat_proto::Room;
use heliostat_scenario::Scenario;
use heliostat_service::exit::UnusableInput;
use heliostat_service::{input, whole_file};
use serde::{Deserialize, Serialize};

/// What readings belong to: with another room, array or calibration they would be misread.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Origin {
    room: String,
    scenario: String,
    array: usize,
    /// As text, because numbers may be rounded on their way through JSON.
    base: Option<String>,
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
    pub fn new(
        file: Option<&'a Path>,
        (room, scenario): (&Room, &Scenario),
        (array, base): (usize, Option<&CalibrationFile>),
    ) -> Self {
        // A recorded walk is that of simulated users, and its path depends on the folder of the command.
        let mut described = scenario.clone();
        described.users.trace = None;
        let (room, scenario, base) = (room.to_string(), described.hash(), base.map(CalibrationFile::to_toml));
        Self { file, of: Origin { room, scenario, array, base } }
    }

    /// The readings of a complete calibration of the same room and array, and the calibration that the
    /// array used meanwhile.
    ///
    /// # Errors
    /// A file that holds no readings, or those of another room or array.
    pub fn load_former(&self, file: &Path) -> Result<(Log, Option<CalibrationFile>)> {
        let Saved { of, log } = read(file)?;
        let base = of.base.as_deref().map(CalibrationFile::parse).transpose();
        let base = base.with_context(|| UnusableInput::new(format!("in {}", file.display())))?;
        self.check(file, &Origin { base: self.of.base.clone(), ..of })?;
        Ok((log, base))
    }

    /// The readings of the file, if it exists.
    ///
    /// # Errors
    /// A file that holds no readings, or those of another room, array or calibration.
    pub fn load(&self) -> Result<Option<Log>> {
        let Some(file) = self.file.filter(|file| file.exists()) else { return Ok(None) };
        let Saved { of, log } = read(file)?;
        self.check(file, &of)?;
        Ok(Some(log))
    }

    /// The context of an error about what the file holds.
    pub fn unusable(&self) -> UnusableInput {
        let name = self.file.unwrap_or(Path::new("--readings")).display();
        UnusableInput::new(format!(
            "{name} cannot be continued; correct it, name another file, or remove it to begin again"
        ))
    }

    fn check(&self, file: &Path, of: &Origin) -> Result<()> {
        let name = file.display();
        for (what, is_same) in [
            ("--room", of.room == self.of.room),
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
        Ok(())
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

fn read(file: &Path) -> Result<Saved> {
    let text = input::read(file)?;
    let unusable = || {
        UnusableInput::new(format!(
            "{} holds no readings of a calibration: name another file, or remove it to begin again",
            file.display()
        ))
    };
    serde_json::from_str(&text).with_context(unusable)
}

#[cfg(test)]
mod tests {
    use heliostat_array::calibration_file::AxisCorrections;

    use super::*;

    #[test]
    fn readings_of_another_room_array_or_calibration_are_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("readings.json");
        let hall = Scenario::builtin("hall").expect("a scenario");
        let lab = Scenario::builtin("lab").expect("a scenario");
        let axis = AxisCorrections { offset_deg: vec![0.1], gain: vec![1.0] };
        let base = CalibrationFile { rows: 1, columns: 1, roll: axis.clone(), yaw: axis };
        let digits = [0.123_456_789_012_345_67, 0.1 + 0.2, 1.0 / 3.0, 2.0 / 7.0].map(|offset| 1.7 * offset);
        let axis = AxisCorrections { offset_deg: digits.to_vec(), gain: digits.map(|digit| 1.0 / digit).to_vec() };
        let precise = CalibrationFile { rows: 2, columns: 2, roll: axis.clone(), yaw: axis };
        let rooms = ["hall", "north"].map(|name| Room::new(name).expect("a room"));
        let open = |scenario, array, base| Readings::new(Some(&file), (&rooms[0], scenario), (array, base));
        std::fs::write(
            &file,
            serde_json::to_vec(&Saved { of: open(&hall, 0, Some(&precise)).of, log: Log::default() }).expect("JSON"),
        )
        .expect("a file");
        assert!(open(&hall, 0, Some(&precise)).load().expect("the same to the last digit").is_some());
        std::fs::remove_file(&file).expect("a file");
        assert!(open(&hall, 0, None).load().expect("no file").is_none());
        let saved = Saved { of: open(&hall, 0, None).of, log: Log { mirrors: 100, ..Log::default() } };
        std::fs::write(&file, serde_json::to_vec(&saved).expect("JSON")).expect("a file");
        assert_eq!(open(&hall, 0, None).load().expect("the same").map(|log| log.mirrors), Some(100));
        let walked = hall.with_overrides(&["users.trace=../walk.csv"]).expect("a scenario");
        assert!(open(&walked, 0, None).load().expect("the same room from another folder").is_some());
        for (other, what) in [
            (open(&lab, 0, None), "scenario"),
            (open(&hall, 1, None), "--array"),
            (open(&hall, 0, Some(&base)), "--base"),
        ] {
            let refusal = other.load().expect_err(what).to_string();
            assert!(refusal.contains(&format!("another {what}")), "{refusal}");
        }
        let elsewhere = Readings::new(Some(&file), (&rooms[1], &hall), (0, None)).load().expect_err("another room");
        assert!(elsewhere.to_string().contains("another --room"), "{elsewhere}");
    }
}
