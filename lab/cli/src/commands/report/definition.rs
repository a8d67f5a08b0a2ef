//! A report as data: a TOML file with sections, columns and bounds.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use heliostat_files::from_toml;
use heliostat_service::input;
use serde::Deserialize;

use super::bound::Bound;
use super::table::Column;

/// A report.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Definition {
    /// Name of the page's file.
    pub name: String,
    /// Heading.
    pub title: String,
    /// How the figures are to be read.
    pub about: String,
    /// Words that commands contain as `{NAME}`.
    #[serde(default)]
    pub words: BTreeMap<String, String>,
    /// Columns of tables, by the name of the table.
    pub columns: BTreeMap<String, Vec<Column>>,
    /// What sections have that do not state it themselves.
    #[serde(default)]
    default: Defaults,
    /// Tables over several sections, in front of them.
    #[serde(default)]
    pub summary: Vec<Summary>,
    /// In the order of the page.
    #[serde(rename = "section")]
    pub sections: Vec<Section>,
}

#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Defaults {
    full: String,
    quick: String,
    tables: Vec<Table>,
}

/// One command and its tables.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Section {
    /// Name for `--only`.
    pub name: String,
    /// Heading.
    pub title: String,
    /// What the command measures.
    pub about: String,
    /// The command: program and arguments, separated by spaces.
    pub command: String,
    /// Further arguments of a full run.
    full: Option<String>,
    /// Further arguments of a quick run.
    quick: Option<String>,
    /// The section without the change that this section makes.
    pub base: Option<String>,
    /// What is shown of the command's JSON object.
    #[serde(default)]
    pub tables: Vec<Table>,
    /// What is promised.
    #[serde(default, rename = "bound")]
    pub bounds: Vec<Bound>,
}

/// Rows of a command's JSON object.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Table {
    /// JSON pointer of the rows.
    pub rows: String,
    /// Name of the columns.
    pub columns: String,
}

/// A table over several sections.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Summary {
    /// Heading.
    pub title: String,
    /// How the figures are to be read.
    pub about: String,
    /// What a line stands for.
    pub of: Lines,
    /// Name of the columns.
    pub columns: String,
}

/// What a line of a summary stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Lines {
    /// A section; a column points into its JSON object.
    Sections,
    /// A section with a base: its figures minus those of the base.
    Changes,
    /// A row of the first tables: means of intervals over the sections, and the largest of other numbers.
    Rows,
}

impl Section {
    /// The JSON pointers of rows: those of the tables, and of the bounds that name some.
    pub fn rows(&self) -> impl Iterator<Item = &str> {
        let of_tables = self.tables.iter().map(|table| table.rows.as_str());
        of_tables.chain(self.bounds.iter().filter_map(|bound| bound.rows.as_deref()))
    }
}

impl Definition {
    /// Reads a file; `words` replace those of the file.
    ///
    /// # Errors
    /// A file that cannot be read, or contradicts itself.
    pub fn read(file: &Path, words: &[(String, String)]) -> Result<Self> {
        let text = input::read(file)?;
        Self::parse(&text, words).with_context(|| format!("in {}", file.display()))
    }

    fn parse(text: &str, words: &[(String, String)]) -> Result<Self> {
        let mut definition: Self = from_toml(text)?;
        for (name, value) in words {
            let word = definition.words.get_mut(name);
            *word.with_context(|| format!("--word {name}: the report has no such word"))? = value.clone();
        }
        let Defaults { full, quick, tables } = definition.default.clone();
        for section in &mut definition.sections {
            section.full.get_or_insert_with(|| full.clone());
            section.quick.get_or_insert_with(|| quick.clone());
            if section.tables.is_empty() {
                section.tables.clone_from(&tables);
            }
        }
        definition.check()?;
        Ok(definition)
    }

    fn check(&self) -> Result<()> {
        let names: BTreeSet<&str> = self.sections.iter().map(|section| section.name.as_str()).collect();
        let titles: BTreeSet<&str> = self.sections.iter().map(|section| section.title.as_str()).collect();
        ensure!(names.len() == self.sections.len(), "two sections have one name; expected a name for each");
        ensure!(titles.len() == self.sections.len(), "two sections have one title; expected a title for each");
        for section in &self.sections {
            let of = || format!("in section {}", section.name);
            ensure!(!section.tables.is_empty(), "section {} has no tables; expected at least one", section.name);
            section.tables.iter().try_for_each(|table| self.columns(&table.columns).map(drop)).with_context(of)?;
            section.bounds.iter().try_for_each(Bound::check).with_context(of)?;
            self.arguments(section, false).and_then(|_| self.arguments(section, true)).with_context(of)?;
            let base = section.base.as_deref();
            ensure!(base.is_none_or(|base| names.contains(base)), "section {}: no base {base:?}", section.name);
        }
        self.summary.iter().try_for_each(|summary| self.columns(&summary.columns).map(drop))
    }

    /// The columns of a name.
    ///
    /// # Errors
    /// There are none.
    pub fn columns(&self, name: &str) -> Result<&[Column]> {
        let columns = self.columns.get(name).with_context(|| {
            let known: Vec<&str> = self.columns.keys().map(String::as_str).collect();
            format!("there are no columns {name}; expected one of {}", known.join(", "))
        })?;
        Ok(columns)
    }

    /// The program and the arguments of a section, as the page prints them.
    ///
    /// # Errors
    /// A command with an unknown word.
    pub fn arguments(&self, section: &Section, quick: bool) -> Result<Vec<String>> {
        let further = if quick { &section.quick } else { &section.full };
        let mut text = format!("{} {}", section.command, further.as_deref().unwrap_or_default());
        for (name, value) in &self.words {
            text = text.replace(&format!("{{{name}}}"), value);
        }
        // `{}` and `{key=value}` are values of a scenario key.
        let mut braced = text.split('{').skip(1).filter_map(|rest| Some(rest.split_once('}')?.0));
        if let Some(word) = braced.find(|inside| !inside.is_empty() && !inside.contains('=')) {
            let known: Vec<&str> = self.words.keys().map(String::as_str).collect();
            bail!("unknown word {{{word}}}; expected one of {}", known.join(", "));
        }
        Ok(text.split_whitespace().map(str::to_owned).collect())
    }
}
