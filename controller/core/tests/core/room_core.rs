//! The core of a room from payloads to payloads.

use allocation_counter::measure;
use heliostat_core::{
    core::Timing,
    policy::PolicyKind,
    refusal::Stream,
    room_core::{Handled, Input, InputKey, Output, Publish, RoomCore, RoomSettings, WAKE_INTERVAL_NS},
    tenure::Tenure,
};
use heliostat_proto::{
    AxisLimits, Capabilities, EmergencyStop, LatchedStopReport, Message, MirrorCommand, Nanos, NodeKind,
    Room as RoomName, RoomGeometry, Stamp, StopAction, StopRepetition, StopReport, decode, encode,
};

use crate::support::{MS, Room, build, scenario, telemetry};

const DRIVER: u64 = 9;

type Published = Vec<(Output, Vec<u8>)>;

fn core(settings: RoomSettings) -> RoomCore {
    let scenario = scenario(&[]);
    RoomCore::new(&scenario, build(PolicyKind::FixedPoint, &scenario).unwrap(), settings).unwrap()
}

fn live() -> RoomCore {
    core(RoomSettings::new(3, Tenure::fixed(7)))
}

fn bytes<T: Message>(message: &T) -> Vec<u8> {
    let mut payload = Vec::new();
    encode(message, &mut payload).unwrap();
    payload
}

fn report(stream: Stream) -> InputKey {
    InputKey::Report(stream.into())
}

fn advance<T: Message>(core: &mut RoomCore, now: Nanos, key: InputKey, message: &T) -> Published {
    let mut published = Published::new();
    core.advance(now, Input::Payload { key, bytes: &bytes(message) }, &mut published);
    published
}

fn wake(core: &mut RoomCore, now: Nanos) -> Vec<Output> {
    let mut published = Published::new();
    core.advance(now, Input::Wake, &mut published);
    published.into_iter().map(|(output, _)| output).filter(|output| *output != Output::Geometry).collect()
}

fn stop() -> EmergencyStop {
    EmergencyStop {
        stamp: Stamp { source: 5, sequence: 1, time_ns: 0 },
        action: StopAction::Stop,
        ..Default::default()
    }
}

#[test]
fn payloads_of_reports_become_numbered_payloads_of_commands() {
    let (mut core, mut room) = (live(), Room::new(&scenario(&[])));
    for tick in 1..=3 {
        let now = Room::time(tick);
        assert_eq!(advance(&mut core, now, report(Stream::Channel), &room.gains(tick, 1e-6)), []);
        let published = advance(&mut core, now, report(Stream::Users), &room.positions(tick));
        let (output, payload) = &published[0];
        let command: MirrorCommand = decode(payload).unwrap();
        assert_eq!(*output, Output::Command(0));
        assert_eq!((command.epoch, command.sequence, command.answers, command.time_ns), (7, tick, tick, now));
    }
    let mut published = Published::new();
    core.advance(Room::time(4), Input::Payload { key: report(Stream::Users), bytes: &[1, 1] }, &mut published);
    assert_eq!((published, core.controller().inbox().refused().total()), (Vec::new(), 1));
    assert!(core.last_malformed().is_some());
}

#[test]
fn the_trackers_and_simulators_in_the_room_are_counted_by_their_tokens() {
    let (mut core, room) = (live(), RoomName::new("lab").unwrap());
    let mut count = |node, source, is_alive| {
        let token = room.alive(node, source);
        core.advance(0, Input::Presence { token: &token, is_alive }, &mut Published::new());
        core.trackers()
    };
    assert_eq!([4, 5, 5].map(|source| count(NodeKind::Tracker, source, true)), [1, 2, 2]);
    assert_eq!([NodeKind::Viewer, NodeKind::SimNode].map(|node| count(node, 6, true)), [2, 3]);
    let others = [NodeKind::Viewer, NodeKind::Driver, NodeKind::SimNode];
    assert_eq!(others.map(|node| count(node, 4, false)), [3; 3], "the token of the tracker is there");
    assert_eq!([4, 4, 5].map(|source| count(NodeKind::Tracker, source, false)), [2, 2, 1]);
    assert_eq!(count(NodeKind::SimNode, 6, false), 0);
}

#[test]
fn a_tick_that_a_newer_one_supersedes_costs_no_decision() {
    let (mut core, mut room) = (live(), Room::new(&scenario(&[])));
    let mut published = Published::new();
    for tick in 1..=2 {
        let payload = bytes(&room.positions(tick));
        let input = Input::Payload { key: report(Stream::Users), bytes: &payload };
        assert!(matches!(core.handle(Room::time(tick), input, &mut published), Handled::DecisionDue));
    }
    let mut decide =
        || core.decide(Room::time(2), Timing::InTime, &mut |_| {}, &mut published).map(|answered| answered.tick);
    assert_eq!([decide(), decide()], [Some(2), None]);
    assert_eq!(core.superseded(), 1);
}

/// Counts what is published.
struct Count(u64);

impl Publish for Count {
    fn publish(&mut self, _output: Output, payload: &[u8]) {
        self.0 += payload.len() as u64;
    }

    fn has_subscribers(&mut self, _output: Output) -> bool {
        false
    }
}

#[test]
fn nothing_is_allocated_from_payload_to_payload() {
    let (mut core, mut room, mut out) = (live(), Room::new(&scenario(&[])), Count(0));
    core.warm_up(0..2);
    for tick in 1..=60 {
        let now = Room::time(tick);
        let payloads = [
            (report(Stream::Telemetry), bytes(&telemetry(DRIVER, tick, now, 9))),
            (report(Stream::Channel), bytes(&room.gains(tick, 1e-6))),
            (report(Stream::Users), bytes(&room.positions(tick))),
        ];
        let counted = measure(|| {
            for (key, payload) in &payloads {
                core.advance(now, Input::Payload { key: *key, bytes: payload }, &mut out);
            }
        });
        assert!(tick < 20 || counted.count_total == 0, "tick {tick}: {}", counted.count_total);
    }
    assert_eq!(core.controller().counters().commands, 60);
}

#[test]
fn in_lockstep_time_is_that_of_the_newest_report() {
    let settings = RoomSettings { is_lockstep: true, ..RoomSettings::new(3, Tenure::lockstep(1)) };
    let (mut core, mut room) = (core(settings), Room::new(&scenario(&[])));
    let hour = 3_600_000 * MS;
    let published = advance(&mut core, hour, report(Stream::Users), &room.positions(5));
    let command: MirrorCommand = decode(&published[0].1).unwrap();
    assert_eq!((command.time_ns, core.room_time_ns(hour)), (Room::time(5), Room::time(5)));
    assert_eq!(wake(&mut core, 2 * hour), [], "the room has not fallen silent");
}

#[test]
fn capabilities_are_examined_once_and_those_of_another_size_withhold_commands() {
    let (mut core, mut room) = (live(), Room::new(&scenario(&[])));
    let axis = AxisLimits { min_rad: -1.5, max_rad: 1.5, ..AxisLimits::default() };
    let array = |rows, sequence| Capabilities {
        stamp: Stamp { source: DRIVER, sequence, time_ns: 0 },
        rows,
        columns: 3,
        roll: axis,
        yaw: axis,
        ..Capabilities::default()
    };
    let examined = |core: &mut RoomCore, rows, sequence| {
        let payload = bytes(&array(rows, sequence));
        let input = Input::Payload { key: InputKey::Capabilities(0), bytes: &payload };
        let Handled::Examination(examination) = core.handle(0, input, &mut Published::new()) else { return false };
        core.handle(0, examination.run(), &mut Published::new());
        true
    };
    assert_eq!(
        [(4, 1), (4, 2), (3, 3), (3, 4)].map(|(rows, number)| examined(&mut core, rows, number)),
        [true, false, true, false]
    );
    assert!(core.controller().unfit().is_none());
    assert!(examined(&mut core, 5, 5));
    let published = advance(&mut core, Room::time(1), report(Stream::Users), &room.positions(1));
    assert!(published.iter().all(|(output, _)| *output == Output::Belief), "{published:?}");
    core.advance(0, Input::Payload { key: InputKey::Safety(0), bytes: &[1] }, &mut Published::new());
    assert_eq!(core.undecodable().named().collect::<Vec<_>>(), [("safety:truncated".to_owned(), 1)]);
}

#[test]
fn a_stop_is_repeated_five_times_a_second_until_the_array_has_reported_it() {
    let mut core = live();
    let start = Room::time(1);
    assert_eq!(advance(&mut core, start, InputKey::Stop, &stop()), []);
    let mut repeated = Vec::new();
    for step in 0..20 {
        repeated.extend(wake(&mut core, start + step * WAKE_INTERVAL_NS));
    }
    assert_eq!(repeated, [Output::StopRepetition(0); 5]);
    let latched = LatchedStopReport { source: 5, sequence: 1, ..LatchedStopReport::default() };
    let stamp = Stamp { source: DRIVER, sequence: 1, time_ns: start };
    let reported = StopReport { stamp, stops: vec![latched], ..StopReport::default() };
    advance(&mut core, start, InputKey::Stops(0), &reported);
    assert_eq!(wake(&mut core, start + 2_000 * MS), []);
    assert_eq!(core.controller().stops(0).len(), 1);
}

#[test]
fn the_geometry_is_announced_once_a_second_and_that_of_the_simulator_is_kept_while_it_is_announced() {
    let (mut core, scenario) = (live(), scenario(&[]));
    let mut published = Published::new();
    (0..60).for_each(|step| core.advance(step * WAKE_INTERVAL_NS, Input::Wake, &mut published));
    assert_eq!(published.len(), 3);
    let own: RoomGeometry = decode(&published[2].1).unwrap();
    assert_eq!((own.stamp.source, own.stamp.sequence, own.scenario), (3, 3, scenario.geometry_toml()));
    let announced = RoomGeometry { scenario: "[room]".into(), ..RoomGeometry::default() };
    advance(&mut core, 0, InputKey::Geometry, &announced);
    assert_eq!([4_999, 5_000].map(|ms| core.announced_geometry(ms * MS)), [Some("[room]"), None]);
}

#[test]
fn an_array_without_stop_reports_gets_the_stop_itself_while_it_is_present() {
    let mut core = live();
    let start = Room::time(1);
    advance(&mut core, start, report(Stream::Telemetry), &telemetry(DRIVER, 1, start, 9));
    advance(&mut core, start, InputKey::Stop, &stop());
    let first = wake(&mut core, start + 300 * MS);
    assert_eq!(first, [Output::StopRepetition(0)], "its first stop report may be on its way");
    let later = start + 1_600 * MS;
    advance(&mut core, later, report(Stream::Telemetry), &telemetry(DRIVER, 2, later, 9));
    assert_eq!(wake(&mut core, later), [Output::Stop]);
    assert_eq!(wake(&mut core, later + 1_100 * MS), [Output::StopRepetition(0)], "it may have left");
}

#[test]
fn an_order_that_waits_for_a_policy_is_repeated_meanwhile() {
    let mut core = live();
    let stops = core.repeater();
    let payload = bytes(&stop());
    stops.lock().unwrap().note_order(5, &payload);
    let mut published = Published::new();
    stops.lock().unwrap().repeat(Room::time(1), &mut published);
    let [(Output::Geometry, _), (Output::StopRepetition(0), repetition)] = &published[..] else {
        panic!("{published:?}")
    };
    let repetition: StopRepetition = decode(repetition).unwrap();
    assert_eq!((repetition.stop_source, repetition.stop_sequence, repetition.stamp.source), (5, 1, 3));
    core.advance(Room::time(1), Input::Payload { key: InputKey::Stop, bytes: &payload }, &mut published);
    assert_eq!(wake(&mut core, Room::time(1) + 300 * MS), [Output::StopRepetition(0)], "once");
}

#[test]
fn an_order_that_a_full_queue_has_dropped_is_held_and_ends_with_its_release() {
    let mut core = live();
    let start = Room::time(1);
    core.repeater().lock().unwrap().note_order(start, &bytes(&stop()));
    assert_eq!(wake(&mut core, start), [Output::StopRepetition(0)]);
    assert_eq!(core.controller().stops(0).len(), 1);
    let stamp = Stamp { source: DRIVER, sequence: 1, time_ns: start };
    let released = StopReport { stamp, released: vec![stop().name()], ..StopReport::default() };
    advance(&mut core, start, InputKey::Stops(0), &released);
    assert_eq!(wake(&mut core, start + 300 * MS), []);
    assert!(core.controller().stops(0).is_empty());
}

#[test]
fn commands_without_a_sign_of_a_driver_are_noticed_by_liveliness() {
    let (mut core, mut room) = (live(), Room::new(&scenario(&[])));
    advance(&mut core, Room::time(1), report(Stream::Users), &room.positions(1));
    let absent = |core: &mut RoomCore, ms: u64| core.without_driver(Room::time(1) + ms * MS);
    assert_eq!((absent(&mut core, 0), absent(&mut core, 2_000)), (vec![], vec![0]));
    let token = RoomName::new("lab").unwrap().alive(NodeKind::Driver, DRIVER);
    core.advance(0, Input::Presence { token: &token, is_alive: true }, &mut Published::new());
    assert_eq!(absent(&mut core, 2_000), []);
    core.advance(0, Input::Presence { token: &token, is_alive: false }, &mut Published::new());
    assert_eq!((absent(&mut core, 3_000), absent(&mut core, 5_000)), (vec![], vec![0]));
}

#[test]
fn a_standby_misses_the_array_of_its_room_before_its_first_command() {
    let absent_of = |tenure: Tenure| {
        let mut core = core(RoomSettings::new(3, tenure));
        [0, 2_000].map(|ms| core.without_driver(Room::time(1) + ms * MS))
    };
    let (tenure, none) = (|| Tenure::live(3, 50 * MS), Vec::<usize>::new());
    assert_eq!(absent_of(tenure().in_reserve(None)), [none.clone(), vec![0]]);
    assert_eq!(absent_of(tenure()), [none.clone(), none], "it may be the first process of the room");
}
