//! Accepted reports, and the named reasons for refusing others.

use heliostat_core::{
    core::{Controller, DegradedMode},
    inbox::Message,
    refusal::{Found, LeftOut, Refusal, Stream, UserValues},
};
use heliostat_proto::{
    ArrayState, MirrorTelemetry, NodeKind, Obstacle, Stamp, UserReport, UserState, encode, sender_of,
};

use crate::support::{MS, Outcome, Room, SOURCE, flat, receive, scenario, telemetry};

fn refused(controller: &Controller, stream: Stream, refusal: Refusal) -> u64 {
    controller.inbox().refused().get(stream, refusal)
}

#[test]
fn a_position_report_completes_a_tick_and_a_channel_report_does_not() {
    let (mut controller, mut room) = flat(&[]);
    let now = Room::time(3);
    assert_eq!(receive(&mut controller, now, Message::Channel(&mut room.gains(3, 1e-6))), Outcome::Nothing);
    let command = receive(&mut controller, now, Message::Users(&mut room.positions(3))).command();
    assert_eq!((command.answers, command.sequence, command.epoch), (3, 1, 7));
    assert_eq!((command.time_ns, command.validity_ms), (now, 200));
    assert_eq!(controller.inbox().refused().total(), 0);
}

#[test]
fn a_report_that_is_too_old_gets_no_command() {
    let (mut controller, mut room) = flat(&[]);
    let late = Room::time(1) + 501 * MS;
    let outcome = receive(&mut controller, late, Message::Users(&mut room.positions(1)));
    assert_eq!(outcome, Outcome::Held(DegradedMode::StaleReport));
    assert_eq!(refused(&controller, Stream::Users, Refusal::Stale), 1);
    assert_eq!(controller.counters().degraded(DegradedMode::StaleReport), 1);

    let in_time = Room::time(2) + 500 * MS;
    receive(&mut controller, in_time, Message::Users(&mut room.positions(2))).command();
}

#[test]
fn a_report_from_the_future_is_refused_beyond_what_clocks_may_differ() {
    let (mut controller, mut room) = flat(&[]);
    let early = Room::time(1) - 51 * MS;
    let outcome = receive(&mut controller, early, Message::Users(&mut room.positions(1)));
    assert_eq!(outcome, Outcome::Nothing);
    assert_eq!(refused(&controller, Stream::Users, Refusal::FromFuture), 1);
    let outcome = receive(&mut controller, Room::time(2) - 49 * MS, Message::Users(&mut room.positions(2)));
    assert_eq!(outcome.command().answers, 2);
}

#[test]
fn a_second_source_is_refused_and_named_until_the_first_is_silent() {
    let (mut controller, mut room) = flat(&[]);
    room.tick(&mut controller, 1).command();
    let mut other = Room { source: 0x52, ..room };
    assert_eq!(other.tick(&mut controller, 2), Outcome::Nothing);
    assert_eq!(refused(&controller, Stream::Users, Refusal::ForeignSource), 1);
    assert_eq!(refused(&controller, Stream::Channel, Refusal::ForeignSource), 1);
    let last = controller.inbox().refused().last();
    assert_eq!(last.map(|last| last.found), Some(Found::Source(0x52)));
    assert_eq!(controller.inbox().source(), Some(SOURCE));

    // Silent for more than a second: ticks are 10 ms.
    other.tick(&mut controller, 102).command();
    assert_eq!(controller.inbox().source(), Some(0x52));
    assert_eq!(controller.inbox().sources(), 2);
}

#[test]
fn reports_of_two_sources_are_never_mixed() {
    let (mut controller, mut room) = flat(&[]);
    room.tick(&mut controller, 1).command();
    let mut other = Room { source: 0x52, ..room };
    let now = Room::time(102);
    receive(&mut controller, now, Message::Users(&mut other.positions(102))).command();
    assert!(controller.inbox().channel(now).is_none());
    assert_eq!(controller.counters().modelled, 1, "the other source has not reported gains so far");
}

#[test]
fn a_source_that_has_left_frees_the_room_at_once_and_no_other_token_does() {
    let (mut controller, mut room) = flat(&[]);
    room.tick(&mut controller, 1).command();
    let others = [NodeKind::Viewer, NodeKind::Controller, NodeKind::Driver].map(|node| (node, SOURCE));
    for (node, source) in others.into_iter().chain([(NodeKind::SimNode, 0x99)]) {
        controller.handle_source_lost(node, source);
        assert_eq!(controller.inbox().source(), Some(SOURCE), "{node}");
    }
    assert_eq!(room.tick(&mut controller, 2).command().answers, 2);
    controller.handle_source_lost(NodeKind::Tracker, SOURCE);
    assert_eq!(controller.inbox().source(), None);
    let mut other = Room { source: 0x52, ..room };
    assert_eq!(other.tick(&mut controller, 3).command().answers, 3);
}

#[test]
fn a_late_report_of_a_source_that_has_left_is_refused_until_the_source_returns() {
    let (mut controller, mut room) = flat(&[]);
    room.tick(&mut controller, 1).command();
    controller.handle_source_lost(NodeKind::SimNode, SOURCE);
    assert_eq!(room.tick(&mut controller, 2), Outcome::Nothing);
    assert_eq!((controller.inbox().source(), refused(&controller, Stream::Users, Refusal::SourceGone)), (None, 1));
    controller.handle_source_found(NodeKind::SimNode, 0x99);
    assert_eq!(room.tick(&mut controller, 3), Outcome::Nothing);
    controller.handle_source_found(NodeKind::SimNode, SOURCE);
    assert_eq!(room.tick(&mut controller, 4).command().answers, 4);
}

#[test]
fn a_report_with_two_entries_for_one_user_is_refused() {
    let (mut controller, mut room) = flat(&[]);
    let (mut gains, mut users) = (room.gains_of(1, 1e-6, &[4, 4]), room.positions_of(1, &[7, 3, 7]));
    let found = |controller: &Controller| controller.inbox().refused().last().map(|last| last.found);
    receive(&mut controller, Room::time(1), Message::Channel(&mut gains));
    assert_eq!(found(&controller), Some(Found::Twice(4)));
    assert_eq!(receive(&mut controller, Room::time(1), Message::Users(&mut users)), Outcome::Nothing);
    assert_eq!(found(&controller), Some(Found::Twice(7)));
    assert_eq!(refused(&controller, Stream::Users, Refusal::DuplicateUser), 1);
    assert_eq!(refused(&controller, Stream::Channel, Refusal::DuplicateUser), 1);
    assert_eq!(controller.inbox().source(), None, "a report that is refused does not claim the room");
}

#[test]
fn orientations_are_refused_for_the_reasons_of_the_other_reports() {
    let (mut controller, mut room) = flat(&[]);
    let mut other = Room { source: 0x99, users: 3, sequence: 0 };
    room.tick(&mut controller, 1).command();
    let now = Room::time(100);
    let stale = room.orientations_of(1, 0.3, &[0]);
    let repeated = room.orientations_of(100, 0.3, &[0]);
    let cases = [
        (room.orientations_of(100, 0.3, &[4, 4]), Refusal::DuplicateUser),
        (stale, Refusal::Stale),
        (room.orientations_of(110, 0.3, &[0]), Refusal::FromFuture),
    ];
    receive(&mut controller, now, Message::Users(&mut room.positions(100))).command();
    for (mut report, reason) in cases {
        receive(&mut controller, now, Message::Orientation(&mut report));
        assert_eq!(refused(&controller, Stream::Orientation, reason), 1, "{reason:?}");
        assert!(controller.inbox().orientation(now).is_none(), "{reason:?}");
    }
    for _ in 0..2 {
        receive(&mut controller, now, Message::Orientation(&mut repeated.clone()));
    }
    assert_eq!(refused(&controller, Stream::Orientation, Refusal::Repeated), 1);
    receive(&mut controller, now, Message::Orientation(&mut other.orientations_of(100, 0.9, &[0])));
    assert_eq!(refused(&controller, Stream::Orientation, Refusal::ForeignSource), 1);
    assert_eq!(controller.inbox().orientation(now), Some(&repeated));
    controller.handle_source_lost(NodeKind::SimNode, SOURCE);
    assert_eq!(controller.inbox().orientation(now), None, "the source has left");
}

#[test]
fn a_user_with_impossible_values_is_left_out_and_the_others_are_served() {
    let (mut controller, mut room) = flat(&[]);
    let mut report = room.positions(1);
    let all = report.users.len();
    report.users[0].position_m[0] = 3.6;
    // The largest speed of a user.
    report.users[1].velocity_m_s = [60.0, -80.0];
    let (user, position_m) = (report.users[0].user, report.users[0].position_m);
    let values = UserValues::from(&report.users[0]);
    receive(&mut controller, Room::time(1), Message::Users(&mut report)).command();
    let kept: Vec<u32> = controller.inbox().users().expect("accepted").users.iter().map(|user| user.user).collect();
    assert!(kept.len() == all - 1 && !kept.contains(&user), "{kept:?}");
    let refused = controller.inbox().refused();
    let expected = LeftOut { user, refusal: Refusal::OutsideRoom, position_m, values };
    assert_eq!((refused.left_out(), refused.last_left_out(), refused.total()), (1, Some(expected), 0));
    // Speeds and minimum rates are those of one user too.
    type Change = fn(&mut UserState);
    let changes: [(Change, &str); 2] = [
        (|user| user.min_rate_bps = -1.0, "a minimum rate of -1 bit/s: expected 0 or more"),
        (|user| user.velocity_m_s = [0.0, 100.5], "a speed of 100.5000 m/s: expected at most 100 m/s"),
    ];
    for (change, words) in changes {
        let mut report = room.positions(2);
        change(&mut report.users[1]);
        receive(&mut controller, Room::time(2), Message::Users(&mut report));
        assert_eq!(controller.inbox().users().expect("accepted").users.len(), all - 1);
        let last = controller.inbox().refused().last_left_out().expect("one");
        assert_eq!((last.refusal, last.values.to_string().as_str()), (Refusal::Implausible, words));
    }
    // A report of this user alone is refused, with the value.
    let mut alone = room.positions(3);
    alone.users.truncate(1);
    alone.users[0].velocity_m_s = [0.0, 101.0];
    receive(&mut controller, Room::time(3), Message::Users(&mut alone));
    let last = controller.inbox().refused().last().expect("one");
    let Found::User(LeftOut { user: 0, values, .. }) = last.found else { panic!("{last:?}") };
    assert_eq!(values.speed_m_s, 101.0);
}

#[test]
fn physically_impossible_values_are_refused() {
    let (mut controller, mut room) = flat(&[]);
    let now = Room::time(1);
    let mut outside = room.positions(1);
    outside.users.iter_mut().for_each(|user| user.position_m[0] = 3.6);
    assert_eq!(receive(&mut controller, now, Message::Users(&mut outside)), Outcome::Nothing);
    assert_eq!(refused(&controller, Stream::Users, Refusal::OutsideRoom), 1);
    let last = controller.inbox().refused().last().expect("a refusal");
    let Found::User(LeftOut { user: 0, position_m: [x, ..], .. }) = last.found else { panic!("{last:?}") };
    assert_eq!(x, 3.6);

    receive(&mut controller, now, Message::Channel(&mut room.gains_of(1, -1e-9, &[5])));
    assert_eq!(refused(&controller, Stream::Channel, Refusal::Implausible), 1);
    let last = controller.inbox().refused().last().expect("a refusal");
    assert_eq!(last.found, Found::Gain { user: 5, los_gain: -1e-9 });

    let hollow = Obstacle { x_m: 0.0, y_m: 0.0, radius_m: -0.1, height_m: 1.0 };
    receive(&mut controller, now, Message::Obstacles(&mut room.survey(1, vec![hollow])));
    assert_eq!(refused(&controller, Stream::Obstacles, Refusal::Implausible), 1);
}

/// A report of the room's own source, with another sequence number.
fn numbered(room: &mut Room, tick: u64, sequence: u64) -> UserReport {
    let mut report = room.positions(tick);
    report.stamp.sequence = sequence;
    report
}

#[test]
fn a_report_of_the_highest_sequence_number_does_not_darken_the_room() {
    let (mut controller, mut room) = flat(&[]);
    room.tick(&mut controller, 1).command();
    let forged = receive(&mut controller, Room::time(2), Message::Users(&mut numbered(&mut room, 2, u64::MAX)));
    assert_eq!(forged, Outcome::Nothing);
    assert_eq!(refused(&controller, Stream::Users, Refusal::SequenceJump), 1);
    for tick in 3..=200 {
        room.tick(&mut controller, tick).command();
    }
}

#[test]
fn a_stream_that_began_with_a_wild_sequence_number_recovers_after_the_source_timeout() {
    let (mut controller, mut room) = flat(&[]);
    receive(&mut controller, Room::time(1), Message::Users(&mut numbered(&mut room, 1, u64::MAX))).command();
    // The channel reports go on and keep the ownership: the stream of positions recovers by itself.
    let answered = (2..=150).filter(|tick| room.tick(&mut controller, *tick) != Outcome::Nothing);
    let first = answered.min().expect("the stream recovers");
    assert_eq!(first, 102, "the timeout is 1 s, and ticks are 10 ms");
    assert_eq!(controller.inbox().sources(), 1);
}

#[test]
fn only_an_accepted_report_renews_the_ownership() {
    let (mut controller, mut room) = flat(&[]);
    let mut repeated = room.positions(1);
    receive(&mut controller, Room::time(1), Message::Users(&mut repeated.clone())).command();
    let mut other = Room { source: 0x52, ..Room::new(&scenario(&[])) };
    for tick in 2..=101 {
        repeated.stamp.time_ns = Room::time(tick);
        assert_eq!(receive(&mut controller, Room::time(tick), Message::Users(&mut repeated)), Outcome::Nothing);
    }
    assert_eq!(refused(&controller, Stream::Users, Refusal::Repeated), 100);
    other.tick(&mut controller, 102).command();
}

#[test]
fn a_stale_report_of_a_foreign_source_gets_no_command() {
    let (mut controller, mut room) = flat(&["control.when_stale=\"park\""]);
    room.tick(&mut controller, 100).command();
    let mut other = Room { source: 0x52, ..Room::new(&scenario(&[])) };
    let now = Room::time(101);
    assert_eq!(receive(&mut controller, now, Message::Users(&mut other.positions(1))), Outcome::Nothing);
    assert_eq!(refused(&controller, Stream::Users, Refusal::ForeignSource), 1);
    assert_eq!(receive(&mut controller, now, Message::Users(&mut room.positions(1))).command().answers, 0);
}

#[test]
fn telemetry_of_a_wild_sequence_number_hides_no_stop() {
    let (mut controller, mut room) = flat(&[]);
    let report = |sequence, tick, state| MirrorTelemetry { state, ..telemetry(9, sequence, Room::time(tick), 9) };
    let following = ArrayState::Following;
    receive(&mut controller, Room::time(1), Message::Telemetry(0, &mut report(1, 1, following)));
    receive(&mut controller, Room::time(2), Message::Telemetry(0, &mut report(u64::MAX, 2, following)));
    receive(&mut controller, Room::time(3), Message::Telemetry(0, &mut report(2, 3, ArrayState::Stopped)));
    assert_eq!(room.tick(&mut controller, 4), Outcome::Held(DegradedMode::Withheld));
}

#[test]
fn an_owner_is_replaced_after_a_clock_has_stepped_back() {
    let (mut controller, mut room) = flat(&[]);
    room.tick(&mut controller, 1000).command();
    let mut other = Room { source: 0x52, ..Room::new(&scenario(&[])) };
    other.tick(&mut controller, 1).command();
}

#[test]
fn reports_that_did_not_arrive_are_counted_by_stream() {
    let (mut controller, mut room) = flat(&[]);
    for (tick, sequence) in [(1, 10), (2, 11), (3, 15), (4, 16), (5, 18)] {
        receive(&mut controller, Room::time(tick), Message::Users(&mut numbered(&mut room, tick, sequence))).command();
    }
    let mut gains = room.gains(5, 1e-6);
    gains.stamp.sequence = 70;
    receive(&mut controller, Room::time(5), Message::Channel(&mut gains.clone()));
    gains.stamp.sequence = 72;
    receive(&mut controller, Room::time(5), Message::Channel(&mut gains));
    assert_eq!(Stream::ALL.map(|stream| controller.inbox().missed(stream)), [4, 1, 0, 0, 0, 0]);
}

#[test]
fn a_report_that_is_cut_off_within_its_stamp_is_counted_once() {
    let (mut controller, mut room) = flat(&[]);
    receive(&mut controller, Room::time(1), Message::Users(&mut numbered(&mut room, 1, 1000))).command();
    let mut payload = Vec::new();
    encode(&numbered(&mut room, 2, 1001), &mut payload).unwrap();
    // Behind the source, and in the middle of the number.
    let cut = (0..payload.len()).find(|length| sender_of(&payload[..*length]).is_some()).expect("a source");
    for (tick, length) in [(3, cut), (5, cut + 1)] {
        controller.handle_malformed((Stream::Users, 0), Refusal::Truncated, &payload[..length]);
        receive(&mut controller, Room::time(tick), Message::Users(&mut numbered(&mut room, tick, 999 + tick)))
            .command();
    }
    assert_eq!(refused(&controller, Stream::Users, Refusal::Truncated), 2);
    assert_eq!(controller.inbox().missed(Stream::Users), 0, "each is refused, and none is missed too");
}

#[test]
fn of_reports_that_do_not_decode_those_of_the_source_are_not_missed() {
    let (mut controller, mut room) = flat(&[]);
    receive(&mut controller, Room::time(1), Message::Users(&mut numbered(&mut room, 1, 10))).command();
    let own = numbered(&mut room, 2, 11);
    let foreign = UserReport { stamp: Stamp { source: 0x52, ..own.stamp }, ..own.clone() };
    for report in [&own, &foreign] {
        let mut payload = Vec::new();
        encode(report, &mut payload).unwrap();
        payload.pop();
        controller.handle_malformed((Stream::Users, 0), Refusal::Truncated, &payload);
    }
    controller.handle_malformed((Stream::Users, 0), Refusal::Truncated, &[]);
    receive(&mut controller, Room::time(3), Message::Users(&mut numbered(&mut room, 3, 14))).command();
    assert_eq!(controller.inbox().missed(Stream::Users), 2, "12 and 13 did not arrive");
    assert_eq!(refused(&controller, Stream::Users, Refusal::Truncated), 3);
}
