//! A driver whose device takes long, or fails: the order of its calls.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use heliostat_array::arrivals::Arrivals;
use heliostat_array::content::Content;
use heliostat_array::moment::Moment;
use heliostat_array::station::{Identity, Station};
use heliostat_array::stop_record::StopRecord;
use heliostat_array::{Device, DeviceError, Kit, Watch};
use heliostat_channel::MirrorAngles;
use heliostat_proto::{ArrayState, Capabilities, MirrorCommand, Rearm, StopRepetition};

use crate::common::MS;
use crate::station::{Memory, Mirror, status, stop_at};

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
type Script = Box<dyn Fn(&World, usize) -> bool + Send>;

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

    fn stop(&mut self, _now: Moment) -> Result<(), DeviceError> {
        self.call("stop".into())
    }
}

fn blocking(script: impl Fn(&World, usize) -> bool + Send + 'static) -> (Arc<World>, Station<Blocking>) {
    let world = Arc::<World>::default();
    let mut kit = Kit::new(Blocking(Arc::clone(&world), Box::new(script)));
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

/// A device that has failed at its second movement, before a connection during which time passes.
fn before_a_slow_connection(during: fn(&World)) -> (Arc<World>, Station<Blocking>) {
    let (world, mut station) = blocking(move |world, call| {
        if call == 4 {
            during(world);
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
fn a_stop_that_arrives_during_a_connection_comes_before_the_movement_after_it() {
    let (world, mut station) = before_a_slow_connection(|world| {
        world.pass(1500);
        world.push(stop_at(world.now()));
        world.pass(2500);
    });
    world.command(2);
    for _ in 0..2 {
        step(&world, &mut station);
    }
    assert_eq!(world.calls(), ["connect", "turn 0", "turn 0.25", "connect", "stop"]);
}

#[test]
fn angles_that_expire_during_a_connection_are_not_applied_after_it() {
    let (world, mut station) = before_a_slow_connection(|world| world.pass(4000));
    step(&world, &mut station);
    assert_eq!(world.calls(), ["connect", "turn 0", "turn 0.25", "connect", "turn 0"]);
    assert_eq!(station.kit().array().state(), ArrayState::Parked);
}

#[test]
fn a_command_that_expires_while_its_device_connects_is_refused() {
    let (world, mut station) = before_a_slow_connection(|world| world.pass(4000));
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
