//! Forged messages and epochs beyond the bound of an array.

use super::*;

#[test]
fn a_forged_epoch_at_the_start_delays_a_controller_by_one_message() {
    let mut room = Room::new(&[1]);
    room.run(10 * MS);
    room.show(Evidence { epoch: u64::MAX, ..Evidence::default() });
    assert!(room.until_accepted(0) <= 60 * MS);
}

#[test]
fn one_forged_telemetry_message_of_the_highest_epoch_pauses_commands_for_one_message_only() {
    let mut room = Room::new(&[1]);
    room.run(S);
    room.show(Evidence { epoch: u64::MAX, ..room.array.shown });
    assert_eq!(room.standings(), [Standing::Standby]);
    let waited = room.until_accepted(0);
    assert!(waited <= 60 * MS, "{} ms", waited / MS);
    assert_eq!(room.controllers[0].events, [TenureEvent::Superseded, TenureEvent::Resumed]);
}

#[test]
fn a_forged_command_of_a_higher_epoch_locks_out_no_controller() {
    for forged in [NOON_MS + 30_000, NOON_MS + 60_000, u64::MAX] {
        let mut room = Room::new(&[1]);
        room.array.lead_max_ms = Some(60_000);
        room.run(S);
        room.array.handle(room.now, forged, u64::MAX);
        room.run(100 * MS);
        let waited = room.until_accepted(0);
        assert!(waited <= 1200 * MS, "epoch {forged}: {} ms", waited / MS);
        room.run(10 * S);
        assert!(room.controllers[0].accepted > 1000, "{}", room.controllers[0].accepted);
    }
}

#[test]
fn a_forged_command_in_the_own_epoch_is_answered_by_a_new_epoch() {
    let mut room = Room::new(&[1]);
    room.run(S);
    let epoch = room.controllers[0].tenure.epoch();
    assert!(room.array.handle(room.now, epoch, u64::MAX));
    let waited = room.until_accepted(0);
    assert!(waited <= 60 * MS, "{} ms", waited / MS);
    assert!(room.controllers[0].tenure.epoch() > epoch);
    assert_eq!(room.controllers[0].events, [TenureEvent::ForeignSequence]);
}

#[test]
fn an_epoch_beyond_the_bound_of_the_array_is_given_up() {
    let mut room = Room::new(&[1]);
    room.array.lead_max_ms = Some(60_000);
    // The first telemetry comes after the wait for it.
    room.telemetry_interval = 300 * MS;
    room.controllers[0].tenure.handle_announced_epoch(NOON_MS + 1000 * DAY_MS);
    let waited = room.until_accepted(0);
    assert!((S..1700 * MS).contains(&waited), "{} ms", waited / MS);
    assert_eq!(room.controllers[0].events, [TenureEvent::LockedOut]);
}

#[test]
fn the_end_of_a_forged_token_of_the_leaders_remainder_is_no_end_of_the_leader() {
    let mut room = led_room(&[1, 600]);
    for _ in 0..3 {
        room.announce(1 + EPOCH_SLOTS, true);
        room.announce(1 + EPOCH_SLOTS, false);
        room.run(S);
    }
    assert_eq!(room.standings(), [Standing::Leading, Standing::Standby]);
    assert_eq!(room.controllers[1].events, [TenureEvent::StoodBy]);
}

#[test]
fn many_forged_tokens_of_low_ids_delay_a_standby_by_three_reports_at_most() {
    let mut room = led_room(&[1, 600]);
    (2..40).for_each(|forged| room.announce(forged, true));
    assert_eq!(room.takeover(0, 1), (1 + Nanos::from(RANK_MAX)) * INTERVAL);
}

#[test]
fn forged_tokens_of_high_ids_leave_the_order_of_the_standbys() {
    let mut room = led_room(&[1, 600, 700]);
    (800..840).for_each(|forged| room.announce(forged, true));
    room.takeover(0, 1);
    room.run(S);
    assert_eq!(room.standings()[1..], [Standing::Leading, Standing::Standby]);
    assert_eq!(room.controllers[2].events, [TenureEvent::StoodBy], "it waits for the one before it");
}

#[test]
fn the_token_of_the_leader_stays_known_whenever_it_comes_among_many() {
    let mut room = led_room(&[1]);
    let mut standby = Controller::new(600);
    standby.telemetry(room.now, room.array.shown);
    room.controllers.push(standby);
    (700..720).for_each(|other| room.announce(other, true));
    room.announce(1, true);
    (720..740).for_each(|other| room.announce(other, true));
    room.run(S);
    room.announce(1 + EPOCH_SLOTS, true);
    room.announce(1 + EPOCH_SLOTS, false);
    room.run(S);
    assert_eq!(room.standings(), [Standing::Leading, Standing::Standby]);
    room.controllers[0].is_alive = false;
    room.announce(1, false);
    assert_eq!(room.until_accepted(1), INTERVAL, "the end of the leader counts");
}

#[test]
fn of_more_tokens_than_are_kept_the_lowest_ones_are_and_that_of_the_leader() {
    let mut room = led_room(&[1, 600]);
    let leader = room.array.shown.epoch % EPOCH_SLOTS + 100 * EPOCH_SLOTS;
    room.announce(1, false);
    (50..66).rev().chain([leader, 40, 700]).for_each(|forged| room.announce(forged, true));
    let mut peers = room.controllers[1].tenure.peers().to_vec();
    peers.sort_unstable();
    assert_eq!(peers, [40].into_iter().chain(50..64).chain([leader]).collect::<Vec<_>>());
}
