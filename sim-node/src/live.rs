//! Live operation: the room runs as time passes, paced by absolute deadlines.
//!
//! Late wake-ups do not add up: the world is moved to the time that it is, and deadlines that have passed are left out and counted.
//! Commands are stamped as they come in and take effect at that time, although the loop looks at them only when it wakes.

use std::time::{Duration, Instant};

use heliostat_array::moment::Moment;
use heliostat_driver::clock::as_ns;
use heliostat_service::Stop;

use crate::ledger::TICK_TIMEOUT_NS;
use crate::node::{Node, NodeError};
use crate::reporter::ReporterThread;
use crate::summary::Summary;
use heliostat_sim::streams::Report;

/// Longest sleep, so that a stop is noticed soon.
const SLEEP_MAX: Duration = Duration::from_millis(50);

/// Longest sleep while the answers to the last ticks are awaited.
const DRAIN_SLEEP: Duration = Duration::from_millis(1);

pub(crate) fn run(mut node: Node, duration: Option<Duration>, stop: &Stop) -> Result<Summary, NodeError> {
    let mut reporter = node.reporter()?.into_thread();
    let end_ns = duration.map_or(u64::MAX, as_ns);
    while !stop.is_requested() && node.clock.local_ns() < end_ns && !reporter.has_failed() {
        sleep_until(&node, next_event_ns(&node).min(end_ns));
        let now = node.clock.now();
        if now.local_ns < end_ns {
            turn(&mut node, &mut reporter, now)?;
        }
    }
    if !stop.is_requested() {
        drain(&mut node);
    }
    node.refused.set("shed", node.edge.inbox().shed());
    node.refused.set("truth-skipped", reporter.skipped());
    let measurements = reporter.finish()?;
    let summary = node.summary(&measurements);
    node.edge.close()?;
    Ok(summary)
}

/// Everything that is due now.
fn turn(node: &mut Node, reporter: &mut ReporterThread, now: Moment) -> Result<(), NodeError> {
    take_arrivals(node);
    node.obey_orders(now);
    // Before the first report, so that its answer can heed them.
    if node.capabilities.take(now.local_ns).is_some() {
        node.announce_capabilities(now)?;
    }
    if node.reports.next_sample_ns() <= now.local_ns {
        node.room.advance(now.local_ns);
        node.reports.sample(now, node.room.world(), node.room.angles());
    }
    while let Some(report) = node.reports.release(now.local_ns) {
        let (ledger, clock) = (&mut node.ledger, node.clock);
        node.edge.publish(&report, || {
            if let Report::Users(report) = &report {
                ledger.published(report.tick, clock.local_ns());
            }
        })?;
    }
    node.tell_mirrors(now)?;
    if node.truth.take(now.local_ns).is_some() {
        node.room.advance(now.local_ns);
        reporter.truth(node.snapshot(now));
    }
    if node.status.take(now.local_ns).is_some() {
        node.ledger.expire(now.local_ns);
        for token in node.edge.new_rivals() {
            node.refused.count("another-simulator", format!("another simulator came into the room: {token}"));
        }
        reporter.status(node.account(now.room_ns));
    }
    Ok(())
}

fn take_arrivals(node: &mut Node) {
    while let Some(arrival) = node.edge.inbox().pop() {
        let at = arrival.at;
        node.receive(arrival, at);
    }
}

/// Waits for the answers to the last ticks, as long as they may take.
fn drain(node: &mut Node) {
    let give_up_ns = node.clock.local_ns() + TICK_TIMEOUT_NS;
    while node.ledger.is_waiting() && node.clock.local_ns() < give_up_ns {
        if let Some(arrival) = node.edge.inbox().pop_until(Instant::now() + DRAIN_SLEEP) {
            let at = arrival.at;
            node.receive(arrival, at);
        }
    }
    node.ledger.expire(node.clock.local_ns());
}

fn next_event_ns(node: &Node) -> u64 {
    let schedules = [node.telemetry, node.truth, node.status, node.capabilities];
    let next = schedules.into_iter().filter_map(|schedule| schedule.next_ns()).min().unwrap_or(u64::MAX);
    next.min(node.reports.next_sample_ns()).min(node.reports.next_release_ns())
}

fn sleep_until(node: &Node, local_ns: u64) {
    let left = node.clock.instant_at(local_ns.min(node.clock.local_ns() + as_ns(SLEEP_MAX)));
    std::thread::sleep(left.saturating_duration_since(Instant::now()));
}
