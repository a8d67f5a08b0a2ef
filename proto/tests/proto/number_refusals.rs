//! Refusals of the codec for numbers: those that are not finite, and those outside their domain.

use crate::common::*;
use heliostat_proto::*;

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
fn a_led_report_has_as_many_gains_as_users_and_leds_allow() {
    let with = |gains: Vec<LedGain>| {
        encode(&LedReport { gains, ..led_report() }, &mut Vec::new()).map_err(|error| error.name())
    };
    let gain = LedGain { user: 3, led: 63, los_gain: 1e-6 };
    assert_eq!(with(vec![gain; MAX_LED_GAINS]), Ok(()));
    assert_eq!(with(vec![gain; MAX_LED_GAINS + 1]), Err("bad-length"));
    assert_eq!(with(vec![LedGain { los_gain: -1e-6, ..gain }]), Err("implausible"));
    assert_eq!(with(vec![LedGain { los_gain: f32::NAN, ..gain }]), Err("not-finite"));
    let users = vec![UserLeds::default(); MAX_USERS + 1];
    let report = LedReport { users, ..led_report() };
    assert_eq!(encode(&report, &mut Vec::new()).map_err(|error| error.name()), Err("bad-length"));
    assert_eq!(Room::new("demo").expect("a valid name").leds(), "heliostat/v1/demo/leds");
}
