//! Processes that are frozen, killed or ended.

use heliostat_tests::Process;
use heliostat_tests::faults::{Array, Effect, Launch, Setup};

use crate::{freeze, measure, wait_s};

#[test]
fn the_array_parks_while_the_controller_is_frozen() {
    measure("the_array_parks_while_the_controller_is_frozen", || {
        Setup::new(Array::Simulated).start().undergo(|room| freeze(&room.controller, 3.0))
    });
}

#[test]
fn a_killed_controller_is_replaced_by_the_next() {
    measure("a_killed_controller_is_replaced_by_the_next", || {
        Setup::new(Array::Simulated).start().undergo(|room| {
            room.controller.kill();
            room.restart_controller();
        })
    });
}

#[test]
fn a_controller_ended_by_sigterm_is_replaced_by_the_next() {
    measure("a_controller_ended_by_sigterm_is_replaced_by_the_next", || {
        Setup::new(Array::Simulated).start().undergo(|room| {
            let summary = room.end_controller().json();
            assert!(summary["commands"].as_u64() > Some(0), "{summary}");
            room.restart_controller();
        })
    });
}

#[test]
fn a_killed_simulator_is_served_again_after_its_restart() {
    measure("a_killed_simulator_is_served_again_after_its_restart", || {
        Setup::new(Array::Simulated).start().undergo(|room| {
            room.array.kill();
            room.restart_array();
        })
    });
}

#[test]
fn a_killed_driver_follows_again_after_its_restart() {
    measure("a_killed_driver_follows_again_after_its_restart", || {
        Setup::new(Array::Board).start().undergo(|room| {
            room.array.kill();
            room.restart_array();
        })
    });
}

/// The effect of what happens to a number of viewers.
fn with_viewers(count: usize, arguments: &[&str], fault: impl FnOnce(&mut [Process])) -> Effect {
    let mut room = Setup::new(Array::Simulated).start();
    let file = |number| room.folder().join(format!("{number}.mcap")).display().to_string();
    let files: Vec<String> = (0..count).map(file).collect();
    let mut viewers: Vec<Process> = files
        .iter()
        .map(|file| {
            let named: Vec<&str> = arguments.iter().map(|word| if *word == "FILE" { file } else { *word }).collect();
            room.start_process(&Launch::default(), &named)
        })
        .collect();
    // Until they have joined the room.
    wait_s(1.5);
    assert!(viewers.iter_mut().all(Process::is_running), "{}", viewers[0].errors());
    room.undergo(|_| fault(&mut viewers))
}

#[test]
fn a_frozen_recorder_does_not_disturb_the_room() {
    measure("a_frozen_recorder_does_not_disturb_the_room", || {
        with_viewers(1, &["record", "--out", "FILE"], |viewers| {
            freeze(&viewers[0], 3.0);
        })
    });
}

#[test]
fn a_killed_recorder_does_not_disturb_the_room() {
    measure("a_killed_recorder_does_not_disturb_the_room", || {
        with_viewers(1, &["record", "--out", "FILE"], |viewers| {
            viewers[0].kill();
            wait_s(1.0);
        })
    });
}

#[test]
fn a_killed_viewer_does_not_disturb_the_room() {
    measure("a_killed_viewer_does_not_disturb_the_room", || {
        with_viewers(1, &["ui", "--plain", "--no-ui"], |viewers| {
            viewers[0].kill();
            wait_s(1.0);
        })
    });
}

#[test]
fn three_frozen_viewers_do_not_disturb_the_room() {
    measure("three_frozen_viewers_do_not_disturb_the_room", || {
        with_viewers(3, &["record", "--out", "FILE"], |viewers| {
            viewers.iter().for_each(|viewer| viewer.signal("STOP"));
            wait_s(8.0);
            viewers.iter().for_each(|viewer| viewer.signal("CONT"));
        })
    });
}
