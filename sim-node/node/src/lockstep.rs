//! Lockstep: simulated time, in which each tick waits for the command that answers it.
//!
//! All input of the room comes from the seed and from the answers, in a fixed order. So the same
//! seed and the same controller give the same run, bit for bit; the hash in the summary confirms
//! it. Stamps are in simulated time. For each array only the first accepted command that answers the
//! current tick enters the room; others are counted as `not-awaited`.

use std::time::{Duration, Instant};

use heliostat_array::content::Content;
use heliostat_array::moment::Moment;
use heliostat_proto::MirrorCommand;
use heliostat_room::baselines::Measured;
use heliostat_room::reports::Report;
use heliostat_service::Stop;

use crate::error::NodeError;
use crate::node::Node;
use crate::summary::Summary;
use crate::truth_publisher::TruthPublisher;

/// Timeout for the presence of a controller.
const CONTROLLER_WAIT: Duration = Duration::from_secs(30);

/// Timeout of the answer to one tick.
const ANSWER_WAIT: Duration = Duration::from_secs(10);

/// Longest wait, so that a stop request takes effect soon.
const WAIT_SLICE: Duration = Duration::from_millis(50);

/// Simulated room time at the start; not 0, which means "never" in messages.
const START_NS: u64 = 1_000_000_000;

pub(crate) fn run(mut node: Node, ticks: u64, stop: &Stop) -> Result<Summary, NodeError> {
    await_controller(&mut node, stop)?;
    let mut publisher = node.truth_publisher()?;
    node.publish_capabilities(Moment { local_ns: 0, room_ns: START_NS })?;
    let mut hash = Fnv1a::default();
    let mut answered = 0;
    while answered < ticks && !stop.is_requested() {
        node.check_claim()?;
        let local_ns = next_event_ns(&node);
        let now = Moment { local_ns, room_ns: START_NS + local_ns };
        node.room.advance(local_ns);
        node.reports.sample(now, node.room.world(), node.room.angles());
        node.compare_beliefs(now);
        while let Some(report) = node.reports.release(local_ns) {
            answered += publish(&mut node, &report, now, &mut hash, stop)?;
        }
        node.refuse_orders();
        node.publish_telemetry(now)?;
        if node.truth.take(local_ns).is_some() {
            hash.truth(publisher.truth(&node.snapshot(now))?);
        }
        publish_status(&mut node, &mut publisher, now)?;
    }
    let mut summary = node.summary(&publisher.measurements());
    summary.hash = Some(format!("{:016x}", hash.0));
    node.session.close()?;
    Ok(summary)
}

/// Publishes a report, and for positions waits for the answer; returns the number of ticks
/// answered.
fn publish(node: &mut Node, report: &Report, now: Moment, hash: &mut Fnv1a, stop: &Stop) -> Result<u64, NodeError> {
    let (ticks, clock) = (&mut node.ticks, node.clock);
    node.session.publish(report, || {
        if let Report::Users(report) = report {
            ticks.published(report.tick, clock.local_ns());
        }
    })?;
    let Report::Users(report) = report else { return Ok(0) };
    // A controller sends no command to an array that is stopped.
    let arrays = match node.obedient() {
        none if none.is_empty() => vec![0],
        some => some,
    };
    for array in arrays {
        let Some(command) = await_answer(node, array, (report.tick, now), stop)? else { return Ok(0) };
        hash.command(&command);
    }
    Ok(1)
}

/// Waits for the command to an array that answers the tick and gives it to the room; `None` when
/// stopped.
fn await_answer(
    node: &mut Node,
    array: usize,
    (tick, now): (u64, Moment),
    stop: &Stop,
) -> Result<Option<MirrorCommand>, NodeError> {
    let begun = Instant::now();
    while begun.elapsed() < ANSWER_WAIT {
        if stop.is_requested() {
            return Ok(None);
        }
        let Some(arrival) = node.session.received(array).pop_until(Instant::now() + WAIT_SLICE) else { continue };
        if let Content::Command(Ok(MirrorCommand { answers, .. })) = &arrival.content
            && *answers != tick
        {
            node.refused
                .count("not-awaited", format!("a command answers tick {answers}: expected an answer to tick {tick}"));
            continue;
        }
        if let Some(command) = node.handle(array, arrival, (now, now)) {
            return Ok(Some(command));
        }
    }
    let last_problem = match node.refused.last_problem() {
        "" => String::new(),
        problem => format!("; last problem: {problem}"),
    };
    Err(NodeError::NoAnswer { tick, waited_s: ANSWER_WAIT.as_secs(), last_problem })
}

fn await_controller(node: &mut Node, stop: &Stop) -> Result<(), NodeError> {
    let begun = Instant::now();
    while !stop.is_requested() && !node.session.controller_is_alive()? {
        node.check_claim()?;
        if begun.elapsed() > CONTROLLER_WAIT {
            return Err(NodeError::NoController {
                room: node.session.room_name(),
                waited_s: CONTROLLER_WAIT.as_secs(),
            });
        }
        std::thread::sleep(WAIT_SLICE);
    }
    Ok(())
}

/// Publishes the status, paced by real time; it does not affect the room.
fn publish_status(node: &mut Node, publisher: &mut TruthPublisher, now: Moment) -> Result<(), NodeError> {
    if node.status.take(node.clock.local_ns()).is_some() {
        publisher.status(node.status_and_metrics(now.room_ns))?;
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

    /// The parts of a command that affect the room; not epoch and sequence, which identify the
    /// sender.
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
    fn the_hash_is_fnv_1a_of_every_bit_of_a_command_except_its_sender() {
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
