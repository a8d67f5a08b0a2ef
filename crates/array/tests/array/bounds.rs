//! Bounds on the numbers of commands: no single command excludes later controllers or holds the
//! array.

use heliostat_array::bounds::{Bounds, EPOCH_MAX_WITHOUT_UTC};
use heliostat_array::moment::Moment;
use heliostat_array::rules::{Array, Limits, Refusal};
use heliostat_proto::messages::fault;
use heliostat_proto::{ArrayState, MirrorCommand, ValidityClock};

use crate::{MS, UTC, at, limits};

const UTC_MS: u64 = UTC / MS;

fn array(clock: ValidityClock) -> Array {
    Array::new(Limits { clock, ..limits(1) })
}

fn command(at: Moment, epoch: u64, sequence: u64, validity_ms: u32) -> MirrorCommand {
    MirrorCommand { epoch, sequence, answers: 1, time_ns: at.room_ns, validity_ms, roll: vec![0.1], yaw: vec![0.1] }
}

/// Sends a command that was made at the time of its arrival.
fn send(array: &mut Array, at: Moment, epoch: u64, sequence: u64) -> Result<(), Refusal> {
    array.handle_command(at, &command(at, epoch, sequence, 200))
}

#[test]
fn an_epoch_far_ahead_is_refused_and_the_controller_stays_in_control() {
    let mut array = array(ValidityClock::SourceTime);
    send(&mut array, at(0), UTC_MS, 1).unwrap();
    for epoch in [u64::MAX, u64::MAX - 1, UTC_MS + 60_002] {
        let refusal = send(&mut array, at(1), epoch, 1).unwrap_err();
        assert_eq!(refusal, Refusal::EpochBound { found: epoch, bound: UTC_MS + 60_001 });
    }
    assert_eq!((array.counters().rejected, array.followed().unwrap().epoch), (3, UTC_MS));
    send(&mut array, at(2), UTC_MS, 2).unwrap();
    send(&mut array, at(3), UTC_MS + 60_003, 1).unwrap();
}

#[test]
fn one_more_than_the_highest_epoch_is_accepted_after_the_clock_was_set_back() {
    let mut array = array(ValidityClock::SourceTime);
    let day_ms = 86_400_000;
    send(&mut array, at(day_ms), UTC_MS + day_ms, 1).unwrap();
    let back = Moment { local_ns: at(day_ms + 1).local_ns, room_ns: at(1).room_ns };
    send(&mut array, back, UTC_MS + day_ms + 1, 1).unwrap();
    assert_eq!(
        send(&mut array, back, UTC_MS, 1),
        Err(Refusal::LowerEpoch { found: UTC_MS, followed: UTC_MS + day_ms + 1 })
    );
}

#[test]
fn a_controller_with_a_fast_clock_is_a_fault_of_the_clocks_and_not_of_its_epoch() {
    let mut array = array(ValidityClock::SourceTime);
    let ahead = command(at(86_400_000), UTC_MS + 86_400_000, 1, 200);
    assert_eq!(array.handle_command(at(0), &ahead).unwrap_err().name(), "from-future");
    assert_eq!((array.faults(), array.counters().expired), (fault::CLOCK, 1));
}

#[test]
fn low_epochs_are_valid_and_so_are_epochs_of_lockstep() {
    send(&mut array(ValidityClock::SourceTime), at(0), 1, 1).unwrap();
    // In lockstep time is simulated: an epoch is a small number, or UTC in ms.
    for epoch in [1, 77, UTC_MS, EPOCH_MAX_WITHOUT_UTC] {
        let mut array = array(ValidityClock::SourceTime);
        send(&mut array, Moment::simulated(1000 * MS), epoch, 1).unwrap();
        assert_eq!(send(&mut array, Moment::simulated(1001 * MS), u64::MAX, 2).unwrap_err().name(), "epoch-bound");
        send(&mut array, Moment::simulated(1002 * MS), epoch + 1, 1).unwrap();
    }
}

#[test]
fn an_array_without_utc_bounds_the_first_epoch_and_follows_one_more_than_the_highest() {
    // The clock of this host is not set, or is wrong: neither may count.
    for wrong_clock in [Moment::simulated(0), at(0), Moment { local_ns: 0, room_ns: u64::MAX }] {
        let mut array = array(ValidityClock::Arrival);
        let bound = EPOCH_MAX_WITHOUT_UTC;
        assert_eq!(send(&mut array, wrong_clock, u64::MAX, 1), Err(Refusal::EpochBound { found: u64::MAX, bound }));
        send(&mut array, wrong_clock, bound, 1).unwrap();
        send(&mut array, wrong_clock, bound + 1, 1).unwrap();
        send(&mut array, wrong_clock, bound + 60_001, 1).unwrap();
        assert_eq!(send(&mut array, wrong_clock, bound + 120_002, 1).unwrap_err().name(), "epoch-bound");
    }
}

#[test]
fn a_sequence_far_ahead_is_refused_and_its_epoch_goes_on() {
    let step = Bounds::default().sequence_step_max;
    let mut array = array(ValidityClock::SourceTime);
    for first in [u64::MAX, step + 1] {
        let refusal = send(&mut array, at(0), UTC_MS, first).unwrap_err();
        assert_eq!(refusal, Refusal::SequenceBound { found: first, bound: step });
    }
    send(&mut array, at(0), UTC_MS, 5).unwrap();
    let refusal = send(&mut array, at(0), UTC_MS, step + 6).unwrap_err();
    assert_eq!(refusal, Refusal::SequenceBound { found: step + 6, bound: step + 5 });
    send(&mut array, at(0), UTC_MS, 6).unwrap();
    send(&mut array, at(0), UTC_MS, step + 6).unwrap();
    assert_eq!(send(&mut array, at(0), UTC_MS + 1, step + 1).unwrap_err().name(), "sequence-bound");
    assert_eq!(array.counters().rejected, 4);
}

#[test]
fn a_controller_that_was_cut_off_for_a_day_continues_its_epoch() {
    let mut array = array(ValidityClock::SourceTime);
    send(&mut array, at(0), UTC_MS, 1).unwrap();
    let day_ms = 86_400_000;
    send(&mut array, at(day_ms), UTC_MS, 1000 * 86_400).unwrap();
    assert_eq!(array.state(), ArrayState::Following);
}

#[test]
fn a_validity_beyond_the_bound_is_refused_by_either_clock() {
    for clock in [ValidityClock::SourceTime, ValidityClock::Arrival] {
        let mut array = array(clock);
        for found_ms in [u32::MAX, 10_001] {
            let refusal = array.handle_command(at(0), &command(at(0), 1, 1, found_ms)).unwrap_err();
            assert_eq!(refusal, Refusal::ValidityBound { found_ms, bound_ms: 10_000 });
        }
        assert_eq!((array.state(), array.parks_at_ns()), (ArrayState::Parked, None));
        array.handle_command(at(0), &command(at(0), 1, 1, 10_000)).unwrap();
        assert_eq!(array.parks_at_ns(), Some(10_300 * MS));
    }
}
