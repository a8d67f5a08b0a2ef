//! Finished sections as JSON: all that a page is rendered from.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::commands::whole_file;

/// The finished sections of one page.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Archive {
    /// Name of the page.
    pub page: String,
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
    /// The arguments of `heliostat`, without `--json`.
    pub arguments: Vec<String>,
    /// When the command started, in UTC.
    pub made: String,
    /// The commit that was built.
    pub commit: String,
    /// Processors of the machine.
    pub machine: String,
    /// The load average of the machine over the last minute when the command ended, if the system
    /// reports it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub load: Option<f64>,
    /// How long the command took, in s.
    pub seconds: f64,
    /// Its JSON object.
    pub output: Value,
}

/// The JSON file in which the finished steps of a page are kept, beside the page.
///
/// # Errors
/// The page has the name of this file, or one of both cannot be written.
pub fn beside(page: &Path) -> Result<PathBuf> {
    let kept = page.with_extension("json");
    ensure!(
        page != kept,
        "--out {}: what is finished goes to the JSON file of this name; expected another ending, such as .md",
        page.display()
    );
    whole_file::check_writable(page)?;
    whole_file::check_writable(&kept)?;
    Ok(kept)
}

impl Archive {
    /// Holds no section yet.
    pub fn new(page: &str, quick: bool) -> Self {
        Self { page: page.into(), quick, sections: Vec::new() }
    }

    /// Reads an archive.
    ///
    /// # Errors
    /// A file that cannot be read or is no archive.
    pub fn read(file: &Path) -> Result<Self> {
        let text = fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
        serde_json::from_str(&text).with_context(|| {
            format!(
                "{} holds no finished sections: delete it or restore it, or leave out --resume to measure all again",
                file.display()
            )
        })
    }

    /// Writes the archive, complete or not at all: a full disk leaves the finished sections of before.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn write(&self, file: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self)? + "\n";
        whole_file::write(file, text.as_bytes())
    }

    /// Whether the section was finished by this command at this commit.
    pub fn holds(&self, section: &str, arguments: &[String], commit: &str) -> bool {
        self.find(section).is_some_and(|finished| finished.arguments == arguments && finished.commit == commit)
    }

    /// The section, where it is finished.
    pub fn find(&self, section: &str) -> Option<&Finished> {
        self.sections.iter().find(|finished| finished.section == section)
    }

    /// Adds a section, in place of an earlier one of the same name.
    pub fn put(&mut self, finished: Finished) {
        self.sections.retain(|other| other.section != finished.section);
        self.sections.push(finished);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn finished(commit: &str) -> Finished {
        Finished {
            section: "loop".into(),
            arguments: vec!["bench".into(), "loop".into()],
            made: "2026-11-22T12:00:00Z".into(),
            commit: commit.into(),
            machine: "2 cores".into(),
            load: Some(1.25),
            seconds: 1.5,
            output: serde_json::json!({ "rows": [] }),
        }
    }

    #[test]
    fn a_section_counts_as_finished_only_for_the_same_command_and_commit() {
        let mut archive = Archive::new("latency", false);
        archive.put(finished("a"));
        let arguments = finished("a").arguments;
        assert!(archive.holds("loop", &arguments, "a"));
        assert!(!archive.holds("loop", &arguments, "b") && !archive.holds("loop", &arguments[..1], "a"));
        archive.put(finished("b"));
        assert_eq!(archive.sections, [finished("b")]);
    }

    #[test]
    fn an_archive_is_read_as_it_was_written_and_other_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("latency.json");
        let mut archive = Archive::new("latency", true);
        archive.put(finished("a"));
        archive.write(&file).unwrap();
        let read = Archive::read(&file).unwrap();
        assert_eq!((read.page, read.quick, read.sections), ("latency".into(), true, vec![finished("a")]));
        fs::write(&file, "{}").unwrap();
        assert!(Archive::read(&file).is_err());
    }

    #[test]
    fn an_archive_that_cannot_be_written_completely_leaves_the_one_of_before() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("latency.json");
        let mut archive = Archive::new("latency", true);
        archive.put(finished("a"));
        archive.write(&file).unwrap();
        // Nothing can be written beside the file.
        fs::create_dir(folder.path().join("latency.json.part")).unwrap();
        archive.put(finished("b"));
        let refusal = format!("{:#}", archive.write(&file).unwrap_err());
        assert!(refusal.contains("cannot write") && refusal.contains("latency.json"), "{refusal}");
        assert_eq!(Archive::read(&file).unwrap().sections, [finished("a")]);
    }
}
