//! What the core does when there is no time, no report or no actor.

use heliostat_core::{
    core::{Controller, Decision, DegradedMode, Timing},
    inbox::Message,
    policy::{PolicyError, PolicyKind},
};
use heliostat_proto::MirrorCommand;

use crate::support::{MS, Outcome, Room, by_policy, scripted};

/// Two ticks in time, then one that is late.
fn late_action(action: &str) -> (MirrorCommand, Outcome, Controller) {
    let (mut controller, mut room) = by_policy(PolicyKind::Greedy, &[&format!("control.when_late={action}")]);
    room.tick(&mut controller, 1);
    let good = room.tick(&mut controller, 2).command();
    controller.handle_message(Room::time(30), Message::Channel(&mut room.gains(30, 1e-6)));
    controller.handle_message(Room::time(30), Message::Users(&mut room.positions(30)));
    let outcome = match controller.poll_command(Room::time(30), Timing::Late, &mut |_| {}) {
        Decision::Move { command, .. } => Outcome::Moved(command.clone()),
        Decision::Hold(mode) => Outcome::Held(mode),
    };
    assert_eq!(controller.counters().degraded(DegradedMode::Late), 1);
    (good, outcome, controller)
}

#[test]
fn a_late_decision_has_the_configured_answer() {
    let (good, outcome, _) = late_action("last-good");
    let again = outcome.command();
    assert_eq!((&again.roll, &again.yaw), (&good.roll, &good.yaw));
    assert_eq!((again.sequence, again.answers, again.time_ns), (3, 30, Room::time(30)));

    let parked = late_action("park").1.command();
    assert!(parked.roll.iter().chain(&parked.yaw).all(|angle| *angle == 0.0));

    let (_, held, controller) = late_action("hold");
    assert_eq!(held, Outcome::Held(DegradedMode::Late));
    assert_eq!((controller.counters().decisions, controller.counters().commands), (3, 2));

    let decided = late_action("policy").1.command();
    let by_model = late_action("fallback").1.command();
    assert_ne!(decided.yaw, good.yaw, "the users have moved on");
    assert_ne!(by_model.yaw, good.yaw);
}

#[test]
fn without_a_last_command_the_array_holds() {
    let (mut controller, _) = by_policy(PolicyKind::Nearest, &["control.when_stale=last-good"]);
    assert_eq!(controller.poll_stale_command(Room::time(1)), Decision::Hold(DegradedMode::Held));
    assert_eq!(controller.counters().degraded(DegradedMode::StaleReport), 1);
}

#[test]
fn a_failing_policy_may_be_replaced_by_the_last_command() {
    let (mut controller, mut room) = scripted(&["control.fallback=last-good"], |observation, out| {
        if observation.tick > 1 {
            return Err(PolicyError::Inference { message: "silent".into() });
        }
        out.roll.fill(0.125);
        out.yaw.fill(-0.25);
        Ok(())
    });
    let good = room.tick(&mut controller, 1).command();
    let again = room.tick(&mut controller, 2).command();
    assert_eq!((again.roll, again.yaw), (good.roll, good.yaw));
    assert_eq!(controller.counters().degraded(DegradedMode::PolicyFailed), 1);
}

/// Commands given over a silence of one second, looked at every 50 ms.
fn silence(action: &str) -> (Vec<MirrorCommand>, Controller) {
    let when_silent = format!("control.when_silent={action}");
    let (mut controller, mut room) = by_policy(PolicyKind::Greedy, &[&when_silent, "control.report_age_max_ms=100"]);
    assert!(controller.poll_timeout_command(Room::time(1)).is_none(), "no report has arrived yet");
    room.tick(&mut controller, 1);
    let mut commands = Vec::new();
    for step in 1..=20 {
        if let Some(Decision::Move { command, .. }) = controller.poll_timeout_command(Room::time(1) + step * 50 * MS) {
            commands.push(command.clone());
        }
    }
    (commands, controller)
}

#[test]
fn silence_is_counted_once_and_answered_as_configured() {
    let (held, controller) = silence("hold");
    assert!(held.is_empty());
    assert_eq!(controller.counters().degraded(DegradedMode::Silence), 1);

    let (parked, controller) = silence("park");
    assert_eq!((parked.len(), controller.counters().degraded(DegradedMode::Silence)), (1, 1));
    assert!(parked[0].roll.iter().chain(&parked[0].yaw).all(|angle| *angle == 0.0));

    let (repeated, controller) = silence("last-good");
    assert_eq!((repeated.len(), controller.counters().degraded(DegradedMode::Silence)), (18, 1));
    assert!(repeated.windows(2).all(|pair| pair[0].yaw == pair[1].yaw && pair[0].time_ns < pair[1].time_ns));
    assert!(repeated[0].yaw.iter().any(|angle| *angle != 0.0));
    assert_eq!(controller.counters().decisions, 1, "only a report makes a decision");
}

#[test]
fn a_report_ends_the_silence() {
    let (mut controller, mut room) = by_policy(PolicyKind::Nearest, &["control.report_age_max_ms=100"]);
    for (tick, silences) in [(1, 1), (100, 2)] {
        room.tick(&mut controller, tick).command();
        assert!(controller.poll_timeout_command(Room::time(tick) + 50 * MS).is_none());
        controller.poll_timeout_command(Room::time(tick) + 150 * MS);
        assert_eq!(controller.counters().degraded(DegradedMode::Silence), silences);
    }
}
