//! Two processes in one role, and floods.

use std::time::Duration;

use heliostat_proto::{MirrorCommand, MirrorTelemetry, UserReport};
use heliostat_tests::faults::{Array, Attacker, Effect, Launch, Setup, encoded};

use crate::{measure, wait_s};

/// Messages of a flood in Hz, fifty times the rate of the reports.
const FLOOD_HZ: f64 = 5000.0;

#[test]
fn reports_of_a_second_tracker_are_not_mixed() {
    measure("reports_of_a_second_tracker_are_not_mixed", || {
        let mut room = Setup::new(Array::Simulated).start();
        let (attacker, source) = (room.attacker(), room.witness.users().stamp.source);
        let report = room.witness.users();
        let effect = room.undergo(|_| {
            attacker.flood(&attacker.room().users(), 100.0, Duration::from_secs(3), |sequence| {
                encoded(&UserReport { stamp: Attacker::stamp(sequence), tick: 1 << 40, ..report.clone() })
            });
        });
        assert_eq!(room.witness.users().stamp.source, source);
        assert!(room.witness.telemetry().answers < 1 << 40, "a report of the second tracker was answered");
        effect
    });
}

#[test]
fn a_second_controller_and_its_end_leave_one_controller_in_charge() {
    measure("a_second_controller_and_its_end_leave_one_controller_in_charge", || {
        let mut room = Setup::new(Array::Simulated).start();
        let effect = room.undergo(|room| {
            let mut second = room.second_controller();
            wait_s(3.0);
            second.kill();
        });
        assert!(room.controller.is_running(), "{}", room.controller.errors());
        effect
    });
}

#[test]
fn a_second_driver_is_refused() {
    measure("a_second_driver_is_refused", || {
        let mut room = Setup::new(Array::Board).start();
        let config = room.folder().join("array.toml").display().to_string();
        room.undergo(|room| {
            let second = room.start_process(&Launch::default(), &["driver", "run", "--config", &config]).wait();
            assert!(second.refusal().contains("another driver is in room"), "{}", second.errors);
        })
    });
}

/// The effect of payloads on one key at a high rate.
fn flood(key: fn(&Attacker) -> String, payload: impl Fn(u64) -> Vec<u8>, room: Setup) -> Effect {
    let mut room = room.start();
    let attacker = room.attacker();
    room.undergo(|_| {
        let sent = attacker.flood(&key(&attacker), FLOOD_HZ, Duration::from_secs(3), payload);
        println!("{sent} payloads sent");
    })
}

#[test]
fn a_flood_of_user_reports_is_survived() {
    let payload = |sequence| encoded(&UserReport { stamp: Attacker::stamp(sequence), ..UserReport::default() });
    measure("a_flood_of_user_reports_is_survived", || {
        flood(|attacker| attacker.room().users(), payload, Setup::new(Array::Simulated))
    });
}

#[test]
fn a_flood_of_commands_is_survived() {
    let angles = vec![0.0; 100];
    let payload = |sequence| {
        let (roll, yaw) = (angles.clone(), angles.clone());
        encoded(&MirrorCommand { epoch: 1, sequence, roll, yaw, ..MirrorCommand::default() })
    };
    measure("a_flood_of_commands_is_survived", || {
        flood(|attacker| attacker.room().command(), payload, Setup::new(Array::Simulated))
    });
}

#[test]
fn a_flood_of_telemetry_is_survived() {
    let payload =
        |sequence| encoded(&MirrorTelemetry { stamp: Attacker::stamp(sequence), ..MirrorTelemetry::default() });
    measure("a_flood_of_telemetry_is_survived", || {
        flood(|attacker| attacker.room().telemetry(), payload, Setup::new(Array::Simulated))
    });
}

#[test]
fn a_flood_of_invalid_stops_is_survived() {
    measure("a_flood_of_invalid_stops_is_survived", || {
        flood(|attacker| attacker.room().stop(), |_| vec![1, 9, 1], Setup::new(Array::Simulated))
    });
}
