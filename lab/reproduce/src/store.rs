//! Finished parts on disk: one JSON file each, named by the key of the part, written to a temporary
//! file and renamed.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use heliostat_service::whole_file;
use serde::{Deserialize, Serialize};

use crate::machine;
use crate::part::{Measured, Part};

/// A finished part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finished {
    /// Its origin.
    pub origin: Origin,
    /// Its results.
    pub measured: Measured,
}

/// The origin of a part.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// The figure it belongs to.
    pub figure: String,
    /// The room's name.
    pub room: String,
    /// The name of the part.
    pub name: String,
    /// Its seed.
    pub seed: u64,
    /// When it was finished, in UTC.
    pub made: String,
    /// The commit that computed it.
    pub commit: String,
    /// The machine.
    pub machine: String,
    /// Processor time that it took in s.
    pub cpu_s: f64,
    /// The larger load average of its start and its end, if the system reports it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub load: Option<f64>,
    /// Cores of the machine.
    #[serde(default)]
    pub cores: usize,
    /// Whether it was finished before this run.
    #[serde(default)]
    pub kept: bool,
}

impl Origin {
    /// The load, if it exceeds the number of cores: other work then slowed the part.
    pub fn overload(&self) -> Option<f64> {
        self.load.filter(|load| *load > self.cores as f64)
    }
}

/// The folder of finished parts.
#[derive(Debug)]
pub struct Store {
    folder: PathBuf,
}

impl Store {
    /// Opens the folder `parts` in an output folder, and creates both if they are missing.
    ///
    /// # Errors
    /// A folder that cannot be created or written.
    pub fn open(out: &Path) -> Result<Self> {
        let folder = out.join("parts");
        let refused = || format!("cannot write into {}: expected a writable folder for --out", out.display());
        fs::create_dir_all(&folder).with_context(refused)?;
        let probe = folder.join(".probe");
        fs::write(&probe, "").with_context(refused)?;
        fs::remove_file(&probe).with_context(refused)?;
        Ok(Self { folder })
    }

    /// The finished part, if it exists; an unreadable file counts as missing.
    ///
    /// # Errors
    /// The error of [`Part::key`].
    pub fn find(&self, part: &Part) -> Result<Option<Finished>> {
        let text = fs::read(self.path(part)?).ok();
        let finished: Option<Finished> = text.and_then(|text| serde_json::from_slice(&text).ok());
        Ok(finished.map(|finished| Finished { origin: Origin { kept: true, ..finished.origin }, ..finished }))
    }

    /// Computes a part with `compute` and stores the result.
    ///
    /// # Errors
    /// The error of `compute`, and a file that cannot be written.
    pub fn compute(&self, part: &Part, compute: impl FnOnce(&Part) -> Result<Measured>) -> Result<Finished> {
        let (before_s, before) = (machine::cpu_s(), machine::load());
        let measured = compute(part)?;
        let origin = Origin {
            figure: part.figure.into(),
            room: part.room.clone(),
            name: part.name.clone(),
            seed: part.seed,
            made: machine::now(),
            commit: machine::COMMIT.into(),
            machine: machine::hardware(),
            cpu_s: machine::cpu_s() - before_s,
            load: [before, machine::load()].into_iter().flatten().reduce(f64::max),
            cores: machine::cores(),
            kept: false,
        };
        let text = serde_json::to_vec(&Finished { origin, measured })?;
        whole_file::write(&self.path(part)?, &text)?;
        // Read back, so that the report is equal when the part comes from its file.
        Ok(serde_json::from_slice(&text)?)
    }

    fn path(&self, part: &Part) -> Result<PathBuf> {
        let words = format!("{}-{}-{}-{}", part.figure, part.room, part.name, part.seed);
        let plain = |letter: char| if letter.is_ascii_alphanumeric() || ".-".contains(letter) { letter } else { '_' };
        Ok(self.folder.join(format!("{}-{}.json", words.chars().map(plain).collect::<String>(), part.key()?)))
    }
}
