//! Commands of a controller in the same process: they wait for nothing, keep their place behind stops,
//! and turn no mirror without the thread that handles stops.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::{self, ThreadId};

use heliostat_array::moment::Moment;
use heliostat_bus::{Bus, BusConfig, private_endpoint};
use heliostat_channel::MirrorAngles;
use heliostat_driver::direct_commands::DirectCommands;
use heliostat_driver::run::{ArrayDriver, Settings};
use heliostat_driver::stop_record::StopRecordSettings;
use heliostat_driver::summary::Summary;
use heliostat_driver::{Device, DeviceError, Kit};
use heliostat_proto::{AxisLimits, Capabilities, MirrorCommand, Room, decode, encode};
use heliostat_service::Stop;
use heliostat_service::clock::utc_ns;

use crate::{LIMIT, wait_until};

/// A device of one mirror that notes who turns it, and whose measurement waits where that is ordered.
struct Noting {
    turns: Arc<Mutex<Vec<(ThreadId, f64)>>>,
    measuring: Sender<()>,
    go_on: Receiver<()>,
    waits: Arc<Mutex<bool>>,
}

impl Device for Noting {
    fn capabilities(&self) -> Capabilities {
        let axis = AxisLimits { min_rad: -1.0, max_rad: 1.0, ..AxisLimits::default() };
        Capabilities { rows: 1, columns: 1, roll: axis, yaw: axis, park_after_ms: 60_000, ..Capabilities::default() }
    }

    fn apply(&mut self, _now: Moment, angles: &MirrorAngles) -> Result<(), DeviceError> {
        self.turns.lock().unwrap().push((thread::current().id(), angles.roll[0]));
        Ok(())
    }

    fn measure(&mut self, _now: Moment, _into: &mut MirrorAngles) -> Result<bool, DeviceError> {
        if std::mem::take(&mut *self.waits.lock().unwrap()) {
            self.measuring.send(()).unwrap();
            self.go_on.recv_timeout(LIMIT).unwrap();
        }
        Ok(false)
    }

    fn stop(&mut self, _now: Moment) -> Result<(), DeviceError> {
        Ok(())
    }
}

/// A running array, and the entry of its commands.
struct Running {
    turns: Arc<Mutex<Vec<(ThreadId, f64)>>>,
    measuring: Receiver<()>,
    go_on: Sender<()>,
    waits: Arc<Mutex<bool>>,
    direct: DirectCommands<Noting>,
    stop: Stop,
    thread: thread::JoinHandle<Summary>,
    config: BusConfig,
    _folder: tempfile::TempDir,
}

impl Running {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let endpoint = private_endpoint().unwrap();
        let (turns, waits) = (Arc::default(), Arc::default());
        let ((measuring, on_measuring), (go_on, on_go_on)) = (channel(), channel());
        let device = Noting { turns: Arc::clone(&turns), measuring, go_on: on_go_on, waits: Arc::clone(&waits) };
        let config = BusConfig::new(Room::new("direct").unwrap());
        let record = StopRecordSettings { directory: Some(folder.path().to_owned()), start_armed: true };
        let settings = Settings { record, ..Settings::new(config.clone().listen_at(&endpoint)) };
        let stop = Stop::default();
        let driver = ArrayDriver::open(Kit::new(device), &settings, &stop).unwrap().expect("not stopped");
        let direct = driver.direct_commands();
        let until = stop.clone();
        let thread = thread::spawn(move || driver.run(None, &until).unwrap());
        let config = config.connect_to(&endpoint);
        let running =
            Self { turns, measuring: on_measuring, go_on, waits, direct, stop, thread, config, _folder: folder };
        wait_until("a connected device", || !running.turns.lock().unwrap().is_empty());
        running
    }

    fn turned_to(&self, roll: f64) -> Option<ThreadId> {
        let turns = self.turns.lock().unwrap();
        turns.iter().find(|(_, turned)| (turned - roll).abs() < 1e-6).map(|(thread, _)| *thread)
    }
}

fn command(sequence: u64, roll: f32) -> Vec<u8> {
    let now = utc_ns();
    let command = MirrorCommand {
        epoch: 1,
        sequence,
        answers: sequence,
        time_ns: now,
        validity_ms: 5000,
        roll: vec![roll],
        yaw: vec![0.0],
    };
    let mut payload = Vec::new();
    encode(&command, &mut payload).unwrap();
    payload
}

#[test]
fn a_command_is_applied_on_the_thread_that_gives_it() {
    let mut running = Running::start();
    running.direct.apply(&command(1, 0.25));
    // While the array's thread is busy the command is queued; it is free most of the time.
    let mut sequence = 1;
    wait_until("a command that is not queued", || {
        sequence += 1;
        let roll = sequence as f32 * 1e-3;
        running.direct.apply(&command(sequence, roll));
        running.turned_to(f64::from(roll)) == Some(thread::current().id())
    });
    running.stop.request();
    let summary = running.thread.join().unwrap();
    assert_eq!((summary.commands, summary.refused.len()), (sequence, 0), "{summary:?}");
}

#[test]
fn a_command_does_not_wait_for_the_array_and_is_handled_after_it() {
    let mut running = Running::start();
    *running.waits.lock().unwrap() = true;
    running.measuring.recv_timeout(LIMIT).expect("a measurement, during which the array is held");
    running.direct.apply(&command(1, 0.5));
    assert_eq!(running.turned_to(0.5), None, "the command is queued");
    running.go_on.send(()).unwrap();
    wait_until("the queued command", || running.turned_to(0.5).is_some());
    assert_ne!(running.turned_to(0.5), Some(thread::current().id()), "the array's thread has handled it");
    running.stop.request();
    assert_eq!(running.thread.join().unwrap().commands, 1);
}

#[test]
fn without_the_thread_that_handles_stops_no_command_turns_a_mirror() {
    let Running { turns, mut direct, stop, thread, .. } = Running::start();
    stop.request();
    thread.join().unwrap();
    let before = turns.lock().unwrap().len();
    direct.apply(&command(1, 0.5));
    assert_eq!(turns.lock().unwrap().len(), before);
}

#[test]
fn the_copy_of_a_command_and_an_older_one_from_the_network_change_nothing_and_another_epoch_counts() {
    let mut running = Running::start();
    let bus = Bus::open(&running.config).unwrap();
    let publisher = bus.publisher(&bus.room().command(), heliostat_bus::Class::RealTimeBlock).unwrap();
    running.direct.apply(&command(7, 0.25));
    wait_until("the command", || running.turned_to(0.25).is_some());
    let mut of_another: MirrorCommand = decode(&command(1, 0.75)).unwrap();
    of_another.epoch = 2;
    let mut payload = Vec::new();
    wait_until("the command of another controller", || {
        publisher.put(&command(7, 0.25)).unwrap();
        publisher.put(&command(6, 0.125)).unwrap();
        of_another.time_ns = utc_ns();
        of_another.sequence += 1;
        encode(&of_another, &mut payload).unwrap();
        publisher.put(&payload).unwrap();
        running.turned_to(0.75).is_some()
    });
    assert_eq!(running.turned_to(0.125), None);
    running.stop.request();
    let summary = running.thread.join().unwrap();
    assert!(summary.refused.is_empty(), "{summary:?}");
}
