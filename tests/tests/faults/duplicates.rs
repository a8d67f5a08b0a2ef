//! Two processes in one role, and floods.

use std::time::Duration;

use heliostat_proto::{MirrorCommand, MirrorTelemetry, UserReport};
use heliostat_tests::encoded;
use heliostat_tests::faults::{Array, Attacker, Effect, Launch, Setup};

use crate::measure;

/// Messages of a flood in Hz, fifty times the rate of the reports.
const FLOOD_HZ: f64 = 5000.0;

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
