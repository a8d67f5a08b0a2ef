//! The model card: what an actor is, the command that made it, and how good it is.

use std::fmt::Write;
use std::time::Duration;

use heliostat_decide::observation::OBSERVATION_VERSION;

use crate::algorithm::Algorithm;
use crate::evaluate::{Estimate, Score};
use crate::learner::Learner;

/// A score in one kind of room.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct ScoreRow {
    /// Users.
    pub users: usize,
    /// How many have their direct path forced off.
    pub forced: usize,
    /// States judged.
    pub states: usize,
    /// The score.
    pub score: Score,
    /// The ratio to the oracle and the share of needs met of the best that the learner could ever give, where that is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ceiling: Option<(Estimate, f64)>,
}

/// Everything that a card tells.
pub struct Card<'a> {
    /// File name of the actor.
    pub file: &'a str,
    /// The command that makes it.
    pub command: &'a str,
    /// What was trained.
    pub algorithm: Algorithm,
    /// The finished run.
    pub learner: &'a dyn Learner,
    /// How long training took, without the final evaluation; `None` when it was resumed.
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
        let (run, scenario) = (self.learner.run(), self.learner.scenario());
        writeln!(text, "# {}\n", self.file)?;
        writeln!(
            text,
            "Turns the {} mirrors of a {} x {} array for 1 to 10 users, channel mode `{}`. Input: the observation vector, version {OBSERVATION_VERSION}; \
             output: roll and yaw of each mirror in radians. All that lies between is inside the graph.\n",
            scenario.mirror_count(),
            scenario.mirrors.rows,
            scenario.mirrors.columns,
            scenario.channel.mode.name()
        )?;
        writeln!(text, "Made by\n\n```sh\n{}\n```\n", self.command)?;
        writeln!(text, "| | |\n| --- | --- |")?;
        writeln!(text, "| algorithm | {} |", self.algorithm.summary())?;
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
        for (name, note) in self.learner.notes() {
            writeln!(text, "| {name} | {note} |")?;
        }
        writeln!(text, "| settings | `{}` |", self.learner.settings())?;
        writeln!(text, "| licence | {} |\n", env!("CARGO_PKG_LICENSE"))?;
        self.write_scores(text)?;
        writeln!(
            text,
            "\nLimits: one access point, the geometry named above, true positions and gains without delay. A controller refuses the \
             actor elsewhere."
        )
    }

    fn write_scores(&self, text: &mut String) -> std::fmt::Result {
        writeln!(
            text,
            "Held-out states of the scenario with its own noise, mean and 95 % interval; ratio to the oracle that keeps minimum rates, \
             state by state; `b` users have their direct path forced off, besides those in the shadow of bodies and obstacles.\n"
        )?;
        let known = self.scores.iter().all(|row| row.ceiling.is_some());
        if known {
            writeln!(
                text,
                "The ceiling is the ratio of the codebook's truly best entry in each state, found by trying all, and the needs that it \
                 meets.\n"
            )?;
        }
        let more = if known { [" ceiling |", " --- |"] } else { [""; 2] };
        writeln!(
            text,
            "| users | b | states | no array, Mbit/s | actor, Mbit/s | oracle, Mbit/s | ratio | needs met (oracle) |{}",
            more[0]
        )?;
        writeln!(text, "| --- | --- | --- | --- | --- | --- | --- | --- |{}", more[1])?;
        for ScoreRow { users, forced, states, score, ceiling } in self.scores {
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
            match ceiling {
                Some((ratio, met)) => writeln!(text, " {:.4} ± {:.4}, {met:.3} |", ratio.mean, ratio.ci95)?,
                None => writeln!(text)?,
            }
        }
        Ok(())
    }
}

/// Number of cores and, where the system tells, their model.
pub fn hardware() -> String {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let listing = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = listing.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    match model {
        Some((_, name)) => format!("{cores} cores of {}", name.trim()),
        None => format!("{cores} cores, {}", std::env::consts::ARCH),
    }
}
