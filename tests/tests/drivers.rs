//! Drivers across processes: the simulated array keeps the contract, and one written in Python does so and is led by the controller.

use std::path::Path;
use std::process::Child;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use heliostat_bus::{BusConfig, free_loopback_endpoint};
use heliostat_proto::{ArrayState, MirrorCommand, MirrorTelemetry, Room, Stamp, UserReport, UserState, encode};
use heliostat_tests::{Process, Witness, wait_until};
use serde_json::Value;

/// A Python interpreter that has the package `eclipse-zenoh`; none where it is missing and not required.
fn python() -> Option<String> {
    let python = std::env::var("HELIOSTAT_PYTHON").unwrap_or_else(|_| "python3".into());
    let found = std::process::Command::new(&python).args(["-c", "import zenoh; zenoh.Config"]).output();
    if found.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    assert!(
        std::env::var_os("HELIOSTAT_REQUIRE_PYTHON").is_none(),
        "{python} has no package eclipse-zenoh, which is required where HELIOSTAT_REQUIRE_PYTHON is set"
    );
    println!(
        "skipped: {python} has no package eclipse-zenoh (pip install eclipse-zenoh; HELIOSTAT_PYTHON names another)"
    );
    None
}

/// The example driver of 2 x 3 mirrors, which ends with this.
struct PythonDriver(Child);

impl PythonDriver {
    fn start(python: &str, room: &str, endpoints: &str) -> Self {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let arguments = ["examples/driver.py", room, endpoints, "2", "3", "60"];
        Self(std::process::Command::new(python).args(arguments).current_dir(root).spawn().expect("python starts"))
    }
}

impl Drop for PythonDriver {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Verdicts by rule.
fn check(arguments: &[&str]) -> Vec<(String, String)> {
    let all: Vec<&str> = ["driver", "check", "--json"].iter().chain(arguments).copied().collect();
    let ended = Process::heliostat(&all).wait();
    assert!(ended.status.success(), "{} {}", ended.output, ended.errors);
    let report: Value = serde_json::from_str(&ended.output).expect("the report is JSON");
    let text = |finding: &Value, name: &str| finding[name].as_str().expect("a text").to_owned();
    let findings = report["findings"].as_array().expect("a list").iter();
    findings.map(|finding| (text(finding, "rule"), text(finding, "verdict"))).collect()
}

#[test]
fn the_simulated_array_keeps_every_rule() {
    let endpoint = free_loopback_endpoint().unwrap();
    let _room = Process::heliostat(&["sim-node", "--room", "sim", "--listen", &endpoint, "--exit-with-parent"]);
    let verdicts = check(&["--connect", &endpoint, "heliostat/v1/sim/mirrors/command"]);
    assert!(verdicts.len() > 15 && verdicts.iter().all(|(_, verdict)| verdict == "kept"), "{verdicts:?}");
}

#[test]
fn an_empty_room_has_nobody_to_check() {
    let endpoint = free_loopback_endpoint().unwrap();
    let ended = Process::heliostat(&["driver", "check", "--room", "empty", "--listen", &endpoint]).wait();
    assert!(ended.refusal().contains("no driver in room \"empty\""), "{}", ended.errors);
}

#[test]
fn a_driver_in_python_keeps_every_rule() {
    let Some(python) = python() else { return };
    let endpoint = free_loopback_endpoint().unwrap();
    let _driver = PythonDriver::start(&python, "python", &endpoint);
    let verdicts = check(&["--listen", &endpoint, "--room", "python"]);
    assert!(verdicts.iter().all(|(_, verdict)| verdict == "kept"), "{verdicts:?}");
}

/// Five people who stand still, as a tracker would report them.
fn report(tick: u64) -> Vec<u8> {
    let time_ns = SystemTime::now().duration_since(UNIX_EPOCH).expect("after 1970").as_nanos() as u64;
    let user = |user: u32| UserState {
        user,
        position_m: [user as f32 - 2.0, 0.5 * user as f32 - 1.0, 0.85],
        velocity_m_s: [0.0, 0.0],
        min_rate_bps: 1e6,
    };
    let stamp = Stamp { source: 7, sequence: tick, time_ns };
    let mut payload = Vec::new();
    encode(&UserReport { stamp, tick, users: (0..5).map(user).collect() }, &mut payload).expect("a sound report");
    payload
}

/// Whether telemetry shows the angles of this very command.
fn shows(told: &MirrorTelemetry, command: &MirrorCommand) -> bool {
    (told.epoch, told.applied_sequence, told.answers) == (command.epoch, command.sequence, command.answers)
        && told.roll_commanded == command.roll
        && told.yaw_commanded == command.yaw
}

#[test]
fn a_driver_in_python_is_led_by_the_controller() {
    let Some(python) = python() else { return };
    let (of_controller, of_tracker) = (free_loopback_endpoint().unwrap(), free_loopback_endpoint().unwrap());
    // A busy machine may take its time from a command to the look at what came of it.
    let set = ["--set", "mirrors.rows=2", "--set", "mirrors.columns=3", "--set", "control.validity_ms=20000"];
    let flags = ["controller", "--room", "led", "--listen", &of_controller, "--policy", "fixed-point"];
    let _controller = Process::heliostat(&[&flags[..], &set, &["--exit-with-parent"]].concat());
    let room = BusConfig::new(Room::new("led").unwrap());
    let tracker = Witness::join(&room.listen_at(&of_tracker).connect_to(&of_controller));
    let _driver = PythonDriver::start(&python, "led", &format!("{of_controller},{of_tracker}"));
    let (mut tick, mut acknowledged) = (0, 0);
    wait_until("ten commands that the driver acknowledges by number, tick and angles", || {
        tick += 1;
        tracker.say(&tracker.room().users(), &report(tick));
        // Longer than from one telemetry to the next.
        std::thread::sleep(Duration::from_millis(120));
        if let (Some(told), Some(command)) = (tracker.telemetry(), tracker.command().1)
            && shows(&told, &command)
        {
            assert_eq!(told.state, ArrayState::Following, "{told:?}");
            assert!(told.counters.accepted > 0 && told.counters.rejected == 0, "{told:?}");
            assert!(command.roll.iter().chain(&command.yaw).any(|angle| angle.abs() > 0.01), "{command:?}");
            acknowledged += u32::from(command.answers == tick);
        }
        acknowledged >= 10
    });
}
