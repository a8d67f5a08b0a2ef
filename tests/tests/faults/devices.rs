//! Mirrors and boards that do not answer, and policies that are too slow.

use std::time::Duration;

use heliostat_proto::{ArrayState, ControllerControl, FaultKind, MirrorFault, SimulatorControl};
use heliostat_tests::faults::{Array, Attacker, Behaviour, Effect, Setup};

use crate::{measure, wait_s};

/// The effect of a fault of the simulated array that lasts for some seconds.
fn fault_of_the_array(fault: FaultKind, seconds: f32, ends_itself: bool) -> Effect {
    let mut room = Setup::new(Array::Simulated).start();
    let operator = room.attacker();
    let order = |sequence, seconds| {
        let faults = vec![MirrorFault { fault, seconds, ..MirrorFault::default() }];
        let order = SimulatorControl { stamp: Attacker::stamp(sequence), faults, ..SimulatorControl::default() };
        operator.publish(&operator.room().simulator_control(), &order);
    };
    room.undergo(|_| {
        order(1, seconds);
        wait_s(if ends_itself { f64::from(seconds) } else { 3.0 });
        if !ends_itself {
            order(2, 0.0);
        }
    })
}

#[test]
fn the_array_follows_again_after_it_was_offline() {
    measure("the_array_follows_again_after_it_was_offline", || fault_of_the_array(FaultKind::Offline, 2.0, true));
}

#[test]
fn the_array_follows_again_after_its_reboot() {
    measure("the_array_follows_again_after_its_reboot", || fault_of_the_array(FaultKind::Reboot, 2.0, true));
}

#[test]
fn late_mirrors_do_not_end_the_commands() {
    measure("late_mirrors_do_not_end_the_commands", || fault_of_the_array(FaultKind::Late, 1.0, false));
}

/// The effect of a board that behaves differently for 3 s; its mirrors must turn again.
fn behaviour_of_the_board(behaviour: Behaviour) -> Effect {
    let mut room = Setup::new(Array::Board).start();
    let mut effect = room.undergo(|room| {
        room.board().longest_pause();
        room.board().behave(behaviour);
        wait_s(3.0);
        room.board().behave(Behaviour::Prompt);
    });
    // Telemetry gives the arrival of a command, and the board the time at which mirrors turn.
    effect.gap_ms = 1e3 * room.board().longest_pause().as_secs_f64();
    effect
}

#[test]
fn a_slow_board_does_not_end_the_commands() {
    measure("a_slow_board_does_not_end_the_commands", || {
        behaviour_of_the_board(Behaviour::Slow(Duration::from_millis(300)))
    });
}

#[test]
fn a_silent_board_is_used_again() {
    measure("a_silent_board_is_used_again", || behaviour_of_the_board(Behaviour::Silent));
}

#[test]
fn a_board_that_disconnects_is_reported_and_used_again() {
    measure("a_board_that_disconnects_is_reported_and_used_again", || {
        let effect = behaviour_of_the_board(Behaviour::Absent);
        assert!(effect.states.contains(&ArrayState::Fault), "{effect:?}");
        effect
    });
}

#[test]
fn a_policy_slower_than_the_reports_does_not_end_the_commands() {
    measure("a_policy_slower_than_the_reports_does_not_end_the_commands", || {
        let mut room = Setup::new(Array::Simulated).start();
        let operator = room.attacker();
        let switch = |sequence, policy: &str| {
            let order = ControllerControl { stamp: Attacker::stamp(sequence), policy: policy.to_owned() };
            operator.publish(&operator.room().controller_control(), &order);
        };
        room.undergo(|_| {
            switch(1, "oracle");
            wait_s(3.0);
            switch(2, "nearest");
        })
    });
}
