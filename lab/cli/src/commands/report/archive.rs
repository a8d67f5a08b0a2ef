//! Finished sections as JSON beside the page: all that the page is rendered from.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use heliostat_service::{input, whole_file};

/// The finished sections of one report.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Archive {
    /// Name of the report.
    pub report: String,
    /// Whether the commands ran with fewer states, seeds and seconds.
    pub quick: bool,
    /// In the order in which they finished.
    pub sections: Vec<Finished>,
}

/// What one section's command printed, and where.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Finished {
    /// Name of the section.
    pub section: String,
    /// Program and arguments, without `--json`.
    pub arguments: Vec<String>,
    /// When the command started, in UTC.
    pub made: String,
    /// The commit that was built.
    pub commit: String,
    /// Processors of the machine.
    pub machine: String,
    /// The load average of the last minute when the command ended, if the system reports it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub load: Option<f64>,
    /// How long the command took, in s.
    pub seconds: f64,
    /// Its JSON object.
    pub output: Value,
}

/// The JSON file beside a page.
///
/// # Errors
/// The page has the name of this file, or one of both cannot be written.
pub fn beside(page: &Path) -> Result<PathBuf> {
    let kept = page.with_extension("json");
    ensure!(
        page != kept,
        "--out {}: finished sections go to the JSON file of this name; expected another ending, such as .md",
        page.display()
    );
    whole_file::check_writable(page)?;
    whole_file::check_writable(&kept)?;
    Ok(kept)
}

impl Archive {
    /// Holds no section yet.
    pub fn new(report: &str, quick: bool) -> Self {
        Self { report: report.into(), quick, sections: Vec::new() }
    }

    /// The finished sections from which a run continues; none if the file does not exist.
    ///
    /// # Errors
    /// A file that is no archive, of another report, or of a quick run where a full one continues.
    pub fn resume(kept: &Path, report: &str, quick: bool) -> Result<Self> {
        if !kept.exists() {
            return Ok(Self::new(report, quick));
        }
        let (file, archive) = (kept.display(), Self::read(kept)?);
        let name = |report: &str, quick: bool| format!("{report}{}", if quick { " --quick" } else { "" });
        let (found, expected) = (name(&archive.report, archive.quick), name(report, quick));
        ensure!(
            found == expected,
            "{file} holds {found}; expected {expected}. Choose another --out, or leave out --resume"
        );
        Ok(archive)
    }

    /// Reads a file of finished sections.
    ///
    /// # Errors
    /// A file that cannot be read, or is no archive.
    pub fn read(kept: &Path) -> Result<Self> {
        let (text, file) = (input::read(kept)?, kept.display());
        serde_json::from_str(&text).with_context(|| {
            format!("{file} holds no finished sections: delete it or restore it, or leave out --resume")
        })
    }

    /// Writes the archive, complete or not at all.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn write(&self, file: &Path) -> Result<()> {
        whole_file::write(file, (serde_json::to_string_pretty(self)? + "\n").as_bytes())
    }

    /// The section, where it is finished.
    pub fn find(&self, section: &str) -> Option<&Finished> {
        self.sections.iter().find(|finished| finished.section == section)
    }

    /// Whether the section was finished by this command at this commit.
    pub fn holds(&self, section: &str, arguments: &[String], commit: &str) -> bool {
        self.find(section).is_some_and(|finished| finished.arguments == arguments && finished.commit == commit)
    }

    /// Adds a section, in place of an earlier one of the same name.
    pub fn put(&mut self, finished: Finished) {
        self.sections.retain(|other| other.section != finished.section);
        self.sections.push(finished);
    }
}
