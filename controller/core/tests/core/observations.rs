//! The layout of the observation, and values inferred from reports.

use heliostat_channel::{MirrorAngles, Orientation, Vec3};
use heliostat_core::{
    inbox::Message,
    observation::{EncodeError, Observation, ObservationEncoder, RoomState, Summary},
    policy::Fixed,
};
use heliostat_proto::Obstacle;

use crate::support::{Room, controller, flat, model, receive, scenario};

const POSITIONS: [Vec3; 3] = [Vec3::new(0.5, 0.25, 0.85), Vec3::new(-1.0, 1.5, 0.85), Vec3::new(2.0, -2.0, 0.85)];

const STANDING: [Vec3; 3] = [Vec3::new(0.0, 0.0, 0.0); 3];

const STATE: RoomState<'_> = RoomState {
    tick: 5,
    positions: &POSITIONS,
    velocities: &STANDING,
    min_rate_bps: &[1e6, 2e6, 0.0],
    blockers: &[],
    forced: &[false; 3],
    orientations: None,
    measured_los_gain: None,
};

/// Version 3 of the layout, written out: a failure means a new version, not a test to update.
#[test]
fn the_layout_is_version_three() {
    let scenario = scenario(&[]);
    let model = model(&scenario);
    let mut observation = Observation::new(&model, 3);
    observation.set_state(&model, &STATE);
    observation.angles.copy_from(&MirrorAngles { roll: (0..9).map(f64::from).collect(), yaw: vec![-0.5; 9] });

    let encoder = ObservationEncoder::new(4, 9);
    assert_eq!(encoder.len(), 122);
    let parts = encoder.parts();
    assert!(parts.iter().all(|part| part.values.len() == part.shape.iter().product::<usize>()), "{parts:?}");
    let amplitudes = [("los_amplitude", 16), ("min_rate", 20), ("steering_amplitude", 24)];
    let expected = [&[("mask", 0), ("positions", 4)][..], &amplitudes, &[("angles", 60), ("summary", 78)]].concat();
    assert_eq!(parts.map(|part| (part.name, part.values.start)).to_vec(), expected);
    let mut vector = vec![f32::NAN; 122];
    encoder.encode(&model, &observation, &mut vector).unwrap();

    assert_eq!(vector[0..4], [1.0, 1.0, 1.0, 0.0]);
    assert_eq!(vector[4..16], [0.5, 0.25, 0.85, -1.0, 1.5, 0.85, 2.0, -2.0, 0.85, 0.0, 0.0, 0.0]);
    let scale = model.budget.amplitude_scale();
    for user in 0..3 {
        assert_eq!(vector[16 + user], (scale * observation.scene.los_gain()[user]) as f32);
    }
    assert!(vector[16] > 1.0, "an unblocked user is well above the noise: {}", vector[16]);
    assert_eq!(vector[19], 0.0);
    // Minimum rate times users over 20 MHz.
    assert_eq!(vector[20..24], [0.15, 0.3, 0.0, 0.0]);
    for (index, gain) in observation.scene.steering_gain().iter().enumerate() {
        assert_eq!(vector[24 + index], (scale * gain) as f32);
    }
    assert!(vector[24..51].iter().any(|amplitude| *amplitude > 0.0));
    assert_eq!(vector[51..60], [0.0; 9]);
    assert_eq!(vector[60..69], [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]);
    assert_eq!(vector[69..78], [-0.5; 9]);

    let summary: Vec<&[f32]> = vector[78..].chunks(4).collect();
    let (direct, min_rate) = (&vector[16..20], &vector[20..24]);
    assert_eq!(summary[0], [1.0, 1.0, 1.0, 0.0]);
    assert_eq!([summary[1], summary[2]], [[0.5, -1.0, 2.0, 0.0], [0.25, 1.5, -2.0, 0.0]]);
    assert_eq!([summary[3], summary[4], summary[5]], [&[0.85, 0.85, 0.85, 0.0], min_rate, &[3.0, 3.0, 3.0, 0.0]]);
    assert_eq!(summary[6], [direct[0].ln_1p(), direct[1].ln_1p(), direct[2].ln_1p(), 0.0]);
    let in_f64 = |values: &[f32]| values.iter().map(|&value| f64::from(value)).collect::<Vec<f64>>();
    let expected = balanced(&in_f64(&vector[24..51]), &in_f64(&direct[..3]), &in_f64(&min_rate[..3]));
    for (column, expected) in summary[7..].iter().zip(expected) {
        for (found, expected) in column.iter().zip(expected) {
            assert!(
                (f64::from(*found) - expected).abs() < 1e-4 * expected.abs().max(1.0),
                "{column:?} for {expected:?}"
            );
        }
        assert_eq!(column[3], 0.0);
    }
}

/// The last four columns by their definitions.
fn balanced(steering: &[f64], direct: &[f64], min_rates: &[f64]) -> [Vec<f64>; 4] {
    let rows: Vec<&[f64]> = steering.chunks(steering.len() / direct.len()).collect();
    let totals: Vec<f64> = rows.iter().map(|row| row.iter().sum()).collect();
    let shared = |weights: &[f64]| -> Vec<f64> {
        let power = |user: usize, mirror: usize| (weights[user] * rows[user][mirror]).powi(8);
        let share = |user: usize, mirror: usize| {
            let all: f64 = (0..rows.len()).map(|other| power(other, mirror)).sum();
            if rows[user][mirror] > 0.0 { rows[user][mirror] * power(user, mirror) / all } else { 0.0 }
        };
        (0..rows.len()).map(|k| direct[k] + (0..rows[k].len()).map(|mirror| share(k, mirror)).sum::<f64>()).collect()
    };
    let slope = |min_rate: f64, x: f64| {
        let min_rate = min_rate * std::f64::consts::LN_2;
        let (threshold, nats) = (min_rate.exp_m1().sqrt(), (x * x).ln_1p());
        if x < threshold { 11.0 * (min_rate - nats) / (threshold - x) } else { 2.0 * x / (1.0 + x * x) }
    };
    let mean_log = |weights: &[f64]| weights.iter().map(|weight| weight.ln()).sum::<f64>() / weights.len() as f64;
    let mut weights: Vec<f64> = totals.iter().map(|total| (rows[0].len() as f64).sqrt() / (total + 1e-6)).collect();
    let (before, equal) = (mean_log(&weights), shared(&weights));
    let mut amplitudes = equal.clone();
    for step in [0.4, 0.4 / 1.5, 0.2, 0.16] {
        for (k, weight) in weights.iter_mut().enumerate() {
            *weight = weight.powf(1.0 - step) * slope(min_rates[k], amplitudes[k].max(1e-3)).powf(step);
        }
        amplitudes = shared(&weights);
    }
    let after = mean_log(&weights);
    let logs = |values: &[f64]| values.iter().map(|value| value.ln_1p()).collect();
    let weights = weights.iter().map(|weight| weight.ln() + before - after).collect();
    [logs(&totals), logs(&equal), logs(&amplitudes), weights]
}

/// Nothing is divided by zero where some or all mirrors have no path to any user.
#[test]
fn users_without_a_path_to_a_mirror_have_finite_features() {
    let scenario = scenario(&[]);
    let model = model(&scenario);
    let mut observation = Observation::new(&model, 3);
    observation.set_state(&model, &STATE);
    let encoder = ObservationEncoder::new(3, 9);
    let mut vector = vec![f32::NAN; encoder.len()];
    for unseen in [vec![4], (0..9).collect()] {
        observation.scene.exclude_mirrors(&unseen);
        encoder.encode(&model, &observation, &mut vector).unwrap();
        assert!(vector.iter().all(|value| value.is_finite()), "without {unseen:?}");
    }
    let direct: Vec<f32> = vector[encoder.los_amplitude()].iter().map(|amplitude| amplitude.ln_1p()).collect();
    for column in [Summary::LogShared, Summary::LogBalanced] {
        assert_eq!(vector[encoder.column(column as usize)], direct);
    }
    assert_eq!(vector[encoder.column(Summary::LogSteering as usize)], [0.0; 3]);
}

#[test]
fn an_observation_that_does_not_fit_the_vector_is_an_error() {
    let scenario = scenario(&[]);
    let model = model(&scenario);
    let observation = Observation::new(&model, 3);
    let encode = |users_max, mirrors, length| {
        ObservationEncoder::new(users_max, mirrors).encode(&model, &observation, &mut vec![0.0; length])
    };
    assert_eq!(encode(2, 9, 68), Err(EncodeError::Users { users: 3, capacity: 2 }));
    assert_eq!(encode(4, 8, 112), Err(EncodeError::Mirrors { found: 9, expected: 8 }));
    assert_eq!(encode(4, 9, 121), Err(EncodeError::Buffer { found: 121, expected: 122 }));
}

#[test]
fn measured_gains_replace_modelled_ones() {
    let (mut controller, mut room) = flat(&["control.belief=none"]);
    receive(&mut controller, Room::time(1), Message::Users(&mut room.positions(1)));
    let modelled = controller.observation().scene.los_gain().to_vec();
    let mut gains = room.gains(2, 0.0);
    for (index, user) in gains.users.iter_mut().enumerate() {
        user.los_gain = index as f32 * 1e-7;
    }
    // Entries are identified by their user, not by their index.
    gains.users.reverse();
    receive(&mut controller, Room::time(2), Message::Channel(&mut gains));
    receive(&mut controller, Room::time(2), Message::Users(&mut room.positions(2)));
    let measured = controller.observation().scene.los_gain();
    assert!(modelled.iter().any(|gain| *gain > 0.0));
    for (index, gain) in measured.iter().enumerate() {
        assert_eq!(*gain, f64::from(index as f32 * 1e-7));
    }
}

#[test]
fn a_gain_within_the_noise_of_the_receiver_is_that_of_a_blocked_path() {
    let sets = ["blockage.bodies=false", "streams.channel.noise_gain=1e-8", "blockage.obstacles_per_m2=0"];
    for belief in ["control.belief=none", "control.belief=filter"] {
        let (mut controller, mut room) = flat(&[&sets[..], &[belief]].concat());
        let mut gains = room.gains(2, 0.0);
        for (user, los_gain) in gains.users.iter_mut().zip([2.9e-8, 3.1e-8, 1e-7]) {
            user.los_gain = los_gain;
        }
        receive(&mut controller, Room::time(2), Message::Channel(&mut gains));
        receive(&mut controller, Room::time(2), Message::Users(&mut room.positions(2)));
        let seen: Vec<bool> = controller.observation().scene.los_gain().iter().map(|gain| *gain > 0.0).collect();
        assert_eq!(seen, [false, true, true], "{belief}");
    }
}

/// A user walks towards the LED: the body behind the device blocks no path. On the way back the
/// body is between LED and device.
#[test]
fn bodies_stand_behind_walking_users() {
    let (mut controller, mut room) = flat(&["users.count=1", "receiver.height_m=1.0", "control.belief=none"]);
    let mut gain_when_walking = |tick, velocity: f32| {
        let mut report = room.positions(tick);
        report.users[0].position_m = [2.3, 0.0, 1.0];
        report.users[0].velocity_m_s = [velocity, 0.0];
        receive(&mut controller, Room::time(tick), Message::Users(&mut report)).command();
        controller.observation().scene.los_gain()[0]
    };
    assert!(gain_when_walking(1, 0.0) > 0.0, "the direction is unknown before the first step");
    assert_eq!(gain_when_walking(2, 1.0), 0.0, "the body stands between the light and the device");
    assert_eq!(gain_when_walking(3, 0.0), 0.0, "a user who stops keeps the direction");
    assert!(gain_when_walking(4, -1.0) > 0.0);
}

#[test]
fn bodies_can_be_left_out() {
    let (mut controller, mut room) = flat(&["users.count=1", "receiver.height_m=1.0", "blockage.bodies=false"]);
    let mut report = room.positions(1);
    report.users[0].position_m = [2.3, 0.0, 1.0];
    report.users[0].velocity_m_s = [1.0, 0.0];
    receive(&mut controller, Room::time(1), Message::Users(&mut report)).command();
    assert!(controller.observation().scene.los_gain()[0] > 0.0);
}

#[test]
fn surveyed_obstacles_stand_in_the_light() {
    let (mut controller, mut room) = flat(&["users.count=1", "blockage.bodies=false"]);
    let mut report = room.positions(1);
    let [x, y, _] = report.users[0].position_m;
    receive(&mut controller, Room::time(1), Message::Users(&mut report)).command();
    let free = controller.observation().scene.los_gain()[0];
    let beside = Obstacle { x_m: 0.9 * x, y_m: 0.9 * y, radius_m: 0.1, height_m: 2.0 };
    receive(&mut controller, Room::time(1), Message::Obstacles(&mut room.survey(1, vec![beside])));
    receive(&mut controller, Room::time(2), Message::Users(&mut room.positions(2))).command();
    let shaded = controller.observation().scene.los_gain()[0];
    receive(&mut controller, Room::time(3), Message::Obstacles(&mut room.survey(3, Vec::new())));
    receive(&mut controller, Room::time(3), Message::Users(&mut room.positions(3))).command();
    let cleared = controller.observation().scene.los_gain()[0];
    assert!(free > 0.0 && shaded == 0.0 && cleared > 0.0, "{free} {shaded} {cleared}");
}

#[test]
fn reported_orientations_tilt_the_receivers_of_the_observation_until_they_are_too_old() {
    let scenario = scenario(&["blockage.bodies=false", "led.side_m=0", "led.points_per_side=1"]);
    for belief in ["none", "filter"] {
        let scenario = scenario.with_overrides(&[format!("control.belief={belief}")]).unwrap();
        let mut controller = controller(&scenario, Box::new(Fixed::flat(9)));
        let mut room = Room::new(&scenario);
        let mut gains_at = |tick: u64, held: Option<&[u32]>| {
            if let Some(users) = held {
                let mut report = room.orientations_of(tick, 0.4, users);
                receive(&mut controller, Room::time(tick), Message::Orientation(&mut report));
            }
            // The same positions at each time.
            let mut report = room.positions(tick);
            report.users = Room::new(&scenario).positions(0).users;
            report.users.iter_mut().for_each(|user| user.velocity_m_s = [0.0; 2]);
            receive(&mut controller, Room::time(tick), Message::Users(&mut report)).command();
            let scene = &controller.observation().scene;
            (scene.positions().to_vec(), scene.los_gain().to_vec(), scene.steering_gain().to_vec())
        };
        let (_, upright, steered) = gains_at(1, None);
        let (positions, tilted, tilted_steered) = gains_at(2, Some(&[2, 0]));
        for (user, position) in positions.iter().enumerate() {
            let ray = (Vec3::new(0.0, 0.0, 3.0) - position).normalize();
            let held = Orientation::from_polar_azimuth(if user == 1 { 0.0 } else { 0.4 }, user as f64);
            let expected = upright[user] * ray.dot(&held.normal()) / ray.z;
            assert!((tilted[user] / expected - 1.0).abs() < 1e-4, "{belief}, user {user}: {tilted:?} {upright:?}");
            let all_mirrors = |gains: &[f64]| gains[user * 9..user * 9 + 9].iter().sum::<f64>();
            let change = (all_mirrors(&tilted_steered) / all_mirrors(&steered) - 1.0).abs();
            assert_eq!(change > 0.01, user != 1, "{belief}, user {user}: {change}");
        }
        let (_, later, _) = gains_at(3, None);
        assert!((later[0] / tilted[0] - 1.0).abs() < 1e-4, "the last report holds");
        let (_, old, _) = gains_at(1000, None);
        assert!((old[0] / upright[0] - 1.0).abs() < 1e-4, "the last report is too old");
    }
}

#[test]
fn an_obstacle_of_radius_0_is_accepted_and_blocks_nothing() {
    let (mut controller, mut room) = flat(&["users.count=1", "blockage.bodies=false"]);
    let mut report = room.positions(1);
    let [x, y, _] = report.users[0].position_m;
    receive(&mut controller, Room::time(1), Message::Users(&mut report)).command();
    let line = Obstacle { x_m: 0.9 * x, y_m: 0.9 * y, radius_m: 0.0, height_m: 2.0 };
    let pillar = Obstacle { x_m: -x, y_m: -y, radius_m: 0.1, height_m: 2.0 };
    receive(&mut controller, Room::time(1), Message::Obstacles(&mut room.survey(1, vec![line, pillar])));
    assert_eq!(controller.inbox().obstacles().map(|report| report.obstacles.len()), Some(2));
    receive(&mut controller, Room::time(2), Message::Users(&mut room.positions(2))).command();
    assert!(controller.observation().scene.los_gain()[0] > 0.0);
}

/// A report of 20 ms ago, in a room that reports every 10 ms: 25 ms lie between the sample and the
/// middle of the command's time.
#[test]
fn users_are_predicted_to_walk_on_but_not_through_walls() {
    let place = |prediction: &str, x: f32| {
        let (mut controller, mut room) = flat(&["users.count=1", prediction]);
        let mut report = room.positions(1);
        report.users[0].position_m = [x, 0.5, 0.85];
        report.users[0].velocity_m_s = [2.0, -1.0];
        receive(&mut controller, Room::time(3), Message::Users(&mut report)).command();
        controller.observation().positions[0]
    };
    assert_eq!(place("control.belief=none", 1.0), Vec3::new(1.0, 0.5, f64::from(0.85_f32)));
    let ahead = place("control.belief=constant-velocity", 1.0);
    assert!((ahead - Vec3::new(1.05, 0.475, f64::from(0.85_f32))).norm() < 1e-9, "{ahead}");
    assert_eq!(place("control.belief=constant-velocity", 2.49).x, 2.5);
}
