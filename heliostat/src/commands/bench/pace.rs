//! When reports are due, and two parties that take turns at the same pace.
//!
//! Due times are laid out in advance, so a late one does not put off those after it, and what is late because of the work before it counts from
//! when it was due: a slow answer cannot hide the wait of the next report.

use std::time::{Duration, Instant};

use anyhow::{Result, bail, ensure};
use heliostat_service::duration;

/// One party acts for so long before the other does: far longer than a decision, far shorter than a drift of the machine.
const BLOCK: Duration = Duration::from_millis(500);

/// The measured party has so many blocks for each one of the reference.
const SHARE: u32 = 2;

/// Reports in a block without pauses, at the most.
const UNPACED_BLOCK: u64 = 2000;

/// How often, and how many.
#[derive(Clone, Debug, clap::Args)]
pub struct PaceArgs {
    /// Reports a second (comma-separated); 0 is without pauses
    #[arg(long, value_name = "HZ", value_delimiter = ',')]
    hz: Vec<f64>,
    /// Time for each row in s, two thirds of it for what is measured and one for the reference
    #[arg(long, value_name = "S", default_value = "6", value_parser = duration::seconds, allow_negative_numbers = true)]
    seconds: Duration,
    /// So many measured decisions a row, in place of --seconds
    #[arg(long, value_name = "N")]
    decisions: Option<u64>,
}

impl PaceArgs {
    /// The plans, one a pace; `default_hz` where none was named.
    pub fn plans(&self, default_hz: &[f64]) -> Result<Vec<Plan>> {
        let paces = if self.hz.is_empty() { default_hz } else { &self.hz };
        let plan = |hz: &f64| {
            ensure!(*hz == 0.0 || (0.1..=10_000.0).contains(hz), "--hz {hz}: wanted 0 (no pauses), or 0.1 to 10000");
            let amount = match self.decisions {
                Some(0) => bail!("--decisions 0: wanted at least 1"),
                Some(decisions) => Amount::Decisions(decisions),
                None => Amount::Time(self.seconds),
            };
            Ok(Plan { hz: (*hz > 0.0).then_some(*hz), amount })
        };
        paces.iter().map(plan).collect()
    }
}

/// How much a row measures.
#[derive(Clone, Copy, Debug)]
enum Amount {
    Decisions(u64),
    Time(Duration),
}

/// One row's pace.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// Reports a second; none without pauses.
    pub hz: Option<f64>,
    amount: Amount,
}

/// Whose turn it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// What is measured.
    Measured,
    /// What it is compared with.
    Reference,
}

/// One block of reports.
#[derive(Clone, Copy, Debug)]
pub struct Block {
    /// Time between reports; none without pauses.
    pub interval: Option<Duration>,
    /// How many.
    pub reports: u64,
    /// When the block is over although reports are left; without pauses only.
    pub until: Instant,
}

impl Plan {
    /// Lets the two take turns, block by block, until there is enough, and each has had one.
    pub fn take_turns(&self, mut act: impl FnMut(Turn, Block) -> Result<u64>) -> Result<()> {
        let (start, mut decisions) = (Instant::now(), 0);
        for turn in 0.. {
            let turn = if turn % (SHARE + 1) == 0 { Turn::Reference } else { Turn::Measured };
            let done = act(turn, self.block())?;
            if turn == Turn::Reference {
                let enough = match self.amount {
                    Amount::Decisions(wanted) => decisions >= wanted,
                    Amount::Time(time) => start.elapsed() >= time,
                };
                if enough && decisions > 0 {
                    break;
                }
            } else {
                decisions += done;
            }
        }
        Ok(())
    }

    fn block(&self) -> Block {
        let interval = self.hz.map(|hz| Duration::from_secs_f64(1.0 / hz));
        let reports = match interval {
            Some(interval) => (BLOCK.as_secs_f64() / interval.as_secs_f64()).ceil() as u64,
            None => UNPACED_BLOCK,
        };
        Block { interval, reports: reports.max(1), until: Instant::now() + BLOCK }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn however_short_the_time_something_is_measured() {
        let plan = Plan { hz: Some(100.0), amount: Amount::Time(Duration::ZERO) };
        let mut measured = 0;
        plan.take_turns(|turn, block| {
            measured += if turn == Turn::Measured { block.reports } else { 0 };
            Ok(block.reports)
        })
        .unwrap();
        assert!(measured > 0);
    }

    #[test]
    fn the_two_take_turns_until_there_is_enough() {
        let plan = Plan { hz: Some(1000.0), amount: Amount::Decisions(2500) };
        let (mut turns, mut measured) = (Vec::new(), 0);
        plan.take_turns(|turn, block| {
            turns.push(turn);
            measured += if turn == Turn::Measured { block.reports } else { 0 };
            Ok(block.reports)
        })
        .unwrap();
        assert_eq!(measured, 3000);
        assert_eq!(turns.first(), Some(&Turn::Reference));
        assert_eq!(turns.last(), Some(&Turn::Reference));
        assert_eq!(turns.iter().filter(|turn| **turn == Turn::Reference).count(), 4);
    }
}
