//! The state of a controller restores another one, which then gives the same commands.

use heliostat_core::{
    capabilities::Unfit,
    core::{
        Controller,
        memory::{Memory, MemoryError},
    },
    inbox::Message,
    policy::PolicyKind,
};
use heliostat_proto::{
    Capabilities, ControllerInput, InputKind, MirrorCommand, MirrorTelemetry, Obstacle, Stamp, ValidityClock,
};
use heliostat_scenario::Scenario;

use crate::support::{Outcome, Room, build, controller, receive, scenario, telemetry};

const POLICIES: [PolicyKind; 5] =
    [PolicyKind::FixedPoint, PolicyKind::Greedy, PolicyKind::Pso, PolicyKind::Ddpg, PolicyKind::Nearest];

/// Obstacles that no survey reports, so that the filter has a map.
const HIDDEN: [&str; 2] = ["blockage.obstacles_per_m2=0.05", "streams.obstacles.rate_hz=0"];

fn room_scenario(belief: &str) -> Scenario {
    let belief = format!("control.belief=\"{belief}\"");
    scenario(&[&belief, HIDDEN[0], HIDDEN[1], "control.search_time_us=0", "control.search_evaluations=60"])
}

/// The users of a tick: they come and go, in another order each time.
fn users(tick: u64) -> Vec<u32> {
    let mut users: Vec<u32> = (0..5).filter(|user| !(tick / 7 + u64::from(*user)).is_multiple_of(4)).collect();
    users.rotate_left(tick as usize % 3);
    users
}

/// The direct path of all users is blocked at times.
fn gain(tick: u64) -> f32 {
    if tick.is_multiple_of(9) { 0.0 } else { 1e-6 }
}

/// One tick of a room whose users come and go; their orientations are old at times.
fn tick(room: &mut Room, controller: &mut Controller, tick: u64) -> Outcome {
    let (now, users) = (Room::time(tick), users(tick));
    if tick.is_multiple_of(3) {
        let polar = 0.01 * tick as f64;
        receive(controller, now, Message::Orientation(&mut room.orientations_of(tick, polar, &users)));
    }
    receive(controller, now, Message::Channel(&mut room.gains_of(tick, gain(tick), &users)));
    receive(controller, now, Message::Users(&mut room.positions_of(tick, &users))).unnumbered()
}

/// A survey and telemetry, which come once and stay in force.
fn begin(room: &mut Room, controller: &mut Controller) {
    let obstacle = Obstacle { x_m: 0.5, y_m: 0.2, radius_m: 0.2, height_m: 1.5 };
    receive(controller, Room::time(0), Message::Obstacles(&mut room.survey(0, vec![obstacle])));
    let mut unusable = MirrorTelemetry { unusable: vec![4], ..telemetry(9, 1, Room::time(0), 9) };
    receive(controller, Room::time(0), Message::Telemetry(0, &mut unusable));
}

fn running(scenario: &Scenario, kind: PolicyKind, ticks: u64) -> (Room, Controller) {
    let mut first = controller(scenario, build(kind, scenario).unwrap());
    let mut room = Room::new(scenario);
    first.warm_up(0..3);
    begin(&mut room, &mut first);
    (1..=ticks).for_each(|number| drop(tick(&mut room, &mut first, number)));
    (room, first)
}

#[test]
fn a_restored_controller_gives_the_same_commands_with_each_belief_and_policy() {
    for belief in ["none", "constant-velocity", "filter"] {
        let scenario = room_scenario(belief);
        for kind in POLICIES {
            let (mut room, mut first) = running(&scenario, kind, 40);
            let bytes = first.memory().to_bytes().unwrap();
            let mut second = controller(&scenario, build(kind, &scenario).unwrap());
            second.restore(&Memory::from_bytes(&bytes).unwrap()).unwrap();
            for number in 41..=80 {
                let sequence = room.sequence;
                let expected = tick(&mut room, &mut first, number);
                room.sequence = sequence;
                assert_eq!(tick(&mut room, &mut second, number), expected, "{belief}, {kind:?}, tick {number}");
            }
            let states = [&second, &first].map(|controller| controller.memory().to_bytes().unwrap());
            let apart = states[0].iter().zip(&states[1]).position(|(one, other)| one != other);
            assert_eq!((apart, states[0].len()), (None, states[1].len()), "{belief}, {kind:?}");
        }
    }
}

#[test]
fn the_filter_without_its_state_decides_differently() {
    let scenario = room_scenario("filter");
    let (mut room, mut first) = running(&scenario, PolicyKind::Greedy, 40);
    let mut second = controller(&scenario, build(PolicyKind::Greedy, &scenario).unwrap());
    let sequence = room.sequence;
    let expected = tick(&mut room, &mut first, 41);
    room.sequence = sequence;
    assert_ne!(tick(&mut room, &mut second, 41), expected);
}

#[test]
fn a_restored_controller_acts_the_same_in_silence() {
    let scenario = scenario(&["control.belief=\"filter\"", "control.when_silent=\"last-good\""]);
    let (_, mut first) = running(&scenario, PolicyKind::Greedy, 20);
    let mut second = controller(&scenario, build(PolicyKind::Greedy, &scenario).unwrap());
    second.restore(&first.memory()).unwrap();
    let late = Room::time(20) + 2_000_000_000;
    let [expected, found] = [&mut first, &mut second].map(|controller| {
        let decision = controller.poll_timeout_command(late).expect("silence");
        let commands = decision.commands().map(|(_, command)| MirrorCommand { sequence: 0, ..command.clone() });
        commands.collect::<Vec<_>>()
    });
    assert_eq!((expected.len(), &found), (1, &expected));
}

#[test]
fn a_restored_controller_knows_that_a_driver_has_no_clock() {
    let scenario = room_scenario("none");
    let (_, mut first) = running(&scenario, PolicyKind::Nearest, 5);
    let stamp = Stamp { source: 9, ..Stamp::default() };
    let capabilities = Capabilities { stamp, validity_clock: ValidityClock::Arrival, ..Capabilities::default() };
    assert!(first.handle_capabilities(0, &capabilities, Err(Unfit::PaperAngles)));
    let mut second = controller(&scenario, build(PolicyKind::Nearest, &scenario).unwrap());
    second.restore(&Memory::from_bytes(&first.memory().to_bytes().unwrap()).unwrap()).unwrap();
    let mut early = telemetry(9, 2, 1, 9);
    let stamp = early.stamp;
    receive(&mut second, Room::time(6), Message::Telemetry(0, &mut early));
    assert_eq!(second.inbox().telemetry(0).map(|telemetry| telemetry.stamp), Some(stamp));
}

#[test]
fn a_state_of_another_scenario_or_layout_is_refused() {
    let filter = room_scenario("filter");
    let (_, first) = running(&filter, PolicyKind::Nearest, 5);
    let memory = first.memory();
    let restore = |scenario: &Scenario| {
        controller(scenario, build(PolicyKind::Nearest, scenario).unwrap()).restore(&memory).unwrap_err().to_string()
    };
    let part = |part| MemoryError::Scenario { part }.to_string();
    assert_eq!(restore(&room_scenario("none")), part("belief"));
    assert_eq!(restore(&scenario(&["mirrors.rows=2"])), part("number of mirrors"));
    assert_eq!(restore(&scenario(&["control.range_deg=5"])), part("range of the mirrors"));
    let bytes = memory.to_bytes().unwrap();
    for found in [7, 99] {
        let of_layout = [&[found][..], &bytes[1..]].concat();
        assert_eq!(Memory::from_bytes(&of_layout).unwrap_err(), MemoryError::Layout { found: u32::from(found) });
    }
}

#[test]
fn damaged_bytes_are_refused_or_restored_without_a_panic() {
    let scenario = room_scenario("filter");
    let (_, first) = running(&scenario, PolicyKind::Greedy, 30);
    let bytes = first.memory().to_bytes().unwrap();
    let mut second = controller(&scenario, build(PolicyKind::Greedy, &scenario).unwrap());
    for length in (0..bytes.len()).step_by(1 + bytes.len() / 2000) {
        assert!(Memory::from_bytes(&bytes[..length]).is_err(), "cut to {length}");
    }
    let mut room = Room::new(&scenario);
    // Of the long lists of the map, a part.
    for at in (1..bytes.len()).step_by(1 + bytes.len() / 4000) {
        for bit in [1, 0x80] {
            let mut damaged = bytes.clone();
            damaged[at] ^= bit;
            let Ok(memory) = Memory::from_bytes(&damaged) else { continue };
            if second.restore(&memory).is_ok() {
                room.sequence = 1000;
                tick(&mut room, &mut second, 31);
            }
        }
    }
}

#[test]
fn the_journal_has_accepted_messages_and_decisions_in_order() {
    let scenario = room_scenario("none");
    let mut first = controller(&scenario, build(PolicyKind::Nearest, &scenario).unwrap()).with_journal();
    let mut room = Room::new(&scenario);
    tick(&mut room, &mut first, 1);
    // A repeated report is refused, and a report that is too old makes another decision due.
    receive(&mut first, Room::time(2), Message::Users(&mut room_report(1, 2)));
    receive(&mut first, Room::time(1) + 1_000_000_000, Message::Users(&mut room_report(3, 2)));
    let mut inputs = Vec::new();
    assert!(first.take_inputs(&mut inputs));
    let now = Room::time(1);
    let message =
        |input, sequence| ControllerInput { input, source: room.source, sequence, time_ns: now, command: false };
    let decision = |input, time_ns, command| ControllerInput { input, source: 0, sequence: 0, time_ns, command };
    let expected = [
        message(InputKind::Channel, 1),
        message(InputKind::Users, 2),
        decision(InputKind::Decision, now, true),
        decision(InputKind::StaleDecision, now + 1_000_000_000, false),
    ];
    assert_eq!(inputs, expected);
    assert!(first.take_inputs(&mut inputs) && inputs.is_empty());
}

fn room_report(sequence: u64, tick: u64) -> heliostat_proto::UserReport {
    Room { source: crate::support::SOURCE, users: 3, sequence: sequence - 1 }.positions(tick)
}
