//! Live operation: the room runs in real time, paced by absolute due times.
//!
//! Delayed wake-ups do not accumulate: the world advances to the present time, and due times that
//! have passed are skipped and counted. Commands are stamped on arrival and take effect at that
//! time, although the loop handles them when it wakes up.

use std::time::{Duration, Instant};

use heliostat_array::moment::Moment;
use heliostat_array::refusal_counts::DROPPED;
use heliostat_driver::run::SLEEP_MAX;
use heliostat_room::reports::Report;
use heliostat_service::{Stop, clock::as_ns};

use crate::error::NodeError;
use crate::node::Node;
use crate::summary::Summary;
use crate::tick_ledger::TICK_TIMEOUT_NS;
use crate::truth_publisher::PublisherThread;

/// Longest wait for one of the answers to the last ticks.
const DRAIN_SLEEP: Duration = Duration::from_millis(1);

pub(crate) fn run(mut node: Node, duration: Option<Duration>, stop: &Stop) -> Result<Summary, NodeError> {
    let mut publisher = node.truth_publisher()?.into_thread();
    let end_ns = duration.map_or(u64::MAX, as_ns);
    while !stop.is_requested() && node.clock.local_ns() < end_ns && !publisher.has_failed() {
        sleep_until(&node, next_event_ns(&node).min(end_ns));
        let now = node.clock.now();
        if now.local_ns < end_ns {
            run_due(&mut node, &mut publisher, now)?;
        }
    }
    if !stop.is_requested() {
        drain(&mut node);
        node.keep_latches(false);
    }
    node.refused.set(DROPPED, node.session.dropped());
    let skipped_instants = publisher.skipped();
    let measurements = publisher.finish()?;
    let summary = Summary { skipped_instants, ..node.summary(&measurements) };
    node.session.close()?;
    Ok(summary)
}

/// Runs everything that is due now.
fn run_due(node: &mut Node, publisher: &mut PublisherThread, now: Moment) -> Result<(), NodeError> {
    node.check_claim()?;
    handle_received(node);
    node.apply_orders(now);
    // Before the first report, so that its answer can respect them.
    if node.capabilities.take(now.local_ns).is_some() {
        node.publish_capabilities(now)?;
        node.keep_latches(true);
        node.publish_safety(now)?;
    }
    if node.reports.next_sample_ns() <= now.local_ns {
        node.room.advance(now.local_ns);
        node.reports.sample(now, node.room.world(), node.room.angles());
        node.compare_beliefs(now);
    }
    while let Some(report) = node.reports.release(now.local_ns) {
        let (ticks, clock) = (&mut node.ticks, node.clock);
        node.session.publish(&report, || {
            if let Report::Users(report) = &report {
                ticks.published(report.tick, clock.local_ns());
            }
        })?;
    }
    // After the publication, so that a stop excuses each tick that waits for an answer.
    node.excuse_ticks();
    node.publish_telemetry(now)?;
    if node.truth.take(now.local_ns).is_some() {
        node.room.advance(now.local_ns);
        publisher.truth(node.snapshot(now));
    }
    if node.status.take(now.local_ns).is_some() {
        node.ticks.expire(now.local_ns);
        node.log_refusals();
        publisher.status(node.status_and_metrics(now.room_ns));
    }
    Ok(())
}

fn handle_received(node: &mut Node) {
    for array in 0..node.room.arrays() {
        while let Some(arrival) = node.session.received(array).pop() {
            // The mirrors have their own time line: the wait for this loop is no wait of the array.
            let at = arrival.at;
            node.handle(array, arrival, (at, at));
        }
    }
}

/// Waits for the answers to the last ticks until their timeout.
fn drain(node: &mut Node) {
    let give_up_ns = node.clock.local_ns() + TICK_TIMEOUT_NS;
    while node.ticks.is_waiting() && node.clock.local_ns() < give_up_ns {
        for array in 0..node.room.arrays() {
            if let Some(arrival) = node.session.received(array).pop_until(Instant::now() + DRAIN_SLEEP) {
                let at = arrival.at;
                node.handle(array, arrival, (at, at));
            }
        }
    }
    node.excuse_ticks();
    node.ticks.expire(node.clock.local_ns());
}

fn next_event_ns(node: &Node) -> u64 {
    let schedules = [node.telemetry, node.truth, node.status, node.capabilities];
    let next = schedules.into_iter().filter_map(|schedule| schedule.next_ns()).min().unwrap_or(u64::MAX);
    next.min(node.reports.next_sample_ns()).min(node.reports.next_release_ns())
}

/// Sleeps until a local time; a stop that arrives ends the sleep.
fn sleep_until(node: &Node, local_ns: u64) {
    let left = node.clock.instant_at(local_ns.min(node.clock.local_ns() + as_ns(SLEEP_MAX)));
    node.session.wait_for_stop(left);
}
