//! The last command of a controller that takes over: the one that the array follows by telemetry.

use heliostat_core::{
    core::{Controller, DegradedMode},
    inbox::Message,
    tenure::Tenure,
};
use heliostat_proto::{ArrayState, Counters, MirrorCommand, MirrorTelemetry, Nanos, Stamp};

use crate::support::{MS, Outcome, Room, Scripted, controller, receive, scenario, scripted, telemetry};

const DRIVER: u64 = 9;

/// The epoch of the leader, above that of a controller which led before.
const LEADER: u64 = 1 << 50;

/// A controller whose own policy turns every mirror to 0.125.
fn other_policy() -> (Controller, Room) {
    scripted(&[], |_, out| {
        out.roll.fill(0.125);
        out.yaw.fill(0.125);
        Ok(())
    })
}

/// The same, which stands by from the start.
fn standby() -> (Controller, Room) {
    let (controller, room) = other_policy();
    (controller.with_tenure(in_reserve()), room)
}

fn in_reserve() -> Tenure {
    Tenure::live(3, 10 * MS).in_reserve(None)
}

/// A command of the leader.
fn led(tick: u64, roll: f32) -> MirrorCommand {
    MirrorCommand {
        epoch: LEADER,
        sequence: tick,
        roll: vec![roll; 9],
        yaw: vec![-roll; 9],
        ..MirrorCommand::default()
    }
}

/// When telemetry arrives after a tick.
fn shown_at(tick: u64) -> Nanos {
    Room::time(tick) + 5 * MS
}

/// Telemetry after a tick, of an array that follows a command.
fn following(tick: u64, command: &MirrorCommand) -> MirrorTelemetry {
    MirrorTelemetry {
        state: ArrayState::Following,
        epoch: command.epoch,
        applied_sequence: command.sequence,
        counters: Counters { accepted: command.sequence, ..Counters::default() },
        roll_commanded: command.roll.clone(),
        yaw_commanded: command.yaw.clone(),
        ..telemetry(DRIVER, 10 * tick, shown_at(tick), 9)
    }
}

fn show(controller: &mut Controller, tick: u64, command: &MirrorCommand) {
    receive(controller, shown_at(tick), Message::Telemetry(0, &mut following(tick, command)));
}

/// A tick that a standby does not answer, and then telemetry of the followed command.
fn follow(controller: &mut Controller, room: &mut Room, tick: u64, command: &MirrorCommand) {
    assert_eq!(room.tick(controller, tick), Outcome::Held(DegradedMode::Standby), "tick {tick}");
    show(controller, tick, command);
}

/// The angles of the answer to a report without users.
fn answer_without_users(controller: &mut Controller, room: &mut Room, tick: u64) -> [Vec<f32>; 2] {
    angles(&receive(controller, Room::time(tick), Message::Users(&mut room.positions_of(tick, &[]))).command())
}

fn angles(command: &MirrorCommand) -> [Vec<f32>; 2] {
    [command.roll.clone(), command.yaw.clone()]
}

#[test]
fn a_standby_repeats_the_command_of_the_former_leader() {
    let (mut controller, mut room) = standby();
    (1..=6).for_each(|tick| follow(&mut controller, &mut room, tick, &led(tick, 0.0625 * tick as f32)));
    let last = led(6, 0.375);
    // The leader does not answer this tick.
    follow(&mut controller, &mut room, 7, &last);
    assert_eq!(answer_without_users(&mut controller, &mut room, 8), angles(&last));
}

#[test]
fn a_former_leader_repeats_the_command_of_its_successor_and_not_its_own() {
    let (controller, mut room) = other_policy();
    let mut controller = controller.with_tenure(Tenure::live(3, 10 * MS));
    receive(&mut controller, shown_at(1), Message::Telemetry(0, &mut telemetry(DRIVER, 10, shown_at(1), 9)));
    let own = room.tick(&mut controller, 2).command();
    assert_eq!(own.roll, [0.125; 9]);
    show(&mut controller, 2, &own);
    show(&mut controller, 3, &led(3, 0.25));
    // Its own command is valid for 200 ms.
    (4..=30).for_each(|tick| follow(&mut controller, &mut room, tick, &led(tick, 0.25)));
    let last = led(30, 0.25);
    follow(&mut controller, &mut room, 31, &last);
    assert_eq!(answer_without_users(&mut controller, &mut room, 32), angles(&last));
}

#[test]
fn angles_that_the_array_does_not_follow_are_not_repeated() {
    let last = led(6, 0.25);
    let forged = |change: fn(&mut MirrorTelemetry)| {
        let (mut controller, mut room) = standby();
        (1..=6).for_each(|tick| follow(&mut controller, &mut room, tick, &led(tick, 0.25)));
        follow(&mut controller, &mut room, 7, &last);
        let mut other = MirrorTelemetry {
            stamp: Stamp { source: DRIVER, sequence: 71, time_ns: shown_at(7) },
            roll_commanded: vec![0.5; 9],
            ..following(7, &last)
        };
        change(&mut other);
        receive(&mut controller, shown_at(7), Message::Telemetry(0, &mut other));
        answer_without_users(&mut controller, &mut room, 8)
    };
    let changes: [fn(&mut MirrorTelemetry); 3] = [
        |telemetry| telemetry.stamp.source += 1,
        |telemetry| telemetry.roll_commanded.truncate(8),
        |telemetry| telemetry.state = ArrayState::Parked,
    ];
    for (index, change) in changes.into_iter().enumerate() {
        assert_eq!(forged(change), angles(&last), "change {index}");
    }
    assert_ne!(forged(|_| {}), angles(&last), "the array of the room itself is believed");
}

#[test]
fn a_replay_from_a_state_of_a_standby_adopts_the_same_command() {
    let (mut recorded, mut room) = standby();
    (1..=6).for_each(|tick| follow(&mut recorded, &mut room, tick, &led(tick, 0.25)));
    let state = recorded.memory();
    // A replay has another tenure, under which it does not stand by.
    let (mut replayed, _) = other_policy();
    replayed.restore(&state).unwrap();
    let mut restored = other_policy().0;
    restored.restore(&state).unwrap();
    let mut later = Room { sequence: room.sequence + 100, ..Room::new(&scenario(&[])) };
    let found = answer_without_users(&mut restored, &mut later, 7);
    assert_eq!(found, angles(&led(6, 0.25)), "a state holds the command that was adopted");

    let last = led(7, 0.5);
    for tick in [7, 8] {
        follow(&mut recorded, &mut room, tick, &last);
        show(&mut replayed, tick, &last);
    }
    let sequence = room.sequence;
    let expected = answer_without_users(&mut recorded, &mut room, 9);
    room.sequence = sequence;
    assert_eq!(answer_without_users(&mut replayed, &mut room, 9), expected);
    assert_eq!(expected, angles(&last));
}

#[test]
fn a_standby_that_joined_late_gives_the_command_that_the_leader_would_give() {
    let scenario = scenario(&["control.belief=none"]);
    // As the input of an actor, the last angles are in single precision.
    let halving = || {
        Box::new(Scripted(|observation, out| {
            for (out, last) in out.roll.iter_mut().zip(&observation.angles.roll) {
                *out = 0.5 * f64::from(*last as f32) + 0.05;
            }
            out.yaw.fill(0.0);
            Ok(())
        }))
    };
    let mut leader = controller(&scenario, halving());
    let mut standby = controller(&scenario, halving()).with_tenure(in_reserve());
    let mut room = Room::new(&scenario);
    let mut answer = |controller: &mut Controller, tick: u64| {
        room.sequence = 10 * tick;
        room.tick(controller, tick)
    };
    let mut last = MirrorCommand::default();
    for tick in 1..=12 {
        last = answer(&mut leader, tick).command();
        if tick > 6 {
            assert_eq!(answer(&mut standby, tick), Outcome::Held(DegradedMode::Standby));
            show(&mut standby, tick, &last);
        }
    }
    // The leader does not answer this tick.
    assert_eq!(answer(&mut standby, 13), Outcome::Held(DegradedMode::Standby));
    show(&mut standby, 13, &last);
    let [expected, found] = [&mut leader, &mut standby].map(|controller| angles(&answer(controller, 14).command()));
    assert_eq!(found, expected);
    let mut alone = controller(&scenario, halving());
    assert_ne!(angles(&answer(&mut alone, 14).command()), expected, "the command depends on the last one");
}
