//! The readers of files: text and binary, each with what a process does with the result.
//!
//! An input that starts with a zero byte is the file itself, after that byte. Any other input is a
//! script that edits a sound file.

use heliostat_array::calibration_file::CalibrationFile;
use heliostat_channel::MirrorAngles;
use heliostat_core::observation::Observation;
use heliostat_core::policy::actor_file::ActorFile;
use heliostat_core::policy::{Policy, PolicyKind};
use heliostat_driver::Device;
use heliostat_driver::config::Config;
use heliostat_models::{ActorSource, library, load_actor};
use heliostat_proto::*;
use heliostat_record::account::Account;
use heliostat_record::file::{Header, Recording};
use heliostat_record::replay;
use heliostat_room::episode::Event;
use heliostat_room::reports::Report;
use heliostat_room::{Episode, SimulatedRoom};
use heliostat_scenario::{BUILTIN_NAMES, Scenario};

use crate::forge::{self, Genuine};
use crate::onnx_edits;
use crate::script::Script;

/// Largest room that is also simulated, in pairs of a mirror and a user.
const SIMULATED_MAX: usize = 2_000;

const CALIBRATION: &str = "rows = 1\ncolumns = 2\n\n[roll]\noffset_deg = [0.52, -0.1]\ngain = [1.0, 1.01]\n\n\
                           [yaw]\noffset_deg = [0.0, 0.25]\ngain = [1.0, 0.99]\n";

const DRIVER: &str = "rows = 1\ncolumns = 3\ncalibration_reserve_deg = 1.0\npark_after_ms = 500\n\n\
                      [[boards]]\nkind = \"playzerx\"\naddress = \"serial:/dev/ttyACM0\"\nrange_deg = 5.0\n\
                      sample_rate_hz = 1000\nmirrors = [2]\n\n\
                      [[boards]]\nkind = \"servo-board\"\naddress = \"tcp:127.0.0.1:9000\"\nmin_deg = -20.0\n\
                      max_deg = 30.0\nslew_deg_per_s = 90.0\nsettling_ms = 8.0\nresolution_deg = 0.1\n\
                      measures = true\nmirrors = [1, 0]\n";

const TRACE: &str = "time,user,x,y\n# a comment\n10,0,0,0\n10,1,1,1\n12,0,2,0\n14,0,2,2\n14.5,1,-1,0.5\n";
const HEADED: &str = "time,user,x,y,heading_deg\n0,0,0,0,170\n0,1,1,1,-5.5\n2,0,2,0,-170\n3,1,-1,0.5,1e308\n";

/// The bytes after a leading zero byte.
fn whole_file(input: &[u8]) -> Option<&[u8]> {
    input.strip_prefix(&[0])
}

/// The text of a file: the input itself, or an edited example.
fn text(input: &[u8], script: &mut Script<'_>, examples: &[&str]) -> String {
    match whole_file(input) {
        Some(file) => String::from_utf8_lossy(file).into_owned(),
        None => {
            let example = examples[script.below(examples.len())];
            script.edit_text(example)
        }
    }
}

/// A room of two users and six mirrors.
fn small_room() -> Scenario {
    let small = ["mirrors.rows=2", "mirrors.columns=3", "users.count=2"];
    Scenario::builtin("specular").and_then(|full| full.with_overrides(&small)).expect("valid")
}

fn assert_finite(room: &SimulatedRoom) {
    let angles = room.angles();
    let mut numbers = angles.roll.iter().chain(&angles.yaw).copied();
    assert!(numbers.all(f64::is_finite), "angles {angles:?}");
    let world = room.world();
    let mut numbers = world.positions().iter().flat_map(|at| [at.x, at.y, at.z]);
    assert!(numbers.all(f64::is_finite), "positions {:?}", world.positions());
}

/// A scenario file: a room that is accepted can be written again, and simulated.
pub fn scenario(input: &[u8]) {
    let mut script = Script::new(input);
    let examples: Vec<&str> = BUILTIN_NAMES.iter().filter_map(|name| Scenario::builtin_text(name).ok()).collect();
    let Ok(scenario) = Scenario::from_toml(&text(input, &mut script, &examples)) else { return };
    let effective = scenario.to_toml();
    let again = Scenario::from_toml(&effective).unwrap_or_else(|error| panic!("{error}\n{effective}"));
    assert_eq!(again.hash(), scenario.hash(), "{effective}");
    if scenario.mirror_count().saturating_mul(scenario.users.count) > SIMULATED_MAX || scenario.users.trace.is_some() {
        return;
    }
    let Ok(mut episode) = Episode::new(&scenario, None, 1, 0) else { return };
    let end_ns = 30_000_000;
    let mut payload = Vec::new();
    while let Some((_, event)) = episode.poll_event(end_ns) {
        let encoded = match &event {
            Event::Telemetry(_, report) => encode(report.as_ref(), &mut payload),
            Event::Report(Report::Users(report)) => encode(report, &mut payload),
            Event::Report(Report::Channel(report)) => encode(report, &mut payload),
            Event::Report(Report::Obstacles(report)) => encode(report, &mut payload),
            Event::Report(Report::Orientation(report)) => encode(report, &mut payload),
            Event::Report(Report::Branches(report)) => encode(report, &mut payload),
            Event::Report(Report::Leds(report)) => encode(report, &mut payload),
        };
        encoded.unwrap_or_else(|error| panic!("{error}: {event:?}"));
    }
    episode.advance(end_ns);
    assert_finite(episode.room());
}

/// A recorded walk: users of a walk that is accepted stay at finite positions.
pub fn trace(input: &[u8]) {
    let mut script = Script::new(input);
    let text = text(input, &mut script, &[TRACE, HEADED]);
    let Ok(mut room) = SimulatedRoom::new(&small_room(), Some(&text), 1) else { return };
    let mut now_ns = 0;
    for _ in 0..20 {
        now_ns += [1_000_000, 100_000_000, 3_000_000_000][script.below(3)];
        room.advance(now_ns);
        assert_finite(&room);
    }
}

/// The files of a driver: what is accepted can be announced and sent.
pub fn configuration(input: &[u8]) {
    let mut script = Script::new(input);
    let text = text(input, &mut script, &[CALIBRATION, DRIVER]);
    let mut payload = Vec::new();
    if let Ok(calibration) = CalibrationFile::parse(&text) {
        let mirrors = calibration.rows.checked_mul(calibration.columns);
        assert_eq!(mirrors, Some(calibration.roll.gain.len()), "the lists fit the array");
        CalibrationFile::parse(&calibration.to_toml()).expect("it can be read again");
        // The message may be refused: an offset may exceed single precision.
        drop(encode(&calibration.message(Stamp::default()), &mut payload));
    }
    let Ok(wall) = toml::from_str::<Config>(&text).map_err(anyhow::Error::from).and_then(|config| config.wall()) else {
        return;
    };
    let capabilities = wall.capabilities();
    encode(&capabilities, &mut payload).unwrap_or_else(|error| panic!("{error}: {capabilities:?}"));
}

/// A recording: read to its end and replayed, if its bytes allow that.
pub fn recording(input: &[u8]) {
    let mut script = Script::new(input);
    let file = tempfile::NamedTempFile::new().expect("a file");
    match whole_file(input) {
        Some(bytes) => std::fs::write(file.path(), bytes).expect("a file"),
        None => write_recording(&mut script, &file),
    }
    let edited = script.one_in(2);
    if edited {
        let mut bytes = std::fs::read(file.path()).expect("a file");
        script.edit_bytes(&mut bytes);
        std::fs::write(file.path(), bytes).expect("a file");
    }
    let settings = replay::Settings {
        file: file.path().to_owned(),
        policy: Some(PolicyKind::Nearest),
        model: None,
        settle: Some(0),
    };
    if let Ok(verdict) = replay::run(&settings) {
        assert!(verdict.compared <= verdict.reports, "more commands than reports");
    }
}

/// Writes a recording whose structure is sound and whose messages are hostile.
fn write_recording(script: &mut Script<'_>, file: &tempfile::NamedTempFile) {
    let mut scenario = small_room().to_toml();
    if script.one_in(8) {
        scenario = script.edit_text(&scenario);
    }
    let header = Header {
        room: "a".into(),
        scenario_hash: Scenario::hash_of(&scenario),
        scenario,
        contract: VERSION.to_string(),
        ..Header::default()
    };
    let mut recording = Recording::create(file.reopen().expect("a file"), &header).expect("a disk with space");
    let room = Room::new("a").expect("a valid name");
    let start_ns = 1_767_323_045_678_000_000;
    let mut payload = Vec::new();
    for index in 0..script.below(24) as u64 {
        let kinds = [Kind::UserReport, Kind::MirrorCommand, Kind::ChannelReport];
        let kind =
            if script.one_in(4) { Kind::ALL[script.below(Kind::ALL.len())] } else { kinds[script.below(kinds.len())] };
        let key = match kind {
            Kind::UserReport => room.users(),
            Kind::ChannelReport => room.channel(),
            Kind::ObstacleReport => room.obstacles(),
            Kind::OrientationReport => room.orientation(),
            Kind::BranchReport => room.branches(),
            Kind::StopReport => room.stops(),
            Kind::StopRepetition => room.stop_repetition(),
            Kind::LedReport => room.leds(),
            Kind::MirrorCommand => room.command(),
            Kind::MirrorTelemetry => room.telemetry(),
            Kind::Capabilities => room.capabilities(),
            Kind::EmergencyStop => room.stop(),
            Kind::Rearm => room.rearm(),
            Kind::SafetyReport => room.safety(),
            Kind::Calibration => room.calibration(),
            Kind::RoomTruth => room.truth(),
            Kind::RoomGeometry => room.geometry(NodeKind::SimNode),
            Kind::BeliefReport => room.belief(),
            Kind::ControllerMemory => room.controller_memory(),
            Kind::ControllerControl => room.controller_control(),
            Kind::SimulatorControl => room.simulator_control(),
            Kind::NodeStatus => room.status(NodeKind::Controller),
        };
        let time_ns = start_ns + index * 10_000_000;
        let genuine = Genuine { source: 7, sequence: index + 1, time_ns, epoch: 7, tick: index / 2, stop: (0, 0) };
        forge::write(script, kind, &genuine, &mut payload);
        recording.payload(&key, time_ns, index, &payload).expect("a disk with space");
    }
    recording.finish(&Account::default()).expect("a disk with space");
}

/// The file of an actor: a network that is loaded answers with finite angles or an error.
pub fn actor(input: &[u8]) {
    let mut script = Script::new(input);
    // The readers of this workspace are tested, not the library of ONNX Runtime.
    library::choose("none".into());
    let scenario = Scenario::builtin("specular").expect("valid");
    let bytes = match whole_file(input) {
        Some(bytes) => bytes.to_vec(),
        None => {
            let shipped = ActorSource::Shipped.fetch(PolicyKind::Ddpg, &scenario).expect("a shipped actor");
            onnx_edits::edited(&mut script, &shipped.bytes)
        }
    };
    let file = ActorFile { origin: "input.onnx".into(), bytes: bytes.into() };
    let Ok(mut actor) = load_actor(&file, &scenario) else { return };
    let model = scenario.channel_model().expect("valid");
    let mut angles = MirrorAngles::flat(model.mirrors.len());
    if actor.act(&model, &Observation::new(&model, scenario.users.count), &mut angles).is_ok() {
        assert!(angles.roll.iter().chain(&angles.yaw).all(|angle| angle.is_finite()), "{angles:?}");
    }
}
