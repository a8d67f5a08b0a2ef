//! Refusals of the codec and their names.

mod common;

use common::*;
use heliostat_proto::*;

fn any_refusal(kind: Kind, payload: &[u8]) -> Option<CodecError> {
    match kind {
        Kind::UserReport => decode::<UserReport>(payload).err(),
        Kind::ChannelReport => decode::<ChannelReport>(payload).err(),
        Kind::ObstacleReport => decode::<ObstacleReport>(payload).err(),
        Kind::MirrorCommand => decode::<MirrorCommand>(payload).err(),
        Kind::MirrorTelemetry => decode::<MirrorTelemetry>(payload).err(),
        Kind::NodeStatus => decode::<NodeStatus>(payload).err(),
        Kind::RoomTruth => decode::<RoomTruth>(payload).err(),
        Kind::Capabilities => decode::<Capabilities>(payload).err(),
        Kind::EmergencyStop => decode::<EmergencyStop>(payload).err(),
        Kind::Calibration => decode::<Calibration>(payload).err(),
        Kind::SimulatorControl => decode::<SimulatorControl>(payload).err(),
        Kind::ControllerControl => decode::<ControllerControl>(payload).err(),
        Kind::Rearm => decode::<Rearm>(payload).err(),
        Kind::SafetyReport => decode::<SafetyReport>(payload).err(),
        Kind::RoomGeometry => decode::<RoomGeometry>(payload).err(),
        Kind::BeliefReport => decode::<BeliefReport>(payload).err(),
        Kind::ControllerMemory => decode::<ControllerMemory>(payload).err(),
        Kind::OrientationReport => decode::<OrientationReport>(payload).err(),
        Kind::BranchReport => decode::<BranchReport>(payload).err(),
    }
}

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
    for number in [0, 20, 255] {
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
fn numbers_that_are_not_finite_are_refused_with_field_and_index() {
    let payload = encoded(&mirror_command());
    let end = payload.len();
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for (at, named, place) in [(end - 4, "yaw", 1), (end - 8, "yaw", 0), (end - 13, "roll", 1)] {
            match refusal::<MirrorCommand>(&with_f32(payload.clone(), at, value)) {
                CodecError::NotFinite { kind: Kind::MirrorCommand, field, index, value: found } => {
                    assert_eq!((field, index), (named, place));
                    assert!(!found.is_finite());
                }
                other => panic!("{other}"),
            }
        }
    }
    let error = refusal::<MirrorCommand>(&with_f32(payload, end - 4, f32::NAN));
    assert_eq!(error.to_string(), "mirror command: yaw at index 1 is NaN: expected a finite number");
}

/// The name of a field, and a function that sets it to NaN.
type Alteration<T> = (&'static str, fn(&mut T));

/// Checks that each alteration is refused as not finite, with the name of the field.
fn check_nan_is_refused<T: Message + Clone>(sample: &T, alterations: &[Alteration<T>]) {
    for (expected, alter) in alterations {
        let mut message = sample.clone();
        alter(&mut message);
        match encode(&message, &mut Vec::new()) {
            Err(CodecError::NotFinite { kind, field, .. }) => assert_eq!((kind, field), (T::KIND, *expected)),
            other => panic!("{} with a NaN in {expected}: {other:?}", T::KIND),
        }
    }
}

#[test]
fn reports_with_a_nan_are_refused() {
    check_nan_is_refused(
        &user_report(),
        &[
            ("users.position_m", |report| report.users[0].position_m[2] = f32::NAN),
            ("users.velocity_m_s", |report| report.users[0].velocity_m_s[1] = f32::NAN),
            ("users.min_rate_bps", |report| report.users[0].min_rate_bps = f32::NAN),
        ],
    );
    check_nan_is_refused(
        &channel_report(),
        &[
            ("users.los_gain", |report| report.users[0].los_gain = f32::NAN),
            ("users.irs_gain", |report| report.users[0].irs_gain = f32::NAN),
            ("users.sinr", |report| report.users[0].sinr = f32::NAN),
        ],
    );
    check_nan_is_refused(
        &obstacle_report(),
        &[
            ("obstacles.x_m", |report| report.obstacles[0].x_m = f32::NAN),
            ("obstacles.y_m", |report| report.obstacles[0].y_m = f32::NAN),
            ("obstacles.radius_m", |report| report.obstacles[0].radius_m = f32::NAN),
            ("obstacles.height_m", |report| report.obstacles[0].height_m = f32::NAN),
        ],
    );
    check_nan_is_refused(
        &room_truth(),
        &[
            ("users.position_m", |truth| truth.users[0].position_m[0] = f32::NAN),
            ("users.heading_rad", |truth| truth.users[0].heading_rad = f32::NAN),
            ("users.los_gain", |truth| truth.users[0].los_gain = f32::NAN),
            ("users.irs_gain", |truth| truth.users[0].irs_gain = f32::NAN),
            ("users.sinr", |truth| truth.users[0].sinr = f32::NAN),
            ("users.rate_bps", |truth| truth.users[0].rate_bps = f32::NAN),
            ("users.min_rate_bps", |truth| truth.users[0].min_rate_bps = f32::NAN),
            ("obstacles.height_m", |truth| truth.obstacles[0].height_m = f32::NAN),
            ("sum_rate_bps", |truth| truth.sum_rate_bps.policy = f64::NAN),
            ("sum_rate_bps", |truth| truth.sum_rate_bps.no_irs = f64::NAN),
            ("sum_rate_bps", |truth| truth.sum_rate_bps.flat = f64::NAN),
            ("sum_rate_bps", |truth| truth.sum_rate_bps.oracle = f64::NAN),
        ],
    );
}

#[test]
fn messages_to_and_from_an_array_with_a_nan_are_refused() {
    check_nan_is_refused(
        &mirror_command(),
        &[("roll", |command| command.roll[1] = f32::NAN), ("yaw", |command| command.yaw[0] = f32::NAN)],
    );
    check_nan_is_refused(
        &mirror_telemetry(),
        &[
            ("temperature_c", |telemetry| telemetry.temperature_c = Some(f32::NAN)),
            ("roll_commanded", |telemetry| telemetry.roll_commanded[0] = f32::NAN),
            ("yaw_commanded", |telemetry| telemetry.yaw_commanded[0] = f32::NAN),
            ("roll_measured", |telemetry| telemetry.roll_measured[0] = f32::NAN),
            ("yaw_measured", |telemetry| telemetry.yaw_measured = vec![0.0, f32::NAN]),
        ],
    );
    check_nan_is_refused(
        &capabilities(),
        &[
            ("roll", |limits| limits.roll.min_rad = f32::NAN),
            ("roll", |limits| limits.roll.max_rad = f32::NAN),
            ("roll", |limits| limits.roll.slew_rad_s = f32::NAN),
            ("yaw", |limits| limits.yaw.settling_s = f32::NAN),
            ("yaw", |limits| limits.yaw.resolution_rad = f32::NAN),
            ("command_rate_max_hz", |limits| limits.command_rate_max_hz = f32::NAN),
            ("park_rad", |limits| limits.park_rad[1] = f32::NAN),
        ],
    );
    check_nan_is_refused(
        &calibration(),
        &[
            ("roll_offset_rad", |values| values.roll_offset_rad[0] = f32::NAN),
            ("roll_gain", |values| values.roll_gain[0] = f32::NAN),
            ("yaw_offset_rad", |values| values.yaw_offset_rad[0] = f32::NAN),
            ("yaw_gain", |values| values.yaw_gain[0] = f32::NAN),
        ],
    );
    check_nan_is_refused(
        &node_status(),
        &[
            ("gauges", |status| status.gauges[0].1 = f64::NAN),
            ("timings", |status| status.timings[0].1.p50 = f64::NAN),
            ("timings", |status| status.timings[0].1.p90 = f64::NAN),
            ("timings", |status| status.timings[0].1.p99 = f64::NAN),
            ("timings", |status| status.timings[0].1.p999 = f64::NAN),
            ("timings", |status| status.timings[0].1.max = f64::NAN),
        ],
    );
}

#[test]
fn simulator_controls_with_a_nan_are_refused() {
    check_nan_is_refused(
        &SimulatorControl { power_w: Some(2.0), ..simulator_control() },
        &[
            ("power_w", |control| control.power_w = Some(f32::NAN)),
            ("speed_m_s", |control| control.speed_m_s = Some([0.1, f32::NAN])),
            ("faults.seconds", |control| control.faults[0].seconds = f32::NAN),
            ("faults.share", |control| control.faults[0].share = f32::NAN),
        ],
    );
}

#[test]
fn simulator_controls_outside_their_domain_are_refused() {
    let refused = |change: fn(&mut SimulatorControl)| {
        let mut control = simulator_control();
        change(&mut control);
        encode(&control, &mut Vec::new()).expect_err("the control is outside its domain")
    };
    let share = refused(|control| control.faults[0].share = 1.5);
    assert_eq!(share.to_string(), "simulator control: faults.share at index 0 is 1.5: expected a share from 0 to 1");
    let power = refused(|control| control.power_w = Some(-1.0));
    assert!(matches!(power, CodecError::OutOfDomain { field: "power_w", .. }));
    let speed = refused(|control| control.speed_m_s = Some([-0.1, 1.0]));
    assert!(matches!(speed, CodecError::OutOfDomain { field: "speed_m_s", .. }));
    let many = refused(|control| control.faults = vec![MirrorFault::default(); 257]);
    assert!(matches!(many, CodecError::TooMany { field: "faults", found: 257, .. }));
    let wide = refused(|control| control.faults[0].mirrors = vec![0; MAX_MIRRORS + 1]);
    assert!(matches!(wide, CodecError::TooMany { field: "faults.mirrors", .. }));
    let mut payload = encoded(&simulator_control());
    let fault = payload.len() - 15;
    assert_eq!(payload[fault], 3, "the number of the fault");
    payload[fault] = 9;
    assert!(matches!(refusal::<SimulatorControl>(&payload), CodecError::Malformed { field: "faults.fault", .. }));
    let policy = ControllerControl { policy: "x".repeat(MAX_TEXT + 1), ..controller_control() };
    assert!(matches!(encode(&policy, &mut Vec::new()), Err(CodecError::TooMany { field: "policy", .. })));
}

#[test]
fn numbers_outside_their_domain_are_refused() {
    let mut obstacles = obstacle_report();
    obstacles.obstacles[0].radius_m = -0.1;
    let error = encode(&obstacles, &mut Vec::new()).expect_err("a radius is not negative");
    assert!(error.to_string().starts_with("obstacle report: obstacles.radius_m at index 0 is -0.1"), "{error}");
    let mut users = user_report();
    users.users[0].min_rate_bps = -1.0;
    assert!(matches!(
        encode(&users, &mut Vec::new()),
        Err(CodecError::OutOfDomain { field: "users.min_rate_bps", .. })
    ));
    let mut range = capabilities();
    range.roll.min_rad = 1.0;
    assert!(matches!(encode(&range, &mut Vec::new()), Err(CodecError::OutOfDomain { field: "roll", .. })));
    let wall = Capabilities { rows: u32::MAX, columns: u32::MAX, ..capabilities() };
    assert!(matches!(encode(&wall, &mut Vec::new()), Err(CodecError::TooMany { field: "rows * columns", .. })));
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
}

#[test]
fn long_texts_are_refused_and_long_problems_are_cut_to_the_limit() {
    let long = NodeStatus { name: "x".repeat(MAX_TEXT + 1), ..node_status() };
    let expected = CodecError::TooMany { kind: Kind::NodeStatus, field: "name", found: 1025, limit: MAX_TEXT };
    assert_eq!(encode(&long, &mut Vec::new()), Err(expected));
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
fn room_names_hold_only_letters_digits_dashes_and_underscores() {
    assert_eq!(Room::new(""), Err(RoomError::Empty));
    assert!(matches!(Room::new(&"a".repeat(65)), Err(RoomError::TooLong { found: 65 })));
    for bad in ["a/b", "*", "a b", "a$", "ä", "a?", "a#", "@x", "a.b", "\n"] {
        assert!(matches!(Room::new(bad), Err(RoomError::BadCharacter { .. })), "{bad:?}");
    }
    let room = Room::new("Lab_2-b").expect("a valid name");
    assert_eq!(room.command(), "heliostat/v1/Lab_2-b/mirrors/command");
    assert_eq!(room.status(NodeKind::SimNode), "heliostat/v1/Lab_2-b/status/sim-node");
    assert_eq!("Lab_2-b".parse(), Ok(room));
}

#[test]
fn liveliness_keys_survive_a_round_trip() {
    let room = Room::new("demo").expect("a valid name");
    let key = room.alive(NodeKind::Driver, 0xabc);
    assert_eq!(key, "heliostat/v1/demo/alive/driver/0000000000000abc");
    assert_eq!(keys::parse_alive(&key), Some((NodeKind::Driver, 0xabc)));
    assert_eq!(keys::parse_alive(&room.array(3).driver_alive(0xabc)), Some((NodeKind::Driver, 0xabc)));
    let not_drivers = ["driver-0", "driver-16", "tracker-1"].map(|node| format!("heliostat/v1/demo/alive/{node}/1"));
    let others = [room.users(), room.all_alive(), format!("{key}/more"), "heliostat/v2/demo/alive/driver/1".into()];
    for other in others.into_iter().chain(not_drivers) {
        assert_eq!(keys::parse_alive(&other), None, "{other}");
    }
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

#[test]
fn an_orientation_is_a_rotation_of_each_user() {
    let with = |quaternion| {
        let users = vec![UserOrientation { user: 3, quaternion }];
        encode(&OrientationReport { users, ..orientation_report() }, &mut Vec::new()).map_err(|error| error.name())
    };
    assert_eq!(with([0.8, 0.0, 0.0, 0.6]), Ok(()));
    assert_eq!(with([0.8005, 0.0, 0.0, 0.6]), Ok(()), "rounded");
    assert_eq!(with([0.0; 4]), Err("implausible"));
    assert_eq!(with([1.0, 0.1, 0.0, 0.0]), Err("implausible"));
    assert_eq!(with([f32::NAN, 0.0, 0.0, 1.0]), Err("not-finite"));
    let payload = encoded(&orientation_report());
    let last = payload.len() - 4;
    assert_eq!(refusal::<OrientationReport>(&with_f32(payload.clone(), last, f32::INFINITY)).name(), "not-finite");
    let longer = refusal::<OrientationReport>(&with_f32(payload, last, 2.0));
    assert!(longer.name() == "implausible" && longer.to_string().contains("quaternion"), "{longer}");
    let many = vec![UserOrientation { user: 1, quaternion: [1.0, 0.0, 0.0, 0.0] }; MAX_USERS + 1];
    let report = OrientationReport { users: many, ..orientation_report() };
    assert_eq!(encode(&report, &mut Vec::new()).map_err(|error| error.name()), Err("bad-length"));
    assert_eq!(Room::new("demo").expect("a valid name").orientation(), "heliostat/v1/demo/orientation");
}

#[test]
fn a_branch_has_one_gain_of_each_path() {
    let with = |los_gain: &[f32], irs_gain: &[f32]| {
        let users = vec![UserBranches { user: 3, los_gain: los_gain.to_vec(), irs_gain: irs_gain.to_vec() }];
        encode(&BranchReport { users, ..branch_report() }, &mut Vec::new()).map_err(|error| error.name())
    };
    assert_eq!(with(&[], &[]), Ok(()));
    assert_eq!(with(&[1e-6; MAX_BRANCHES], &[0.0; MAX_BRANCHES]), Ok(()));
    assert_eq!(with(&[0.0; MAX_BRANCHES + 1], &[0.0; MAX_BRANCHES + 1]), Err("bad-length"));
    assert_eq!(with(&[1e-6, 0.0], &[1e-6]), Err("bad-length"));
    assert_eq!(with(&[-1e-6], &[0.0]), Err("implausible"));
    assert_eq!(with(&[0.0], &[f32::NAN]), Err("not-finite"));
    let payload = encoded(&branch_report());
    let last = payload.len() - 4;
    assert_eq!(refusal::<BranchReport>(&with_f32(payload.clone(), last, -0.5)).name(), "implausible");
    let mut fewer = payload[..last].to_vec();
    fewer[last - 5] = 1;
    assert_eq!(refusal::<BranchReport>(&fewer).name(), "bad-length");
    assert_eq!(Room::new("demo").expect("a valid name").branches(), "heliostat/v1/demo/branches");
}

#[test]
fn counters_and_messages_name_an_array_by_the_first_part_of_its_keys() {
    let room = Room::new("lab").expect("a valid name");
    for array in [0, 1, MAX_ARRAYS - 1] {
        let key = format!("heliostat/v1/lab/{}/command", array_keys::array_name(array));
        assert_eq!(key, room.array(array).command());
    }
}
