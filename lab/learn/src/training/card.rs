//! The model card: the task of an actor, the command that made it, and its scores.

use std::fmt::Write;
use std::time::Duration;

use heliostat_core::observation::OBSERVATION_VERSION;

use super::algorithm::Algorithm;
use super::run::Training;
use crate::evaluation::{Estimate, Score};

/// A score in one kind of room.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct ScoreRow {
    /// Number of users.
    pub users: usize,
    /// Number of users with the direct path forced off.
    pub forced: usize,
    /// Number of states.
    pub states: usize,
    /// The score.
    pub score: Score,
    /// Ratio to the oracle and share of minimum rates met of the learner's best action in each
    /// state, where it is known.
    #[serde(rename = "ceiling", skip_serializing_if = "Option::is_none")]
    pub upper_bound: Option<(Estimate, f64)>,
}

/// The contents of a card.
pub struct Card<'a> {
    /// File name of the actor.
    pub file: &'a str,
    /// The command that makes it.
    pub command: &'a str,
    /// The algorithm.
    pub algorithm: Algorithm,
    /// The finished run.
    pub training: &'a Training,
    /// Duration of the training without the final evaluation; `None` for a resumed run.
    pub duration: Option<Duration>,
    /// Scores on held-out states.
    pub scores: &'a [ScoreRow],
}

impl Card<'_> {
    /// The card as Markdown.
    pub fn markdown(&self) -> String {
        let mut text = String::new();
        self.write(&mut text).expect("writing into a string does not fail");
        text
    }

    fn write(&self, text: &mut String) -> std::fmt::Result {
        let scenario = self.training.scenario();
        writeln!(text, "# {}\n", self.file)?;
        writeln!(
            text,
            "Turns the {} mirrors ({}) of an array for 1 to 10 users, channel mode `{}`. Input: the observation vector, version {OBSERVATION_VERSION}. \
             Output: roll and yaw of each mirror in radians. The graph holds the complete computation between the two.\n",
            scenario.mirror_count(),
            scenario.mirrors,
            scenario.channel.mode.name()
        )?;
        self.write_training(text)?;
        self.write_scores(text)?;
        writeln!(
            text,
            "\nLimits: one access point, the geometry named above, true positions and gains without delay. A controller refuses the \
             actor for another geometry."
        )
    }

    /// The command, the settings and the notes of the run.
    fn write_training(&self, text: &mut String) -> std::fmt::Result {
        let (run, scenario) = (self.training.run(), self.training.scenario());
        writeln!(text, "Made by\n\n```sh\n{}\n```\n", self.command)?;
        writeln!(text, "| | |\n| --- | --- |")?;
        writeln!(text, "| algorithm | {} |", self.algorithm.summary)?;
        writeln!(
            text,
            "| scenario | {} (hash {}, geometry {}) |",
            scenario.name,
            scenario.hash(),
            scenario.geometry_hash()
        )?;
        writeln!(text, "| training | {} episodes of {} steps, seed {} |", run.episodes, run.steps, run.seed)?;
        match self.duration {
            Some(duration) => writeln!(text, "| duration | {:.0} s on {} |", duration.as_secs_f64(), hardware())?,
            None => writeln!(text, "| duration | resumed; last part on {} |", hardware())?,
        }
        for (name, note) in self.training.learner().notes() {
            writeln!(text, "| {name} | {note} |")?;
        }
        writeln!(text, "| settings | `{}` |", self.training.settings())?;
        writeln!(text, "| licence | {} |\n", env!("CARGO_PKG_LICENSE"))?;
        Ok(())
    }

    fn write_scores(&self, text: &mut String) -> std::fmt::Result {
        writeln!(
            text,
            "Held-out states of the scenario with its own noise: mean and 95 % interval. The ratio is that to the oracle with minimum \
             rates, state by state. `b` users have their direct path forced off, in addition to those in the shadow of bodies and obstacles.\n"
        )?;
        let known = self.scores.iter().all(|row| row.upper_bound.is_some());
        if known {
            writeln!(
                text,
                "The upper bound is the ratio of the best codeword in each state, found by evaluating all codewords, and its share of \
                 minimum rates met.\n"
            )?;
        }
        let more = if known { [" upper bound |", " --- |"] } else { [""; 2] };
        writeln!(
            text,
            "| users | b | states | no array, Mbit/s | actor, Mbit/s | oracle, Mbit/s | ratio | minimum rates met (oracle) |{}",
            more[0]
        )?;
        writeln!(text, "| --- | --- | --- | --- | --- | --- | --- | --- |{}", more[1])?;
        for ScoreRow { users, forced, states, score, upper_bound } in self.scores {
            write!(
                text,
                "| {users} | {forced} | {states} | {:.1} | {:.1} ± {:.1} | {:.1} | {:.4} ± {:.4} | {:.3} ({:.3}) |",
                score.no_irs_mbps.mean,
                score.sum_rate_mbps.mean,
                score.sum_rate_mbps.ci95,
                score.oracle_mbps.mean,
                score.ratio_to_oracle.mean,
                score.ratio_to_oracle.ci95,
                score.qos_met,
                score.oracle_qos_met
            )?;
            match upper_bound {
                Some((ratio, met)) => writeln!(text, " {:.4} ± {:.4}, {met:.3} |", ratio.mean, ratio.ci95)?,
                None => writeln!(text)?,
            }
        }
        Ok(())
    }
}

/// Number of cores and, where the system reports it, their model.
pub fn hardware() -> String {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let listing = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = listing.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    match model {
        Some((_, name)) => format!("{cores} cores of {}", name.trim()),
        None => format!("{cores} cores, {}", std::env::consts::ARCH),
    }
}
