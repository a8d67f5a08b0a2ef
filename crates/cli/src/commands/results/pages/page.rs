//! A page and its sections.

use anyhow::Result;

use super::super::archive::Archive;
use super::super::bound::Bound;
use super::super::table::{Column, Layout};

/// Writes Markdown from the sections of a page and those of them that are finished.
pub type Summary = fn(&[Section], &Archive) -> Result<String>;

/// A page.
#[derive(Debug)]
pub struct Page {
    /// Its name on the command line and in file names.
    pub name: &'static str,
    /// Its heading.
    pub title: &'static str,
    /// How its figures are to be read.
    pub about: &'static str,
    /// The part in front of the sections, if the page has one.
    pub summary: Option<Summary>,
    /// In the order of the page.
    pub sections: &'static [Section],
}

/// One command and its table.
#[derive(Debug)]
pub struct Section {
    /// Its name on the command line, unique within the page.
    pub name: &'static str,
    /// Its heading.
    pub title: &'static str,
    /// What the command measures.
    pub about: &'static str,
    /// The arguments of `heliostat`, separated by single spaces.
    pub command: &'static str,
    /// Further arguments of a full run.
    pub full: &'static str,
    /// Further arguments of a quick run.
    pub quick: &'static str,
    /// Where its rows are.
    pub layout: Layout,
    /// What its table shows.
    pub columns: &'static [Column],
    /// What is promised.
    pub bounds: &'static [Bound],
}

impl Section {
    /// A section that compares policies, 200 states in each of 10 rooms: its name, its heading, what it
    /// measures, and its command.
    pub const fn of_policies([name, title, about, command]: [&'static str; 4], columns: &'static [Column]) -> Self {
        Self {
            name,
            title,
            about,
            command,
            full: "--states 200 --seeds 10",
            quick: "--states 2 --seeds 1",
            layout: Layout::Policies,
            columns,
            bounds: &[],
        }
    }

    /// The arguments of `heliostat`, as the page prints them.
    pub fn arguments(&self, quick: bool) -> Vec<String> {
        let further = if quick { self.quick } else { self.full };
        self.command.split_whitespace().chain(further.split_whitespace()).map(String::from).collect()
    }

    /// The arguments with `--json` in front of those that are passed on to another process.
    pub fn with_json(&self, arguments: &[String]) -> Vec<String> {
        let end = arguments.iter().position(|word| word == "--").unwrap_or(arguments.len());
        let (own, passed_on) = arguments.split_at(end);
        own.iter().cloned().chain(["--json".into()]).chain(passed_on.iter().cloned()).collect()
    }
}
