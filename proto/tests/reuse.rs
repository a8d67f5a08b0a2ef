//! Once warm, neither way allocates: buffers stay where they are and keep their capacity.

mod common;

use common::*;
use heliostat_proto::*;

/// Where a list's memory is, and how much of it there is.
fn place<T>(list: &Vec<T>) -> (*const T, usize) {
    (list.as_ptr(), list.capacity())
}

fn command(sequence: u64, mirrors: usize) -> MirrorCommand {
    let angle = |index: usize| (index as f32 + sequence as f32) * 1e-3;
    let angles: Vec<f32> = (0..mirrors).map(angle).collect();
    MirrorCommand { sequence, roll: angles.clone(), yaw: angles, ..mirror_command() }
}

#[test]
fn a_command_is_read_into_the_same_memory() {
    let mut warm: MirrorCommand = decode(&encoded(&command(1, 100))).expect("sound");
    let before = (place(&warm.roll), place(&warm.yaw));
    for (sequence, mirrors) in [(2, 100), (3, 49), (4, 0), (5, 100)] {
        let wanted = command(sequence, mirrors);
        decode_into(&mut warm, &encoded(&wanted)).expect("sound");
        assert_eq!(warm, wanted);
        assert_eq!((place(&warm.roll), place(&warm.yaw)), before);
    }
}

#[test]
fn reports_are_read_into_the_same_memory() {
    let users = |count: usize| UserReport { users: vec![user_report().users[0]; count], ..user_report() };
    let channel = |count: usize| ChannelReport { users: vec![channel_report().users[0]; count], ..channel_report() };
    let obstacles = |count: usize| ObstacleReport { obstacles: vec![obstacle(); count], ..obstacle_report() };
    let mut warm: (UserReport, ChannelReport, ObstacleReport) = Default::default();
    let mut before = None;
    for count in [10, 3, 0, 10] {
        decode_into(&mut warm.0, &encoded(&users(count))).expect("sound");
        decode_into(&mut warm.1, &encoded(&channel(count))).expect("sound");
        decode_into(&mut warm.2, &encoded(&obstacles(count))).expect("sound");
        assert_eq!(warm, (users(count), channel(count), obstacles(count)));
        let now = (place(&warm.0.users), place(&warm.1.users), place(&warm.2.obstacles));
        assert_eq!(now, *before.get_or_insert(now));
    }
}

#[test]
fn telemetry_and_texts_are_read_into_the_same_memory() {
    let mut telemetry = mirror_telemetry();
    let before = (place(&telemetry.roll_commanded), place(&telemetry.roll_measured), place(&telemetry.unusable));
    decode_into(&mut telemetry, &encoded(&mirror_telemetry())).expect("sound");
    let after = (place(&telemetry.roll_commanded), place(&telemetry.roll_measured), place(&telemetry.unusable));
    assert_eq!(after, before);
    let mut status = node_status();
    let before = (status.name.as_ptr(), place(&status.counters));
    decode_into(&mut status, &encoded(&node_status())).expect("sound");
    assert_eq!((status.name.as_ptr(), place(&status.counters)), before);
}

#[test]
fn a_payload_is_written_into_the_same_memory() {
    let mut buffer = Vec::new();
    encode(&command(1, 100), &mut buffer).expect("sound");
    let before = place(&buffer);
    for (sequence, mirrors) in [(2, 100), (3, 0), (4, 100)] {
        encode(&command(sequence, mirrors), &mut buffer).expect("sound");
        assert_eq!(place(&buffer), before);
    }
}

#[test]
fn a_refused_payload_does_not_keep_a_later_one_from_being_read() {
    let mut warm = MirrorCommand::default();
    let payload = encoded(&command(9, 16));
    for length in 2..payload.len() {
        assert!(decode_into(&mut warm, &payload[..length]).is_err());
        decode_into(&mut warm, &payload).expect("sound");
        assert_eq!(warm, command(9, 16));
    }
}
