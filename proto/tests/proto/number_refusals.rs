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

/// Fields of numbers in the messages, by the names of their kinds; one with several numbers may stand several times.
const NUMBERS: [(&str, &str); 10] = [
    ("user report", "users.position_m users.velocity_m_s users.min_rate_bps"),
    ("channel report", "users.los_gain users.irs_gain users.sinr"),
    ("obstacle report", "obstacles.x_m obstacles.y_m obstacles.radius_m obstacles.height_m"),
    (
        "room truth",
        "users.position_m users.heading_rad users.los_gain users.irs_gain users.sinr users.rate_bps users.min_rate_bps \
         obstacles.height_m sum_rate_bps sum_rate_bps sum_rate_bps sum_rate_bps",
    ),
    ("mirror command", "roll yaw"),
    ("mirror telemetry", "temperature_c roll_commanded yaw_commanded roll_measured yaw_measured"),
    ("capabilities message", "roll roll roll yaw yaw command_rate_max_hz park_rad"),
    ("calibration", "roll_offset_rad roll_gain yaw_offset_rad yaw_gain"),
    ("node status", "gauges timings timings timings timings timings"),
    ("simulator control", "power_w speed_m_s faults.seconds faults.share"),
];

#[test]
fn each_number_that_is_not_finite_is_refused_with_its_field() {
    // Of single precision, and as the second half of one of double precision.
    let nan = f32::from_bits(0x7ff8_0000);
    let control = SimulatorControl { power_w: Some(2.0), ..simulator_control() };
    let telemetry = MirrorTelemetry { yaw_measured: vec![0.0; 2], ..mirror_telemetry() };
    let further = [("simulator control", encoded(&control)), ("mirror telemetry", encoded(&telemetry))];
    let mut refused = Vec::new();
    for (name, payload) in payloads().into_iter().chain(further) {
        let kind = codec::kind_of(&payload).expect("samples are valid");
        for at in 2..payload.len() - 3 {
            if let Some(CodecError::NotFinite { field, .. }) = any_refusal(kind, &with_f32(payload.clone(), at, nan)) {
                refused.push((name, field));
            }
        }
    }
    for (name, fields) in NUMBERS {
        for field in fields.split_whitespace() {
            let place = refused.iter().position(|found| *found == (name, field));
            refused.swap_remove(place.unwrap_or_else(|| panic!("{name}: {field}")));
        }
    }
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
