//! When a connection carries messages again after its packets were lost.
//!
//! A link that works again is not used at once. TCP sends the oldest lost packet again after a timeout that
//! doubles each time (RFC 6298, section 5.5). A connection that was silent for the lease is closed, and opened
//! again by attempts whose period doubles (`connect/retry` in `crates/bus/src/config.rs`).

use rand::RngExt;

use super::{Event, World};
use crate::clock::{MS, TrueNs};
use crate::plan::Fault;
use crate::random::Rng;

/// Time without a message after which a connection is closed and its tokens end, in ns: `lease` in
/// `crates/bus/src/config.rs`.
pub(super) const LEASE_NS: u64 = 5000 * MS;

/// First and longest period of the attempts to connect in ns.
const RETRY_NS: (u64, u64) = (50 * MS, 1000 * MS);

/// The least timeout of TCP in ns, as in Linux, and what the time of a round trip adds to it at most.
const TIMEOUT_NS: (u64, u64) = (200 * MS, 4 * MS);

impl World {
    /// A partition ends: its connections carry messages again, now or later.
    pub(super) fn end_partition(&mut self, index: usize) {
        let begin = self.faults[index].at_ms * MS;
        let at = carries_again(begin, self.now, &mut self.connections);
        self.schedule(at, Event::Connected(index));
    }

    /// The connections of a partition carry messages again.
    pub(super) fn connect(&mut self, fault: &Fault) {
        self.network.end(fault);
        self.release_held();
        self.update_presence();
    }
}

/// When a connection whose packets were lost from `begin` to `end` carries messages again.
fn carries_again(begin: TrueNs, end: TrueNs, rng: &mut Rng) -> TrueNs {
    let (timeout_ns, share) = (TIMEOUT_NS.0 + rng.random_range(0..TIMEOUT_NS.1), rng.random_range(0.0..1.0));
    let closed = begin + LEASE_NS;
    if end >= closed {
        let period_ns = (end - closed).clamp(RETRY_NS.0, RETRY_NS.1);
        return end + (share * period_ns as f64) as u64;
    }
    // Before the first timeout, the next packets show at once which one is lost.
    if end < begin + timeout_ns {
        return end;
    }
    let mut wait_ns = timeout_ns;
    let mut sent = begin + wait_ns;
    while sent < end {
        wait_ns *= 2;
        sent += wait_ns;
    }
    sent.min(closed + (share * RETRY_NS.0 as f64) as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    fn after(lost_ms: u64) -> f64 {
        let mut rng = stream(1, Purpose::Connections);
        let end = lost_ms * MS;
        (carries_again(0, end, &mut rng) - end) as f64 / MS as f64
    }

    #[test]
    fn a_connection_carries_again_at_the_next_retransmission_or_attempt() {
        assert_eq!(after(150), 0.0);
        // Retransmissions after 1, 3, 7 and 15 timeouts of 200 to 204 ms.
        assert!((400.0..430.0).contains(&after(1000)), "{}", after(1000));
        assert!((0.0..=60.0).contains(&after(3000)), "{}", after(3000));
        // Closed after 5 s, and opened again.
        assert!((1000.0..=1050.0).contains(&after(4000)), "{}", after(4000));
        assert!((0.0..=1000.0).contains(&after(30_000)), "{}", after(30_000));
    }
}
