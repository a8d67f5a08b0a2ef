//! What a run came to, and its files: the page, and SVG, CSV and JSON for each figure.

use std::path::Path;

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};

use crate::claims::Claim;
use crate::draw::svg;
use crate::figure::Figure;
use crate::page;
use crate::store::{self, Origin};

/// A whole report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// What made it.
    pub meta: Meta,
    /// Every statement of the paper with what was found.
    pub claims: Vec<Claim>,
    /// The figures.
    pub figures: Vec<Figure>,
    /// What was left out, and why.
    pub left_out: Vec<LeftOut>,
    /// Where the parts came from, figure by figure.
    pub sources: Vec<Source>,
    /// Where each part came from.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub parts: Vec<Origin>,
}

/// Where the parts of one figure in one room came from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Source {
    /// The figure.
    pub figure: String,
    /// The room.
    pub room: String,
    /// How many.
    pub parts: usize,
    /// How many of them were there before the run.
    pub kept: usize,
    /// The commits that computed them.
    pub commits: Vec<String>,
    /// When the first was finished, in UTC.
    pub first: String,
    /// When the last was.
    pub last: String,
    /// Processor time of all in s.
    pub cpu_s: f64,
}

impl Source {
    /// One entry a figure and room, in the order of the parts.
    pub fn of(parts: &[Origin]) -> Vec<Self> {
        let mut sources: Vec<Self> = Vec::new();
        for part in parts {
            let same = |source: &&mut Self| source.figure == part.figure && source.room == part.room;
            match sources.iter_mut().find(same) {
                Some(source) => source.add(part),
                None => {
                    let mut source = Self {
                        figure: part.figure.clone(),
                        room: part.room.clone(),
                        parts: 0,
                        kept: 0,
                        commits: Vec::new(),
                        first: part.made.clone(),
                        last: part.made.clone(),
                        cpu_s: 0.0,
                    };
                    source.add(part);
                    sources.push(source);
                }
            }
        }
        sources
    }

    fn add(&mut self, part: &Origin) {
        self.parts += 1;
        self.kept += usize::from(part.kept);
        self.cpu_s += part.cpu_s;
        if !self.commits.contains(&part.commit) {
            self.commits.push(part.commit.clone());
        }
        // Times of this form sort as text.
        self.first = self.first.clone().min(part.made.clone());
        self.last = self.last.clone().max(part.made.clone());
    }
}

/// What made a report, where and when.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Meta {
    /// Version of the program.
    pub version: String,
    /// The commits that computed the parts.
    pub commits: Vec<String>,
    /// When, in UTC.
    pub made: String,
    /// Where.
    pub machine: String,
    /// By which command.
    pub command: String,
    /// Full, quick, or reduced: full with other seeds or episodes.
    pub effort: String,
    /// The first seed.
    pub first_seed: u64,
    /// Seeds of what does not train.
    pub seeds: u64,
    /// Seeds of what trains or is timed.
    pub training_seeds: u64,
    /// Episodes of each training run.
    pub episodes: usize,
    /// Processor time of all parts in s.
    pub cpu_s: f64,
}

/// A figure that makes no sense in a room.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeftOut {
    /// The figure.
    pub figure: String,
    /// The room.
    pub room: String,
    /// Why.
    pub why: String,
}

/// Writes all files of a report into a folder.
///
/// # Errors
/// A file that cannot be written.
pub fn write(report: &Report, out: &Path) -> Result<()> {
    for figure in &report.figures {
        let file = |extension: &str| out.join(format!("{}.{extension}", figure.stem()));
        store::write(&file("svg"), svg::draw(figure).with_context(|| figure.stem())?.as_bytes())?;
        store::write(&file("csv"), &csv(figure)?)?;
        store::write(&file("json"), &serde_json::to_vec(figure)?)?;
    }
    store::write(&out.join("report.json"), &serde_json::to_vec(report)?)?;
    store::write(&out.join("report.html"), page::html(report).as_bytes())
}

/// One line a point; for a floor one a cell.
fn csv(figure: &Figure) -> Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(["panel", "series", &figure.x.label, &figure.y.label, "ci95", "ci95 of x"])?;
    for panel in &figure.panels {
        for series in &panel.series {
            for point in &series.points {
                let [ci95, x_ci95] =
                    [point.ci95, point.x_ci95].map(|half| half.map_or(String::new(), |half| half.to_string()));
                let [x, y] = [point.x, point.y].map(|value| value.to_string());
                writer.write_record([&panel.title, &series.name, &x, &y, &ci95, &x_ci95])?;
            }
        }
        let Some(floor) = &panel.floor else { continue };
        for (index, value) in floor.values.iter().enumerate() {
            let [x, y] = floor.centre(index % floor.columns, index / floor.columns);
            let name = format!("{}: {value}", floor.label);
            writer.write_record([&panel.title, &name, &x.to_string(), &y.to_string(), "", ""])?;
        }
    }
    writer.into_inner().context("the table cannot be finished")
}
