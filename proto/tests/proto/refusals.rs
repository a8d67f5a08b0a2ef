//! Refusals of the codec for the form of a payload: header, length, lists and texts.

use crate::common::*;
use heliostat_proto::*;

#[test]
fn a_wrong_version_is_refused_before_any_other_fault() {
    for version in (0..=u8::MAX).filter(|version| *version != VERSION) {
        assert_eq!(refusal::<MirrorCommand>(&[version]), CodecError::WrongVersion { found: version });
        let mut payload = encoded(&mirror_command());
        payload[0] = version;
        payload[1] = 200;
        payload.truncate(5);
        assert_eq!(refusal::<MirrorCommand>(&payload), CodecError::WrongVersion { found: version });
    }
}

#[test]
fn a_payload_without_header_is_refused() {
    assert_eq!(refusal::<UserReport>(&[]), CodecError::NoHeader { found: 0 });
    assert_eq!(refusal::<UserReport>(&[VERSION]), CodecError::NoHeader { found: 1 });
}

#[test]
fn a_wrong_kind_is_refused_with_both_names() {
    let error = refusal::<MirrorCommand>(&encoded(&user_report()));
    assert_eq!(error, CodecError::WrongKind { found: Kind::UserReport, expected: Kind::MirrorCommand });
    assert_eq!(error.to_string(), "payload of the kind \"user report\": expected \"mirror command\"");
    for number in [0, 23, 255] {
        assert_eq!(refusal::<UserReport>(&[VERSION, number]), CodecError::UnknownKind { found: number });
    }
}

#[test]
fn every_truncated_payload_is_refused() {
    for (name, payload) in payloads() {
        let kind = codec::kind_of(&payload).expect("samples are valid");
        assert_eq!(any_refusal(kind, &payload), None, "the complete {name}");
        for length in 2..payload.len() {
            let error = any_refusal(kind, &payload[..length]);
            let truncated = matches!(error, Some(CodecError::Truncated { kind: named, .. }) if named == kind);
            assert!(truncated, "{name} cut to {length} bytes: {error:?}");
        }
    }
}

#[test]
fn the_field_in_which_a_payload_ends_is_named() {
    let payload = encoded(&mirror_command());
    let field = |length: usize| match refusal::<MirrorCommand>(&payload[..length]) {
        CodecError::Truncated { field, .. } => field,
        other => panic!("{other}"),
    };
    assert_eq!(field(2), "epoch");
    assert_eq!(field(8), "time_ns");
    assert_eq!(field(25), "roll");
    assert_eq!(field(payload.len() - 1), "yaw");
}

#[test]
fn bytes_after_the_last_field_are_refused_with_their_number() {
    for (name, mut payload) in payloads() {
        let kind = codec::kind_of(&payload).expect("samples are valid");
        payload.extend_from_slice(&[0, 0, 0]);
        assert_eq!(any_refusal(kind, &payload), Some(CodecError::TrailingBytes { kind, extra: 3 }), "{name}");
    }
}

#[test]
fn an_oversized_payload_is_refused_before_its_header_is_read() {
    let payload = vec![0; MAX_PAYLOAD + 1];
    assert_eq!(refusal::<UserReport>(&payload), CodecError::Oversized { found: MAX_PAYLOAD + 1 });
}

#[test]
fn the_largest_messages_fit_into_a_payload() {
    let angles = vec![0.1; MAX_MIRRORS];
    let telemetry = MirrorTelemetry {
        roll_commanded: angles.clone(),
        yaw_commanded: angles.clone(),
        roll_measured: angles.clone(),
        yaw_measured: angles,
        unusable: vec![u32::MAX; MAX_MIRRORS],
        ..mirror_telemetry()
    };
    let payload = encoded(&telemetry);
    assert!(payload.len() <= MAX_PAYLOAD);
    assert_eq!(decode(&payload), Ok(telemetry));
    let text = "x".repeat(MAX_TEXT);
    let status = NodeStatus {
        name: text.clone(),
        software: text.clone(),
        state: text.clone(),
        scenario: text.clone(),
        policy: text.clone(),
        counters: vec![(text.clone(), u64::MAX); MAX_ENTRIES],
        gauges: vec![(text.clone(), 1.0); MAX_ENTRIES],
        timings: vec![(text.clone(), Quantiles { count: u64::MAX, ..Quantiles::default() }); MAX_ENTRIES],
        last_problem: text,
        ..node_status()
    };
    assert_eq!(decode(&encoded(&status)), Ok(status));
}

#[test]
fn lists_over_their_limit_are_refused_before_their_entries_are_read() {
    let mut payload = encoded(&UserReport { stamp: stamp(), tick: 1, users: vec![] });
    payload.pop();
    payload.extend_from_slice(&[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x01]);
    let expected = CodecError::TooMany { kind: Kind::UserReport, field: "users", found: u64::MAX, limit: MAX_USERS };
    assert_eq!(refusal::<UserReport>(&payload), expected);
    let crowd = UserReport { users: vec![UserState::default(); MAX_USERS + 1], ..user_report() };
    let expected = CodecError::TooMany { kind: Kind::UserReport, field: "users", found: 65, limit: 64 };
    assert_eq!(encode(&crowd, &mut Vec::new()), Err(expected));
    let wall = MirrorCommand { roll: vec![0.0; MAX_MIRRORS + 1], yaw: vec![], ..mirror_command() };
    assert!(matches!(encode(&wall, &mut Vec::new()), Err(CodecError::TooMany { field: "roll", .. })));
    let many = SimulatorControl { faults: vec![MirrorFault::default(); 257], ..simulator_control() };
    let many = encode(&many, &mut Vec::new());
    assert!(matches!(many, Err(CodecError::TooMany { field: "faults", found: 257, .. })));
    let mut wide = simulator_control();
    wide.faults[0].mirrors = vec![0; MAX_MIRRORS + 1];
    assert!(matches!(encode(&wide, &mut Vec::new()), Err(CodecError::TooMany { field: "faults.mirrors", .. })));
}

#[test]
fn lists_that_belong_together_must_have_the_same_length() {
    let mut payload = encoded(&mirror_command());
    payload.truncate(payload.len() - 9);
    payload.push(1);
    payload.extend_from_slice(&0.5f32.to_le_bytes());
    let error = refusal::<MirrorCommand>(&payload);
    let expected =
        CodecError::LengthMismatch { kind: Kind::MirrorCommand, field: "yaw", found: 1, like: "roll", expected: 2 };
    assert_eq!(error, expected);
    assert_eq!(error.to_string(), "mirror command: yaw has a length of 1: expected 2, that of roll");
    let half = MirrorTelemetry { roll_measured: vec![0.0], ..mirror_telemetry() };
    assert!(matches!(
        encode(&half, &mut Vec::new()),
        Err(CodecError::LengthMismatch { field: "roll_measured", found: 1, expected: 2, .. })
    ));
    let short = Calibration { yaw_gain: vec![1.0], ..calibration() };
    assert!(matches!(encode(&short, &mut Vec::new()), Err(CodecError::LengthMismatch { field: "yaw_gain", .. })));
}

#[test]
fn invalid_bytes_are_refused_with_the_field() {
    let command = encoded(&mirror_command());
    let mut endless = command.clone();
    endless.splice(2..3, [0xff; 11]);
    assert!(matches!(refusal::<MirrorCommand>(&endless), CodecError::Malformed { field: "epoch", .. }));
    let mut telemetry = encoded(&mirror_telemetry());
    telemetry[22] = 9;
    assert!(matches!(refusal::<MirrorTelemetry>(&telemetry), CodecError::Malformed { field: "state", .. }));
    let mut stop = encoded(&emergency_stop());
    let last = stop.len() - 1;
    stop[last] = 0xff;
    assert!(matches!(refusal::<EmergencyStop>(&stop), CodecError::Malformed { field: "reason", .. }));
    let mut control = encoded(&simulator_control());
    let fault = control.len() - 15;
    assert_eq!(control[fault], 3, "the number of the fault");
    control[fault] = 9;
    assert!(matches!(refusal::<SimulatorControl>(&control), CodecError::Malformed { field: "faults.fault", .. }));
}

#[test]
fn long_texts_are_refused_and_long_problems_are_cut_to_the_limit() {
    let long = NodeStatus { name: "x".repeat(MAX_TEXT + 1), ..node_status() };
    let expected = CodecError::TooMany { kind: Kind::NodeStatus, field: "name", found: 1025, limit: MAX_TEXT };
    assert_eq!(encode(&long, &mut Vec::new()), Err(expected));
    let policy = ControllerControl { policy: "x".repeat(MAX_TEXT + 1), ..controller_control() };
    assert!(matches!(encode(&policy, &mut Vec::new()), Err(CodecError::TooMany { field: "policy", .. })));
    let mut status = node_status();
    status.set_problem(&"µ".repeat(MAX_TEXT));
    assert_eq!(status.last_problem.len(), MAX_TEXT);
    status.set_problem(&format!("x{}", "µ".repeat(MAX_TEXT)));
    assert_eq!(status.last_problem.len(), MAX_TEXT - 1, "no character is cut in two");
    assert_eq!(encode(&status, &mut Vec::new()), Ok(()));
}

#[test]
fn a_refused_message_leaves_the_buffer_empty() {
    let mut buffer = vec![1, 2, 3];
    let nan = MirrorCommand { roll: vec![f32::NAN], yaw: vec![0.0], ..mirror_command() };
    assert!(encode(&nan, &mut buffer).is_err());
    assert!(buffer.is_empty());
}

#[test]
fn counts_are_compared_with_those_of_the_receiver() {
    assert_eq!(mirror_command().check_mirrors(2), Ok(()));
    let error = mirror_command().check_mirrors(100).expect_err("the command is for two mirrors");
    assert_eq!(error.to_string(), "mirror command for an array of size 2: expected 100, the number of its mirrors");
    assert!(mirror_telemetry().check_mirrors(3).is_err());
    assert!(capabilities().check_mirrors(3).is_err());
    assert!(calibration().check_mirrors(3).is_err());
}

#[test]
fn a_geometry_text_may_be_longer_than_other_texts_up_to_its_own_limit() {
    let geometry = |length: usize| RoomGeometry { scenario: "x".repeat(length), ..room_geometry() };
    let mut payload = encoded(&geometry(MAX_GEOMETRY));
    assert_eq!(decode(&payload), Ok(geometry(MAX_GEOMETRY)));
    let refused = CodecError::TooMany {
        kind: Kind::RoomGeometry,
        field: "scenario",
        found: MAX_GEOMETRY as u64 + 1,
        limit: MAX_GEOMETRY,
    };
    assert_eq!(encode(&geometry(MAX_GEOMETRY + 1), &mut payload), Err(refused.clone()));
    let longest = encoded(&geometry(MAX_GEOMETRY));
    let length_at = longest.len() - MAX_GEOMETRY - 3;
    assert_eq!(longest[length_at..length_at + 3], [0x80, 0x80, 0x01], "16384 as a varint");
    let mut longer = longest;
    longer[length_at] = 0x81;
    longer.push(b'x');
    assert_eq!(refusal::<RoomGeometry>(&longer), refused);
    assert_eq!(
        Room::new("demo").expect("a valid name").geometry(NodeKind::SimNode),
        "heliostat/v1/demo/geometry/sim-node"
    );
}
