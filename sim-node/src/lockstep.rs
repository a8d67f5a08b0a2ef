//! Lockstep: simulated time, in which each tick waits for the command that answers it.
//!
//! Everything that enters the room comes from the seed and from the answers, in one order, so the same seed and the same controller give
//! the same run, bit for bit; the hash in the summary shows it. Stamps are simulated time. Only the first accepted command that answers
//! the tick under way enters the room; others are counted as `not-awaited`.

use std::time::{Duration, Instant};

use heliostat_array::content::Content;
use heliostat_array::moment::Moment;
use heliostat_proto::MirrorCommand;
use heliostat_service::Stop;

use crate::node::{Node, NodeError};
use crate::reporter::Reporter;
use crate::summary::Summary;
use heliostat_sim::baselines::Measured;
use heliostat_sim::streams::Report;

/// How long a controller is waited for.
const CONTROLLER_WAIT: Duration = Duration::from_secs(30);

/// How long the answer to one tick is waited for.
const ANSWER_WAIT: Duration = Duration::from_secs(10);

/// A stop is noticed after this long at the latest.
const LISTEN_SLICE: Duration = Duration::from_millis(50);

/// Simulated room time at the start; not 0, which stands for "never" in messages.
const START_NS: u64 = 1_000_000_000;

pub(crate) fn run(mut node: Node, ticks: u64, stop: &Stop) -> Result<Summary, NodeError> {
    await_controller(&node, stop)?;
    let mut reporter = node.reporter()?;
    node.announce_capabilities(Moment { local_ns: 0, room_ns: START_NS })?;
    let mut hash = Fnv1a::default();
    let mut answered = 0;
    while answered < ticks && !stop.is_requested() {
        let local_ns = next_event_ns(&node);
        let now = Moment { local_ns, room_ns: START_NS + local_ns };
        node.room.advance(local_ns);
        node.reports.sample(now, node.room.world(), node.room.angles());
        while let Some(report) = node.reports.release(local_ns) {
            answered += publish(&mut node, &report, now, &mut hash, stop)?;
        }
        node.refuse_orders();
        node.tell_mirrors(now)?;
        if node.truth.take(local_ns).is_some() {
            hash.truth(reporter.truth(&node.snapshot(now))?);
        }
        show_status(&mut node, &mut reporter, now)?;
    }
    let mut summary = node.summary(&reporter.measurements());
    summary.hash = Some(format!("{:016x}", hash.0));
    node.edge.close()?;
    Ok(summary)
}

/// Publishes a report; positions wait for their answer. Gives the number of ticks answered.
fn publish(node: &mut Node, report: &Report, now: Moment, hash: &mut Fnv1a, stop: &Stop) -> Result<u64, NodeError> {
    let (ledger, clock) = (&mut node.ledger, node.clock);
    node.edge.publish(report, || {
        if let Report::Users(report) = report {
            ledger.published(report.tick, clock.local_ns());
        }
    })?;
    let Report::Users(report) = report else { return Ok(0) };
    match await_answer(node, report.tick, now, stop)? {
        Some(command) => {
            hash.command(&command);
            Ok(1)
        }
        None => Ok(0),
    }
}

/// The command that answers the tick, given to the room; nothing when stopped.
fn await_answer(node: &mut Node, tick: u64, now: Moment, stop: &Stop) -> Result<Option<MirrorCommand>, NodeError> {
    let begun = Instant::now();
    while begun.elapsed() < ANSWER_WAIT {
        if stop.is_requested() {
            return Ok(None);
        }
        let Some(arrival) = node.edge.inbox().pop_until(Instant::now() + LISTEN_SLICE) else { continue };
        if let Content::Command(Ok(MirrorCommand { answers, .. })) = &arrival.content
            && *answers != tick
        {
            node.refused.count("not-awaited", format!("a command that answers tick {answers} during tick {tick}"));
            continue;
        }
        if let Some(command) = node.receive(arrival, now) {
            return Ok(Some(command));
        }
    }
    let last_problem = match node.refused.last_problem() {
        "" => String::new(),
        problem => format!("; last problem: {problem}"),
    };
    Err(NodeError::NoAnswer { tick, waited_s: ANSWER_WAIT.as_secs(), last_problem })
}

fn await_controller(node: &Node, stop: &Stop) -> Result<(), NodeError> {
    let begun = Instant::now();
    while !stop.is_requested() && !node.edge.controller_is_alive()? {
        if begun.elapsed() > CONTROLLER_WAIT {
            return Err(NodeError::NoController { room: node.edge.room_name(), waited_s: CONTROLLER_WAIT.as_secs() });
        }
        std::thread::sleep(LISTEN_SLICE);
    }
    Ok(())
}

/// A status twice a second of real time; nothing of it enters the room.
fn show_status(node: &mut Node, reporter: &mut Reporter, now: Moment) -> Result<(), NodeError> {
    if node.status.take(node.clock.local_ns()).is_some() {
        reporter.status(node.account(now.room_ns))?;
    }
    Ok(())
}

fn next_event_ns(node: &Node) -> u64 {
    let schedules = [node.telemetry, node.truth];
    let next = schedules.into_iter().filter_map(|schedule| schedule.next_ns()).min().unwrap_or(u64::MAX);
    next.min(node.reports.next_sample_ns()).min(node.reports.next_release_ns())
}

/// The 64-bit FNV-1a hash (Fowler, Noll, Vo).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Fnv1a(u64);

impl Default for Fnv1a {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Fnv1a {
    fn bytes(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }

    /// What the room gets of a command; not epoch and sequence, which name the sender's run.
    fn command(&mut self, command: &MirrorCommand) {
        self.bytes(&command.answers.to_le_bytes());
        self.bytes(&command.time_ns.to_le_bytes());
        self.bytes(&command.validity_ms.to_le_bytes());
        for angle in command.roll.iter().chain(&command.yaw) {
            self.bytes(&angle.to_bits().to_le_bytes());
        }
    }

    fn truth(&mut self, measured: &Measured) {
        let sums = &measured.sum_rates_bps;
        let sums = [sums.policy, sums.no_irs, sums.flat, sums.oracle];
        for value in sums.iter().chain(&measured.rates_bps).chain(&measured.los_gain).chain(&measured.irs_gain) {
            self.bytes(&value.to_bits().to_le_bytes());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hash_is_fnv_1a_and_sees_every_bit_of_a_command_but_its_sender() {
        let mut hash = Fnv1a::default();
        hash.bytes(b"foobar");
        assert_eq!(hash.0, 0x8594_4171_f739_67e8, "published test vector");

        let of = |change: fn(&mut MirrorCommand)| {
            let mut command = MirrorCommand { roll: vec![0.1, 0.2], yaw: vec![0.3, 0.4], ..MirrorCommand::default() };
            change(&mut command);
            let mut hash = Fnv1a::default();
            hash.command(&command);
            hash.0
        };
        let plain = of(|_| {});
        assert_ne!(plain, of(|c| c.yaw[1] = f32::from_bits(c.yaw[1].to_bits() ^ 1)));
        assert_ne!(plain, of(|c| c.time_ns = 1));
        assert_eq!(plain, of(|c| c.epoch = 9));
    }
}
