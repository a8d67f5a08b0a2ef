//! A controller that takes the lead when it joins, as a calibration does, and gives it back.

use std::ops::RangeInclusive;

use super::*;

const GUEST: u64 = 9;

/// A controller of the room that is no guest.
const OTHER: u64 = 5;

/// The epoch of a controller without a tenure of its own that takes the lead now.
fn epoch_above(room: &Room, source: u64) -> u64 {
    let base = room.array.shown.epoch.max(NOON_MS);
    base / EPOCH_SLOTS * EPOCH_SLOTS + EPOCH_SLOTS + source
}

/// Lets the array follow these commands, one a report.
fn command(room: &mut Room, epoch: u64, sequences: RangeInclusive<u64>) {
    for sequence in sequences {
        assert!(room.array.handle(room.now, epoch, sequence));
        room.run(INTERVAL);
    }
}

/// Lets a controller without a tenure of its own lead for some reports; its epoch.
fn lead(room: &mut Room, source: u64) -> u64 {
    let epoch = epoch_above(room, source);
    command(room, epoch, 1..=50);
    epoch
}

/// Ends the token of a guest that leads. It commands until its successor is obeyed.
fn leave(room: &mut Room, epoch: u64) {
    room.announce(GUEST, false);
    command(room, epoch, 51..=51);
}

/// Lets a guest lead for some reports.
fn lend(room: &mut Room) {
    room.announce(GUEST, true);
    let epoch = lead(room, GUEST);
    assert_eq!(room.standings().last(), Some(&Standing::Standby));
    leave(room, epoch);
    assert_eq!(room.standings().last(), Some(&Standing::Leading), "at the next report");
    assert!(!room.array.handle(room.now, epoch, 52), "a command on its way");
    room.run(S);
}

/// Lets a controller that is no guest lead, and ends its token: that is a takeover by the first one.
fn expect_takeover_from_other(mut room: Room) {
    lead(&mut room, OTHER);
    assert_eq!(room.standings(), [Standing::Standby]);
    room.announce(OTHER, false);
    room.run(S);
    assert_eq!(room.controllers[0].events, [TenureEvent::Superseded, TenureEvent::TookOver]);
}

#[test]
fn a_lead_that_a_guest_took_and_gives_back_is_no_takeover() {
    let mut room = led_room(&[1]);
    (0..3).for_each(|_| lend(&mut room));
    assert_eq!(room.controllers[0].events, [TenureEvent::Superseded, TenureEvent::Resumed].repeat(3));
}

#[test]
fn contested_takeovers_do_not_delay_the_return_of_the_lead() {
    let mut room = led_room(&[1, 600]);
    room.takeover(0, 1);
    assert!(room.is_contested(0, 1));
    room.announce(1, false);
    lend(&mut room);
    assert_eq!(room.controllers[1].events.last(), Some(&TenureEvent::Resumed));
}

#[test]
fn the_end_of_a_controller_that_stood_by_before_it_led_is_a_takeover() {
    let mut room = led_room(&[1, 600]);
    room.hang(0, 1);
    room.announce(600, false);
    room.controllers[1].is_alive = false;
    room.run(S);
    assert_eq!(room.controllers[0].events, [TenureEvent::Superseded, TenureEvent::TookOver]);
}

#[test]
fn the_first_leader_of_an_array_is_no_guest() {
    let mut room = Room::new(&[600]);
    room.telemetry_interval = INTERVAL;
    room.show(room.array.shown);
    room.controllers[0].tenure = Tenure::live(600, INTERVAL).in_reserve(None);
    room.run(INTERVAL);
    room.announce(GUEST, true);
    lead(&mut room, GUEST);
    room.announce(GUEST, false);
    room.run(S);
    assert_eq!(room.controllers[0].events, [TenureEvent::StoodBy, TenureEvent::TookOver]);
}

#[test]
fn a_controller_that_joins_and_takes_over_from_a_leader_that_has_failed_or_left_is_no_guest() {
    for has_left in [false, true] {
        let mut room = led_room(&[1, 600]);
        room.announce(OTHER, true);
        room.controllers[0].is_alive = false;
        if has_left {
            room.announce(1, false);
        } else {
            // The last answer of the leader, and one report without an answer.
            room.run(2 * INTERVAL);
        }
        lead(&mut room, OTHER);
        assert_eq!(room.standings()[1], Standing::Standby, "a token that has ended is not that of the new leader");
        room.announce(OTHER, false);
        room.run(S);
        let events = &room.controllers[1].events;
        assert_eq!(events.last(), Some(&TenureEvent::TookOver), "has left: {has_left}");
        if has_left {
            assert_eq!(*events, [TenureEvent::StoodBy, TenureEvent::TookOver]);
        }
    }
}

#[test]
fn a_controller_whose_link_returns_or_whose_token_is_repeated_is_no_guest() {
    for returns in [true, false] {
        let mut room = led_room(&[1]);
        room.announce(OTHER, true);
        room.run(2 * S);
        if returns {
            room.announce(OTHER, false);
        }
        room.announce(OTHER, true);
        expect_takeover_from_other(room);
    }
}

#[test]
fn a_guest_that_lost_the_lead_and_takes_it_again_is_still_one() {
    let mut room = led_room(&[1]);
    room.announce(OTHER, true);
    room.announce(GUEST, true);
    lead(&mut room, GUEST);
    lead(&mut room, OTHER);
    room.announce(GUEST, false);
    room.announce(GUEST, true);
    let epoch = lead(&mut room, GUEST);
    leave(&mut room, epoch);
    assert_eq!(room.controllers[0].events, [TenureEvent::Superseded, TenureEvent::Resumed]);
}

#[test]
fn a_guest_whose_token_returns_before_the_next_report_keeps_the_lead() {
    let mut room = led_room(&[1]);
    room.announce(GUEST, true);
    let epoch = lead(&mut room, GUEST);
    room.announce(GUEST, false);
    room.announce(GUEST, true);
    command(&mut room, epoch, 51..=100);
    assert_eq!(room.standings(), [Standing::Standby]);
    room.announce(GUEST, false);
    room.run(INTERVAL);
    assert_eq!(room.controllers[0].events, [TenureEvent::Superseded, TenureEvent::Resumed]);
}

#[test]
fn the_end_of_a_token_that_was_not_seen_is_no_end_of_the_leader() {
    let mut room = led_room(&[1]);
    let epoch = lead(&mut room, GUEST);
    leave(&mut room, epoch);
    assert_eq!(room.standings(), [Standing::Standby]);
}

#[test]
fn the_leader_after_a_guest_whose_commands_have_expired_is_no_guest() {
    let mut room = led_room(&[1]);
    room.announce(OTHER, true);
    room.announce(GUEST, true);
    lead(&mut room, GUEST);
    room.array.shown.following = false;
    room.show(room.array.shown);
    expect_takeover_from_other(room);
}

#[test]
fn the_lead_of_a_guest_returns_at_once_also_where_it_left_before_telemetry_showed_its_lead() {
    let mut room = led_room(&[1]);
    let epoch = epoch_above(&room, GUEST);
    room.announce(GUEST, true);
    assert!(room.array.handle(room.now, epoch, 1));
    room.announce(GUEST, false);
    for sequence in 2..=4 {
        // It commands until its successor is obeyed.
        room.array.handle(room.now, epoch, sequence);
        room.run(INTERVAL);
    }
    assert_eq!(room.controllers[0].events, [TenureEvent::Superseded, TenureEvent::Resumed]);
}

#[test]
fn the_end_of_a_leader_counts_beside_more_controllers_than_are_known() {
    let mut room = led_room(&[1]);
    (0..16).for_each(|other| room.announce(700 + other, true));
    lend(&mut room);
}
