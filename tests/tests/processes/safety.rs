//! The emergency stop, the bounds on messages and a restart, across processes.

use std::fs;
use std::path::Path;
use std::sync::{Arc, Mutex};

use heliostat_bus::{BusConfig, private_endpoint};
use heliostat_proto::messages::fault;
use heliostat_proto::{
    ArrayState, Calibration, EmergencyStop, Message, MirrorCommand, NodeKind, Rearm, Room, SafetyReport, Stamp,
    StopAction,
};
use heliostat_service::clock::utc_ns;
use heliostat_tests::{Process, RoomObserver, encoded, wait_until};

use crate::servo_board::servo_board;

/// A room in a test: its observer, and a real driver of one emulated mirror.
struct DrivenRoom {
    observer: RoomObserver,
    endpoint: String,
    folder: tempfile::TempDir,
    lines: Arc<Mutex<Vec<String>>>,
    sequence: u64,
}

impl DrivenRoom {
    fn new(room: &str) -> Self {
        let endpoint = private_endpoint().expect("an endpoint");
        let (address, lines) = servo_board(1, usize::MAX);
        let folder = tempfile::tempdir().expect("a folder");
        let config = format!(
            "rows = 1\ncolumns = 1\ncalibration_reserve_deg = 10.0\n[[boards]]\nkind = \"servo-board\"\n\
             address = \"tcp:{address}\"\nmin_deg = -30.0\nmax_deg = 30.0\nmeasures = true\nmirrors = [0]\n"
        );
        fs::write(folder.path().join("array.toml"), config).expect("a file");
        let bus = BusConfig::new(Room::new(room).expect("a room")).listen_at(&endpoint);
        Self { observer: RoomObserver::join(&bus), endpoint, folder, lines, sequence: 0 }
    }

    fn state_folder(&self) -> std::path::PathBuf {
        self.folder.path().join("state")
    }

    /// Starts the driver. Its first start is declared safe, unless `declare_safe` is false.
    fn start(&self, declare_safe: bool) -> Process {
        self.start_with(if declare_safe { &["--start-armed"] } else { &[] })
    }

    fn start_with(&self, more: &[&str]) -> Process {
        self.start_under(&[], &[], more)
    }

    /// Starts the driver by another program, with variables of its environment.
    fn start_under(&self, wrapper: &[&str], variables: &[(&str, &str)], more: &[&str]) -> Process {
        let text = |path: &Path| path.display().to_string();
        let (config, state) = (text(&self.folder.path().join("array.toml")), text(&self.state_folder()));
        let room = self.observer.room().to_string();
        let mut flags = vec!["driver", "run", "--config", &config, "--state", &state, "--room", &room];
        flags.extend(["--connect", &self.endpoint, "--exit-with-parent"]);
        flags.extend(more);
        let driver = Process::heliostat_under(wrapper, variables, &flags);
        let before = self.observer.telemetry_count();
        wait_until("telemetry of the driver", || self.observer.telemetry_count() > before + 2);
        driver
    }

    fn send<T: Message>(&self, key: &str, message: &T) {
        self.observer.publish(key, &encoded(message));
    }

    /// Sends a command with the next sequence number.
    fn command(&mut self, roll: f32, change: impl FnOnce(&mut MirrorCommand)) {
        self.sequence += 1;
        let mut command = MirrorCommand {
            epoch: 5,
            sequence: self.sequence,
            answers: self.sequence,
            time_ns: utc_ns(),
            validity_ms: 5000,
            roll: vec![roll],
            yaw: vec![0.0],
        };
        change(&mut command);
        self.send(&self.observer.room().command(), &command);
    }

    /// Sends valid commands until one is applied.
    fn follow(&mut self) {
        wait_until("a command that the array follows", || {
            self.command(0.25, |_| {});
            std::thread::sleep(std::time::Duration::from_millis(60));
            self.telemetry_state() == Some(ArrayState::Following)
        });
    }

    fn telemetry_state(&self) -> Option<ArrayState> {
        self.observer.telemetry().map(|telemetry| telemetry.state)
    }

    /// Waits until telemetry has this state; after a start a board may not be connected yet.
    fn wait_for_state(&self, state: ArrayState) {
        wait_until(&format!("telemetry with state {}", state.name()), || self.telemetry_state() == Some(state));
    }

    /// Waits until the record on disk says whether the array is stopped.
    fn wait_for_record(&self, stopped: bool) {
        let file = self.state_folder().join(format!("{}.stop.toml", self.observer.room()));
        let line = format!("stopped = {stopped}");
        wait_until("the record of the stop", || fs::read_to_string(&file).is_ok_and(|record| record.contains(&line)));
    }

    /// Stops the array; the clock of the sender is ahead by `lead_ns`.
    fn stop(&self, sequence: u64, lead_ns: u64) {
        let stamp = Stamp { source: 0xabc, sequence, time_ns: utc_ns() + lead_ns };
        let order = EmergencyStop { stamp, action: StopAction::Stop, operator: "ann".into(), reason: "smoke".into() };
        self.send(&self.observer.room().stop(), &order);
        wait_until("a stopped array", || self.telemetry_state() == Some(ArrayState::Stopped));
        wait_until("a report of the stop", || {
            self.observer.safety().is_some_and(|safety| (safety.stop_source, safety.stop_sequence) == (0xabc, sequence))
        });
    }

    fn rearm(&self, stop_source: u64, stop_sequence: u64) {
        let stamp = Stamp { source: 0xdef, sequence: 1, time_ns: 1 };
        let order = Rearm { stamp, stop_source, stop_sequence, ..Rearm::default() };
        self.send(&self.observer.room().rearm(), &order);
    }

    /// Lines that the board received, without queries.
    fn orders(&self) -> Vec<String> {
        let lines = self.lines.lock().expect("no test panics");
        lines.iter().filter(|line| *line != "get").cloned().collect()
    }
}

#[test]
fn a_stop_survives_the_end_of_the_driver_and_no_mirror_turns_until_the_rearm() {
    let mut room = DrivenRoom::new("kept");
    let mut driver = room.start(true);
    room.follow();
    room.stop(1, 0);
    wait_until("the execution of the stop in the log", || {
        let errors = driver.errors();
        let ordered = errors.split_once("stop ordered by 0000000000000abc/1, operator \"ann\": \"smoke\"");
        let executed = "the array is stopped: its device has executed the stop";
        ordered.is_some_and(|(before, after)| !before.contains(executed) && after.contains(executed))
    });
    room.wait_for_record(true);
    driver.kill();
    room.lines.lock().expect("no test panics").clear();
    let killed = room.observer.safety().expect("a safety report").stamp.source;
    let driver = room.start(true);
    let safety = || room.observer.safety().expect("a safety report");
    wait_until("a report of the recorded stop", || safety().stamp.source != killed && safety().stopped);
    let SafetyReport { stop_source, stop_sequence, operator, reason, .. } = safety();
    assert_eq!((stop_source, stop_sequence, operator.as_str(), reason.as_str()), (0xabc, 1, "ann", "smoke"));
    room.wait_for_state(ArrayState::Stopped);
    let before = room.observer.telemetry().expect("telemetry").counters.stopped;
    wait_until("refused commands", || {
        room.command(0.25, |_| {});
        room.observer.telemetry().is_some_and(|telemetry| telemetry.counters.stopped > before + 3)
    });
    // A stopped board receives the stop again and again.
    wait_until("a stopped board", || room.orders().len() >= 3);
    let orders = room.orders();
    assert_eq!(orders[0], "stop");
    assert!(orders.iter().all(|line| line == "stop" || line == "hello"), "the board receives no angles: {orders:?}");
    wait_until("advice in the log", || {
        let errors = driver.errors();
        errors.contains("the array starts stopped by ann")
            && errors.contains("heliostat rearm --room kept --connect ENDPOINT")
    });
    room.rearm(0xabc, 1);
    wait_until("a parked array", || room.telemetry_state() == Some(ArrayState::Parked));
    room.follow();
    let orders = room.orders();
    let first = orders.iter().find(|line| line.starts_with("set")).map(String::as_str);
    assert_eq!(first, Some("set 0 0"), "it parks first");
}

#[test]
fn an_array_whose_last_state_is_unknown_starts_stopped_and_the_command_line_releases_it() {
    let mut room = DrivenRoom::new("unknown");
    let mut driver = room.start(false);
    room.wait_for_state(ArrayState::Stopped);
    wait_until("a safety report", || room.observer.safety().is_some());
    let safety = room.observer.safety().expect("received");
    assert_eq!((safety.stop_source, safety.stop_sequence), (0, 0));
    assert!(safety.reason.contains("the last state is unknown"), "{safety:?}");
    driver.kill();
    // The driver connects to the command, which waits for its report.
    let listener = private_endpoint().expect("an endpoint");
    let mut driver = room.start_with(&["--connect", &listener]);
    let ended = Process::heliostat(&["rearm", "--room", "unknown", "--timeout", "60", "--listen", &listener]).wait();
    assert!(ended.output.contains("released: 0000000000000000/0"), "{} {}", ended.output, ended.errors);
    room.follow();
    room.wait_for_record(false);
    driver.kill();
    drop(driver);
    let mut driver = room.start(false);
    // The re-arm is recorded.
    room.wait_for_state(ArrayState::Parked);
    driver.kill();
    fs::write(room.state_folder().join("unknown.stop.toml"), "version = 1\nstopped = fal").expect("a file");
    let _driver = room.start(true);
    // A damaged record is an unknown state.
    room.wait_for_state(ArrayState::Stopped);
}

#[test]
fn a_stop_that_cannot_be_recorded_stops_the_array_now_and_at_the_next_start() {
    let mut room = DrivenRoom::new("full");
    let mut driver = room.start(true);
    room.follow();
    // A folder in place of the new file: no process can write it, whatever its rights.
    fs::create_dir(room.state_folder().join("full.stop.new")).expect("a folder");
    room.stop(1, 0);
    wait_until("an error in the log", || driver.errors().contains("cannot record the emergency stop"));
    assert!(driver.errors().contains("the next start is stopped"), "{}", driver.errors());
    driver.kill();
    let _driver = room.start(true);
    room.wait_for_state(ArrayState::Stopped);
}

/// A pipe without a reader: a process that writes to it waits for ever.
#[cfg(unix)]
fn unread_pipe(at: &Path) {
    let made = std::process::Command::new("mkfifo").arg(at).status().expect("mkfifo runs");
    assert!(made.success(), "mkfifo {}", at.display());
}

#[cfg(unix)]
#[test]
fn a_disk_that_does_not_answer_delays_no_stop_and_is_reported() {
    let mut room = DrivenRoom::new("slow");
    let _driver = room.start(true);
    room.follow();
    unread_pipe(&room.state_folder().join("slow.stop.new"));
    for sequence in 1..4 {
        room.stop(sequence, 0);
        wait_until("a stopped board", || room.orders().last().is_some_and(|line| line == "stop"));
        room.rearm(0xabc, sequence);
        wait_until("a parked array", || room.telemetry_state() == Some(ArrayState::Parked));
        room.follow();
    }
    wait_until("a problem of the disk", || {
        let status = room.observer.status(NodeKind::Driver);
        status.is_some_and(|status| status.last_problem.contains("not recorded yet"))
    });
}

#[cfg(unix)]
#[test]
fn a_driver_that_ends_obeys_a_stop_until_its_disk_has_had_its_time() {
    let mut room = DrivenRoom::new("ending");
    let driver = room.start(true);
    room.follow();
    unread_pipe(&room.state_folder().join("ending.stop.new"));
    room.stop(1, 0);
    room.rearm(0xabc, 1);
    wait_until("a parked array", || room.telemetry_state() == Some(ArrayState::Parked));
    room.follow();
    room.lines.lock().expect("no test panics").clear();
    driver.signal("TERM");
    // It still serves: the disk has not answered.
    let stamp = Stamp { source: 0xabc, sequence: 2, time_ns: utc_ns() };
    room.send(&room.observer.room().stop(), &EmergencyStop { stamp, ..EmergencyStop::default() });
    wait_until("a stopped board", || room.orders().last().is_some_and(|line| line == "stop"));
    let ended = driver.wait();
    assert!(ended.errors.contains("ERROR the emergency stop is not recorded yet: its disk"), "{}", ended.errors);
}

#[cfg(unix)]
#[test]
fn a_log_without_a_reader_delays_no_stop() {
    let mut room = DrivenRoom::new("unread");
    let pipe = room.folder.path().join("log");
    unread_pipe(&pipe);
    let wrapper = ["sh", "-c", r#"exec "$@" 2<>"$0""#, &pipe.display().to_string()];
    // More than the pipe holds, before the array follows a command.
    let _driver = room.start_under(&wrapper, &[("RUST_LOG", "trace")], &["--start-armed"]);
    for sequence in 1..4 {
        room.follow();
        room.stop(sequence, 0);
        wait_until("a stopped board", || room.orders().last().is_some_and(|line| line == "stop"));
        room.rearm(0xabc, sequence);
        wait_until("a parked array", || room.telemetry_state() == Some(ArrayState::Parked));
    }
}

#[test]
fn a_calibration_with_a_tiny_gain_turns_no_mirror_and_is_reported() {
    let mut room = DrivenRoom::new("gains");
    let _driver = room.start(true);
    room.follow();
    let is_turned = || room.orders().last().is_some_and(|line| line == "set 250000 0");
    wait_until("a turned mirror", is_turned);
    let stamp = Stamp { source: 9, sequence: 1, time_ns: utc_ns() };
    let calibration = Calibration {
        stamp,
        roll_offset_rad: vec![0.0],
        roll_gain: vec![1e-38],
        yaw_offset_rad: vec![0.0],
        yaw_gain: vec![1e-38],
    };
    room.send(&room.observer.room().calibration(), &calibration);
    wait_until("the fault bit of the calibration", || {
        room.observer.telemetry().is_some_and(|telemetry| telemetry.faults & fault::CALIBRATION != 0)
    });
    let telemetry = || room.observer.telemetry().expect("telemetry");
    assert_eq!(telemetry().calibration, 0);
    wait_until("the measured angle", || {
        telemetry().roll_measured.first().is_some_and(|roll| (roll - 0.25).abs() < 1e-4)
    });
    assert!(is_turned(), "{:?}", room.orders());
    wait_until("the name of the refusal", || room.observer.counter(NodeKind::Driver, "refused:calibration:gain") == 1);
}

#[test]
fn a_simulated_room_keeps_its_stop_where_a_folder_is_given_and_starts_parked_otherwise() {
    let folder = tempfile::tempdir().expect("a folder");
    let state = folder.path().display().to_string();
    let start = |flags: &[&str]| {
        let endpoint = private_endpoint().expect("an endpoint");
        let all = [&["sim-node", "--room", "sim", "--listen", &endpoint, "--exit-with-parent"], flags].concat();
        let process = Process::heliostat(&all);
        let observer = RoomObserver::connect("sim", &[&endpoint]);
        wait_until("telemetry and a safety report", || observer.telemetry().is_some() && observer.safety().is_some());
        (process, observer, endpoint)
    };
    let state_of = |observer: &RoomObserver| observer.telemetry().expect("telemetry").state;
    let (mut room, observer, _) = start(&["--state", &state, "--start-armed"]);
    assert_eq!(state_of(&observer), ArrayState::Parked);
    let stamp = Stamp { source: 3, sequence: 4, time_ns: utc_ns() };
    let order = EmergencyStop { stamp, operator: "bob".into(), ..EmergencyStop::default() };
    wait_until("a stopped room", || {
        observer.publish(&observer.room().stop(), &encoded(&order));
        state_of(&observer) == ArrayState::Stopped
    });
    let record = folder.path().join("sim.stop.toml");
    wait_until("the record", || fs::read_to_string(&record).is_ok_and(|record| record.contains("stopped = true")));
    room.kill();
    let (_room, observer, endpoint) = start(&["--state", &state, "--start-armed"]);
    assert_eq!(state_of(&observer), ArrayState::Stopped);
    let ended = Process::heliostat(&["rearm", "--room", "sim", "--connect", &endpoint]).wait();
    assert!(ended.output.contains("released: 0000000000000003/4 of \"bob\""), "{} {}", ended.output, ended.errors);
    wait_until("a parked room", || state_of(&observer) == ArrayState::Parked);
    drop(_room);
    let (_room, observer, _) = start(&[]);
    assert_eq!(state_of(&observer), ArrayState::Parked);
}

#[test]
fn stop_and_status_name_a_simulated_array_that_cannot_record_its_stop() {
    let folder = tempfile::tempdir().expect("a folder");
    let (state, endpoint) = (folder.path().display().to_string(), private_endpoint().expect("an endpoint"));
    let flags = ["sim-node", "--room", "sim", "--listen", &endpoint, "--exit-with-parent", "--start-armed", "--state"];
    let _room = Process::heliostat(&[&flags[..], &[&state]].concat());
    let observer = RoomObserver::connect("sim", &[&endpoint]);
    wait_until("a safety report", || observer.safety().is_some());
    // Folders in place of the record and of its new file: no process can write them, whatever its rights.
    fs::remove_file(folder.path().join("sim.stop.toml")).expect("the record of the start");
    for name in ["sim.stop.toml", "sim.stop.new"] {
        fs::create_dir(folder.path().join(name)).expect("a folder");
    }
    let order = |command: &str, flags: &[&str]| {
        Process::heliostat(&[&[command, "--room", "sim", "--connect", &endpoint][..], flags].concat()).wait()
    };
    let stopped = order("stop", &[]);
    assert!(stopped.output.contains("are stopped, confirmed"), "{} {}", stopped.output, stopped.errors);
    let refusal = stopped.refusal();
    assert!(refusal.contains("array 0 has stopped, but the stop is not recorded: "), "{refusal}");
    assert!(refusal.contains("sim.stop.toml") && refusal.contains("a restart may release the array"), "{refusal}");
    let stopped = order("stop", &["--json"]);
    assert!(!stopped.status.success(), "{}", stopped.output);
    let result: serde_json::Value = serde_json::from_str(stopped.output.trim()).expect("JSON");
    assert!(result["unrecorded"][0].as_str().is_some_and(|line| line.contains("sim.stop.toml")), "{result}");
    let status = order("status", &[]);
    let of_record: Vec<&str> =
        status.output.lines().filter(|line| line.starts_with("problem") && line.contains("sim.stop.toml")).collect();
    assert_eq!(of_record.len(), 1, "{}", status.output);
}
