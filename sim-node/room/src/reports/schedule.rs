//! When the samples of a stream are due: at k / rate seconds. Absolute due times do not drift.

/// The due times of one stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Schedule {
    rate_hz: f64,
    phase_ns: u64,
    next: u64,
}

/// A due time that has been reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Due {
    /// When the sample was due, in ns of local time.
    pub due_ns: u64,
    /// Later due times that have passed as well and are skipped.
    pub skipped: u64,
}

impl Schedule {
    /// Samples at `phase_ns` and every 1 / `rate_hz` seconds after it; a rate of 0 or less has no
    /// samples.
    pub fn new(rate_hz: f64, phase_ns: u64) -> Self {
        Self { rate_hz, phase_ns, next: 0 }
    }

    /// The next due time in ns of local time.
    pub fn next_ns(&self) -> Option<u64> {
        (self.rate_hz > 0.0).then(|| self.due_ns(self.next))
    }

    /// Takes the due time that has been reached; later ones that have passed too are skipped and
    /// counted.
    pub fn take(&mut self, now_ns: u64) -> Option<Due> {
        let due_ns = self.next_ns().filter(|due_ns| *due_ns <= now_ns)?;
        let first = self.next + 1;
        // The estimate is never too large; the loop corrects it against the due times.
        let elapsed_s = now_ns.saturating_sub(self.phase_ns) as f64 * 1e-9;
        self.next = first.max((elapsed_s * self.rate_hz) as u64);
        while self.due_ns(self.next) <= now_ns {
            self.next += 1;
        }
        Some(Due { due_ns, skipped: self.next - first })
    }

    /// The time between two due times in ns.
    pub fn period_ns(&self) -> u64 {
        (1e9 / self.rate_hz).round() as u64
    }

    fn due_ns(&self, index: u64) -> u64 {
        self.phase_ns + (index as f64 * 1e9 / self.rate_hz).round() as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn due_times_do_not_drift_and_streams_of_one_rate_coincide() {
        let mut thirds = Schedule::new(3.0, 0);
        let mut sixths = Schedule::new(6.0, 0);
        let mut last = 0;
        for _ in 0..3_000_000 / 1000 {
            last = thirds.next_ns().unwrap();
            assert_eq!(thirds.take(last), Some(Due { due_ns: last, skipped: 0 }));
            assert_eq!(sixths.take(last).map(|due| due.due_ns), Some(last));
            sixths.take(sixths.next_ns().unwrap());
        }
        assert_eq!(last, (2999.0_f64 * 1e9 / 3.0).round() as u64);
    }

    #[test]
    fn no_sample_is_due_early_and_skipped_due_times_are_counted() {
        let mut schedule = Schedule::new(100.0, 5_000_000);
        assert_eq!(schedule.take(4_999_999), None);
        assert_eq!(schedule.take(5_000_001), Some(Due { due_ns: 5_000_000, skipped: 0 }));
        assert_eq!(schedule.take(5_000_002), None);
        assert_eq!(schedule.take(36_000_000), Some(Due { due_ns: 15_000_000, skipped: 2 }));
        assert_eq!(schedule.next_ns(), Some(45_000_000));
        assert_eq!(Schedule::new(0.0, 0).next_ns(), None);
    }
}
