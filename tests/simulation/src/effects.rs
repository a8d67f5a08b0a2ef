//! The effect of one fault, over many seeds: what docs/results/simulated-faults.md shows.
//!
//! Each case is one fault, or one short sequence, in a room with one array and 100 reports a second.
//! The seed draws the moment of the fault, the delays of the links, the clocks, the positions and the
//! policy. The invariants hold in each run; the effect is what they leave open.

mod cases;

use rand::RngExt;

use crate::clock::{MS, TrueNs};
use crate::plan::{Fault, OptionalReports, Setup, Timed};
use crate::random::{Purpose, stream};
use crate::violation::Violation;
use crate::world;

pub use cases::cases;

/// Position reports per second.
const RATE_HZ: u64 = 100;

/// Time in ms from the launch of a process to its first message. Beside a build on 2 cores it was 10 to 46 ms in 11
/// starts of a simulator, and 24 to 126 ms in 14 of 15 starts of a controller; an idle machine takes less.
const START_UP_MS: std::ops::RangeInclusive<u64> = 5..=130;

/// A fault with its name on the page.
pub struct Case {
    /// What is done.
    pub action: &'static str,
    /// Number of controllers; all but the first stand by.
    pub controllers: usize,
    /// Each part with its begin after the first, and its duration, in ms.
    parts: Vec<(u64, u64, Fault)>,
    /// Telemetry messages of the array per second.
    telemetry_hz: u64,
    /// The tests of real processes that cause the same fault.
    pub tests: &'static [&'static str],
    /// Why a measurement of real processes can be outside the range of the simulation.
    pub differs: Option<&'static str>,
}

/// What a fault does to the commands that an array follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effect {
    /// Longest time between two followed commands, in ms.
    pub gap_ms: f64,
    /// Commands that would have been followed at the rate of the reports, less those that were.
    pub lost: u64,
    /// From the end of the fault to the next followed command, in ms.
    pub recovery_ms: f64,
}

impl Case {
    /// The effect in the run of a seed.
    ///
    /// # Errors
    /// The violation of an invariant.
    pub fn run(&self, seed: u64) -> Result<Effect, Violation> {
        let setup = Setup {
            arrays: 1,
            controllers: self.controllers,
            is_reserve: true,
            has_ranks: false,
            rate_hz: RATE_HZ,
            counts_from_arrival: false,
            reports: OptionalReports::default(),
            rearms_at_end: true,
            telemetry_hz: self.telemetry_hz,
            is_busy: true,
            ..Setup::draw(seed)
        };
        let mut rng = stream(seed, Purpose::Plan);
        let at_ms = rng.random_range(3000..4000);
        let start_up_ms = rng.random_range(START_UP_MS);
        let timed = |(after_ms, for_ms, fault): &(u64, u64, Fault)| {
            let starts = matches!(fault, Fault::Crash { .. } | Fault::End { .. });
            let for_ms = for_ms + if starts { start_up_ms } else { 0 };
            Timed { at_ms: at_ms + after_ms, for_ms, fault: fault.clone() }
        };
        let faults: Vec<Timed> = self.parts.iter().map(timed).collect();
        // A process that is started again is launched at the end of its fault.
        let end_ms = self.parts.iter().map(|(after_ms, for_ms, _)| at_ms + after_ms + for_ms).max();
        let outcome = world::run(&setup, &faults, None, false);
        match outcome.violation {
            Some(violation) => Err(violation),
            None => Ok(effect(&outcome.accepted[0], at_ms * MS, end_ms.unwrap_or(at_ms) * MS)),
        }
    }
}

/// The effect on the commands that were followed at these times.
fn effect(accepted: &[TrueNs], begin: TrueNs, end: TrueNs) -> Effect {
    let interval = 1_000_000_000 / RATE_HZ;
    let before = accepted.partition_point(|at| *at < begin).saturating_sub(1);
    let window = &accepted[before..];
    let gap = window.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap_or_default();
    let first = window.first().copied().unwrap_or(begin);
    let last = window.last().copied().unwrap_or(begin);
    let due = (last - first + interval / 2) / interval;
    let next = accepted.iter().find(|at| **at >= end);
    Effect {
        gap_ms: gap as f64 / MS as f64,
        lost: due.saturating_sub(window.len() as u64 - 1),
        recovery_ms: next.map_or(f64::INFINITY, |at| (at - end) as f64 / MS as f64),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_effect_is_read_from_the_times_of_the_followed_commands() {
        let accepted: Vec<TrueNs> = [0, 10, 20, 60, 70, 80].map(|ms| ms * MS).to_vec();
        let effect = effect(&accepted, 25 * MS, 55 * MS);
        assert_eq!(effect, Effect { gap_ms: 40.0, lost: 3, recovery_ms: 5.0 });
    }
}
