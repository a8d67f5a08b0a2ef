//! Encoding and decoding into existing memory allocate nothing: buffers keep their address and
//! their capacity.

use crate::common::*;
use heliostat_proto::*;

/// Address and capacity of a list.
fn memory<T>(list: &Vec<T>) -> (*const T, usize) {
    (list.as_ptr(), list.capacity())
}

fn command(sequence: u64, mirrors: usize) -> MirrorCommand {
    let angle = |index: usize| (index as f32 + sequence as f32) * 1e-3;
    let angles: Vec<f32> = (0..mirrors).map(angle).collect();
    MirrorCommand { sequence, roll: angles.clone(), yaw: angles, ..mirror_command() }
}

#[test]
fn a_command_is_decoded_into_the_same_memory() {
    let mut warm: MirrorCommand = decode(&encoded(&command(1, 100))).expect("a valid message");
    let before = (memory(&warm.roll), memory(&warm.yaw));
    for (sequence, mirrors) in [(2, 100), (3, 49), (4, 0), (5, 100)] {
        let expected = command(sequence, mirrors);
        decode_into(&mut warm, &encoded(&expected)).expect("a valid message");
        assert_eq!(warm, expected);
        assert_eq!((memory(&warm.roll), memory(&warm.yaw)), before);
    }
}

#[test]
fn reports_are_decoded_into_the_same_memory() {
    let users = |count: usize| UserReport { users: vec![user_report().users[0]; count], ..user_report() };
    let channel = |count: usize| ChannelReport { users: vec![channel_report().users[0]; count], ..channel_report() };
    let obstacles = |count: usize| ObstacleReport { obstacles: vec![obstacle(); count], ..obstacle_report() };
    let mut warm: (UserReport, ChannelReport, ObstacleReport) = Default::default();
    let mut before = None;
    for count in [10, 3, 0, 10] {
        decode_into(&mut warm.0, &encoded(&users(count))).expect("a valid message");
        decode_into(&mut warm.1, &encoded(&channel(count))).expect("a valid message");
        decode_into(&mut warm.2, &encoded(&obstacles(count))).expect("a valid message");
        assert_eq!(warm, (users(count), channel(count), obstacles(count)));
        let now = (memory(&warm.0.users), memory(&warm.1.users), memory(&warm.2.obstacles));
        assert_eq!(now, *before.get_or_insert(now));
    }
}

#[test]
fn telemetry_texts_and_nested_lists_are_decoded_into_the_same_memory() {
    let mut telemetry = mirror_telemetry();
    let before = (memory(&telemetry.roll_commanded), memory(&telemetry.roll_measured), memory(&telemetry.unusable));
    decode_into(&mut telemetry, &encoded(&mirror_telemetry())).expect("a valid message");
    let after = (memory(&telemetry.roll_commanded), memory(&telemetry.roll_measured), memory(&telemetry.unusable));
    assert_eq!(after, before);
    let mut status = node_status();
    let before = (status.name.as_ptr(), memory(&status.counters));
    decode_into(&mut status, &encoded(&node_status())).expect("a valid message");
    assert_eq!((status.name.as_ptr(), memory(&status.counters)), before);
    let mut control = simulator_control();
    let before = (memory(&control.faults), memory(&control.faults[0].mirrors));
    decode_into(&mut control, &encoded(&simulator_control())).expect("a valid message");
    assert_eq!((memory(&control.faults), memory(&control.faults[0].mirrors)), before);
}

#[test]
fn a_payload_is_encoded_into_the_same_memory() {
    let mut buffer = Vec::new();
    encode(&command(1, 100), &mut buffer).expect("a valid message");
    let before = memory(&buffer);
    for (sequence, mirrors) in [(2, 100), (3, 0), (4, 100)] {
        encode(&command(sequence, mirrors), &mut buffer).expect("a valid message");
        assert_eq!(memory(&buffer), before);
    }
}

#[test]
fn a_message_can_be_decoded_after_a_refused_payload() {
    let mut warm = MirrorCommand::default();
    let payload = encoded(&command(9, 16));
    for length in 2..payload.len() {
        assert!(decode_into(&mut warm, &payload[..length]).is_err());
        decode_into(&mut warm, &payload).expect("a valid message");
        assert_eq!(warm, command(9, 16));
    }
}
