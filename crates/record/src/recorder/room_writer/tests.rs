use std::fs::File;

use foxglove::messages::SceneUpdate;
use heliostat_bus::BusConfig;
use heliostat_proto::{ArrayState, MirrorTelemetry, RoomGeometry, Stamp, encode};
use heliostat_scenario::Scenario;
use heliostat_service::MetricsArgs;
use heliostat_service::log_limit::{EVENT_EVERY, EVENTS_MAX};
use prost::Message;

use super::*;

fn writer(room: &Room, scenario: Scenario) -> RoomWriter<File> {
    let settings = Settings {
        scenario,
        bus: BusConfig::new(room.clone()),
        out: PathBuf::new(),
        run_for: None,
        metrics: MetricsArgs::default(),
        until_empty: false,
        ring: None,
    };
    let file = tempfile::tempfile().expect("a file");
    RoomWriter::create(file, &settings, PathBuf::new()).expect("writable")
}

#[test]
fn a_missing_stream_is_reported_once_during_the_recording() {
    let room = Room::new("alone").expect("a name");
    let scenario = Scenario::builtin("specular").expect("a built-in one");
    let early = MISSING_AFTER - Duration::from_millis(1);
    let after = |keys: &[String]| {
        let mut writer = writer(&room, scenario.clone());
        for key in keys {
            writer.take(Item::Payload { key: key.clone(), arrived_ns: 1, payload: Vec::new() });
        }
        [early, MISSING_AFTER, MISSING_AFTER].map(|recorded| writer.missing_once(recorded).unwrap_or_default())
    };
    assert_eq!(after(&[]), ["", NOTHING, ""]);
    let [early, due, again] = after(&[room.users(), room.telemetry()]);
    assert!(early.is_empty() && again.is_empty(), "{early:?} {again:?}");
    assert!(due.starts_with("no command was received") && due.contains("let the controller connect here"), "{due}");
    let [_, real, _] = after(&[room.command()]);
    assert!(real.starts_with("no position report, no telemetry was received"), "{real}");
    assert!(real.contains("let the tracker and the driver (or the simulator) connect here (--listen)"), "{real}");
    assert_eq!(after(&[room.users(), room.command(), room.telemetry()]), [""; 3]);
    let (mut held, mut payload) = (writer(&room, scenario.clone()), Vec::new());
    let telemetry = MirrorTelemetry { state: ArrayState::Stopped, ..MirrorTelemetry::default() };
    encode(&telemetry, &mut payload).expect("encodable");
    held.take(Item::Payload { key: room.array(0).telemetry(), arrived_ns: 1, payload });
    assert!(held.missing_once(MISSING_AFTER).is_some_and(|reason| reason.contains("is stopped")), "no connection");
}

#[test]
fn the_last_line_of_a_recording_names_the_streams_that_a_replay_lacks() {
    let room = Room::new("alone").expect("a name");
    let scenario = Scenario::builtin("specular").expect("a built-in one");
    let last_line = |keys: &[String]| {
        let mut writer = writer(&room, scenario.clone());
        for key in keys {
            writer.take(Item::Payload { key: key.clone(), arrived_ns: 1, payload: Vec::new() });
        }
        writer.finish(0).to_string().lines().last().unwrap_or_default().to_owned()
    };
    assert_eq!(
        last_line(&[room.command()]),
        "a replay cannot repeat the decisions of this recording: it lacks position reports and telemetry"
    );
    let complete = last_line(&[room.users(), room.command(), room.telemetry()]);
    assert!(complete.starts_with("heliostat/v1/alone/users"), "{complete}");
    assert!(last_line(&[]).starts_with("stream"), "without a message, the error says what was wrong");
}

#[test]
fn invented_geometries_do_not_fill_the_list_of_problems() {
    let room = Room::new("alone").expect("a name");
    let mut writer = writer(&room, Scenario::builtin("specular").expect("a built-in one"));
    for number in 0..2 * PROBLEMS_MAX {
        let geometry = RoomGeometry { stamp: Stamp::default(), scenario: format!("key-{number} = 1") };
        let mut payload = Vec::new();
        encode(&geometry, &mut payload).expect("encodable");
        writer.take(Item::Payload { key: room.geometry(NodeKind::SimNode), arrived_ns: 1, payload });
    }
    assert_eq!(writer.problems.len(), PROBLEMS_MAX);
}

#[test]
fn more_keys_than_a_file_has_places_do_not_end_a_recording() {
    let room = Room::new("alone").expect("a name");
    let mut writer = writer(&room, Scenario::builtin("specular").expect("a built-in one"));
    let mut take = |key: String| writer.take(Item::Payload { key, arrived_ns: 1, payload: Vec::new() });
    take(format!("heliostat/v1/alone/mirrors-{}/stop", "0".repeat(1 << 20)));
    (0..=usize::from(u16::MAX) + 1).for_each(|index| take(format!("heliostat/v1/alone/mirrors-0{index}/stop")));
    take(room.users());
    assert!(!writer.has_failed());
    assert_eq!(writer.account.streams.len(), OTHER_KEYS_MAX + 1);
    assert!(writer.account.streams.contains_key(&room.users()));
    assert_eq!(writer.problems.len(), 1, "{:?}", writer.problems);
    assert!(writer.problems[0].len() < 2000, "{}", writer.problems[0].len());
}

#[test]
fn a_viewer_with_the_source_of_another_process_neither_fills_nor_empties_the_room() {
    let room = Room::new("alone").expect("a name");
    let mut writer = writer(&room, Scenario::builtin("specular").expect("a built-in one"));
    let mut is_empty_again = |node, alive| {
        writer.take(Item::Presence { arrived_ns: 1, presence: Presence { node, source: 7, alive } });
        writer.is_empty_again()
    };
    let (viewer, tracker) = (NodeKind::Viewer, NodeKind::Tracker);
    let steps = [(viewer, true), (viewer, false), (tracker, true), (viewer, true), (viewer, false), (tracker, false)];
    assert_eq!(steps.map(|(node, alive)| is_empty_again(node, alive)), [false, false, false, false, false, true]);
}

#[test]
fn a_flood_of_tokens_has_one_line_in_ten_seconds_and_hides_no_process_of_another_kind() {
    let room = Room::new("alone").expect("a name");
    let mut writer = writer(&room, Scenario::builtin("specular").expect("a built-in one"));
    let begin = Instant::now();
    let mut lines = |at: Duration, sources: u64| {
        let presence = |source| Presence { node: NodeKind::Viewer, source, alive: true };
        (0..sources).filter_map(|source| writer.presence_line(begin + at, presence(source))).count()
    };
    let most = EVENTS_MAX as usize;
    assert_eq!(lines(Duration::ZERO, 10_000), most + 1);
    assert_eq!(lines(EVENT_EVERY, 10_000), 2);
    let controller = Presence { node: NodeKind::Controller, source: 1, alive: false };
    assert!(writer.presence_line(begin + EVENT_EVERY, controller).is_some());
}

#[test]
fn a_recording_whose_file_is_deleted_fails_at_the_next_flush() {
    let scenario = Scenario::builtin("specular").expect("a built-in one");
    let mut writer = writer(&Room::new("deleted").expect("a name"), scenario);
    let file = tempfile::NamedTempFile::new().expect("a file");
    writer.place = Place::new(file.path().to_owned());
    let mut has_failed = || {
        writer.flushed -= FLUSH_EVERY;
        writer.flush_if_due();
        writer.has_failed()
    };
    assert!(!has_failed());
    file.close().expect("a deleted file");
    assert!(has_failed() && writer.failure.is_some_and(|failure| failure.contains("is gone")));
}

#[test]
fn scenes_show_the_geometry_that_the_room_announces() {
    let room = Room::new("drawn").expect("a name");
    let late_ns = 10_000_000_000;
    let scenario = Scenario::builtin("specular").expect("a built-in one");
    let announced = scenario.with_overrides(&["mirrors.rows=4", "mirrors.columns=3"]).expect("valid");
    let mut writer = writer(&room, scenario);
    let mut mirrors_after = |key: String, scenario: String| {
        let mut payload = Vec::new();
        encode(&RoomGeometry { stamp: Stamp::default(), scenario }, &mut payload).expect("it fits");
        writer.take(Item::Payload { key, arrived_ns: 1, payload });
        let update = SceneUpdate::decode(writer.scene.draw(late_ns)).expect("a scene");
        let drawn = update.entities.iter().find(|entity| entity.id == "room").map(|room| room.cubes.len() - 1);
        (drawn, writer.problems.len())
    };
    assert_eq!(mirrors_after(room.geometry(NodeKind::SimNode), announced.geometry_toml()), (Some(12), 0));
    assert_eq!(mirrors_after(room.geometry(NodeKind::SimNode), "[users]".into()), (None, 1), "a problem is reported");
}
