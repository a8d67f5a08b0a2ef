//! Emergency stops of foreign senders, and their release.

use heliostat_proto::{ArrayState, EmergencyStop, Rearm, SafetyReport, StopAction};
use heliostat_tests::faults::{Array, Attacker, FaultRoom, Setup};
use heliostat_tests::wait_until;

use crate::{measure, wait_s};

/// Stops the array, and waits until it is stopped.
fn stop(room: &FaultRoom, operator: &Attacker) {
    let stop = EmergencyStop { stamp: Attacker::stamp(7), action: StopAction::Stop, ..EmergencyStop::default() };
    operator.publish(&operator.room().stop(), &stop);
    room.wait_for_state(ArrayState::Stopped);
    let accepted = room.witness.telemetry().counters.accepted;
    wait_s(1.0);
    assert_eq!(room.witness.telemetry().counters.accepted, accepted, "a stopped array accepts no command");
}

/// The release of the stop in force, as the safety report names it.
fn rearm_for(room: &FaultRoom) -> Rearm {
    // A driver that was killed has published reports too.
    let source = room.witness.telemetry().stamp.source;
    let stopped = || room.witness.safety().filter(|safety| safety.stopped && safety.stamp.source == source);
    wait_until("a safety report of the stop", || stopped().is_some());
    naming(&stopped().expect("received"))
}

/// The re-arm of the stop in a safety report.
fn naming(safety: &SafetyReport) -> Rearm {
    let (stop_source, stop_sequence) = (safety.stop_source, safety.stop_sequence);
    Rearm { stamp: Attacker::stamp(1), stop_source, stop_sequence, ..Rearm::default() }
}

/// Releases the stop in force.
fn rearm(room: &FaultRoom, operator: &Attacker) {
    operator.publish(&operator.room().rearm(), &rearm_for(room));
}

#[test]
fn a_stop_of_any_sender_is_obeyed_until_its_re_arm() {
    measure("a_stop_of_any_sender_is_obeyed_until_its_re_arm", || {
        let mut room = Setup::new(Array::Simulated).start();
        let operator = room.attacker();
        room.undergo(|room| {
            stop(room, &operator);
            rearm(room, &operator);
        })
    });
}
