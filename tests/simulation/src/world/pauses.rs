//! Pauses of processes on a machine with few cores.

use rand::RngExt;

use super::{Event, World};
use crate::clock::MS;
use crate::random::Rng;

/// Longest pause in ns.
pub(super) const PAUSE_MAX_NS: u64 = 50 * MS;

/// Shortest pause in ns that is modelled, and the mean time between two pauses of a process. A thread that sleeps
/// for 10 ms beside a build on 2 cores was late by more than this 1.5 times in 100. The share that was late by
/// more falls with the square of the time.
const PAUSE_MIN_NS: u64 = 2 * MS;
const BETWEEN_NS: u64 = 667 * MS;

impl World {
    /// Lets the processes of a busy machine pause.
    pub(super) fn begin_pauses(&mut self) {
        for host in 0..self.hosts.len() {
            self.schedule_pause(host);
        }
    }

    /// A process does not run for some time; what arrives waits.
    pub(super) fn pause(&mut self, host: usize) {
        let until = self.now + length_ns(&mut self.pauses);
        if self.is_running(host) {
            self.hosts[host].busy_until = until;
            self.schedule(until, Event::Resume(host));
        }
        self.schedule_pause(host);
    }

    fn schedule_pause(&mut self, host: usize) {
        let after_ns = self.pauses.random_range(0..2 * BETWEEN_NS);
        self.schedule(self.now + after_ns, Event::Pause(host));
    }
}

fn length_ns(rng: &mut Rng) -> u64 {
    let share: f64 = rng.random_range(f64::MIN_POSITIVE..1.0);
    ((PAUSE_MIN_NS as f64 / share.sqrt()) as u64).min(PAUSE_MAX_NS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    #[test]
    fn long_pauses_are_as_rare_as_measured() {
        let mut rng = stream(1, Purpose::Pauses);
        let lengths: Vec<u64> = (0..40_000).map(|_| length_ns(&mut rng)).collect();
        let share = |least_ms: u64| lengths.iter().filter(|ns| **ns > least_ms * MS).count() as f64 / 40_000.0;
        assert!((share(4) - 0.25).abs() < 0.02 && (share(20) - 0.01).abs() < 0.003, "{} {}", share(4), share(20));
        assert!(lengths.iter().all(|ns| (PAUSE_MIN_NS..=PAUSE_MAX_NS).contains(ns)));
    }
}
