//! Takeovers from a leader that was not gone.

use super::*;

/// A room in which a standby has just taken over from a leader that is not served.
fn taken_room(standby: Tenure) -> Room {
    let mut room = led_room(&[1, 600]);
    room.controllers[1].tenure = standby;
    room.controllers[1].events.clear();
    room.run(S);
    room.takeover(0, 1);
    assert_eq!(room.controllers[1].events.last(), Some(&TenureEvent::TookOver));
    room
}

#[test]
fn contested_takeovers_make_a_standby_more_patient() {
    let mut room = led_room(&[1, 600]);
    let mut unanswered = Vec::new();
    for _ in 0..3 {
        // The leader is slow: its command comes after the takeover.
        let leader = room.standings().iter().position(|standing| *standing == Standing::Leading).unwrap();
        let standby = 1 - leader;
        unanswered.push(room.takeover(leader, standby) / INTERVAL);
        assert!(room.is_contested(leader, standby));
        room.controllers[leader].is_alive = true;
        room.run(S);
        room.hang(standby, leader);
    }
    assert_eq!(unanswered, [2, 3, 4]);
}

/// A room whose first standby has taken over once from a leader that was only slow, and then stands by again.
fn twice_taken_room() -> Room {
    let mut room = led_room(&[600, 1, 300]);
    room.takeover(0, 1);
    assert!(room.is_contested(0, 1));
    room.controllers[0].is_alive = true;
    room.run(S);
    assert_eq!(room.hang(1, 2), 2 * INTERVAL);
    room.controllers[2].is_alive = false;
    room
}

#[test]
fn a_standby_that_waits_longer_does_not_take_over_together_with_the_next_one() {
    let mut room = twice_taken_room();
    assert_eq!(room.until_accepted(0), 3 * INTERVAL, "the turn of the second rank");
    room.run(S);
    assert_eq!(room.standings()[..2], [Standing::Leading, Standing::Standby]);
    assert_eq!(room.controllers[1].events.last(), Some(&TenureEvent::Superseded));
    assert_eq!(room.controllers[0].events.last(), Some(&TenureEvent::TookOver), "it is not contested");
}

#[test]
fn a_contested_takeover_is_forgiven_after_ten_minutes() {
    let mut room = twice_taken_room();
    room.until_accepted(0);
    room.controllers[2].is_alive = true;
    room.run(FORGIVEN_NS);
    assert_eq!(room.takeover(0, 1), 2 * INTERVAL);
}

#[test]
fn a_command_that_was_accepted_after_the_last_telemetry_contests_a_takeover() {
    let mut room = led_room(&[1, 600]);
    let (epoch, sequence) = room.controllers[0].sent;
    room.controllers[0].is_alive = false;
    room.run(INTERVAL);
    room.now += INTERVAL;
    room.show(room.array.shown);
    assert!(room.array.handle(room.now, epoch, sequence + 1), "the leader is slow");
    room.controllers[1].report(room.now, &mut room.array);
    room.controllers[0].is_alive = true;
    room.run(S);
    assert_eq!(room.array.shown.refused, 0, "telemetry tells the former leader to stand by");
    assert_eq!(room.standings(), [Standing::Standby, Standing::Leading]);
    assert_eq!(room.controllers[1].events, [TenureEvent::StoodBy, TenureEvent::TookOver, TenureEvent::Contested]);
}

#[test]
fn a_slow_leader_contests_a_takeover_for_a_second_and_delays_no_later_one() {
    for (after, expected) in [(500 * MS, true), (2 * S, false)] {
        let mut room = taken_room(Tenure::live(600, INTERVAL));
        room.run(after);
        assert_eq!(room.is_contested(0, 1), expected, "{} ms after the takeover", after / MS);
        room.controllers[0].is_alive = true;
        room.run(S);
        room.hang(1, 0);
        assert_eq!(room.takeover(0, 1), 2 * INTERVAL);
    }
}

#[test]
fn a_leader_whose_token_is_back_had_not_ended() {
    let mut room = led_room(&[1, 600]);
    room.announce(1, false);
    assert_eq!(room.until_accepted(1), INTERVAL);
    room.run(S);
    room.announce(2, true);
    assert!(room.controllers[1].tenure.has_leader_ended());
    assert_eq!(room.controllers[1].events.last(), Some(&TenureEvent::TookOver), "its commands end with its lead");
    room.announce(1, true);
    room.announce(1, true);
    assert!(!room.controllers[1].tenure.has_leader_ended());
    assert_eq!(room.controllers[1].events, [TenureEvent::StoodBy, TenureEvent::TookOver, TenureEvent::Contested]);
}

#[test]
fn a_leader_that_left_a_report_unanswered_or_is_back_after_a_minute_had_ended() {
    for (rank, hung, after) in [(3, 2 * INTERVAL, S), (1, 0, 61 * S)] {
        let mut room = led_room(&[1, 600]);
        room.controllers[1].tenure = room.controllers[1].tenure.clone().in_reserve(Some(rank));
        room.controllers[0].is_alive = false;
        room.run(hung);
        room.announce(1, false);
        assert_eq!(room.until_accepted(1), INTERVAL, "the end of the token decides");
        room.run(after);
        room.announce(1, true);
        assert!(room.controllers[1].tenure.has_leader_ended());
        assert_eq!(room.controllers[1].events, [TenureEvent::StoodBy, TenureEvent::TookOver], "rank {rank}");
    }
}

#[test]
fn a_takeover_of_last_resort_can_be_contested() {
    // The rank counts more reports than the array may leave without a command.
    let mut room = taken_room(Tenure::live(600, INTERVAL).in_reserve(Some(u8::MAX)));
    assert!(room.is_contested(0, 1));
}

#[test]
fn a_takeover_without_telemetry_is_contested_when_telemetry_shows_the_commands_of_the_leader() {
    let mut room = led_room(&[1, 600]);
    room.telemetry_interval = 1000 * S;
    room.run(2 * S);
    room.telemetry_interval = INTERVAL;
    room.run(S);
    assert_eq!(room.standings(), [Standing::Standby, Standing::Leading]);
    assert_eq!(room.controllers[1].events, [TenureEvent::StoodBy, TenureEvent::TookOver, TenureEvent::Contested]);
}

#[test]
fn the_own_commands_of_a_former_epoch_contest_no_takeover() {
    let mut room = taken_room(Tenure::live(600, INTERVAL));
    let (epoch, sequence) = room.controllers[1].sent;
    assert!(room.array.handle(room.now, epoch, u64::MAX), "another sender uses the epoch");
    room.run(INTERVAL);
    assert!(!room.array.handle(room.now, epoch, sequence + 1), "a command on its way");
    room.run(S);
    assert_eq!(room.controllers[1].events.last(), Some(&TenureEvent::ForeignSequence));
}
