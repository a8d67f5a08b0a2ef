//! The result of a run.

use serde::{Deserialize, Serialize};

use crate::figure::Figure;
use crate::store::Origin;
use crate::verdict::Claim;

/// A report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Command, program, machine and time.
    pub meta: Meta,
    /// The statements of the paper with the findings.
    pub claims: Vec<Claim>,
    /// The figures.
    pub figures: Vec<Figure>,
    /// The omitted figures with the reason.
    pub left_out: Vec<LeftOut>,
    /// The origin of the parts, for each figure and room.
    pub sources: Vec<Source>,
    /// The origin of each part.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub parts: Vec<Origin>,
}

/// The origin of the parts of one figure in one room.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Source {
    /// The figure.
    pub figure: String,
    /// The room.
    pub room: String,
    /// Number of parts.
    pub parts: usize,
    /// Number of parts that were finished before the run.
    pub kept: usize,
    /// The commits that computed them.
    pub commits: Vec<String>,
    /// When the first was finished, in UTC.
    pub first: String,
    /// When the last was finished, in UTC.
    pub last: String,
    /// Processor time of all in s.
    pub cpu_s: f64,
}

impl Source {
    /// One entry for each figure and room, in the order of the parts.
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

/// Command, program, machine and time of a report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Meta {
    /// Version of the program.
    pub version: String,
    /// The commits that computed the parts.
    pub commits: Vec<String>,
    /// Time of the report in UTC.
    pub made: String,
    /// The machine.
    pub machine: String,
    /// The command.
    pub command: String,
    /// Full, quick, or reduced: fewer seeds or episodes than the full run.
    pub effort: String,
    /// The first seed.
    pub first_seed: u64,
    /// Seeds of computations without training.
    pub seeds: u64,
    /// Seeds of training runs and timings.
    pub training_seeds: u64,
    /// Episodes of each training run.
    pub episodes: usize,
    /// Processor time of all parts in s.
    pub cpu_s: f64,
}

/// A figure that is omitted in a room.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeftOut {
    /// The figure.
    pub figure: String,
    /// The room.
    pub room: String,
    /// The reason.
    pub why: String,
}

/// A duration for a reader, in s or in min.
pub fn duration_text(seconds: f64) -> String {
    if seconds < 90.0 { format!("{seconds:.0} s") } else { format!("{:.0} min", seconds / 60.0) }
}
