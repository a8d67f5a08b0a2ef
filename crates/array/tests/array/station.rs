//! A driver without transport: which reports are due when, and the record of the emergency stop.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use heliostat_array::arrivals::{Arrival, Arrivals};
use heliostat_array::content::Content;
use heliostat_array::moment::Moment;
use heliostat_array::station::{Identity, Report, Station};
use heliostat_array::stop_record::{RecordError, StopRecord, StopStore};
use heliostat_array::{Device, DeviceError, Kit, Watch};
use heliostat_channel::MirrorAngles;
use heliostat_proto::{
    ArrayState, AxisLimits, Capabilities, EmergencyStop, MirrorCommand, NodeStatus, Rearm, Stamp, StopRepetition,
};

const MS: u64 = 1_000_000;

struct Mirror;

impl Device for Mirror {
    fn capabilities(&self) -> Capabilities {
        let axis = AxisLimits { min_rad: -0.5, max_rad: 0.5, ..AxisLimits::default() };
        Capabilities { rows: 1, columns: 1, roll: axis, yaw: axis, ..Capabilities::default() }
    }

    fn connect(&mut self, _now: Moment) -> Result<(), DeviceError> {
        Ok(())
    }

    fn apply(&mut self, _now: Moment, _angles: &MirrorAngles) -> Result<(), DeviceError> {
        Ok(())
    }

    fn measure(&mut self, _now: Moment, _into: &mut MirrorAngles) -> Result<bool, DeviceError> {
        Ok(false)
    }

    fn stop(&mut self, _now: Moment) -> Result<(), DeviceError> {
        Ok(())
    }
}

/// A record in memory; `None` for none.
#[derive(Clone, Default)]
struct Memory {
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
fn status<D: Device>(station: &mut Station<D>, now: Moment) -> NodeStatus {
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
fn stop_at(at: Moment) -> Content {
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
    let count = |name: &str| status.counters.iter().find(|(found, _)| found == name).map(|(_, count)| *count);
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
    advance(&mut station, &memory, 1006).unwrap();
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
        silent_ms = if reports(&mut station, at_ms).is_empty() { silent_ms + 5 } else { 0 };
        longest_ms = longest_ms.max(silent_ms);
    }
    assert!((200..=250).contains(&longest_ms), "{longest_ms} ms without a report");
}

/// A clock, a queue, and a mirror with the calls that it received.
#[derive(Default)]
struct World {
    local_ns: AtomicU64,
    queue: Mutex<Arrivals>,
    calls: Mutex<Vec<String>>,
    /// Whether the mirror answers, where a script reads it.
    is_there: AtomicBool,
}

impl World {
    fn now(&self) -> Moment {
        Moment::simulated(self.local_ns.load(Ordering::SeqCst))
    }

    fn pass(&self, ms: u64) {
        self.local_ns.fetch_add(ms * MS, Ordering::SeqCst);
    }

    fn push(&self, content: Content) {
        self.queue.lock().unwrap().push(self.now(), content);
    }

    fn command(&self, sequence: u64) {
        let (time_ns, angles) = (self.now().room_ns, vec![0.25]);
        let command = MirrorCommand {
            epoch: 3,
            sequence,
            time_ns,
            validity_ms: 200,
            roll: angles.clone(),
            yaw: angles,
            ..MirrorCommand::default()
        };
        self.push(Content::Command(Ok(command)));
    }

    fn calls(&self) -> Vec<String> {
        self.calls.lock().unwrap().clone()
    }
}

/// What happens during a call, by its number from 1; whether it succeeds.
type Script = fn(&World, usize) -> bool;

/// A mirror whose calls can take long.
struct Blocking(Arc<World>, Script);

impl Blocking {
    fn call(&self, name: String) -> Result<(), DeviceError> {
        self.0.calls.lock().unwrap().push(name);
        let number = self.0.calls().len();
        if (self.1)(&self.0, number) { Ok(()) } else { Err(DeviceError::new("port", "no answer")) }
    }
}

impl Device for Blocking {
    fn capabilities(&self) -> Capabilities {
        Mirror.capabilities()
    }

    fn connect(&mut self, _now: Moment) -> Result<(), DeviceError> {
        self.call("connect".into())
    }

    fn apply(&mut self, _now: Moment, angles: &MirrorAngles) -> Result<(), DeviceError> {
        self.call(format!("turn {}", angles.roll[0]))
    }

    fn measure(&mut self, _now: Moment, _into: &mut MirrorAngles) -> Result<bool, DeviceError> {
        Ok(false)
    }

    fn stop(&mut self, _now: Moment) -> Result<(), DeviceError> {
        self.call("stop".into())
    }
}

fn blocking(script: Script) -> (Arc<World>, Station<Blocking>) {
    let world = Arc::<World>::default();
    let mut kit = Kit::new(Blocking(Arc::clone(&world), script));
    let (clock, waiting) = (Arc::clone(&world), Arc::clone(&world));
    kit.set_watch(Watch::new(move || clock.now(), move |is_stop| waiting.queue.lock().unwrap().has_stop(is_stop)));
    let identity = Identity { source: 9, array: 0, software: "test".into() };
    let (record, latch) = StopRecord::open(Memory::default(), true, 0);
    let station = Station::new(kit, (record.split().0, latch), identity, world.now());
    (world, station)
}

/// A step of a driver.
fn step(world: &World, station: &mut Station<Blocking>) {
    loop {
        let next = world.queue.lock().unwrap().pop();
        let Some(arrival) = next else { break };
        station.handle(world.now(), arrival);
        if station.is_report_due(world.now().local_ns) {
            break;
        }
    }
    station.advance(world.now());
    let now = world.now();
    while station.poll_report(now).is_some() {}
}

#[test]
fn an_old_failure_of_the_device_hides_no_refusal_and_a_refusal_no_present_failure() {
    let (world, mut station) = blocking(|world, _| world.is_there.load(Ordering::SeqCst));
    let absent = |station: &mut Station<Blocking>, now: u64| {
        station.advance(Moment::simulated(now));
        let counters = status(station, Moment::simulated(now)).counters;
        counters.into_iter().find(|(name, _)| name == "device_absent").expect("counted").1
    };
    let refused = |station: &mut Station<Blocking>, at: u64| {
        let command = MirrorCommand { roll: vec![0.0; 2], yaw: vec![0.0; 2], ..MirrorCommand::default() };
        station.handle_command(Moment::simulated(at), &command);
    };
    assert_eq!(absent(&mut station, 1), 1);
    assert_eq!(station.last_problem(), "port: no answer");
    refused(&mut station, 2);
    assert_eq!(station.last_problem(), "port: no answer", "a refusal hides no present failure");
    world.is_there.store(true, Ordering::SeqCst);
    assert_eq!(absent(&mut station, 2000 * MS), 0, "the device has returned");
    refused(&mut station, 2001 * MS);
    assert!(station.last_problem().starts_with("command: "), "{}", station.last_problem());
    assert_eq!(absent(&mut station, 4000 * MS), 0);
    assert!(station.last_problem().starts_with("command: "), "{}", station.last_problem());
    // It is lost and returns between two statuses.
    world.is_there.store(false, Ordering::SeqCst);
    let lost_at = Moment::simulated(4100 * MS);
    let (time_ns, angles) = (lost_at.room_ns, vec![0.25]);
    let command = MirrorCommand {
        epoch: 3,
        sequence: 1,
        time_ns,
        validity_ms: 200,
        roll: angles.clone(),
        yaw: angles,
        ..MirrorCommand::default()
    };
    station.handle_command(lost_at, &command);
    station.advance(lost_at);
    world.is_there.store(true, Ordering::SeqCst);
    station.advance(Moment::simulated(4400 * MS));
    refused(&mut station, 4401 * MS);
    let shown = status(&mut station, Moment::simulated(5000 * MS));
    assert_eq!((shown.counter("device_absent"), shown.last_problem.as_str()), (Some(0), "port: no answer"));
    refused(&mut station, 5001 * MS);
    assert!(station.last_problem().starts_with("command: "), "{}", station.last_problem());
}

#[test]
fn a_stop_that_arrives_during_a_movement_comes_before_the_next_one() {
    let (world, mut station) = blocking(|world, call| {
        if call == 3 {
            world.pass(4000);
            world.push(stop_at(world.now()));
        }
        true
    });
    step(&world, &mut station);
    world.command(1);
    step(&world, &mut station);
    assert_eq!(world.calls(), ["connect", "turn 0", "turn 0.25", "stop"], "the array would park, and a report is due");
    assert_eq!(station.kit().array().state(), ArrayState::Stopped);
}

#[test]
fn a_movement_that_is_due_waits_for_a_stop_even_if_the_caller_advances_first() {
    let (world, mut station) = blocking(|_, _| true);
    step(&world, &mut station);
    world.command(1);
    step(&world, &mut station);
    world.pass(4000);
    world.push(stop_at(world.now()));
    station.advance(world.now());
    assert_eq!(world.calls(), ["connect", "turn 0", "turn 0.25"]);
    assert_eq!(station.next_ns(), 0, "it is still due");
    step(&world, &mut station);
    assert_eq!(world.calls(), ["connect", "turn 0", "turn 0.25", "stop"]);
}

#[test]
fn a_stop_that_arrives_during_a_connection_comes_before_the_movement_after_it() {
    let (world, mut station) = blocking(|world, call| {
        if call == 4 {
            world.pass(1500);
            world.push(stop_at(world.now()));
            world.pass(2500);
        }
        call != 3
    });
    step(&world, &mut station);
    world.command(1);
    step(&world, &mut station);
    world.pass(100);
    world.command(2);
    for _ in 0..2 {
        step(&world, &mut station);
    }
    assert_eq!(world.calls(), ["connect", "turn 0", "turn 0.25", "connect", "stop"]);
}

/// A device that has failed at its second movement, before a connection that takes 4 s.
fn before_a_slow_connection() -> (Arc<World>, Station<Blocking>) {
    let (world, mut station) = blocking(|world, call| {
        if call == 4 {
            world.pass(4000);
        }
        call != 3
    });
    step(&world, &mut station);
    world.command(1);
    step(&world, &mut station);
    world.pass(100);
    (world, station)
}

#[test]
fn angles_that_expire_during_a_connection_are_not_applied_after_it() {
    let (world, mut station) = before_a_slow_connection();
    step(&world, &mut station);
    assert_eq!(world.calls(), ["connect", "turn 0", "turn 0.25", "connect", "turn 0"]);
    assert_eq!(station.kit().array().state(), ArrayState::Parked);
}

#[test]
fn a_command_that_expires_while_its_device_connects_is_refused() {
    let (world, mut station) = before_a_slow_connection();
    world.command(2);
    step(&world, &mut station);
    assert_eq!(world.calls(), ["connect", "turn 0", "turn 0.25", "connect", "turn 0"]);
    assert_eq!(station.kit().array().counters().expired, 1);
}

#[test]
fn a_repetition_of_a_released_stop_holds_back_neither_movements_nor_reports() {
    let (world, mut station) = blocking(|_, _| true);
    step(&world, &mut station);
    world.push(stop_at(world.now()));
    step(&world, &mut station);
    world.push(Content::Rearm(Ok(Rearm { stop_source: 7, stop_sequence: 1, ..Rearm::default() })));
    step(&world, &mut station);
    world.command(1);
    step(&world, &mut station);
    world.pass(300);
    let repeated = StopRepetition { stop_source: 7, stop_sequence: 1, ..StopRepetition::default() };
    world.push(Content::Repetition(Ok(repeated)));
    assert!(station.is_report_due(world.now().local_ns));
    station.advance(world.now());
    assert_eq!(world.calls()[2..], ["stop", "turn 0", "turn 0.25", "turn 0"]);
}
