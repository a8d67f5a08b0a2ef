//! The rules of an array, one by one.

use heliostat_array::rules::{Array, Limits, Refusal};
use heliostat_proto::messages::fault;
use heliostat_proto::{ArrayState, CLOCK_LEAD_MAX_NS, MirrorCommand, ValidityClock};

use crate::{MS, at, limits};

fn array() -> Array {
    Array::new(limits(2))
}

fn command(epoch: u64, sequence: u64, made_at_ms: u64) -> MirrorCommand {
    MirrorCommand {
        epoch,
        sequence,
        answers: 7,
        time_ns: at(made_at_ms).room_ns,
        validity_ms: 200,
        roll: vec![0.1, 0.2],
        yaw: vec![-0.1, -0.2],
    }
}

#[test]
fn follows_holds_and_parks() {
    let mut array = array();
    assert_eq!((array.state(), array.parks_at_ns()), (ArrayState::Parked, None));
    array.handle_command(at(10), &command(1, 1, 5)).unwrap();
    assert_eq!(array.state(), ArrayState::Following);
    assert!((array.target().roll[1] - 0.2).abs() < 1e-7 && (array.target().yaw[0] + 0.1).abs() < 1e-7);
    // 200 ms from the time at which the command was made.
    assert!(!array.advance(204 * MS));
    assert_eq!(array.state(), ArrayState::Following);
    assert!(!array.advance(205 * MS));
    assert_eq!(array.state(), ArrayState::Holding);
    assert!(array.target().roll[1] > 0.0, "the last command is held");
    let parks_at = array.parks_at_ns().unwrap();
    assert_eq!(parks_at, 205 * MS + 300 * MS);
    assert!(!array.advance(parks_at - 1));
    assert!(array.advance(parks_at), "the array parks");
    assert_eq!(array.state(), ArrayState::Parked);
    assert!(array.target().roll.iter().chain(&array.target().yaw).all(|angle| *angle == 0.0));
    assert!(!array.advance(parks_at + 1), "and parks once");
    assert_eq!(array.followed().unwrap().answers, 7);
}

#[test]
fn a_command_after_the_end_of_validity_is_followed_and_counted_as_late() {
    let mut array = array();
    array.handle_command(at(0), &command(1, 1, 0)).unwrap();
    array.handle_command(at(100), &command(1, 2, 100)).unwrap();
    assert_eq!(array.counters().late, 0);
    array.handle_command(at(301), &command(1, 3, 300)).unwrap();
    assert_eq!((array.counters().late, array.counters().accepted), (1, 3));
    assert_eq!(array.state(), ArrayState::Following);
}

#[test]
fn every_refusal_has_a_name_and_does_not_change_the_array() {
    let mut array = array();
    array.handle_command(at(1000), &command(5, 10, 1000)).unwrap();
    let before = (array.target().clone(), array.parks_at_ns(), *array.followed().unwrap());
    let with = |change: fn(&mut MirrorCommand)| {
        let mut command = command(5, 11, 1000);
        change(&mut command);
        command
    };
    let cases = [
        ("wrong-mirror-count", with(|c| c.roll.push(0.0))),
        ("wrong-mirror-count", with(|c| c.yaw.clear())),
        ("not-finite", with(|c| c.roll[1] = f32::NAN)),
        ("not-finite", with(|c| c.yaw[0] = f32::INFINITY)),
        ("lower-epoch", with(|c| c.epoch = 4)),
        ("old-sequence", with(|c| c.sequence = 10)),
        ("old-sequence", with(|c| c.sequence = 9)),
        ("expired", with(|c| c.time_ns -= 200 * MS)),
        ("expired", with(|c| c.validity_ms = 0)),
        ("from-future", with(|c| c.time_ns += CLOCK_LEAD_MAX_NS + 2 * MS)),
    ];
    for (name, command) in &cases {
        assert_eq!(array.handle_command(at(1001), command).unwrap_err().name(), *name, "{command:?}");
        assert_eq!(before, (array.target().clone(), array.parks_at_ns(), *array.followed().unwrap()), "{name}");
    }
    let counters = *array.counters();
    assert_eq!((counters.rejected, counters.old_epoch, counters.old_sequence, counters.expired), (4, 1, 2, 3));
    assert_eq!((counters.refused(), counters.accepted), (10, 1));
    array.count_malformed();
    assert_eq!(array.counters().rejected, 5);
    assert_eq!(array.faults(), fault::CLOCK, "a command from the future is a fault of the clocks");
    array.handle_command(at(1001), &with(|_| {})).unwrap();
    assert_eq!(array.faults(), 0);
}

#[test]
fn a_higher_epoch_takes_over_with_any_sequence_and_the_lower_one_is_refused() {
    let mut array = array();
    array.handle_command(at(0), &command(1, 900, 0)).unwrap();
    array.handle_command(at(1), &command(2, 1, 1)).unwrap();
    assert_eq!(array.handle_command(at(2), &command(1, 901, 2)), Err(Refusal::LowerEpoch { found: 1, followed: 2 }));
}

#[test]
fn angles_beyond_the_range_are_clamped_and_counted_once_per_command() {
    let mut array = array();
    let mut wide = command(1, 1, 0);
    wide.roll = vec![3.0, -3.0];
    wide.yaw = vec![0.5, -0.5];
    array.handle_command(at(0), &wide).unwrap();
    assert_eq!((array.target().roll.as_slice(), array.counters().clipped), ([0.5, -0.5].as_slice(), 1));
    let mut edge = command(1, 2, 0);
    edge.yaw = vec![0.5, -0.5];
    array.handle_command(at(0), &edge).unwrap();
    assert_eq!(array.counters().clipped, 1, "the edge of the range is within it");
}

#[test]
fn a_sender_with_a_clock_ahead_does_not_delay_parking() {
    let mut array = array();
    array.handle_command(at(0), &command(1, 1, 40)).unwrap();
    assert_eq!(array.parks_at_ns(), Some(200 * MS + 300 * MS));
}

#[test]
fn without_a_clock_validity_counts_from_arrival() {
    let mut limits = *array().limits();
    limits.clock = ValidityClock::Arrival;
    let mut array = Array::new(limits);
    array.handle_command(at(60_000), &command(1, 1, 0)).unwrap();
    array.handle_command(at(60_001), &command(1, 2, 200_000)).unwrap();
    assert_eq!(array.parks_at_ns(), Some(60_201 * MS + 300 * MS));
}

#[test]
fn a_command_whose_validity_ends_while_it_waits_is_refused_with_either_clock() {
    for clock in [ValidityClock::SourceTime, ValidityClock::Arrival] {
        let mut array = Array::new(Limits { clock, ..*array().limits() });
        let waiting = command(1, 1, 0);
        let validity_ms = u64::from(waiting.validity_ms);
        let refusal = array.handle_waiting_command((at(0), at(validity_ms)), &waiting).unwrap_err();
        assert_eq!((refusal.name(), array.state()), ("expired", ArrayState::Parked), "{clock:?}");
        array.handle_waiting_command((at(0), at(validity_ms - 1)), &waiting).unwrap();
        assert_eq!(array.changes_at_ns(), Some(validity_ms * MS), "{clock:?}");
        assert_eq!(array.followed().map(|followed| followed.received), Some(at(0)), "{clock:?}");
    }
}
