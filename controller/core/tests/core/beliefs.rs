//! The belief about the users: as a message, and from the readings of real receivers.

use std::f64::consts::TAU;

use heliostat_channel::{MirrorAngles, Vec3, blockage::blocks, decode::aim_at_point};
use heliostat_core::belief::Belief;
use heliostat_core::inbox::Message;
use heliostat_core::policy::PolicyKind;
use heliostat_proto::{
    BeliefReport, ChannelReport, MAX_STATE, MirrorCommand, Stamp, UserChannel, UserReport, UserState, encode,
    encode_state,
};
use heliostat_scenario::Scenario;

use crate::support::{MS, Room, build, by_policy, controller, hall, receive, report_gains, scenario};

#[test]
fn the_belief_of_a_decision_is_reported_without_an_allocation() {
    let overrides = ["control.belief=\"filter\"", "streams.positions.rate_hz=100"];
    let (mut controller, mut room) = by_policy(PolicyKind::Nearest, &overrides);
    let mut report = BeliefReport::buffer();
    assert!(!controller.report_beliefs(Room::time(0), &mut report), "no report has arrived");
    for tick in 1..=30 {
        room.tick(&mut controller, tick);
    }
    let now = Room::time(30);
    let counted = allocation_counter::measure(|| assert!(controller.report_beliefs(now, &mut report)));
    assert_eq!(counted.count_total, 0);
    assert_eq!((report.tick, report.holds_ns), (30, now + 5 * MS), "half an interval after the report");
    let users = room.positions(30).users;
    for (belief, user) in report.users.iter().zip(&users) {
        assert_eq!(belief.user, user.user);
        let [dx, dy] = [0, 1].map(|axis| belief.position_m[axis] - user.position_m[axis]);
        assert!(dx.hypot(dy) < 0.1, "{belief:?} {user:?}");
        let [along_x, along_y] = belief.velocity_m_s;
        let off = (belief.heading_rad - along_y.atan2(along_x)).rem_euclid(std::f32::consts::TAU);
        assert!(off.min(std::f32::consts::TAU - off) < 0.2, "a walking user faces ahead: {belief:?}");
        assert!(belief.heading_certainty > 0.9 && belief.blocked_probability < 0.1, "{belief:?}");
    }
    assert_eq!(report.users.len(), users.len());
    assert_eq!(encode(&report, &mut Vec::new()), Ok(()));
    assert!(controller.innovations().is_some_and(|innovations| innovations.count == 29 * 3));
}

/// The published probability of a blocked direct path, of users at these places who stand. There are
/// no gains.
fn blocked_standing(scenario: &Scenario, places: &[[f32; 3]]) -> Vec<f32> {
    let mut controller = controller(scenario, build(PolicyKind::Nearest, scenario).unwrap());
    let mut report = BeliefReport::buffer();
    for tick in 1..=3 {
        let stamp = Stamp { source: 1, sequence: tick, time_ns: Room::time(tick) };
        let user = |(user, place): (usize, &[f32; 3])| UserState {
            user: user as u32,
            position_m: *place,
            ..UserState::default()
        };
        let users = places.iter().enumerate().map(user).collect();
        receive(&mut controller, Room::time(tick), Message::Users(&mut UserReport { stamp, tick, users }));
        assert!(controller.report_beliefs(Room::time(tick), &mut report));
    }
    report.users.iter().map(|user| user.blocked_probability).collect()
}

#[test]
fn the_published_probability_of_a_blocked_path_is_that_over_all_headings() {
    let scenario = scenario(&["control.belief=\"filter\"", "blockage.bodies=true"]);
    let model = scenario.channel_model().unwrap();
    let (place, led) = ([1.4, 1.1, 0.85], &model.leds[0].position);
    let (device, body) = (Vec3::from_iterator(place), scenario.blockage.body().unwrap());
    let body_blocks = |device: &Vec3, heading: f64, from: &Vec3| {
        let (sine, cosine) = heading.sin_cos();
        blocks(&body.behind(device, &Vec3::new(cosine, sine, 0.0)), led, from)
    };
    let share = |device: &Vec3, from: &Vec3| {
        let blocked = (0..36).filter(|index| body_blocks(device, f64::from(*index) * TAU / 36.0, from)).count();
        blocked as f64 / 36.0
    };
    let expected = share(&device, &device);
    assert!((0.1..0.5).contains(&expected), "{expected}");
    let place = place.map(|part| part as f32);
    // Without a measurement the detector may be covered.
    let without_bodies = crate::support::scenario(&["control.belief=\"filter\"", "blockage.bodies=false"]);
    let uncovered = 1.0 - f64::from(blocked_standing(&without_bodies, &[place])[0]);
    let past_bodies = |places: &[[f32; 3]]| 1.0 - f64::from(blocked_standing(&scenario, places)[0]);
    let (clear, alone) = (uncovered * (1.0 - expected), past_bodies(&[place]));
    assert!((alone - clear).abs() < 0.02, "{alone} for {clear}");

    // Another user between the LED and the first one.
    let near = [0.95, 0.75, 0.85];
    let by_other = share(&Vec3::from_iterator(near), &device);
    assert!((0.1..1.0).contains(&by_other), "{by_other}");
    let (clear, both) = (clear * (1.0 - by_other), past_bodies(&[place, near.map(|part| part as f32)]));
    assert!((both - clear).abs() < 0.02, "{both} for {clear}");
}

#[test]
fn without_a_filter_there_is_no_belief() {
    for belief in ["none", "constant-velocity"] {
        let (mut controller, mut room) = by_policy(PolicyKind::Nearest, &[&format!("control.belief=\"{belief}\"")]);
        room.tick(&mut controller, 1);
        assert!(!controller.report_beliefs(Room::time(1), &mut BeliefReport::buffer()), "{belief}");
        assert_eq!(controller.innovations(), None, "{belief}");
    }
}

/// The probability of a clear direct path in `hall`, after 30 readings of this gain.
fn direct_clear(los_gain: f64, overrides: &[&str]) -> f64 {
    let (_, model, mut belief) = hall(overrides);
    let (place, gains) = (Vec3::new(1.0, 0.5, 0.85), [[los_gain, 0.0]]);
    (1..=30).for_each(|tick| report_gains(&mut belief, &model, tick, &[place], (&gains, None)));
    belief.estimate(0, 0.0).unwrap().direct_clear
}

#[test]
fn readings_within_the_noise_of_the_receiver_show_a_blocked_path() {
    let noise = ["blockage.bodies=false", "streams.channel.noise_gain=1e-8"];
    assert!(direct_clear(2e-8, &noise[..1]) > 0.9, "without noise any reading shows a clear path");
    assert!(direct_clear(2e-8, &noise) < 0.1);
    assert!(direct_clear(1e-6, &noise) > 0.9);
}

#[test]
fn a_path_that_the_converter_cannot_resolve_shows_nothing() {
    let full_scale = "streams.channel.full_scale_gain=3e-5";
    let with = |bits| direct_clear(0.0, &["blockage.bodies=false", full_scale, bits]);
    assert!(with("streams.channel.resolution_bits=12") < 0.1);
    let unknown = with("streams.channel.resolution_bits=2");
    assert!((0.2..1.0).contains(&unknown), "the prior remains: {unknown}");
}

/// A belief in a room with this many rows and columns of mirrors, where reports may be late. Before each
/// of 60 reports, 0.1 s apart, a command turned the mirrors: to the user, and flat from the 31st on.
fn commanded([rows, columns]: [usize; 2]) -> (Scenario, Belief) {
    let mirrors = [format!("mirrors.rows={rows}"), format!("mirrors.columns={columns}")];
    let late = ["control.belief=\"filter\"", "control.report_age_max_ms=10000"];
    let small = ["mirrors.width_m=0.03", "mirrors.height_m=0.02", "mirrors.gap_m=0.005"];
    let scenario = scenario(&[&[&mirrors[0][..], &mirrors[1]], &late[..], &small].concat());
    let model = scenario.channel_model().unwrap();
    let mut belief = Belief::new(&scenario, &model, 64);
    let mut aimed = MirrorAngles::flat(rows * columns);
    aim_at_point(&model, &Vec3::new(1.0, 0.5, 0.85), &mut aimed);
    for tick in 1..=60 {
        let time_ns = tick * 100 * MS;
        let turned = if tick <= 30 { 1.0 } else { 0.0 };
        let angles = |aimed: &[f64]| aimed.iter().map(|angle| (turned * angle) as f32).collect();
        belief.handle_command(&MirrorCommand {
            time_ns: time_ns - 50 * MS,
            validity_ms: 400,
            roll: angles(&aimed.roll),
            yaw: angles(&aimed.yaw),
            ..MirrorCommand::default()
        });
        let user = UserState { user: 7, position_m: [1.0, 0.5, 0.85], ..UserState::default() };
        let stamp = Stamp { source: 1, sequence: tick, time_ns };
        belief.handle_users(&UserReport { stamp, tick, users: vec![user] });
    }
    (scenario, belief)
}

#[test]
fn a_restored_belief_knows_the_mirrors_of_a_late_measurement() {
    let (scenario, mut first) = commanded([3, 3]);
    let model = scenario.channel_model().unwrap();
    let mut second = Belief::new(&scenario, &model, 64);
    assert!(second.restore(&first.memory()));
    // Later commands displace those before the measurement.
    let mut unknown = first.clone();
    for command in 0..200 {
        unknown.handle_command(&MirrorCommand {
            time_ns: 7000 * MS + command,
            validity_ms: 400,
            roll: vec![0.0; 9],
            yaw: vec![0.0; 9],
            ..MirrorCommand::default()
        });
    }
    // A measurement of 4 s before the last report.
    let stamp = Stamp { source: 1, sequence: 61, time_ns: 2000 * MS };
    let measured = UserChannel { user: 7, los_gain: 1e-6, irs_gain: 0.0, sinr: 0.0 };
    let channel = ChannelReport { stamp, tick: 20, users: vec![measured] };
    [&mut first, &mut second].into_iter().for_each(|belief| belief.handle_channel(&model, &channel, None, &[], &[]));
    let heading = |belief: &Belief| belief.heading_distribution(7).copied().unwrap();
    assert_eq!(heading(&second), heading(&first));
    // Without its commands, a belief does not know the angles of the mirrors.
    unknown.handle_channel(&model, &channel, None, &[], &[]);
    assert_ne!(heading(&unknown), heading(&first));
}

#[test]
fn the_commands_of_many_mirrors_leave_room_in_a_state() {
    let (_, belief) = commanded([50, 40]);
    let length = encode_state(&belief.memory()).unwrap().len();
    assert!((200_000..MAX_STATE).contains(&length), "{length}");
}
