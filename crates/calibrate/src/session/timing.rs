//! Which report measures which command, and when the next command is due.
//!
//! A report measures a command if it was sampled after the mirrors had settled, and before the next
//! command was sent. So the next command is due as soon as a sample must have been taken, which is
//! before its report arrives: the latency of the reports costs no time.

use std::collections::VecDeque;

use heliostat_channel::MirrorAngles;
use heliostat_proto::{Capabilities, Nanos};

/// Time in ns from a command to the mirrors before telemetry has shown one.
const DELAY_NS: Nanos = 5_000_000;

/// Largest delay that is believed, in ns.
const DELAY_MAX_NS: Nanos = 500_000_000;

/// Margin in ns for the clocks of the hosts, at most a tenth of the time between two samples.
const MARGIN_NS: Nanos = 2_000_000;

/// Settling time in s of an array that announces none.
const SETTLING_S: f64 = 0.005;

/// Commands that are remembered: reports older than these are not used.
const REMEMBERED: usize = 256;

/// Differences of sample times from which the time between two samples is taken.
const DIFFERENCES: usize = 16;

/// A time without readings, in times between two samples, in which the receiver was carried.
const CARRIED_PERIODS: Nanos = 10;

/// Commands whose readings decide whether samples can be predicted.
const JUDGED: u32 = 24;

/// What a command is for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Purpose {
    /// All mirrors away.
    Dark,
    /// One mirror at these angles.
    Probe(usize, [f64; 2]),
    /// A pattern of a coded group: the group's number and the pattern.
    Group(u32, usize),
    /// Mirrors lit at this place in m, to find the spot: which, by the turn.
    Locate([f64; 2], u32),
    /// All mirrors at their nominal aims, or at the calibrated ones.
    Verify(bool),
}

#[derive(Clone, Debug)]
struct Sent {
    at_ns: Nanos,
    settled_ns: Nanos,
    purpose: Purpose,
    has_reading: bool,
}

/// The times of commands and samples.
#[derive(Clone, Debug)]
pub struct Timing {
    settling_ns: Nanos,
    slew_rad_s: f64,
    delay_ns: Nanos,
    sent: VecDeque<Sent>,
    angles: MirrorAngles,
    last_sample_ns: Nanos,
    differences: VecDeque<Nanos>,
    /// Of the latest commands: how many, and how many without a reading.
    judged: (u32, u32),
    /// Whether to wait for each report instead of predicting the samples.
    waits: bool,
    /// Readings, and the time in ns that they took.
    readings: f64,
    busy_ns: Nanos,
    /// Time of the last reading.
    reading_ns: Option<Nanos>,
}

impl Timing {
    /// The timing of an array.
    pub fn new(capabilities: &Capabilities) -> Self {
        let axes = [&capabilities.roll, &capabilities.yaw];
        let settling_s = axes.map(|axis| f64::from(axis.settling_s)).into_iter().fold(0.0, f64::max);
        let settling_s = if settling_s > 0.0 { settling_s } else { SETTLING_S };
        let slew = axes.map(|axis| f64::from(axis.slew_rad_s)).into_iter().filter(|slew| *slew > 0.0);
        Self {
            settling_ns: (settling_s * 1e9) as Nanos,
            slew_rad_s: slew.fold(f64::INFINITY, f64::min),
            delay_ns: DELAY_NS,
            sent: VecDeque::new(),
            angles: MirrorAngles::default(),
            last_sample_ns: 0,
            differences: VecDeque::new(),
            judged: (0, 0),
            waits: false,
            readings: 0.0,
            busy_ns: 0,
            reading_ns: None,
        }
    }

    /// Notes a sample.
    pub fn handle_sample(&mut self, time_ns: Nanos) {
        if self.last_sample_ns > 0 && time_ns > self.last_sample_ns {
            self.differences.push_back(time_ns - self.last_sample_ns);
            if self.differences.len() > DIFFERENCES {
                self.differences.pop_front();
            }
        }
        self.last_sample_ns = self.last_sample_ns.max(time_ns);
    }

    /// Notes the delay of a command.
    pub fn handle_delay(&mut self, delay_ns: Nanos) {
        if delay_ns <= DELAY_MAX_NS {
            // The longest of late, because a command that comes too late spoils its reading.
            self.delay_ns = delay_ns.max(self.delay_ns - self.delay_ns / 64);
        }
    }

    /// Time between two samples in ns; `None` before it is known. The median, so that lost reports
    /// do not count.
    pub fn period_ns(&self) -> Option<Nanos> {
        let mut sorted: Vec<Nanos> = self.differences.iter().copied().collect();
        sorted.sort_unstable();
        (sorted.len() >= 3).then(|| sorted[sorted.len() / 2])
    }

    /// Mean time for a reading in s, while the receiver is at its places.
    pub fn seconds_per_reading(&self) -> f64 {
        let period_s = self.period_ns().map_or(0.1, |period| period as f64 * 1e-9);
        if self.readings > 30.0 {
            (self.busy_ns as f64 * 1e-9 / self.readings).clamp(period_s, 3.0 * period_s)
        } else {
            period_s
        }
    }

    /// Whether a command is due at `now`.
    pub fn is_due(&self, now: Nanos) -> bool {
        now >= self.due_ns()
    }

    /// When the next command is due: after the sample that measures the last one.
    pub fn due_ns(&self) -> Nanos {
        let Some(last) = self.sent.back() else { return 0 };
        let Some(period) = self.period_ns() else { return Nanos::MAX };
        if self.waits && self.last_sample_ns < last.settled_ns {
            return Nanos::MAX;
        }
        if self.last_sample_ns >= last.settled_ns {
            return 0;
        }
        let periods = (last.settled_ns - self.last_sample_ns).div_ceil(period);
        self.last_sample_ns + periods * period + MARGIN_NS.min(period / 10)
    }

    /// Notes a command.
    pub fn handle_sent(&mut self, at_ns: Nanos, purpose: Purpose, angles: &MirrorAngles) {
        let before = if self.angles.len() == angles.len() { &self.angles } else { angles };
        let pairs = before.roll.iter().zip(&angles.roll).chain(before.yaw.iter().zip(&angles.yaw));
        let turn = pairs.map(|(from, to)| (to - from).abs()).fold(0.0, f64::max);
        let turn_ns = (turn / self.slew_rad_s * 1e9) as Nanos;
        let settled_ns = at_ns + self.delay_ns + turn_ns + self.settling_ns;
        self.sent.push_back(Sent { at_ns, settled_ns, purpose, has_reading: false });
        if self.sent.len() > REMEMBERED {
            self.sent.pop_front();
        }
        self.angles.clone_from(angles);
    }

    /// No sample measures a command so far.
    pub fn forget_sent(&mut self) {
        self.sent.clear();
    }

    /// What a sample of this time measures; `None` while mirrors turned.
    pub fn purpose_at(&mut self, time_ns: Nanos) -> Option<Purpose> {
        let sent = self.sent.iter_mut().rev().find(|sent| sent.at_ns <= time_ns)?;
        if time_ns < sent.settled_ns {
            return None;
        }
        sent.has_reading = true;
        let purpose = sent.purpose;
        self.note_reading(time_ns);
        Some(purpose)
    }

    /// Counts a reading and the time since the one before, unless the receiver was carried meanwhile.
    fn note_reading(&mut self, time_ns: Nanos) {
        let before_ns = self.reading_ns.replace(time_ns).unwrap_or(time_ns);
        let since_ns = time_ns.saturating_sub(before_ns);
        if self.period_ns().is_some_and(|period| since_ns <= CARRIED_PERIODS * period) {
            self.readings += 1.0;
            self.busy_ns += since_ns;
        }
    }

    /// The purposes of commands that no sample measures any more: a later command was sent before
    /// the sample of this time.
    pub fn take_lost(&mut self, time_ns: Nanos) -> Vec<Purpose> {
        let mut lost = Vec::new();
        while let [first, second, ..] =
            [self.sent.front(), self.sent.get(1)].into_iter().flatten().collect::<Vec<_>>()[..]
            && second.at_ns <= time_ns
        {
            self.judged.0 += 1;
            if !first.has_reading {
                self.judged.1 += 1;
                lost.push(first.purpose);
            }
            self.sent.pop_front();
        }
        if self.judged.0 >= JUDGED {
            // Where most predictions fail, the samples are not regular.
            self.waits |= 2 * self.judged.1 > self.judged.0;
            self.judged = (0, 0);
        }
        lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_walk_between_two_spots_makes_no_reading_slower() {
        let mut timing = Timing::new(&Capabilities::default());
        let angles = MirrorAngles::flat(1);
        let mut read = |from_ms: Nanos| {
            for at_ns in (0..40).map(|index| (from_ms + index * 50) * 1_000_000) {
                timing.handle_sample(at_ns);
                timing.purpose_at(at_ns);
                timing.handle_sent(at_ns, Purpose::Dark, &angles);
            }
            timing.seconds_per_reading()
        };
        assert!((read(1000) - 0.05).abs() < 1e-3);
        assert!((read(120_000) - 0.05).abs() < 1e-3);
    }
}
