//! The clock of a host as a function of true time.

use heliostat_array::moment::Moment;

/// True time in ns since the start of a run.
pub type TrueNs = u64;

/// One ms in ns.
pub const MS: u64 = 1_000_000;

/// UTC at the start of a run in ns: 2025-12-29.
pub const START_UTC_NS: u64 = 1_767_000_000 * 1000 * MS;

/// Local time at the start of a run, as of a host that was booted before, in ns.
const BOOTED_NS: u64 = 60_000 * MS;

/// UTC and monotonic time of one host: offset, rate and steps of UTC; the rate concerns both.
#[derive(Clone, Debug)]
pub(crate) struct Clock {
    rate_ppm: i64,
    /// True time since which the rate holds.
    since: TrueNs,
    room_ns: u64,
    local_ns: u64,
}

impl Clock {
    /// A clock that is ahead of UTC by an offset.
    pub fn new(offset_ns: i64, rate_ppm: i64) -> Self {
        Self { rate_ppm, since: 0, room_ns: START_UTC_NS.saturating_add_signed(offset_ns), local_ns: BOOTED_NS }
    }

    /// Both times of the host at a true time.
    pub fn at(&self, now: TrueNs) -> Moment {
        let passed = self.passed(now);
        Moment { local_ns: self.local_ns + passed, room_ns: self.room_ns + passed }
    }

    /// The first true time at which the local time has been reached.
    pub fn when(&self, local_ns: u64) -> TrueNs {
        let passed = u128::from(local_ns.saturating_sub(self.local_ns));
        let rate = (1_000_000 + self.rate_ppm) as u128;
        let mut at = self.since + (passed * 1_000_000 / rate) as u64;
        while self.at(at).local_ns < local_ns {
            at += 1;
        }
        at
    }

    /// Sets UTC forward or back.
    pub fn step(&mut self, now: TrueNs, by_ns: i64) {
        self.settle(now);
        self.room_ns = self.room_ns.saturating_add_signed(by_ns);
    }

    /// Changes the rate by so many parts per million.
    pub fn change_rate(&mut self, now: TrueNs, by_ppm: i64) {
        self.settle(now);
        self.rate_ppm += by_ppm;
    }

    fn settle(&mut self, now: TrueNs) {
        let Moment { local_ns, room_ns } = self.at(now);
        (self.since, self.local_ns, self.room_ns) = (now, local_ns, room_ns);
    }

    fn passed(&self, now: TrueNs) -> u64 {
        let passed = i128::from(now.saturating_sub(self.since));
        (passed + passed * i128::from(self.rate_ppm) / 1_000_000) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_moves_utc_alone_and_a_rate_moves_both_times() {
        let mut clock = Clock::new(-5, 0);
        assert_eq!(clock.at(10).room_ns, START_UTC_NS + 5);
        clock.step(10, 1000);
        assert_eq!(clock.at(10), Moment { local_ns: BOOTED_NS + 10, room_ns: START_UTC_NS + 1005 });
        clock.change_rate(10, 500_000);
        assert_eq!(clock.at(110), Moment { local_ns: BOOTED_NS + 160, room_ns: START_UTC_NS + 1155 });
    }

    #[test]
    fn a_local_time_is_reached_at_the_true_time_that_is_named() {
        let mut clock = Clock::new(0, -70);
        clock.change_rate(12_345, 333);
        for local_ns in [BOOTED_NS, BOOTED_NS + 1, BOOTED_NS + 12_346, BOOTED_NS + 987_654_321] {
            let at = clock.when(local_ns);
            assert!(
                clock.at(at).local_ns >= local_ns && (at == 0 || clock.at(at - 1).local_ns < local_ns || at == 12_345)
            );
        }
    }
}
