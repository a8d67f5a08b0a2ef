//! A played walk, recorded and exported, is the walk.

use std::fs::File;

use heliostat_proto::{Stamp, TruthUser, UserState, VERSION, encode};
use heliostat_record::account::Account;
use heliostat_record::file::{Header, Recording};
use heliostat_room::World;
use heliostat_room::walks::formats::{Source, WalkFormat, read};
use heliostat_room::walks::text::trace_text;
use heliostat_room::walks::tracks::TrackPoint;
use heliostat_room::world::walker::Walker;
use tempfile::NamedTempFile;

use super::*;

const WALK: &str = "time,user,x,y,heading_deg\n0,0,-2,-1,350\n0,1,1,1,90\n4,0,2,-1,10\n4,1,-1,0,180\n";

/// A recording of the scenario's room, still empty.
fn begun(scenario: &Scenario, file: &NamedTempFile) -> Recording<File> {
    let header = Header {
        room: "lab".to_owned(),
        contract: VERSION.to_string(),
        scenario: scenario.to_toml(),
        ..Header::default()
    };
    Recording::create(file.reopen().expect("a file"), &header).expect("a recording")
}

/// A recording of the room that plays the walk, with a message every 50 ms.
fn recording(scenario: &Scenario, with_truth: bool) -> NamedTempFile {
    let mut world = World::new(scenario, Some(WALK), 1).expect("a world");
    let room = Room::new("lab").expect("a name");
    let file = NamedTempFile::new().expect("a file");
    let mut recording = begun(scenario, &file);
    let mut payload = Vec::new();
    for tick in 1..=79 {
        let time_ns = 1_700_000_000_000_000_000 + 50_000_000 * tick;
        let stamp = Stamp { source: 1, sequence: tick, time_ns };
        let truth = truth_users(&world);
        let (key, encoded) = if with_truth {
            let truth = RoomTruth { stamp, tick, users: truth, ..RoomTruth::default() };
            (room.truth(), encode(&truth, &mut payload))
        } else {
            let state =
                |user: &TruthUser| UserState { user: user.user, position_m: user.position_m, ..UserState::default() };
            let report = UserReport { stamp, tick, users: truth.iter().map(state).collect() };
            (room.users(), encode(&report, &mut payload))
        };
        encoded.expect("a payload");
        recording.payload(&key, time_ns, time_ns, &payload).expect("written");
        world.step(0.05);
    }
    recording.finish(&Account::default()).expect("finished");
    file
}

fn truth_users(world: &World) -> Vec<TruthUser> {
    let user = |(walker, user): (&Walker, &u32)| TruthUser {
        user: *user,
        position_m: [walker.position.x, walker.position.y, walker.position.z].map(|coordinate| coordinate as f32),
        heading_rad: walker.heading() as f32,
        ..TruthUser::default()
    };
    world.users().iter().zip(world.ids()).map(user).collect()
}

fn scenario() -> Scenario {
    let small = ["users.count=2", "users.trace=\"walk.csv\""];
    Scenario::builtin("specular").and_then(|full| full.with_overrides(&small)).expect("valid")
}

/// The tracks of a text, as `trace import --format csv --max-gap-s 10` reads them.
fn imported(text: &str) -> Vec<Track> {
    let mut collector = Collector::new(Kept { max_gap_s: 10.0, ..Kept::default() });
    read(&Source::of(WalkFormat::Csv), text.as_bytes(), &mut |row| collector.add(row)).expect("readable");
    collector.finish().tracks
}

fn exported(file: &NamedTempFile) -> (Recorded, String) {
    let recorded = users(file::open(file.path()).expect("a recording")).expect("users");
    let text = trace_text(&recorded.users, &recorded.floor);
    (recorded, text)
}

#[test]
fn a_walk_that_was_simulated_recorded_exported_and_imported_is_the_walk() {
    let (recorded, text) = exported(&recording(&scenario(), true));
    assert!(recorded.is_true && recorded.refused == 0);
    let again = imported(&text);
    let walk = imported(WALK);
    assert_eq!((again.len(), again[0].points.len()), (2, 79));
    for (original, copy) in walk.iter().zip(&again) {
        for TrackPoint { time_s, at_m, heading_rad } in &copy.points {
            let expected = original.at(*time_s);
            let apart = (expected.at_m[0] - at_m[0]).hypot(expected.at_m[1] - at_m[1]);
            let turned = (expected.heading_rad.expect("a heading") - heading_rad.expect("a heading")).sin();
            assert!(apart < 2e-4 && turned.abs() < 2e-4, "{apart} m, {turned} after {time_s} s");
        }
    }
}

#[test]
fn a_recording_without_truth_is_exported_from_the_reports_without_headings() {
    let (recorded, text) = exported(&recording(&scenario(), false));
    assert!(!recorded.is_true);
    assert!(text.starts_with("time,user,x,y\n0,0,-2,-1\n0,1,1,1\n0.05,0,-1.95,-1\n"), "{}", &text[..80]);
}

#[test]
fn a_recording_without_users_is_refused() {
    let file = NamedTempFile::new().expect("a file");
    begun(&scenario(), &file).finish(&Account::default()).expect("an empty recording");
    let refusal = users(file::open(file.path()).expect("a recording")).err().expect("refused").to_string();
    assert!(refusal.contains("no positions of users"), "{refusal}");
}

#[test]
fn the_positions_after_a_jump_are_left_out_until_they_can_be_a_walk() {
    let point = |(time_s, at_m)| TrackPoint { time_s, at_m, heading_rad: None };
    let walk = [(0.0, [-2.0, 0.0]), (0.05, [-1.95, 0.0]), (0.1, [2.5, 2.5]), (0.15, [2.5, 2.5]), (0.2, [2.45, 2.5])];
    let mut points = walk.map(point).to_vec();
    assert_eq!(leave_out_jumps(&mut points), 1);
    assert_eq!(points, [walk[0], walk[1], walk[3], walk[4]].map(point));
    assert_eq!(leave_out_jumps(&mut points), 0);
}
