//! When reports are due, and how the measured side and the reference alternate.
//!
//! Due times are fixed in advance: a delayed report does not delay those after it, and it counts
//! from its due time. A slow decision therefore cannot hide the wait of the next report
//! (coordinated omission).

use std::time::{Duration, Instant};

use anyhow::{Result, bail, ensure};
use heliostat_service::duration;
use heliostat_service::exit::UnusableInput;

/// How long one side runs before the other: far longer than a decision, far shorter than a drift of
/// the machine.
const BLOCK: Duration = Duration::from_millis(500);

/// Blocks of the measured side for each block of the reference.
const SHARE: u32 = 2;

/// Largest number of reports in a block without pauses.
const UNPACED_BLOCK: u64 = 2000;

/// Rate and number of reports.
#[derive(Clone, Debug, clap::Args)]
pub struct PaceArgs {
    /// Reports a second (comma-separated); 0 for no pauses
    #[arg(long, value_name = "HZ", value_delimiter = ',')]
    hz: Vec<f64>,
    /// Time for each row in s: two thirds for the measured side, one third for the reference
    #[arg(long, value_name = "S", default_value = "6", value_parser = duration::seconds, allow_negative_numbers = true)]
    seconds: Duration,
    /// Number of measured decisions a row, instead of --seconds
    #[arg(long, value_name = "N")]
    decisions: Option<u64>,
}

impl PaceArgs {
    /// The plans, one a rate; `default_hz` if no rate was given.
    pub fn plans(&self, default_hz: &[f64]) -> Result<Vec<Plan>> {
        let paces = if self.hz.is_empty() { default_hz } else { &self.hz };
        let plan = |hz: &f64| {
            ensure!(
                *hz == 0.0 || (0.1..=10_000.0).contains(hz),
                UnusableInput::new(format!("--hz {hz}: expected 0 (no pauses), or 0.1 to 10000"))
            );
            let amount = match self.decisions {
                Some(0) => bail!(UnusableInput::new("--decisions 0: expected at least 1")),
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

/// Rate and amount of one row.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// Reports a second; none without pauses.
    pub hz: Option<f64>,
    amount: Amount,
}

/// Which side runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// The measured side.
    Measured,
    /// The side it is compared with.
    Reference,
}

/// One block of reports.
#[derive(Clone, Copy, Debug)]
pub struct Block {
    /// Time between reports; none without pauses.
    pub interval: Option<Duration>,
    /// Number of reports.
    pub reports: u64,
    /// When the block ends although reports are left; only without pauses.
    pub until: Instant,
}

impl Plan {
    /// Alternates the two sides block by block, until enough is measured and each side has run.
    pub fn take_turns(&self, mut act: impl FnMut(Turn, Block) -> Result<u64>) -> Result<()> {
        let (start, mut decisions) = (Instant::now(), 0);
        for turn in 0.. {
            let turn = if turn % (SHARE + 1) == 0 { Turn::Reference } else { Turn::Measured };
            let mut block = self.block();
            if let (Turn::Measured, Amount::Decisions(expected)) = (turn, self.amount) {
                block.reports = block.reports.min(expected - decisions);
            }
            if block.reports == 0 {
                continue;
            }
            let done = act(turn, block)?;
            if turn == Turn::Reference {
                let enough = match self.amount {
                    Amount::Decisions(expected) => decisions >= expected,
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
    fn at_least_one_block_is_measured() {
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
    fn no_more_decisions_are_measured_than_requested() {
        for (hz, decisions) in [(Some(200.0), 30), (None, 30), (Some(1000.0), 501)] {
            let plan = Plan { hz, amount: Amount::Decisions(decisions) };
            let mut measured = 0;
            plan.take_turns(|turn, block| {
                measured += if turn == Turn::Measured { block.reports } else { 0 };
                Ok(block.reports)
            })
            .unwrap();
            assert_eq!(measured, decisions, "{hz:?}");
        }
    }

    #[test]
    fn the_two_sides_alternate_until_enough_is_measured() {
        let plan = Plan { hz: Some(1000.0), amount: Amount::Decisions(2500) };
        let (mut turns, mut measured) = (Vec::new(), 0);
        plan.take_turns(|turn, block| {
            turns.push(turn);
            measured += if turn == Turn::Measured { block.reports } else { 0 };
            Ok(block.reports)
        })
        .unwrap();
        assert_eq!(measured, 2500);
        assert_eq!(turns.first(), Some(&Turn::Reference));
        assert_eq!(turns.last(), Some(&Turn::Reference));
        assert_eq!(turns.iter().filter(|turn| **turn == Turn::Reference).count(), 4);
    }
}
