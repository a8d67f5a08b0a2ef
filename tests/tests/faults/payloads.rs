//! Payloads that no process of the room would publish.

use heliostat_proto::{
    Calibration, ChannelReport, ControllerControl, EmergencyStop, LedReport, NodeKind, ObstacleReport,
    OrientationReport, Rearm, SafetyReport, SimulatorControl,
};
use heliostat_tests::encoded;
use heliostat_tests::faults::{Array, Attacker, Effect, FaultRoom, Setup};
use heliostat_tests::wait_until;

use crate::{measure, wait_s};

/// Lets an attacker act on a simulated room for a second.
fn attack(act: impl Fn(&FaultRoom, &Attacker)) -> (FaultRoom, Effect) {
    let mut room = Setup::new(Array::Simulated).start();
    let attacker = room.attacker();
    let effect = room.undergo(|room| {
        act(room, &attacker);
        wait_s(1.0);
    });
    (room, effect)
}

/// A valid payload for each key that a process of the room subscribes to.
fn valid_payloads(room: &FaultRoom) -> Vec<(String, Vec<u8>)> {
    let keys = room.witness.room();
    let stamp = Attacker::stamp(1);
    vec![
        (keys.users(), encoded(&room.witness.users())),
        (keys.channel(), encoded(&ChannelReport { stamp, ..ChannelReport::default() })),
        (keys.obstacles(), encoded(&ObstacleReport { stamp, ..ObstacleReport::default() })),
        (keys.orientation(), encoded(&OrientationReport { stamp, ..OrientationReport::default() })),
        (keys.leds(), encoded(&LedReport { stamp, ..LedReport::default() })),
        (keys.command(), encoded(&room.witness.command())),
        (keys.telemetry(), encoded(&room.witness.telemetry())),
        (keys.capabilities(), encoded(&room.witness.capabilities())),
        (keys.stop(), encoded(&EmergencyStop { stamp, ..EmergencyStop::default() })),
        (keys.rearm(), encoded(&Rearm { stamp, ..Rearm::default() })),
        (keys.safety(), encoded(&SafetyReport { stamp, ..SafetyReport::default() })),
        (keys.calibration(), encoded(&Calibration { stamp, ..Calibration::default() })),
        (keys.simulator_control(), encoded(&SimulatorControl { stamp, ..SimulatorControl::default() })),
        (keys.controller_control(), encoded(&ControllerControl { stamp, policy: "flat".to_owned() })),
    ]
}

/// The effect of invalid variants of the payloads on every key.
fn invalid_on_every_key(count: usize, change: fn(Vec<u8>) -> Vec<u8>) -> Effect {
    let (_, effect) = attack(|room, attacker| {
        for (key, valid) in valid_payloads(room) {
            attacker.publish_payloads(&key, &vec![change(valid); count]);
        }
    });
    effect
}

#[test]
fn wrong_versions_on_every_key_are_refused() {
    measure("wrong_versions_on_every_key_are_refused", || {
        invalid_on_every_key(100, |mut payload| {
            payload[0] = 9;
            payload
        })
    });
}

#[test]
fn truncated_payloads_on_every_key_are_refused() {
    measure("truncated_payloads_on_every_key_are_refused", || {
        invalid_on_every_key(100, |mut payload| {
            payload.pop();
            payload
        })
    });
}

#[test]
fn oversized_payloads_on_every_key_are_refused() {
    measure("oversized_payloads_on_every_key_are_refused", || {
        invalid_on_every_key(3, |mut payload| {
            payload.resize(2 << 20, 0);
            payload
        })
    });
}

#[test]
fn a_calibration_with_a_vanishing_gain_is_refused() {
    measure("a_calibration_with_a_vanishing_gain_is_refused", || {
        let (room, effect) = attack(|room, attacker| {
            let mirrors = room.witness.telemetry().roll_commanded.len();
            let (offsets, gains) = (vec![0.0; mirrors], vec![1e-38; mirrors]);
            let forged = Calibration {
                stamp: Attacker::stamp(1),
                roll_offset_rad: offsets.clone(),
                roll_gain: gains.clone(),
                yaw_offset_rad: offsets,
                yaw_gain: gains,
            };
            attacker.publish(&attacker.room().calibration(), &forged);
        });
        assert_eq!(room.witness.telemetry().calibration, 0, "the calibration is in use: {effect:?}");
        effect
    });
}

#[test]
fn wild_values_of_an_operator_are_refused_by_the_simulator() {
    measure("wild_values_of_an_operator_are_refused_by_the_simulator", || {
        let (_, effect) = attack(|_, attacker| {
            let stamp = Attacker::stamp(1);
            let fast = SimulatorControl { stamp, speed_m_s: Some([1e9, 1e9]), ..SimulatorControl::default() };
            let bright = SimulatorControl { stamp, power_w: Some(3e38), ..SimulatorControl::default() };
            for order in [fast, bright] {
                attacker.publish(&attacker.room().simulator_control(), &order);
            }
        });
        effect
    });
}

#[test]
fn an_unknown_policy_is_refused_by_the_controller() {
    measure("an_unknown_policy_is_refused_by_the_controller", || {
        let (room, effect) = attack(|_, attacker| {
            for sequence in 1..=10 {
                let order = ControllerControl { stamp: Attacker::stamp(sequence), policy: "clairvoyant".to_owned() };
                attacker.publish(&attacker.room().controller_control(), &order);
            }
        });
        wait_until("a refusal", || room.witness.counter(NodeKind::Controller, "policies_refused") > 0);
        effect
    });
}
