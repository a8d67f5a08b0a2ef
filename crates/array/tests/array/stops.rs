//! The emergency stop of an array: every stop is obeyed, and each can be released.

use heliostat_array::latch::{Latch, LatchedStop};
use heliostat_array::rules::{Array, Limits, RearmRefusal, Refusal};
use heliostat_proto::{ArrayState, EmergencyStop, MirrorCommand, Rearm, Stamp, StopAction, StopName, StopRepetition};

use crate::{MS, UTC, at, limits};

const HOUR_MS: u64 = 3_600_000;

fn array() -> Array {
    let mut array = Array::new(Limits { park_rad: [0.25, 0.0], ..limits(1) });
    array.handle_command(at(0), &command(1, 0)).unwrap();
    array
}

fn command(sequence: u64, ms: u64) -> MirrorCommand {
    let angle = vec![0.1];
    let time_ns = at(ms).room_ns;
    MirrorCommand { epoch: 1, sequence, time_ns, validity_ms: 200, roll: angle.clone(), yaw: angle, answers: 7 }
}

fn order(action: StopAction, sequence: u64, at_ms: u64) -> EmergencyStop {
    let stamp = Stamp { source: 5, sequence, time_ns: at(at_ms).room_ns };
    EmergencyStop { stamp, action, operator: "ann".into(), reason: "test".into() }
}

fn rearm(stop_source: u64, stop_sequence: u64) -> Rearm {
    Rearm { stop_source, stop_sequence, ..Rearm::default() }
}

#[test]
fn a_stop_is_latched_until_a_later_rearm() {
    let mut array = array();
    array.handle_stop(at(100), &order(StopAction::Stop, 1, 100)).unwrap();
    array.handle_stop(at(100), &order(StopAction::Stop, 2, 90)).unwrap();
    assert_eq!(array.handle_command(at(101), &command(2, 101)), Err(Refusal::Stopped));
    assert_eq!((array.counters().stopped, array.followed().unwrap().epoch), (1, 1));
    assert!(!array.advance(10_000 * MS), "a stopped array does not park");
    for early in [90, 99, 100] {
        let refusal = array.handle_stop(at(101), &order(StopAction::Rearm, 3, early)).unwrap_err();
        let (found_ns, stopped_ns) = (at(early).room_ns, at(100).room_ns);
        assert_eq!(refusal, RearmRefusal::TooEarly { found_ns, stopped_ns });
        assert_eq!(array.state(), ArrayState::Stopped);
    }
    array.handle_stop(at(101), &order(StopAction::Rearm, 4, 101)).unwrap();
    assert_eq!((array.state(), array.target().roll[0]), (ArrayState::Parked, 0.25));
    array.handle_command(at(102), &command(2, 102)).unwrap();
    assert_eq!(array.state(), ArrayState::Following);
}

#[test]
fn a_stop_from_a_clock_one_hour_ahead_is_released_by_a_rearm_of_either_kind() {
    for named in [false, true] {
        let mut array = array();
        array.handle_stop(at(100), &order(StopAction::Stop, 1, HOUR_MS)).unwrap();
        assert_eq!(array.state(), ArrayState::Stopped);
        assert_eq!(array.latch().stop().unwrap().arrived_ns, at(100).room_ns);
        match named {
            true => array.handle_rearm(&rearm(5, 1)).unwrap(),
            false => array.handle_stop(at(200), &order(StopAction::Rearm, 1, 200)).unwrap(),
        }
        assert_eq!(array.state(), ArrayState::Parked);
    }
    let mut array = array();
    array.handle_stop(at(100), &order(StopAction::Stop, 1, u64::MAX / MS - UTC / MS - 1)).unwrap();
    array.handle_stop(at(101), &order(StopAction::Rearm, 1, 101)).unwrap();
    assert_eq!(array.state(), ArrayState::Parked);
}

#[test]
fn a_named_rearm_releases_its_stop_and_no_other() {
    let mut array = array();
    assert_eq!(array.handle_rearm(&rearm(5, 1)), Err(RearmRefusal::NotStopped));
    array.handle_stop(at(1), &order(StopAction::Stop, 1, 1)).unwrap();
    array.handle_stop(at(2), &order(StopAction::Stop, 2, 2)).unwrap();
    for (found_source, found_sequence) in [(5, 1), (5, 3), (4, 2), (0, 0)] {
        let refusal = array.handle_rearm(&rearm(found_source, found_sequence)).unwrap_err();
        let found = StopName { source: found_source, sequence: found_sequence };
        assert_eq!(refusal, RearmRefusal::OtherStop { found, latest: StopName { source: 5, sequence: 2 } });
        assert_eq!((refusal.name(), array.state()), ("other-stop", ArrayState::Stopped));
    }
    array.handle_rearm(&rearm(5, 2)).unwrap();
    assert_eq!(array.state(), ArrayState::Parked);
    assert_eq!(array.handle_rearm(&rearm(5, 2)), Ok(()), "a repeated re-arm is no problem");
}

#[test]
fn a_latch_that_is_kept_over_a_restart_stops_the_next_array() {
    let mut before = array();
    before.handle_stop(at(100), &order(StopAction::Stop, 9, HOUR_MS)).unwrap();
    let kept = Latch::parse(&before.latch().to_toml()).unwrap();
    let mut after = array();
    after.stop(kept.stop().unwrap().clone().restored(at(50).room_ns));
    assert_eq!((after.state(), after.target()), (ArrayState::Stopped, array().target()));
    assert_eq!(after.handle_command(at(101), &command(2, 101)), Err(Refusal::Stopped));
    // The clock was set back by 50 ms in between, which delays no re-arm.
    let mut by_time = after.clone();
    by_time.handle_stop(at(60), &order(StopAction::Rearm, 1, 60)).unwrap();
    after.handle_rearm(&rearm(5, 9)).unwrap();
    assert_eq!((by_time.state(), after.state()), (ArrayState::Parked, ArrayState::Parked));
}

#[test]
fn a_stop_without_sender_is_named_by_zeros() {
    let mut array = array();
    array.stop(LatchedStop::without_sender("the last state is unknown", at(1).room_ns));
    array.handle_rearm(&rearm(0, 0)).unwrap();
    assert_eq!(array.state(), ArrayState::Parked);
}

fn repetition(stop_source: u64, stop_sequence: u64) -> StopRepetition {
    StopRepetition { stop_source, stop_sequence, ..StopRepetition::default() }
}

#[test]
fn the_stops_of_two_operators_are_released_one_by_one() {
    let mut array = array();
    array.handle_stop(at(1), &order(StopAction::Stop, 1, 1)).unwrap();
    let stamp = Stamp { source: 6, ..order(StopAction::Stop, 1, 2).stamp };
    array.handle_stop(at(2), &EmergencyStop { stamp, ..order(StopAction::Stop, 1, 2) }).unwrap();
    array.handle_rearm(&rearm(6, 1)).unwrap();
    assert_eq!(array.state(), ArrayState::Stopped, "the first stop is in force");
    assert_eq!(array.latch().stop().map(|stop| stop.source), Some(5));
    array.handle_rearm(&rearm(5, 1)).unwrap();
    assert_eq!(array.state(), ArrayState::Parked);
}

#[test]
fn a_repetition_stops_an_array_that_does_not_know_of_the_stop_and_no_other() {
    let mut array = array();
    assert!(array.handle_repetition(at(1), &repetition(5, 1)));
    assert_eq!(array.state(), ArrayState::Stopped);
    assert!(!array.handle_repetition(at(2), &repetition(5, 1)), "it is latched");
    array.handle_stop(at(3), &order(StopAction::Stop, 2, 3)).unwrap();
    assert!(!array.handle_repetition(at(4), &repetition(5, 1)), "a later stop of the same sender is latched");
    array.handle_rearm(&rearm(5, 2)).unwrap();
    assert!(!array.handle_repetition(at(5), &repetition(5, 2)), "it was released here");
    assert!(!array.handle_repetition(at(5), &repetition(5, 1)), "a later stop of the same sender was released here");
    assert_eq!(array.state(), ArrayState::Parked);
    array.handle_stop(at(6), &order(StopAction::Stop, 2, 6)).unwrap();
    assert_eq!(array.state(), ArrayState::Stopped, "a stop is obeyed, whatever its name");
}
