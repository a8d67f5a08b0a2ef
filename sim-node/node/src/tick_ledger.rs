//! Matches each tick with the command that answers it, and measures the time between them.
//!
//! A tick is lost when no accepted command answers it within [`TICK_TIMEOUT_NS`]. Ticks before the
//! first answer count as unattended, not as lost, because no controller was in the room yet. So do ticks without an
//! answer while every array is stopped: no array accepts one then. Ticks after the last controller ended are lost.

use std::collections::VecDeque;

use hdrhistogram::Histogram;
use heliostat_proto::Quantiles;

/// A tick without an answer for this time is lost.
pub const TICK_TIMEOUT_NS: u64 = 500_000_000;

/// Latencies above this are recorded as this.
const LONGEST_NS: u64 = 10_000_000_000;

/// Matches ticks with their answers.
#[derive(Clone, Debug)]
pub struct TickLedger {
    in_flight: VecDeque<InFlight>,
    latency_ns: Histogram<u64>,
    attended: bool,
    published: u64,
    unattended: u64,
    lost: u64,
}

#[derive(Clone, Copy, Debug)]
struct InFlight {
    tick: u64,
    published_ns: u64,
    answered: bool,
    /// Whether no array could accept its answer.
    excused: bool,
}

impl Default for TickLedger {
    fn default() -> Self {
        let latency_ns =
            Histogram::new_with_bounds(1, LONGEST_NS, 3).expect("the bounds and the precision are constants in range");
        Self { in_flight: VecDeque::new(), latency_ns, attended: false, published: 0, unattended: 0, lost: 0 }
    }
}

impl TickLedger {
    /// Records a tick; to be called before its publication, because the answer may arrive before
    /// that returns.
    pub fn published(&mut self, tick: u64, now_ns: u64) {
        self.expire(now_ns);
        self.published += 1;
        self.in_flight.push_back(InFlight { tick, published_ns: now_ns, answered: false, excused: false });
    }

    /// Records the answer to a tick; returns the time since its publication if it is the first
    /// answer in time.
    pub fn answered(&mut self, tick: u64, now_ns: u64) -> Option<u64> {
        self.expire(now_ns);
        let index = self.in_flight.iter().position(|sent| sent.tick == tick && !sent.answered)?;
        if !self.attended {
            self.attended = true;
            self.unattended += index as u64;
            self.in_flight.drain(..index);
            return self.mark(0, now_ns);
        }
        self.mark(index, now_ns)
    }

    /// Excuses the ticks that wait for their answers, because every array is stopped: none of them gets lost.
    pub fn excuse(&mut self) {
        self.in_flight.iter_mut().for_each(|sent| sent.excused = true);
    }

    /// Removes ticks whose timeout has passed.
    pub fn expire(&mut self, now_ns: u64) {
        while let Some(oldest) = self.in_flight.front() {
            if !oldest.answered && now_ns.saturating_sub(oldest.published_ns) <= TICK_TIMEOUT_NS {
                break;
            }
            match (oldest.answered, self.attended && !oldest.excused) {
                (true, _) => {}
                (false, true) => self.lost += 1,
                (false, false) => self.unattended += 1,
            }
            self.in_flight.pop_front();
        }
    }

    /// Whether a tick still waits for its answer.
    pub fn is_waiting(&self) -> bool {
        self.in_flight.iter().any(|sent| !sent.answered)
    }

    /// Ticks since the first answer that still wait for theirs: neither answered nor lost.
    pub fn waiting(&self) -> u64 {
        if self.attended { self.in_flight.iter().filter(|sent| !sent.answered).count() as u64 } else { 0 }
    }

    /// Ticks that were published.
    pub fn published_count(&self) -> u64 {
        self.published
    }

    /// Ticks that were never answered in time, also those after the last controller ended.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Ticks before the first answer, and those without one while every array was stopped.
    pub fn unattended(&self) -> u64 {
        let waiting = if self.attended { 0 } else { self.in_flight.len() as u64 };
        self.unattended + waiting
    }

    /// From the publication of a tick to the arrival of the command that answers it, in ns.
    pub fn latency_ns(&self) -> &Histogram<u64> {
        &self.latency_ns
    }

    /// Quantiles of the latency.
    pub fn quantiles_us(&self) -> Quantiles {
        let histogram = &self.latency_ns;
        let at = |quantile| histogram.value_at_quantile(quantile) as f64 * 1e-3;
        let (p50, p90, p99, p999) = (at(0.5), at(0.9), at(0.99), at(0.999));
        Quantiles { count: histogram.len(), p50, p90, p99, p999, max: histogram.max() as f64 * 1e-3 }
    }

    fn mark(&mut self, index: usize, now_ns: u64) -> Option<u64> {
        let sent = self.in_flight.get_mut(index)?;
        sent.answered = true;
        let latency_ns = now_ns.saturating_sub(sent.published_ns);
        self.latency_ns.saturating_record(latency_ns.max(1));
        Some(latency_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matches_answers_out_of_order_and_counts_what_is_lost() {
        let mut ledger = TickLedger::default();
        for tick in 1..=6 {
            ledger.published(tick, tick * 1000);
        }
        assert_eq!((ledger.unattended(), ledger.lost(), ledger.waiting()), (6, 0, 0));
        // Ticks 1 and 2 were published before the first answer.
        assert_eq!(ledger.answered(3, 4000), Some(1000));
        assert_eq!(ledger.answered(5, 5200), Some(200));
        assert_eq!(ledger.answered(5, 5300), None, "a tick is answered once");
        assert_eq!(ledger.answered(77, 5300), None, "a tick that was never sent");
        assert_eq!(ledger.answered(4, 5500), Some(1500));
        assert!(ledger.is_waiting());
        // With the three that are answered, these are all.
        assert_eq!((ledger.unattended(), ledger.lost(), ledger.waiting()), (2, 0, 1));
        ledger.expire(6000 + TICK_TIMEOUT_NS);
        assert_eq!(ledger.lost(), 0);
        ledger.expire(6001 + TICK_TIMEOUT_NS);
        assert_eq!((ledger.unattended(), ledger.lost(), ledger.waiting()), (2, 1, 0));
        assert!(!ledger.is_waiting());
        let us = ledger.quantiles_us();
        assert_eq!(us.count, 3);
        assert!((us.p50 - 1.0).abs() < 0.01 && (us.max - 1.5).abs() < 0.01, "{us:?}");
    }

    #[test]
    fn ticks_without_an_answer_during_a_stop_are_unattended_and_not_lost() {
        let mut ledger = TickLedger::default();
        for tick in 1..=4 {
            ledger.published(tick, tick);
        }
        assert_eq!(ledger.answered(1, 5), Some(4));
        ledger.excuse();
        assert_eq!(ledger.answered(2, 6), Some(4), "a stop that was released in time");
        ledger.published(5, 7);
        ledger.expire(8 + TICK_TIMEOUT_NS);
        assert_eq!((ledger.unattended(), ledger.lost()), (2, 1), "the last one came after the stop");
    }

    #[test]
    fn ticks_after_the_controller_ended_are_lost_and_not_unattended() {
        let mut ledger = TickLedger::default();
        ledger.published(1, 1);
        assert_eq!(ledger.answered(1, 2), Some(1));
        ledger.published(2, 3);
        ledger.expire(4 + TICK_TIMEOUT_NS);
        assert_eq!((ledger.unattended(), ledger.lost()), (0, 1));
    }

    #[test]
    fn an_answer_after_the_timeout_is_too_late() {
        let mut ledger = TickLedger::default();
        ledger.published(1, 0);
        ledger.published(2, 10);
        assert_eq!(ledger.answered(1, 5), Some(5));
        assert_eq!(ledger.answered(2, 11 + TICK_TIMEOUT_NS), None);
        assert_eq!(ledger.lost(), 1);
    }
}
