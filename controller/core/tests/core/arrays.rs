//! Several arrays: one decision, a command for each, and arrays that get none.

use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_core::{
    core::{ArrayCommand, Controller, Decision, DegradedMode, Timing, memory::Memory},
    inbox::Message,
    observation::Observation,
    policy::{Policy, PolicyKind, PolicyResult},
    refusal::{Found, LastRefusal, Refusal, Stream, TelemetrySizes},
    tenure::Tenure,
};
use heliostat_proto::{
    ArrayState, AxisLimits, Capabilities, ControllerInput, EmergencyStop, InputKind, LatchedStopReport, MAX_TEXT,
    MirrorCommand, MirrorTelemetry, Nanos, NodeKind, SafetyReport, Stamp, StopAction, StopReport, ValidityClock,
};
use heliostat_scenario::Scenario;

use crate::support::{MS, Room, build, controller, receive};

/// Four mirrors on one wall, then six on another.
const TWO: &str = r#"
[users]
count = 3
[[mirrors]]
rows = 2
columns = 2
[[mirrors]]
rows = 2
columns = 3
wall = "-x"
"#;

/// The driver of the first array, and that of the second.
const DRIVERS: [u64; 2] = [0xd0, 0xd1];

fn two_arrays() -> Scenario {
    Scenario::from_toml(TWO).unwrap()
}

/// Gives each mirror that can reach a user the roll 0.25, and the others 0. The yaw of every mirror
/// is a hundredth of the number of those that can.
struct Reaching;

impl Policy for Reaching {
    fn name(&self) -> &str {
        "reaching"
    }

    fn act(&mut self, _: &ChannelModel, seen: &Observation, out: &mut MirrorAngles) -> PolicyResult {
        for mirror in 0..seen.mirrors() {
            let gains = seen.scene.steering_gain().iter().skip(mirror).step_by(seen.mirrors());
            out.roll[mirror] = if gains.sum::<f64>() > 0.0 { 0.25 } else { 0.0 };
        }
        let reaching = out.roll.iter().filter(|roll| **roll > 0.0).count();
        out.yaw.fill(0.01 * reaching as f64);
        Ok(())
    }
}

/// A controller of two arrays by [`Reaching`], and its room.
fn reaching() -> (Controller, Room) {
    let scenario = two_arrays();
    (controller(&scenario, Box::new(Reaching)), Room::new(&scenario))
}

fn telemetry(array: usize, sequence: u64, tick: u64, state: ArrayState) -> MirrorTelemetry {
    let stamp = Stamp { source: DRIVERS[array], sequence, time_ns: Room::time(tick) };
    let angles = vec![0.5; [4, 6][array]];
    MirrorTelemetry { stamp, state, roll_commanded: angles.clone(), yaw_commanded: angles, ..Default::default() }
}

fn report(controller: &mut Controller, array: usize, sequence: u64, tick: u64, state: ArrayState) {
    let mut telemetry = telemetry(array, sequence, tick, state);
    receive(controller, Room::time(tick), Message::Telemetry(array, &mut telemetry));
}

/// The rolls of all mirrors after a tick, and the commands for the arrays.
fn decide(controller: &mut Controller, room: &mut Room, tick: u64) -> (Vec<f32>, Vec<(usize, MirrorCommand)>) {
    let now = Room::time(tick);
    receive(controller, now, Message::Channel(&mut room.gains(tick, 1e-6)));
    controller.handle_message(now, Message::Users(&mut room.positions(tick)));
    let Decision::Move { command, parts, .. } = controller.poll_command(now, Timing::InTime, &mut |_| {}) else {
        return (Vec::new(), Vec::new());
    };
    let given = parts.iter().filter(|part| part.is_given);
    (command.roll.clone(), given.map(|ArrayCommand { array, command, .. }| (*array, command.clone())).collect())
}

fn arrays_of(commands: &[(usize, MirrorCommand)]) -> Vec<usize> {
    commands.iter().map(|(array, _)| *array).collect()
}

fn stop(time_ns: Nanos) -> EmergencyStop {
    EmergencyStop { stamp: Stamp { source: 5, sequence: 1, time_ns }, action: StopAction::Stop, ..Default::default() }
}

#[test]
fn the_text_about_stops_with_long_names_and_reasons_fits_a_message() {
    let (mut controller, _) = reaching();
    for source in 1..=3 {
        let stamp = Stamp { source, ..stop(Room::time(0)).stamp };
        // A reason is shown with its control characters escaped.
        let (operator, reason) = (format!("{source}{}", "\u{1d11e}".repeat(40)), "\u{80}".repeat(40));
        controller.handle_stop_order(Room::time(0), &EmergencyStop { stamp, operator, reason, ..stop(0) });
    }
    let text = controller.describe_stops(|text| text.into());
    assert!((1000..=MAX_TEXT).contains(&text.len()), "{} bytes: {text}", text.len());
}

#[test]
fn each_array_gets_its_mirrors_and_the_bounds_of_its_own() {
    let scenario = two_arrays();
    let mut controller = controller(&scenario, build(PolicyKind::FixedPoint, &scenario).unwrap());
    let axis = AxisLimits { min_rad: -0.1, max_rad: 0.1, ..AxisLimits::default() };
    let narrow = Capabilities { roll: axis, yaw: axis, ..Capabilities::default() };
    assert!(controller.handle_capabilities(1, &narrow, Ok(())));
    controller.handle_safety(1, &SafetyReport { validity_max_ms: 50, ..SafetyReport::default() });
    let (rolls, commands) = decide(&mut controller, &mut Room::new(&scenario), 1);
    assert_eq!(arrays_of(&commands), [0, 1]);
    let [(_, first), (_, second)] = &commands[..] else { panic!("{commands:?}") };
    assert_eq!([&first.roll[..], &second.roll[..]].concat(), rolls);
    assert_eq!((first.roll.len(), second.roll.len(), first.validity_ms, second.validity_ms), (4, 6, 200, 50));
    assert_eq!((first.answers, first.epoch, first.sequence), (second.answers, second.epoch, second.sequence));
    let largest =
        |command: &MirrorCommand| command.roll.iter().chain(&command.yaw).fold(0.0_f32, |m, a| m.max(a.abs()));
    assert!(largest(first) > 0.1 && largest(second) <= 0.1, "{first:?} {second:?}");
    assert_eq!(controller.counters().commands, 2);
}

#[test]
fn mirrors_of_a_stopped_array_are_left_out_and_the_other_array_continues() {
    let (mut controller, mut room) = reaching();
    report(&mut controller, 0, 1, 1, ArrayState::Following);
    report(&mut controller, 1, 1, 1, ArrayState::Following);
    let (rolls, commands) = decide(&mut controller, &mut room, 1);
    assert_eq!((rolls, arrays_of(&commands)), (vec![0.25; 10], vec![0, 1]));
    report(&mut controller, 0, 2, 2, ArrayState::Stopped);
    let (rolls, commands) = decide(&mut controller, &mut room, 2);
    assert_eq!(arrays_of(&commands), [1]);
    assert_eq!((commands[0].1.roll.clone(), rolls[4..].to_vec()), (vec![0.25; 6], vec![0.25; 6]));
    assert_eq!(commands[0].1.yaw[0], 0.06, "the policy sees the mirrors of the second array alone");
    assert_eq!(controller.counters().degraded(DegradedMode::Withheld), 1);
    assert!(!controller.is_commanded(0) && controller.is_commanded(1));
    // After the validity of its last command, the angles are those that the stopped array reports.
    let later = 30;
    report(&mut controller, 0, 3, later, ArrayState::Stopped);
    report(&mut controller, 1, 2, later, ArrayState::Following);
    let (rolls, _) = decide(&mut controller, &mut room, later);
    assert_eq!(rolls[..4], [0.5; 4]);
    report(&mut controller, 0, 4, later + 1, ArrayState::Parked);
    assert_eq!(decide(&mut controller, &mut room, later + 1).0, [0.25; 10]);
}

#[test]
fn a_stop_concerns_every_array_until_each_has_reported_and_dropped_it() {
    let (mut controller, mut room) = reaching();
    let order = stop(Room::time(0));
    controller.handle_stop_order(Room::time(0), &order);
    assert_eq!(decide(&mut controller, &mut room, 1).1, []);
    assert_eq!(controller.counters().degraded(DegradedMode::Withheld), 2);
    let mut sequence = 0;
    let mut stops = |controller: &mut Controller, array: usize, is_latched: bool| {
        sequence += 1;
        let stamp = Stamp { source: DRIVERS[array], sequence, time_ns: Room::time(0) };
        let latched = LatchedStopReport {
            source: order.stamp.source,
            sequence: order.stamp.sequence,
            ..LatchedStopReport::default()
        };
        let stops = if is_latched { vec![latched] } else { Vec::new() };
        controller.handle_stops(array, &StopReport { stamp, stops, ..StopReport::default() });
    };
    stops(&mut controller, 1, false);
    assert_eq!(decide(&mut controller, &mut room, 2).1, [], "the second array has not reported the stop");
    stops(&mut controller, 1, true);
    stops(&mut controller, 1, false);
    assert_eq!(arrays_of(&decide(&mut controller, &mut room, 3).1), [1]);
    stops(&mut controller, 0, true);
    stops(&mut controller, 0, false);
    assert_eq!(arrays_of(&decide(&mut controller, &mut room, 4).1), [0, 1]);
}

#[test]
fn each_array_has_numbers_of_its_own_without_a_gap_where_it_gets_no_command() {
    let (mut controller, mut room) = reaching();
    let mut numbers = |controller: &mut Controller, tick| {
        let (_, commands) = decide(controller, &mut room, tick);
        commands.iter().map(|(array, command)| (*array, command.sequence)).collect::<Vec<_>>()
    };
    assert_eq!(numbers(&mut controller, 1), [(0, 1), (1, 1)]);
    report(&mut controller, 0, 1, 2, ArrayState::Stopped);
    assert_eq!(numbers(&mut controller, 2), [(1, 2)]);
    report(&mut controller, 0, 2, 3, ArrayState::Parked);
    assert_eq!(numbers(&mut controller, 3), [(0, 2), (1, 3)]);
}

#[test]
fn an_array_that_counts_validity_from_arrival_is_not_judged_by_its_clock() {
    let (mut controller, mut room) = reaching();
    let behind = |controller: &mut Controller, array: usize, state: ArrayState| {
        let mut telemetry = telemetry(array, 1, 0, state);
        telemetry.stamp.time_ns -= 3_600_000 * MS;
        controller.handle_message(Room::time(0), Message::Telemetry(array, &mut telemetry));
    };
    let stamp = Stamp { source: DRIVERS[0], sequence: 1, time_ns: 5 };
    let capabilities = Capabilities { stamp, validity_clock: ValidityClock::Arrival, ..Capabilities::default() };
    assert!(controller.handle_capabilities(0, &capabilities, Ok(())));
    behind(&mut controller, 0, ArrayState::Stopped);
    behind(&mut controller, 1, ArrayState::Stopped);
    assert_eq!(arrays_of(&decide(&mut controller, &mut room, 1).1), [1], "only the first telemetry is accepted");
}

#[test]
fn an_announcement_of_a_second_driver_is_refused_and_its_source_is_named() {
    let (mut controller, _) = reaching();
    report(&mut controller, 1, 1, 1, ArrayState::Following);
    let announced = |source| Capabilities { stamp: Stamp { source, ..Stamp::default() }, ..Capabilities::default() };
    assert!(controller.handle_capabilities(1, &announced(DRIVERS[1]), Ok(())));
    assert_eq!(controller.counters().last_foreign_array, None);
    assert!(!controller.handle_capabilities(1, &announced(0x99), Ok(())));
    let counters = controller.counters();
    assert_eq!((counters.foreign_arrays, counters.last_foreign_array), (1, Some((1, 0x99))));
}

#[test]
fn an_array_that_left_or_is_silent_gets_no_command_until_its_telemetry_returns() {
    let (mut controller, mut room) = reaching();
    let mut given = |controller: &mut Controller, tick| arrays_of(&decide(controller, &mut room, tick).1);
    report(&mut controller, 0, 1, 1, ArrayState::Following);
    report(&mut controller, 1, 1, 1, ArrayState::Following);
    assert_eq!(given(&mut controller, 1), [0, 1]);
    controller.handle_source_lost(NodeKind::Driver, DRIVERS[1]);
    assert_eq!(given(&mut controller, 2), [0]);
    controller.handle_source_found(NodeKind::Driver, DRIVERS[1]);
    report(&mut controller, 1, 1, 3, ArrayState::Parked);
    assert_eq!(given(&mut controller, 3), [0, 1]);
    // Only the second array reports from here on.
    report(&mut controller, 1, 2, 90, ArrayState::Following);
    assert_eq!(given(&mut controller, 101), [0, 1]);
    assert_eq!(given(&mut controller, 102), [1], "1 s after the last telemetry of the first array");
    report(&mut controller, 0, 2, 103, ArrayState::Parked);
    assert_eq!(given(&mut controller, 103), [0, 1]);
}

#[test]
fn an_array_without_a_driver_is_lost_a_second_after_the_first_decision() {
    let (mut controller, mut room) = reaching();
    let mut given = |controller: &mut Controller, tick| {
        report(controller, 0, tick, tick, ArrayState::Following);
        arrays_of(&decide(controller, &mut room, tick).1)
    };
    assert_eq!(given(&mut controller, 1), [0, 1]);
    assert_eq!(given(&mut controller, 101), [0, 1]);
    assert_eq!(given(&mut controller, 102), [0]);
}

#[test]
fn each_array_has_an_epoch_of_its_own() {
    let (controller, mut room) = reaching();
    let mut controller = controller.with_tenure(Tenure::live(3, 10 * MS));
    // The second array followed another controller, with a higher epoch than any by the clock.
    let mut followed = telemetry(1, 1, 1, ArrayState::Parked);
    followed.epoch = 1 << 50;
    receive(&mut controller, Room::time(1), Message::Telemetry(1, &mut followed));
    report(&mut controller, 0, 1, 1, ArrayState::Parked);
    let (_, commands) = decide(&mut controller, &mut room, 1);
    let epochs: Vec<u64> = commands.iter().map(|(_, command)| command.epoch).collect();
    assert!(epochs[0] < 1 << 50 && epochs[1] > 1 << 50, "{epochs:?}");
    let mut followed = telemetry(1, 2, 2, ArrayState::Following);
    (followed.epoch, followed.applied_sequence) = (epochs[1], 1);
    receive(&mut controller, Room::time(2), Message::Telemetry(1, &mut followed));
    followed = telemetry(1, 3, 3, ArrayState::Following);
    followed.epoch = 1 << 51;
    receive(&mut controller, Room::time(3), Message::Telemetry(1, &mut followed));
    assert_eq!(arrays_of(&decide(&mut controller, &mut room, 3).1), [0], "standby at the second array alone");
    assert_eq!(controller.counters().degraded(DegradedMode::Standby), 1);
}

#[test]
fn telemetry_of_one_array_is_none_of_another() {
    let (mut controller, mut room) = reaching();
    for (array, expected) in [(0, 1), (2, 2)] {
        let mut second = telemetry(1, 1, 1, ArrayState::Following);
        receive(&mut controller, Room::time(1), Message::Telemetry(array, &mut second));
        assert_eq!(controller.inbox().refused().total(), expected);
    }
    let mut second = telemetry(1, 1, 1, ArrayState::Following);
    second.unusable = vec![2];
    receive(&mut controller, Room::time(1), Message::Telemetry(1, &mut second));
    assert_eq!((controller.inbox().telemetry(0), controller.inbox().unusable()), (None, &[6][..]));
    let (rolls, _) = decide(&mut controller, &mut room, 1);
    assert_eq!(rolls.iter().position(|roll| *roll == 0.0), Some(6));
}

/// A controller after some ticks, with the first array stopped, and the second one narrow and with
/// a mirror that does not follow.
fn running(scenario: &Scenario, room: &mut Room) -> Controller {
    let mut first = controller(scenario, build(PolicyKind::Greedy, scenario).unwrap()).with_journal();
    let axis = AxisLimits { min_rad: -0.2, max_rad: 0.2, ..AxisLimits::default() };
    first.handle_capabilities(1, &Capabilities { roll: axis, yaw: axis, ..Capabilities::default() }, Ok(()));
    for tick in 1..=20 {
        let state = if tick < 15 { ArrayState::Following } else { ArrayState::Stopped };
        report(&mut first, 0, tick, tick, state);
        let mut second = telemetry(1, tick, tick, ArrayState::Following);
        second.unusable = vec![2];
        receive(&mut first, Room::time(tick), Message::Telemetry(1, &mut second));
        decide(&mut first, room, tick);
    }
    first
}

#[test]
fn a_restored_controller_of_two_arrays_gives_the_same_commands() {
    let scenario = two_arrays();
    let mut room = Room::new(&scenario);
    let mut first = running(&scenario, &mut room);
    let memory = Memory::from_bytes(&first.memory().to_bytes().unwrap()).unwrap();
    let mut second = controller(&scenario, build(PolicyKind::Greedy, &scenario).unwrap());
    second.restore(&memory).unwrap();
    for tick in [21, 22, 60, 115, 130] {
        let sequence = room.sequence;
        let mut unnumbered = |controller: &mut Controller| {
            room.sequence = sequence;
            let (rolls, mut commands) = decide(controller, &mut room, tick);
            // A restored controller begins its numbers again.
            commands.iter_mut().for_each(|(_, command)| command.sequence = 0);
            (rolls, commands)
        };
        assert_eq!(unnumbered(&mut second), unnumbered(&mut first), "tick {tick}");
    }
    let one = Scenario::from_toml("[users]\ncount = 3\n[mirrors]\nrows = 2\ncolumns = 5\n").unwrap();
    let refused = controller(&one, build(PolicyKind::Greedy, &one).unwrap()).restore(&memory).unwrap_err();
    assert!(refused.to_string().contains("differs"), "{refused}");
}

#[test]
fn the_journal_names_the_arrays_so_that_a_replay_repeats_what_was_withheld() {
    let scenario = two_arrays();
    let mut room = Room::new(&scenario);
    let mut first = running(&scenario, &mut room);
    let mut inputs = Vec::new();
    assert!(first.take_inputs(&mut inputs));
    let last = &inputs[inputs.len() - 5..];
    let of_arrays = last.iter().filter(|input| input.input == InputKind::Telemetry).map(|input| input.sequence);
    assert_eq!(of_arrays.collect::<Vec<_>>(), [20, ControllerInput::sequence_of(1, 20)]);
    let Some(ControllerInput { sequence: withheld, command: true, .. }) = last.last() else { panic!("{last:?}") };
    assert_eq!(*withheld, 1, "the first array is stopped");
    // A replay that knows of no stop repeats the decision by these bits.
    let (mut second, mut room) = reaching();
    second.repeat_withheld(*withheld);
    assert_eq!(arrays_of(&decide(&mut second, &mut room, 1).1), [1]);
    assert_eq!(arrays_of(&decide(&mut second, &mut room, 2).1), [0, 1]);
}

#[test]
fn silence_withholds_or_repeats_for_each_array() {
    let scenario = two_arrays().with_overrides(&["control.when_silent=\"last-good\""]).unwrap();
    let (mut controller, mut room) = (controller(&scenario, Box::new(Reaching)), Room::new(&scenario));
    let (_, last) = decide(&mut controller, &mut room, 1);
    assert_eq!(arrays_of(&last), [0, 1]);
    let silent_ns = Room::time(1) + 600 * MS;
    report(&mut controller, 1, 1, 55, ArrayState::Stopped);
    let repeated: Vec<_> = controller.poll_timeout_command(silent_ns).expect("silence").commands().collect();
    let [(0, repeated)] = &repeated[..] else { panic!("{repeated:?}") };
    assert_eq!((&repeated.roll, repeated.answers, repeated.time_ns), (&last[0].1.roll, 0, silent_ns));
}

#[test]
fn a_refusal_of_telemetry_has_the_array_and_the_sizes() {
    let scenario = two_arrays();
    let mut controller = controller(&scenario, build(PolicyKind::Nearest, &scenario).unwrap());
    let last = |controller: &Controller| controller.inbox().refused().last().expect("a refusal");
    let mut of_first = telemetry(0, 1, 1, ArrayState::Following);
    receive(&mut controller, Room::time(1), Message::Telemetry(1, &mut of_first));
    let found = Found::Sizes(TelemetrySizes { roll: 4, yaw: 4, expected: 6 });
    let (stream, refusal) = (Stream::Telemetry, Refusal::WrongMirrorCount);
    assert_eq!(last(&controller), LastRefusal { stream, array: 1, refusal, found });
    controller.handle_malformed((stream, 1), Refusal::Truncated, &[]);
    assert_eq!(last(&controller), LastRefusal { stream, array: 1, refusal: Refusal::Truncated, found: Found::Nothing });
}
