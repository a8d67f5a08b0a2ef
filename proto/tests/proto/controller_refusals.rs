//! Refusals of what a controller publishes about itself: its belief and its state.

use crate::common::*;
use heliostat_proto::*;

#[test]
fn a_belief_outside_its_domain_is_refused_by_field() {
    type Change = fn(&mut UserBelief);
    let refused = |change: Change| {
        let mut report = belief_report();
        change(&mut report.users[0]);
        let error = encode(&report, &mut Vec::new()).expect_err("not a belief");
        (error.name(), error.to_string())
    };
    let cases: [(Change, &str, &str); 6] = [
        (|user| user.position_m[2] = f32::NAN, "not-finite", "users.position_m"),
        (|user| user.heading_rad = f32::INFINITY, "not-finite", "users.heading_rad"),
        (|user| user.xx_m2 = -0.01, "implausible", "users.xx_m2"),
        (|user| user.xy_m2 = 0.1, "implausible", "users.xy_m2"),
        (|user| user.heading_certainty = 1.5, "implausible", "users.heading_certainty"),
        (|user| user.blocked_probability = -0.5, "implausible", "users.blocked_probability"),
    ];
    for (change, name, field) in cases {
        let (found, text) = refused(change);
        assert_eq!(found, name, "{text}");
        // The rule about the covariance names the field without its list.
        assert!(text.contains(field.trim_start_matches("users.")), "{text}");
    }
    let payload = encoded(&belief_report());
    let certainty = payload.len() - 8;
    assert_eq!(refusal::<BeliefReport>(&with_f32(payload.clone(), certainty, f32::NAN)).name(), "not-finite");
    assert_eq!(refusal::<BeliefReport>(&with_f32(payload, certainty, 2.0)).name(), "implausible");
    let exact = |user: &mut UserBelief| (user.xx_m2, user.xy_m2, user.yy_m2) = (0.04, 0.02, 0.01);
    let mut report = belief_report();
    exact(&mut report.users[0]);
    assert_eq!(decode(&encoded(&report)), Ok(report), "positions on one line");
    let report = BeliefReport { users: vec![UserBelief::default(); MAX_USERS + 1], ..belief_report() };
    assert_eq!(encode(&report, &mut Vec::new()).map_err(|error| error.name()), Err("bad-length"));
}

#[test]
fn a_memory_has_known_inputs_and_a_bounded_state() {
    let mut payload = Vec::new();
    let input = ControllerInput { source: u64::MAX, sequence: u64::MAX, time_ns: u64::MAX, ..Default::default() };
    let largest =
        ControllerMemory { inputs: vec![input; MAX_INPUTS], state: vec![0xff; MAX_STATE], ..controller_memory() };
    assert_eq!(encode(&largest, &mut payload), Ok(()), "the largest memory fits into a payload");
    assert_eq!(decode(&payload), Ok(largest.clone()));
    let longer = ControllerMemory { state: vec![0; MAX_STATE + 1], ..controller_memory() };
    let refused = CodecError::TooMany {
        kind: Kind::ControllerMemory,
        field: "state",
        found: MAX_STATE as u64 + 1,
        limit: MAX_STATE,
    };
    assert_eq!(encode(&longer, &mut payload), Err(refused));
    let mut payload = encoded(&ControllerMemory { inputs: vec![ControllerInput::default()], ..Default::default() });
    assert_eq!(payload[8], 0, "the number of the input follows the header, an empty stamp, two numbers, a length");
    payload[8] = 10;
    assert_eq!(refusal::<ControllerMemory>(&payload).name(), "malformed");
    assert_eq!(Room::new("demo").expect("a valid name").controller_memory(), "heliostat/v1/demo/controller/memory");
}

#[test]
fn a_state_keeps_every_bit_and_damaged_bytes_are_refused() {
    let state = (vec![f64::NAN.to_bits(), 3], [-0.0f64, f64::MIN_POSITIVE], Some(7u32));
    let bytes = encode_state(&state).expect("a plain state");
    let back: (Vec<u64>, [f64; 2], Option<u32>) = decode_state(&bytes).expect("the same type");
    assert_eq!((back.0, back.1.map(f64::to_bits), back.2), (state.0, state.1.map(f64::to_bits), state.2));
    type State = (Vec<u64>, [f64; 2], Option<u32>);
    for length in 0..bytes.len() {
        assert!(decode_state::<State>(&bytes[..length]).is_err());
    }
    let longer = [&bytes[..], &[0]].concat();
    assert!(decode_state::<State>(&longer).unwrap_err().to_string().contains("bytes remain"));
}
