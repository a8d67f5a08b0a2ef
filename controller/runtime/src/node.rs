//! The process: opens the rooms, checks them twice a second, and closes them in order.
//!
//! None of this is in the decision path.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use anyhow::Context;
use heliostat_bus::Bus;
use heliostat_core::room_core::WAKE_INTERVAL_NS;
use heliostat_proto::Room;
use heliostat_service::Stop;

use crate::{
    config::NodeConfig,
    pauses::Pauses,
    report::{metrics, summary::Summary},
    room_runtime::{RoomRuntime, transport::LocalArray},
};

/// Time between two status reports.
const STATUS_INTERVAL: Duration = Duration::from_millis(500);

/// Time without any position report after which a warning is logged.
const SILENCE: Duration = Duration::from_secs(3);

/// Time between two wakes of the rooms.
const WAKE_INTERVAL: Duration = Duration::from_nanos(WAKE_INTERVAL_NS);

/// Runs a controller until it is stopped, and returns its summary. This process drives the `local`
/// arrays of its first room.
///
/// # Errors
/// If a policy does not fit, or the bus cannot be opened.
pub fn run(config: &NodeConfig, mut local: Vec<LocalArray>, stop: &Stop) -> anyhow::Result<Summary> {
    let started = Instant::now();
    let exporter = config.metrics.open(config.bus.certificate_ends())?;
    let bus = Bus::open(&config.bus).context("cannot join the room")?;
    let others = config.also_rooms.iter().map(|room| bus.enter(room.clone()));
    let rooms: Vec<Bus> = std::iter::once(bus.enter(config.bus.room.clone())).chain(others).collect();
    let records: Vec<_> = local.iter().map(|local| Arc::clone(&local.is_recorded)).collect();
    let open = |room| RoomRuntime::open(room, config, std::mem::take(&mut local));
    let mut rooms = rooms.iter().map(open).collect::<anyhow::Result<Vec<_>>>()?;
    let deadline = config.run_for.map(|run_for| started + run_for);
    let mut next_check = Instant::now() + STATUS_INTERVAL;
    let mut silence = Silence::new(started);
    let mut pauses = Pauses::default();
    while !wait_for_stop(stop, deadline, &mut pauses) {
        rooms.iter_mut().for_each(RoomRuntime::handle_timeouts);
        if Instant::now() < next_check {
            continue;
        }
        next_check += STATUS_INTERVAL;
        let pause = pauses.recent(Instant::now());
        rooms.iter_mut().for_each(|room| room.check_status(pause));
        if let Some(exporter) = &exporter {
            let mut page = metrics::page(&rooms.iter().map(RoomRuntime::report).collect::<Vec<_>>());
            if !records.is_empty() {
                let is_recorded = records.iter().all(|record| record.load(Ordering::Relaxed));
                // A process with arrays has one room, which the page adds.
                page.stop_recorded(&[], is_recorded);
            }
            exporter.publish(page);
        }
        let has_reports = rooms.iter().any(|room| room.summary().decisions > 0);
        // The check of the connections has logged its reason.
        if silence.is_news(Instant::now(), has_reports, bus.connection_problem().is_some()) {
            tracing::warn!("{}", no_reports(config));
        }
    }
    rooms.iter_mut().for_each(RoomRuntime::close);
    let mut summary = Summary::of_rooms(&rooms.iter().map(RoomRuntime::report).collect::<Vec<_>>());
    if summary.decisions == 0 && summary.last_problem.is_empty() {
        summary.last_problem = bus.connection_problem().unwrap_or_else(|| no_reports(config));
    }
    drop(rooms);
    bus.close()?;
    Ok(summary)
}

/// The wait for the first position report, which is logged once.
struct Silence {
    /// Since when no other problem explains it.
    since: Instant,
    is_logged: bool,
}

impl Silence {
    fn new(since: Instant) -> Self {
        Self { since, is_logged: false }
    }

    /// Whether the absence of reports is to be logged now. While a connection is missing, that is the reason.
    fn is_news(&mut self, now: Instant, has_reports: bool, is_explained: bool) -> bool {
        if is_explained {
            self.since = now;
        }
        let is_news = !has_reports && !self.is_logged && now.saturating_duration_since(self.since) > SILENCE;
        self.is_logged |= is_news;
        is_news
    }
}

fn no_reports(config: &NodeConfig) -> String {
    let rooms: Vec<&str> = std::iter::once(&config.bus.room).chain(&config.also_rooms).map(Room::name).collect();
    describe_silence(&rooms, &config.bus.listen)
}

/// The endpoints to which the controller connects are not named: one of them may be of its own array, and the watch over
/// the connections names those that do not answer.
fn describe_silence(rooms: &[&str], listen: &[String]) -> String {
    let listening = if listen.is_empty() { String::new() } else { format!(", such as {}", listen.join(", ")) };
    format!(
        "no position report from room \"{}\": start the tracker or the simulator with the same --room and an endpoint in \
         common with this controller{listening}",
        rooms.join("\", \"")
    )
}

/// Waits until the rooms are due for a check; true if the node has to end instead.
fn wait_for_stop(stop: &Stop, deadline: Option<Instant>, pauses: &mut Pauses) -> bool {
    let begun = Instant::now();
    let left = deadline.map_or(WAKE_INTERVAL, |deadline| deadline.saturating_duration_since(begun)).min(WAKE_INTERVAL);
    if left.is_zero() || stop.wait_for(left) {
        return true;
    }
    let woken = Instant::now();
    pauses.note_wake(woken, begun + left);
    deadline.is_some_and(|deadline| woken >= deadline)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absent_reports_are_logged_once_also_where_a_connection_was_missing_before() {
        let start = Instant::now();
        let mut silence = Silence::new(start);
        let mut is_news = |second: u64, has_reports, is_explained| {
            silence.is_news(start + Duration::from_secs(second), has_reports, is_explained)
        };
        assert!(!is_news(2, false, false) && !is_news(10, false, true), "no process answered");
        assert!(!is_news(12, false, false), "the first connection is new");
        assert_eq!([14, 20].map(|second| is_news(second, false, false)), [true, false]);
        let mut with_reports = Silence::new(start);
        assert!(!with_reports.is_news(start + Duration::from_secs(60), true, false));
    }

    #[test]
    fn a_room_without_reports_is_named_with_where_its_tracker_connects() {
        let start =
            "start the tracker or the simulator with the same --room and an endpoint in common with this controller";
        let alone = describe_silence(&["own"], &[]);
        assert_eq!(alone, format!("no position report from room \"own\": {start}"));
        let listening = describe_silence(&["own", "hall"], &["tcp/127.0.0.1:7447".to_owned()]);
        assert_eq!(
            listening,
            format!("no position report from room \"own\", \"hall\": {start}, such as tcp/127.0.0.1:7447")
        );
    }
}
