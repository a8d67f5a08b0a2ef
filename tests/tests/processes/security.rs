//! Rooms with keys across processes: who may stop and re-arm, and which processes get no part in a
//! room.

use std::path::Path;
use std::time::{Duration, SystemTime};

use heliostat_bus::{AccessRole, Bus, BusConfig, Certificate, Identity, free_loopback_endpoint, keys};
use heliostat_proto::{ArrayState, EmergencyStop, NodeKind, Rearm, Room, SafetyReport, Stamp, StopAction, decode};
use heliostat_service::clock::utc_ns;
use heliostat_tests::faults::LoopbackBoard;
use heliostat_tests::{Process, RoomObserver, encoded, wait_until};
use serde_json::Value;
use tempfile::TempDir;

const ROOM: &str = "lab";

/// Keys of every role, made by the command line.
struct Keys {
    folder: TempDir,
}

impl Keys {
    fn new() -> Self {
        let keys = Self { folder: tempfile::tempdir().expect("a temporary folder") };
        run(&["keys", "init", "--room", ROOM, "--out", keys.path(), "--json"]).json();
        keys
    }

    fn path(&self) -> &str {
        self.folder.path().to_str().expect("a path in UTF-8")
    }

    /// A folder with the keys of one role only.
    fn of(&self, role: &str) -> Self {
        let keys = Self { folder: tempfile::tempdir().expect("a temporary folder") };
        run(&["keys", "issue", "--role", role, "--dir", self.path(), "--out", keys.path()]);
        keys
    }

    fn config(&self, role: AccessRole, endpoints: &[&str]) -> BusConfig {
        let identity = Identity::load(self.folder.path(), &[role]).expect("keys of each role");
        let config = BusConfig::new(identity.room().clone()).secured_by(identity);
        endpoints.iter().fold(config, |config, endpoint| config.connect_to(endpoint))
    }

    /// A session with a role.
    fn observer(&self, role: AccessRole, endpoints: &[&str]) -> RoomObserver {
        RoomObserver::join(&self.config(role, endpoints))
    }

    /// The safety report that the driver gives a viewer.
    fn safety_report(&self, endpoint: &str) -> SafetyReport {
        let bus = Bus::open(&self.config(AccessRole::Viewer, &[endpoint])).expect("the bus opens");
        let mut answers = Vec::new();
        wait_until("a safety report", || {
            answers = bus.fetch(&bus.room().safety(), Duration::from_secs(1)).expect("a valid key");
            !answers.is_empty()
        });
        decode(&answers[0]).expect("a valid message")
    }
}

fn run(arguments: &[&str]) -> heliostat_tests::Ended {
    Process::heliostat(arguments).wait()
}

fn tls_endpoint() -> String {
    free_loopback_endpoint().expect("a free port").replace("tcp/", "tls/")
}

/// A simulated room and a controller with these keys.
fn start(keys: &Keys, room: &str, controller: &str) -> [Process; 2] {
    let common = ["--tls", keys.path(), "--exit-with-parent", "--json"];
    let room_arguments = [&["sim-node", "--listen", room][..], &common].concat();
    let policy = ["controller", "--policy", "fixed-point", "--connect", room, "--listen", controller];
    [Process::heliostat(&room_arguments), Process::heliostat(&[&policy[..], &common].concat())]
}

#[test]
fn a_room_with_keys_answers_reports_and_only_an_operator_releases_a_stop() {
    let keys = Keys::new();
    let (room, controller) = (tls_endpoint(), tls_endpoint());
    let processes = start(&keys, &room, &controller);
    let viewer = keys.observer(AccessRole::Viewer, &[&room, &controller]);
    viewer.wait_for_commands();
    let state = || viewer.telemetry().map(|array| array.state);
    wait_until("an array that follows", || state() == Some(ArrayState::Following));

    let viewers_folder = keys.of("viewer");
    let order =
        |name: &str, keys: &Keys| run(&[name, "--tls", keys.path(), "--connect", &room, "--timeout", "60", "--json"]);
    assert_eq!(order("stop", &viewers_folder).json()["array"], "stopped");
    wait_until("a stopped array", || state() == Some(ArrayState::Stopped));

    // The command line refuses for lack of a certificate; a program of its own does not ask.
    let refusal = order("rearm", &viewers_folder);
    assert!(refusal.refusal().contains("expected one of: operator"), "{}", refusal.errors);
    let stamp = |sequence| Stamp { source: 7, sequence, time_ns: utc_ns() + 1_000_000_000 };
    let names = viewer.room().clone();
    let latched = keys.safety_report(&room);
    assert!(latched.stopped, "{latched:?}");
    for sequence in 1..=20 {
        let (operator, reason) = ("viewer".to_owned(), String::new());
        let unnamed = EmergencyStop { action: StopAction::Rearm, stamp: stamp(sequence), operator, reason };
        viewer.publish(&names.stop(), &encoded(&unnamed));
        let SafetyReport { stop_source, stop_sequence, .. } = latched;
        let named = Rearm { stamp: stamp(sequence), stop_source, stop_sequence, ..Rearm::default() };
        viewer.publish(&names.rearm(), &encoded(&named));
        std::thread::sleep(Duration::from_millis(50));
        assert_eq!(state(), Some(ArrayState::Stopped));
    }
    assert_eq!(order("rearm", &keys.of("operator")).json()["array"], "released");
    wait_until("an array that follows again", || state() == Some(ArrayState::Following));

    let [room, controller] = processes.map(|process| process.end().json());
    assert!(controller["commands"].as_u64() > Some(0), "{controller}");
    // The unnamed re-arms arrive on the key of the stop; the named ones do not arrive at all.
    assert_eq!(room["refused"]["rearm:unnamed"], 20, "{room}");
    let refused = room["refused"].as_object().expect("an object");
    assert_eq!(refused.keys().filter(|name| name.starts_with("rearm:")).count(), 1, "{room}");
}

#[test]
fn a_calibration_is_applied_with_the_keys_of_a_calibrator_only() {
    let (keys, endpoint) = (Keys::new(), tls_endpoint());
    let size = ["--set", "mirrors.rows=2", "--set", "mirrors.columns=2"];
    let own = ["sim-node", "--listen", &endpoint, "--tls", keys.path(), "--exit-with-parent"];
    let _room = Process::heliostat(&[&own[..], &size].concat());
    keys.safety_report(&endpoint);
    let file = keys.folder.path().join("calibration.toml");
    let axis = "offset_deg = [0.5, 0.5, 0.5, 0.5]\ngain = [1.0, 1.0, 1.0, 1.0]";
    std::fs::write(&file, format!("rows = 2\ncolumns = 2\n[roll]\n{axis}\n[yaw]\n{axis}\n")).expect("writable");
    let file = file.to_str().expect("a path in UTF-8");
    let apply =
        |keys: &Keys| run(&["calibrate", "apply", file, "--connect", &endpoint, "--tls", keys.path(), "--json"]);
    let viewer = apply(&keys.of("viewer"));
    assert!(viewer.refusal().contains("expected one of: calibrator"), "{}", viewer.errors);
    assert_eq!(apply(&keys.of("calibrator")).json()["former"], 0);
}

#[test]
fn a_controller_with_foreign_keys_takes_no_part_in_a_room() {
    let (keys, foreign) = (Keys::new(), Keys::new());
    let (room, controller) = (tls_endpoint(), tls_endpoint());
    let arguments = ["controller", "--policy", "fixed-point", "--connect", &room, "--seconds", "4", "--json"];
    let stranger = Process::heliostat(&[&arguments[..], &["--tls", foreign.path()]].concat());
    let _processes = start(&keys, &room, &controller);
    let viewer = keys.observer(AccessRole::Viewer, &[&room, &controller]);
    viewer.wait_for_commands();
    let epoch = viewer.command().1.expect("a command").epoch;
    let summary = stranger.wait().json();
    assert_eq!((&summary["commands"], &summary["decisions"]), (&Value::from(0), &Value::from(0)), "{summary}");
    viewer.wait_for_commands();
    assert_eq!(viewer.command().1.expect("a command").epoch, epoch, "the controller of the room is in command");
}

#[test]
fn a_plain_process_gets_nothing_from_a_room_with_keys() {
    let keys = Keys::new();
    let (room, controller) = (tls_endpoint(), tls_endpoint());
    let _processes = start(&keys, &room, &controller);
    keys.observer(AccessRole::Viewer, &[&room, &controller]).wait_for_commands();
    let plain = [&room, &controller].map(|endpoint| endpoint.replace("tls/", "tcp/"));
    let config = plain
        .iter()
        .fold(BusConfig::new(Room::new(ROOM).expect("a valid name")), |config, endpoint| config.connect_to(endpoint));
    let stranger = RoomObserver::join(&config);
    let stop = EmergencyStop { action: StopAction::Stop, ..EmergencyStop::default() };
    for _ in 0..20 {
        stranger.publish(&stranger.room().stop(), &encoded(&stop));
        std::thread::sleep(Duration::from_millis(50));
    }
    assert!(stranger.users().is_none() && stranger.telemetry().is_none() && stranger.command().0 == 0);
    assert!(stranger.status(NodeKind::SimNode).is_none() && stranger.truth().is_none());
    let viewer = keys.observer(AccessRole::Viewer, &[&room, &controller]);
    viewer.wait_for_commands();
    wait_until("an array that follows", || {
        viewer.telemetry().is_some_and(|array| array.state == ArrayState::Following)
    });
}

#[test]
fn a_check_that_is_not_connected_names_the_fault_of_its_keys() {
    let (keys, foreign) = (Keys::new(), Keys::new());
    let (room, controller) = (tls_endpoint(), tls_endpoint());
    let _processes = start(&keys, &room, &controller);
    keys.observer(AccessRole::Viewer, &[&room, &controller]).wait_for_commands();
    let check = |arguments: &[&str]| {
        let ended = run(&[&["driver", "check", "--room", ROOM, "--wait", "5"], arguments].concat());
        assert_eq!(ended.status.code(), Some(1), "{}", ended.errors);
        ended.errors
    };
    let refused = check(&["--connect", &room, "--tls", foreign.path()]);
    assert!(refused.contains("another authority than"), "{refused}");
    let plain = check(&["--connect", &room.replace("tls/", "tcp/")]);
    assert!(plain.contains("accepts encrypted connections only") && plain.contains(&room), "{plain}");
}

#[test]
fn an_array_in_the_controllers_process_has_the_keys_of_a_driver() {
    let (keys, board, folder) = (Keys::new(), LoopbackBoard::start(4), tempfile::tempdir().expect("a folder"));
    let at = |name: &str| folder.path().join(name).display().to_string();
    std::fs::write(at("array.toml"), board.configuration()).expect("a file");
    let (of_viewer, file, state) = (tls_endpoint(), at("array.toml"), at("state"));
    let start = |keys: &Keys| {
        let session = ["controller", "--tls", keys.path(), "--connect", &of_viewer, "--exit-with-parent", "--json"];
        let array = ["--driver", &file, "--state", &state, "--start-armed"];
        let mirrors = ["--set", "mirrors.rows=2", "--set", "mirrors.columns=2"];
        Process::heliostat(&[&session[..], &array, &mirrors].concat())
    };
    let lacking = start(&keys.of("controller")).wait();
    assert!(lacking.refusal().contains("--driver needs the keys of a driver too"), "{}", lacking.errors);
    let identity = Identity::load(keys.folder.path(), &[AccessRole::Viewer]).expect("keys of each role");
    let config = BusConfig::new(identity.room().clone()).secured_by(identity).listen_at(&of_viewer);
    let viewer = RoomObserver::join(&config);
    let process = start(&keys);
    wait_until("a controller that knows the array, and an array that reports", || {
        viewer.telemetry().is_some_and(|array| array.state == ArrayState::Parked)
            && viewer.status(NodeKind::Controller).is_some_and(|status| status.counter("driver_absent") == Some(0))
    });
    process.end().json();
}

#[test]
fn an_expired_certificate_is_named_before_a_process_starts() {
    let keys = Keys::new();
    let yesterday = SystemTime::now() - Duration::from_secs(86_400);
    keys::renew(keys.folder.path(), keys.folder.path(), yesterday).expect("a folder of keys");
    let ended = run(&["sim-node", "--tls", keys.path(), "--listen", &tls_endpoint()]);
    let problem = ended.refusal();
    assert!(problem.contains("simulator.pem: the certificate expired on "), "{problem}");
    assert!(problem.contains("heliostat keys renew"), "{problem}");
}

#[test]
fn listening_beyond_this_machine_needs_keys_or_a_flag() {
    let open = free_loopback_endpoint().expect("a free port").replace("127.0.0.1", "0.0.0.0");
    for command in [
        &["sim-node"][..],
        &["controller", "--policy", "fixed-point"],
        &["record", "--out", "unused.mcap"],
        &["ui", "--plain"],
        &["stop"],
    ] {
        let ended = run(&[command, &["--listen", &open]].concat());
        let problem = ended.refusal();
        assert!(
            problem.contains(&open) && problem.contains("--tls DIR") && problem.contains("--insecure"),
            "{problem}"
        );
    }
    let insecure = run(&["sim-node", "--listen", &open, "--insecure", "--seconds", "1", "--json"]);
    assert!(insecure.errors.contains("neither encrypted nor authenticated"), "{}", insecure.errors);
    assert!(insecure.json()["ticks"].as_u64() > Some(0), "{}", insecure.output);
    let keys = Keys::new();
    let secured = ["sim-node", "--listen", &open.replace("tcp/", "tls/"), "--tls", keys.path(), "--seconds", "1"];
    let secured = run(&[&secured[..], &["--json"]].concat());
    assert!(secured.json()["ticks"].as_u64() > Some(0), "{}", secured.output);
    assert!(!secured.errors.contains("neither encrypted"), "{}", secured.errors);
}

#[test]
fn endpoints_rooms_and_folders_that_do_not_suit_the_keys_are_refused() {
    let keys = Keys::new();
    let refused = |arguments: &[&str], expected: &str| {
        let ended = run(arguments);
        assert!(ended.refusal().contains(expected), "{arguments:?}: {}", ended.errors);
    };
    let plain = free_loopback_endpoint().expect("a free port");
    refused(&["sim-node", "--tls", keys.path(), "--listen", &plain], "expected tls/HOST:PORT");
    refused(&["sim-node", "--listen", &plain.replace("tcp/", "tls/")], "expected --tls DIR");
    refused(&["sim-node", "--tls", keys.path(), "--room", "hall"], "the keys are for room \"lab\"");
    refused(&["sim-node", "--tls", keys.of("viewer").path()], "expected one of: simulator");
    refused(&["sim-node", "--tls", "no/such/folder"], "cannot read no/such/folder");
    refused(&["sim-node", "--tls", keys.path(), "--insecure"], "cannot be used with");
    refused(&["controller", "--tls", keys.path(), "--also-room", "hall"], "a certificate gives rights in one room");
    // Keys of one authority with the certificate of another.
    let mixed = Keys::new();
    std::fs::copy(Path::new(keys.path()).join("ca.pem"), Path::new(mixed.path()).join("ca.pem")).expect("a file");
    refused(&["sim-node", "--tls", mixed.path()], "another authority");
}

#[test]
fn keys_are_made_issued_renewed_and_listed() {
    let keys = Keys::new();
    let again = run(&["keys", "init", "--room", ROOM, "--out", keys.path()]);
    assert!(again.refusal().contains("exists"), "{}", again.errors);

    let machine = tempfile::tempdir().expect("a temporary folder");
    let out = machine.path().to_str().expect("a path in UTF-8");
    let issue = ["keys", "issue", "--role", "tracker", "--dir", keys.path(), "--out", out, "--host", "camera.lab"];
    let issued = run(&[&issue[..], &["--days", "7", "--json"]].concat()).json();
    let [certificate] = &issued["certificates"].as_array().expect("a list")[..] else { panic!("{issued}") };
    assert_eq!((&certificate["role"], &certificate["room"]), (&"tracker".into(), &ROOM.into()), "{issued}");
    assert_eq!(certificate["name"], "heliostat-lab-tracker");
    assert_eq!(certificate["hosts"], Value::from(vec!["localhost", "127.0.0.1", "::1", "camera.lab"]));
    assert!((6..=7).contains(&certificate["days_left"].as_i64().expect("a number")), "{issued}");
    let mut files: Vec<String> = machine
        .path()
        .read_dir()
        .expect("a folder")
        .map(|file| file.expect("a file").file_name().into_string().expect("UTF-8"))
        .collect();
    files.sort_unstable();
    assert_eq!(
        files,
        ["ca.pem", "tracker.key", "tracker.pem", "zenoh-tracker.json5"],
        "no other key leaves the machine"
    );

    let file = machine.path().join("tracker.pem");
    let before = std::fs::read(&file).expect("a file");
    let renewed = run(&["keys", "renew", "--dir", keys.path(), "--out", out, "--days", "30", "--json"]).json();
    assert_ne!(std::fs::read(&file).expect("a file"), before);
    let certificate = Certificate::read(&file).expect("a certificate");
    assert_eq!(certificate.hosts, ["localhost", "127.0.0.1", "::1", "camera.lab"]);
    assert!((29..=30).contains(&certificate.days_left()), "{renewed}");
    // The days that are left fall by one within a second.
    let lasting = |mut listed: Value| {
        listed["certificates"][0]["days_left"].take();
        listed
    };
    assert_eq!(lasting(run(&["keys", "show", "--dir", out, "--json"]).json()), lasting(renewed));
    assert!(run(&["keys", "renew", "--dir", out]).refusal().contains("ca.key"), "a machine cannot issue certificates");
}

#[cfg(unix)]
#[test]
fn private_keys_are_readable_by_their_owner_only_and_others_are_refused() {
    use std::fs::{self, Permissions};
    use std::os::unix::fs::PermissionsExt;
    let keys = Keys::new();
    for file in keys.folder.path().read_dir().expect("a folder").map(|file| file.expect("a file").path()) {
        if file.extension().is_some_and(|extension| extension == "key") {
            assert_eq!(fs::metadata(&file).expect("a file").permissions().mode() & 0o777, 0o600, "{}", file.display());
        }
    }
    let key = keys.folder.path().join("simulator.key");
    fs::set_permissions(&key, Permissions::from_mode(0o644)).expect("an own file");
    let ended = run(&["sim-node", "--tls", keys.path(), "--listen", &tls_endpoint()]);
    assert!(ended.refusal().contains("expected chmod 600 or 640"), "{}", ended.errors);
}
