//! Decisions of the core in normal operation and in degraded modes.

use heliostat_core::{
    core::{Controller, DegradedMode, Stage},
    inbox::Message,
    policy::{Fixed, PolicyError, PolicyKind},
};
use heliostat_proto::{ArrayState, AxisLimits, Capabilities, MirrorTelemetry, encode};

use crate::support::{
    MS, Outcome, Room, Scripted, build, by_policy, controller, flat, receive, scenario, scripted, telemetry,
};

#[test]
fn a_failing_policy_is_replaced_and_counted() {
    let fallback = ["control.fallback=nearest"];
    let (mut broken, mut one) = scripted(&fallback, |_, _| Err(PolicyError::Inference { message: "broken".into() }));
    let (mut nearest, mut other) = by_policy(PolicyKind::Nearest, &fallback);
    let (answer, expected) = (one.tick(&mut broken, 1).command(), other.tick(&mut nearest, 1).command());
    assert_eq!((answer.roll, answer.yaw), (expected.roll, expected.yaw));
    assert_eq!(broken.counters().degraded(DegradedMode::PolicyFailed), 1);
    assert!(broken.last_failure().unwrap().to_string().contains("broken"));
    assert_eq!(nearest.counters().degraded(DegradedMode::PolicyFailed), 0);
}

#[test]
fn a_value_that_is_not_finite_is_never_commanded() {
    let (mut controller, mut room) = scripted(&["control.fallback=flat"], |_, out| {
        out.roll.fill(0.1);
        out.yaw[4] = f64::NAN;
        Ok(())
    });
    let command = room.tick(&mut controller, 1).command();
    assert!(command.roll.iter().chain(&command.yaw).all(|angle| *angle == 0.0), "the fallback is flat");
    assert_eq!(controller.counters().degraded(DegradedMode::PolicyFailed), 1);
    assert!(controller.last_failure().unwrap().to_string().contains("mirror 4"));
}

#[test]
fn without_a_fallback_the_array_is_left_to_hold() {
    let (mut controller, mut room) =
        scripted(&["control.fallback=hold"], |_, _| Err(PolicyError::Inference { message: "broken".into() }));
    assert_eq!(room.tick(&mut controller, 1), Outcome::Held(DegradedMode::Held));
    assert_eq!(controller.counters().degraded(DegradedMode::Held), 1);
    assert_eq!((controller.counters().decisions, controller.counters().commands), (1, 0));
}

#[test]
fn missing_and_outdated_gains_are_modelled_and_counted() {
    let (mut controller, mut room) = flat(&["control.report_age_max_ms=100"]);
    let counted = |controller: &Controller| {
        (controller.counters().modelled, controller.counters().degraded(DegradedMode::ChannelMissing))
    };
    receive(&mut controller, Room::time(1), Message::Users(&mut room.positions(1))).command();
    assert_eq!(counted(&controller), (1, 0), "a room that has not reported gains so far");
    room.tick(&mut controller, 2).command();
    assert_eq!(counted(&controller), (1, 0));
    receive(&mut controller, Room::time(12), Message::Users(&mut room.positions(12))).command();
    assert_eq!(counted(&controller), (1, 0), "100 ms is not too old");
    receive(&mut controller, Room::time(13), Message::Users(&mut room.positions(13))).command();
    assert_eq!(counted(&controller), (1, 1));
}

#[test]
fn angles_turn_no_faster_than_the_slew_limit() {
    let (mut controller, mut room) = scripted(&["control.slew_deg_per_s=100"], |_, out| {
        out.roll.fill(0.5);
        out.yaw.fill(0.0);
        Ok(())
    });
    let step = 1f64.to_radians();
    for tick in 1..=3 {
        let command = room.tick(&mut controller, tick).command();
        assert!((f64::from(command.roll[0]) - tick as f64 * step).abs() < 1e-6, "one degree a tick of 10 ms");
    }
    // Two ticks were lost: three times as far.
    let command = room.tick(&mut controller, 6).command();
    assert!((f64::from(command.roll[0]) - 6.0 * step).abs() < 1e-6);
    assert_eq!(controller.counters().clipped.slew, 4 * 9);
    assert_eq!(controller.counters().clipped.range, 0);
}

#[test]
fn angles_stay_within_the_range() {
    let (mut controller, mut room) = scripted(&["control.range_deg=20"], |_, out| {
        out.roll.fill(1.0);
        out.yaw.fill(-1.0);
        Ok(())
    });
    let command = room.tick(&mut controller, 1).command();
    let range = 20f64.to_radians();
    assert!(command.roll.iter().all(|roll| f64::from(*roll) <= range && f64::from(*roll) > range - 1e-6));
    assert!(command.yaw.iter().all(|yaw| f64::from(*yaw) >= -range && f64::from(*yaw) < 1e-6 - range));
    assert_eq!(controller.counters().clipped.range, 18);
}

#[test]
fn no_mirror_is_offered_to_a_user_beyond_its_range() {
    let scenario = scenario(&[]);
    let offered = |array: Option<f64>| {
        let mut controller = controller(&scenario, Box::new(Fixed::flat(scenario.mirror_count())));
        if let Some(range_deg) = array {
            let end = range_deg.to_radians() as f32;
            let axis = AxisLimits { min_rad: -end, max_rad: end, ..AxisLimits::default() };
            controller.handle_capabilities(
                0,
                &Capabilities { roll: axis, yaw: axis, ..Capabilities::default() },
                Ok(()),
            );
        }
        Room::new(&scenario).tick(&mut controller, 1).command();
        controller.observation().scene.steering_gain().iter().filter(|gain| **gain > 0.0).count()
    };
    let all = offered(None);
    assert_eq!(offered(Some(90.0)), all);
    assert!(offered(Some(12.0)) < all && offered(Some(0.01)) == 0, "{} of {all}", offered(Some(12.0)));
}

#[test]
fn a_new_controller_starts_from_where_the_array_is() {
    let (mut controller, mut room) = flat(&["control.slew_deg_per_s=100"]);
    let mut telemetry = MirrorTelemetry {
        state: ArrayState::Following,
        epoch: 6,
        roll_commanded: vec![0.4; 9],
        ..telemetry(9, 1, Room::time(1), 9)
    };
    receive(&mut controller, Room::time(1), Message::Telemetry(0, &mut telemetry));
    let command = room.tick(&mut controller, 1).command();
    assert!((f64::from(command.roll[0]) - (0.4 - 1f64.to_radians())).abs() < 1e-6, "it turns from there");
    assert_eq!(command.epoch, 7);
}

#[test]
fn stages_are_marked_in_order_and_once() {
    let (mut controller, mut room) = flat(&[]);
    let mut marks = Vec::new();
    let mut report = room.positions(1);
    controller.handle_and_poll(Room::time(1) + MS, Message::Users(&mut report), &mut |stage| marks.push(stage));
    assert_eq!(marks, [Stage::Observed, Stage::Inferred, Stage::MadeSafe]);
}

/// The same reports at the same times give the same commands, bit for bit, whatever happened
/// elsewhere in the process.
#[test]
fn the_core_is_deterministic() {
    for kind in [PolicyKind::FixedPoint, PolicyKind::Greedy, PolicyKind::Nearest, PolicyKind::Random, PolicyKind::Ddpg]
    {
        let run = || {
            let (mut controller, mut room) = by_policy(kind, &["control.slew_deg_per_s=2000"]);
            controller.warm_up(0..3);
            let (mut all, mut payload) = (Vec::new(), Vec::new());
            for tick in 1..=200 {
                let command = room.tick(&mut controller, tick).command();
                encode(&command, &mut payload).unwrap();
                all.extend_from_slice(&payload);
            }
            all
        };
        let first = run();
        assert!(first.len() > 200 * 72);
        assert!(first == run(), "{kind:?}");
    }
}

#[test]
fn each_policy_is_credited_with_its_own_commands_and_not_with_those_of_the_fallback() {
    let scenario = scenario(&["control.fallback=flat"]);
    // Angles far beyond any range, as a network without an activation at its end gives.
    let far = Scripted(|observation, out| {
        out.roll.fill(1e30);
        out.yaw.fill(-1e30);
        match observation.tick {
            2 => Err(PolicyError::Inference { message: "broken".into() }),
            _ => Ok(()),
        }
    });
    let mut controller = controller(&scenario, Box::new(far));
    let mut room = Room::new(&scenario);
    (1..=3).for_each(|tick| drop(room.tick(&mut controller, tick)));
    controller.replace_policy(build(PolicyKind::Nearest, &scenario).unwrap());
    (4..=5).for_each(|tick| drop(room.tick(&mut controller, tick)));
    controller.replace_policy(Box::new(Scripted(|_, _| Ok(()))));
    room.tick(&mut controller, 6);
    let [(first, scripted), (second, nearest)] = controller.tallies() else { panic!("{:?}", controller.tallies()) };
    assert_eq!((first.as_str(), second.as_str()), ("scripted", "nearest"));
    assert_eq!((scripted.decisions, scripted.commands, scripted.fallbacks), (4, 3, 1));
    assert_eq!((nearest.decisions, nearest.commands, nearest.fallbacks), (2, 2, 0));
    assert_eq!((scripted.clipped.range, nearest.clipped.range), (2 * 18, 0));
}
