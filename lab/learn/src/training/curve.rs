//! The learning curve: a CSV file with one row for each episode, written during training.

use std::fs::{File, OpenOptions};
use std::io::{BufWriter, Write};
use std::path::Path;

use anyhow::Context;
use heliostat_files::write_whole;

use super::run::EpisodeSummary;
use crate::evaluation::Score;

/// The first line. Held-out columns are empty in episodes without an evaluation.
const HEADER: &str = "episode,steps,reward_mbps,sum_rate_mbps,held_out_ratio,held_out_qos_met";

/// A CSV file to which each episode adds a row.
pub struct Curve {
    file: BufWriter<File>,
}

impl Curve {
    /// Opens the curve of a run with this number of finished episodes. Rows of later episodes, from
    /// an interrupted run, are dropped.
    ///
    /// # Errors
    /// The file cannot be read or written.
    pub fn open(path: &Path, episodes_done: usize) -> anyhow::Result<Self> {
        let context = || format!("learning curve {}", path.display());
        let old = if episodes_done > 0 { std::fs::read_to_string(path).with_context(context)? } else { String::new() };
        let kept = old.lines().skip(1).filter(|line| number(line).is_some_and(|episode| episode <= episodes_done));
        let text: String = std::iter::once(HEADER).chain(kept).flat_map(|line| [line, "\n"]).collect();
        write_whole(path, |part| std::fs::write(part, text)).with_context(context)?;
        let file = OpenOptions::new().append(true).open(path).with_context(context)?;
        Ok(Self { file: BufWriter::new(file) })
    }

    /// Adds an episode's row.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn add(&mut self, episode: &EpisodeSummary, score: Option<&Score>) -> anyhow::Result<()> {
        let EpisodeSummary { number, steps, reward_mbps, sum_rate_mbps } = episode;
        write!(self.file, "{number},{steps},{reward_mbps:.4},{sum_rate_mbps:.4}")?;
        match score {
            Some(score) => writeln!(self.file, ",{:.5},{:.4}", score.ratio_to_oracle.mean, score.qos_met)?,
            None => writeln!(self.file, ",,")?,
        }
        self.file.flush()?;
        Ok(())
    }
}

fn number(line: &str) -> Option<usize> {
    line.split(',').next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_resumed_curve_has_each_episode_once() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("curve.csv");
        let episode = |number| EpisodeSummary { number, steps: 2 * number, reward_mbps: 1.5, sum_rate_mbps: 2.0 };
        let mut curve = Curve::open(&path, 0).expect("a new curve");
        for number in 1..=3 {
            curve.add(&episode(number), None).expect("a row");
        }
        let mut curve = Curve::open(&path, 2).expect("the same curve");
        curve.add(&episode(3), Some(&Score::default())).expect("a row");
        let text = std::fs::read_to_string(&path).expect("the file");
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], HEADER);
        assert_eq!(lines[1..], ["1,2,1.5000,2.0000,,", "2,4,1.5000,2.0000,,", "3,6,1.5000,2.0000,0.00000,0.0000"]);
    }
}
