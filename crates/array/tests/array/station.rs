//! A driver without transport: which reports are due when, and the record of the emergency stop.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::rc::Rc;

use heliostat_array::arrivals::Arrival;
use heliostat_array::content::Content;
use heliostat_array::moment::Moment;
use heliostat_array::station::{Identity, Report, Station};
use heliostat_array::stop_record::{RecordError, StopRecord, StopStore};
use heliostat_array::{Device, DeviceError, Kit};
use heliostat_channel::MirrorAngles;
use heliostat_proto::{ArrayState, AxisLimits, Capabilities, EmergencyStop, NodeStatus, Rearm, Stamp};

use crate::common::MS;

pub struct Mirror;

impl Device for Mirror {
    fn capabilities(&self) -> Capabilities {
        let axis = AxisLimits { min_rad: -0.5, max_rad: 0.5, ..AxisLimits::default() };
        Capabilities { rows: 1, columns: 1, roll: axis, yaw: axis, ..Capabilities::default() }
    }

    fn apply(&mut self, _now: Moment, _angles: &MirrorAngles) -> Result<(), DeviceError> {
        Ok(())
    }

    fn stop(&mut self, _now: Moment) -> Result<(), DeviceError> {
        Ok(())
    }
}

/// A record in memory; `None` for none.
#[derive(Clone, Default)]
pub struct Memory {
    text: Rc<RefCell<Option<String>>>,
    is_full: Rc<RefCell<bool>>,
}

impl StopStore for Memory {
    fn name(&self) -> String {
        "the memory".into()
    }

    fn read(&mut self) -> Result<Option<String>, String> {
        Ok(self.text.borrow().clone())
    }

    fn replace(&mut self, text: &str) -> Result<(), String> {
        if *self.is_full.borrow() {
            return Err("it is full".into());
        }
        *self.text.borrow_mut() = Some(text.to_owned());
        Ok(())
    }

    fn empty(&mut self) -> Result<(), String> {
        *self.text.borrow_mut() = Some(String::new());
        Ok(())
    }
}

fn start(memory: &Memory) -> Station<Mirror> {
    let identity = Identity { source: 9, array: 2, software: "test".into() };
    let (record, latch) = StopRecord::open(memory.clone(), true, 0);
    Station::new(Kit::new(Mirror), (record.split().0, latch), identity, Moment::simulated(0))
}

/// Advances to a time, and writes the record if that is due.
fn advance<D: Device>(station: &mut Station<D>, memory: &Memory, at_ms: u64) -> Result<(), RecordError> {
    station.advance(Moment::simulated(at_ms * MS));
    let Some(task) = station.poll_record(Moment::simulated(at_ms * MS)) else { return Ok(()) };
    let result = task.run(&mut memory.clone());
    station.finish_record(&result);
    result
}

/// The names and sequence numbers of the reports at a time.
fn reports(station: &mut Station<Mirror>, at_ms: u64) -> Vec<(&'static str, u64)> {
    let now = Moment::simulated(at_ms * MS);
    let due = std::iter::from_fn(|| station.poll_report(now));
    due.map(|report| match report {
        Report::Telemetry(telemetry) => ("telemetry", telemetry.stamp.sequence),
        Report::Safety(safety) => ("safety", safety.stamp.sequence),
        Report::Stops(stops) => ("stops", stops.stamp.sequence),
        Report::Capabilities(capabilities) => ("capabilities", capabilities.stamp.sequence),
        Report::Status(status) => ("status", status.stamp.sequence),
    })
    .collect()
}

/// A driver after its first reports.
fn running() -> (Memory, Station<Mirror>) {
    let memory = Memory::default();
    let mut station = start(&memory);
    advance(&mut station, &memory, 0).unwrap();
    reports(&mut station, 0);
    (memory, station)
}

/// The status that is due, after every other report.
pub fn status<D: Device>(station: &mut Station<D>, now: Moment) -> NodeStatus {
    let reports: Vec<_> = std::iter::from_fn(|| station.poll_report(now)).collect();
    let status =
        reports.into_iter().find_map(|report| if let Report::Status(status) = report { Some(status) } else { None });
    status.expect("a status is due")
}

fn stop(station: &mut Station<Mirror>, at_ms: u64) {
    let at = Moment::simulated(at_ms * MS);
    station.handle(at, Arrival { at, content: stop_at(at) });
}

/// A stop that is sent at a time.
pub fn stop_at(at: Moment) -> Content {
    let stamp = Stamp { source: 7, sequence: 1 + at.room_ns / MS, time_ns: at.room_ns };
    Content::Stop(Ok(EmergencyStop { stamp, ..EmergencyStop::default() }))
}

#[test]
fn reports_are_due_at_the_start_at_their_intervals_and_at_each_change() {
    let memory = Memory::default();
    let mut station = start(&memory);
    advance(&mut station, &memory, 0).unwrap();
    let all = [("safety", 1), ("stops", 1), ("telemetry", 1), ("capabilities", 1), ("status", 1)];
    assert_eq!(reports(&mut station, 0), all);
    assert_eq!((reports(&mut station, 39), station.next_ns()), (vec![], 40 * MS), "the request of a measurement");
    advance(&mut station, &memory, 40).unwrap();
    assert_eq!((reports(&mut station, 49), station.next_ns()), (vec![], 50 * MS));
    assert_eq!(reports(&mut station, 50), [("telemetry", 2)]);
    assert!(!station.is_report_due(60 * MS));
    stop(&mut station, 60);
    assert!(station.is_report_due(60 * MS), "no further message is handled before the stop is recorded and reported");
    assert_eq!(reports(&mut station, 60), [("safety", 2), ("stops", 2), ("telemetry", 3)], "the stop before the state");
    assert_eq!(reports(&mut station, 1000), [("telemetry", 4), ("capabilities", 2), ("status", 2)]);
    assert_eq!(reports(&mut station, 1060), [("safety", 3), ("stops", 3), ("telemetry", 5)]);
}

#[test]
fn the_status_names_the_array_its_state_and_what_was_refused() {
    let mut station = start(&Memory::default());
    stop(&mut station, 0);
    let order = EmergencyStop { action: heliostat_proto::StopAction::Rearm, ..EmergencyStop::default() };
    let at = Moment::simulated(0);
    station.handle(at, Arrival { at, content: Content::Stop(Ok(order)) });
    station.set_dropped(3);
    station.set_other_processes(2);
    let status = status(&mut station, at);
    assert_eq!((status.state.as_str(), status.name.as_str()), ("mirrors-2 stopped", "0000000000000009"));
    let count = |name: &str| status.counter(name);
    assert_eq!((count("refused:dropped"), count("commands")), (Some(3), Some(0)), "{:?}", status.counters);
    assert_eq!(count(NodeStatus::OTHER_PROCESSES), Some(2), "{:?}", status.counters);
    assert!(status.last_problem.contains("rearm"), "{}", status.last_problem);
}

#[test]
fn a_stop_is_in_the_record_at_once_and_in_force_at_the_next_start() {
    let memory = Memory::default();
    let mut station = start(&memory);
    stop(&mut station, 5);
    advance(&mut station, &memory, 5).unwrap();
    let restarted = start(&memory);
    assert_eq!(restarted.kit().array().state(), ArrayState::Stopped);
    assert_eq!(restarted.kit().array().latch().stop().map(|stop| stop.source), Some(7));
}

#[test]
fn a_stop_that_cannot_be_recorded_is_tried_again_with_the_next_safety_report() {
    let memory = Memory::default();
    let mut station = start(&memory);
    reports(&mut station, 0);
    *memory.is_full.borrow_mut() = true;
    stop(&mut station, 5);
    let problem = advance(&mut station, &memory, 5).unwrap_err().to_string();
    assert!(problem.contains("the memory: it is full; the next start is stopped"), "{problem}");
    assert_eq!((station.is_recorded(), station.last_problem()), (false, problem));
    advance(&mut station, &memory, 6).expect("no attempt until it is due");
    *memory.is_full.borrow_mut() = false;
    let mut lines = Vec::new();
    for at_ms in [1006, 2010] {
        let at = Moment::simulated(at_ms * MS);
        station.advance(at);
        let task = station.poll_record(at).expect("a repetition, and then a check");
        lines.extend(station.finish_record(&task.run(&mut memory.clone())));
        reports(&mut station, at_ms);
    }
    assert!(lines.len() == 1 && lines[0].contains("is recorded again"), "the log says it once: {lines:?}");
    assert!(
        station.is_recorded() && memory.text.borrow().as_ref().is_some_and(|text| text.contains("sequence = \"6\""))
    );
}

#[test]
fn stop_report_and_status_say_that_a_stop_is_not_recorded_until_it_is() {
    let (memory, mut station) = running();
    // What the stop report and the status say of the record.
    let said = |station: &mut Station<Mirror>, at_ms: u64| {
        let (mut of_stops, mut unrecorded) = (None, None);
        while let Some(report) = station.poll_report(Moment::simulated(at_ms * MS)) {
            match report {
                Report::Stops(stops) => of_stops = Some((stops.device_stopped, stops.problem)),
                Report::Status(status) => {
                    let found = status.counters.into_iter().find(|(name, _)| name == NodeStatus::STOP_UNRECORDED);
                    unrecorded = found.map(|(_, count)| count);
                }
                _ => {}
            }
        }
        (of_stops, unrecorded)
    };
    *memory.is_full.borrow_mut() = true;
    stop(&mut station, 5);
    let problem = advance(&mut station, &memory, 5).unwrap_err().to_string();
    assert_eq!(said(&mut station, 5), (Some((true, problem.clone())), None));
    advance(&mut station, &memory, 1005).unwrap_err();
    assert_eq!(said(&mut station, 1005), (Some((true, problem)), Some(1)));
    *memory.is_full.borrow_mut() = false;
    advance(&mut station, &memory, 2010).unwrap();
    assert_eq!(said(&mut station, 2010), (Some((true, String::new())), Some(0)));
}

#[test]
fn a_slow_disk_delays_no_stop_and_a_report_that_names_one_only_for_a_while() {
    let memory = Memory::default();
    let mut station = start(&memory).with_telemetry_every(1000 * MS);
    advance(&mut station, &memory, 0).unwrap();
    reports(&mut station, 0);
    stop(&mut station, 5);
    let at = |ms: u64| Moment::simulated(ms * MS);
    station.advance(at(5));
    let task = station.poll_record(at(5)).expect("a new stop is recorded");
    assert_eq!(reports(&mut station, 5), [], "no report names a stop that is not recorded");
    assert!(!station.is_report_due(60 * MS), "messages are handled meanwhile");
    assert_eq!(station.next_ns(), 255 * MS, "nothing to do before, and reports then");
    stop(&mut station, 6);
    assert_eq!(station.kit().array().latch().stops().len(), 1, "the later one of the same sender");
    assert!(station.poll_record(at(6)).is_none(), "the disk has not answered");
    station.advance(at(254));
    assert!(station.is_recorded() && reports(&mut station, 254).is_empty());
    station.advance(at(255));
    let names: Vec<_> = reports(&mut station, 255).into_iter().map(|(name, _)| name).collect();
    assert_eq!(names, ["safety", "stops", "telemetry"], "the disk does not answer");
    assert!(!station.is_recorded() && station.last_problem().contains("not recorded yet"));
    station.finish_record(&task.run(&mut memory.clone()));
    let text = || memory.text.borrow().clone().unwrap_or_default();
    assert!(text().contains("sequence = \"6\""), "{}", text());
    advance(&mut station, &memory, 256).unwrap();
    assert!(station.is_recorded() && text().contains("sequence = \"7\""), "{}", text());
    assert_eq!(reports(&mut station, 256), [("stops", 3)], "it is recorded now");
}

#[test]
fn a_release_on_a_slow_disk_is_named_and_no_stop_that_is_not_recorded() {
    let (memory, mut station) = running();
    stop(&mut station, 5);
    advance(&mut station, &memory, 5).unwrap();
    let at = |ms: u64| Moment::simulated(ms * MS);
    let rearm = Rearm { stop_source: 7, stop_sequence: 6, ..Rearm::default() };
    station.handle(at(6), Arrival { at: at(6), content: Content::Rearm(Ok(rearm)) });
    station.advance(at(6));
    let task = station.poll_record(at(6)).expect("a release is recorded");
    station.advance(at(256));
    assert!(station.last_problem().starts_with("the release is not recorded yet"), "{}", station.last_problem());
    assert!(station.is_recorded(), "no stop is in force");
    station.finish_record(&task.run(&mut memory.clone()));
    assert_eq!((station.is_recorded(), station.last_problem()), (true, String::new()));
}

#[test]
fn a_check_of_the_record_that_takes_long_leaves_the_stop_recorded() {
    let (memory, mut station) = running();
    stop(&mut station, 5);
    advance(&mut station, &memory, 5).unwrap();
    reports(&mut station, 5);
    let at = Moment::simulated(1005 * MS);
    station.advance(at);
    let check = station.poll_record(at).expect("the record is checked with each safety report");
    station.advance(Moment::simulated(1300 * MS));
    assert!(station.is_recorded(), "{}", station.last_problem());
    station.finish_record(&check.run(&mut memory.clone()));
    assert!(station.is_recorded(), "{}", station.last_problem());
}

#[test]
fn a_flood_of_stops_on_a_slow_disk_leaves_the_reports() {
    let (memory, mut station) = running();
    let mut silent_ms = 0;
    let mut longest_ms = 0;
    // Each write takes 100 ms, and each meets a newer stop.
    let mut task = None;
    let mut problems = BTreeSet::new();
    for at_ms in (5..3000).step_by(5) {
        if at_ms % 40 == 5 {
            stop(&mut station, at_ms);
        }
        let at = Moment::simulated(at_ms * MS);
        if at_ms % 100 == 0
            && let Some(task) = task.take()
        {
            station.finish_record(&heliostat_array::stop_record::RecordTask::run(&task, &mut memory.clone()));
        }
        station.advance(at);
        task = task.or(station.poll_record(at));
        problems.extend(station.record_problem().map(str::to_owned));
        silent_ms = if reports(&mut station, at_ms).is_empty() { silent_ms + 5 } else { 0 };
        longest_ms = longest_ms.max(silent_ms);
    }
    assert!((200..=250).contains(&longest_ms), "{longest_ms} ms without a report");
    assert!(problems.len() == 1 && problems.iter().all(|text| text.contains("stops arrive faster")), "{problems:?}");
}
