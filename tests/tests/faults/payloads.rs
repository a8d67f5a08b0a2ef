//! Payloads that no process of the room would publish.

use heliostat_proto::{
    ArrayState, Calibration, Capabilities, ChannelReport, ControllerControl, EmergencyStop, LedReport, MirrorCommand,
    MirrorTelemetry, NodeKind, ObstacleReport, OrientationReport, Rearm, SafetyReport, SimulatorControl, Stamp,
    UserChannel, UserReport,
};
use heliostat_service::clock::utc_ns;
use heliostat_tests::faults::{Array, Attacker, Effect, FaultRoom, Setup, encoded};

use crate::{measure, wait_s};

/// A number that occurs in a payload once, to be replaced by NaN.
const MARK: f32 = 0.123_456_79;

/// 10 s, far more than the age at which a report is stale.
const STALE_NS: u64 = 10_000_000_000;

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
fn reports_and_commands_with_a_nan_are_refused() {
    let with_nan = |mut payload: Vec<u8>| {
        let at = payload.windows(4).position(|bytes| bytes == MARK.to_le_bytes()).expect("the mark is there");
        payload[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
        vec![payload; 100]
    };
    measure("reports_and_commands_with_a_nan_are_refused", || {
        let (room, effect) = attack(|room, attacker| {
            let keys = attacker.room();
            let (mut users, mut command) = (room.witness.users(), room.witness.command());
            users.users[0].position_m[0] = MARK;
            command.yaw[0] = MARK;
            let gains = UserChannel { los_gain: MARK, ..UserChannel::default() };
            let channel = ChannelReport { stamp: users.stamp, tick: users.tick, users: vec![gains; 5] };
            attacker.publish_payloads(&keys.users(), &with_nan(encoded(&users)));
            attacker.publish_payloads(&keys.channel(), &with_nan(encoded(&channel)));
            attacker.publish_payloads(&keys.command(), &with_nan(encoded(&command)));
        });
        for stream in ["users", "channel"] {
            let counter = format!("refused:{stream}:not-finite");
            assert!(room.witness.counter(NodeKind::Controller, &counter) >= 100, "{counter}: {effect:?}");
        }
        effect
    });
}

/// The effect of changed copies of the newest user report.
fn users(count: u64, change: impl Fn(&mut UserReport, u64)) -> (FaultRoom, Effect) {
    attack(|room, attacker| {
        let copy = |number| {
            let mut report = room.witness.users();
            change(&mut report, number);
            encoded(&report)
        };
        attacker.publish_payloads(&attacker.room().users(), &(1..=count).map(copy).collect::<Vec<_>>());
    })
}

#[test]
fn stale_reports_of_the_tracker_are_refused() {
    measure("stale_reports_of_the_tracker_are_refused", || {
        let (room, effect) = users(100, |report, number| {
            // Ahead of the reports that the tracker publishes meanwhile.
            report.stamp.sequence += 1000 + number;
            report.stamp.time_ns -= STALE_NS;
        });
        assert!(room.witness.counter(NodeKind::Controller, "refused:users:stale") >= 100, "{effect:?}");
        effect
    });
}

#[test]
fn stale_reports_of_a_foreign_source_are_not_answered() {
    measure("stale_reports_of_a_foreign_source_are_not_answered", || {
        let (room, effect) = users(100, |report, number| {
            report.stamp = Stamp { time_ns: utc_ns() - STALE_NS, ..Attacker::stamp(number) };
        });
        let answered = room.witness.counter(NodeKind::Controller, "fallback:stale-report");
        assert_eq!(answered, 0, "{effect:?}");
        effect
    });
}

#[test]
fn a_user_report_with_the_last_sequence_does_not_darken_the_room() {
    measure("a_user_report_with_the_last_sequence_does_not_darken_the_room", || {
        users(1, |report, _| report.stamp.sequence = u64::MAX).1
    });
}

/// The effect of a changed copy of the newest telemetry.
fn telemetry(change: fn(&mut MirrorTelemetry)) -> Effect {
    let (_, effect) = attack(|room, attacker| {
        let mut telemetry = room.witness.telemetry();
        telemetry.stamp.time_ns = utc_ns();
        change(&mut telemetry);
        attacker.publish(&attacker.room().telemetry(), &telemetry);
    });
    effect
}

#[test]
fn telemetry_with_the_last_sequence_is_refused() {
    measure("telemetry_with_the_last_sequence_is_refused", || {
        telemetry(|telemetry| {
            telemetry.stamp.sequence = u64::MAX;
            telemetry.state = ArrayState::Stopped;
        })
    });
}

#[test]
fn foreign_telemetry_with_the_last_epoch_is_refused() {
    measure("foreign_telemetry_with_the_last_epoch_is_refused", || {
        telemetry(|telemetry| {
            telemetry.stamp = Attacker::stamp(1);
            telemetry.epoch = u64::MAX;
        })
    });
}

/// The effect of a forged command: the newest one with a change.
fn command(change: fn(&mut MirrorCommand)) -> Effect {
    let (_, effect) = attack(|room, attacker| {
        let mut command = room.witness.command();
        command.time_ns = utc_ns();
        change(&mut command);
        attacker.publish(&attacker.room().command(), &command);
    });
    effect
}

#[test]
fn a_command_with_the_last_epoch_is_refused() {
    measure("a_command_with_the_last_epoch_is_refused", || command(|command| command.epoch = u64::MAX));
}

#[test]
fn a_command_with_the_last_sequence_is_refused() {
    measure("a_command_with_the_last_sequence_is_refused", || command(|command| command.sequence = u64::MAX));
}

#[test]
fn a_controller_locked_out_by_a_sequence_takes_a_new_epoch() {
    measure("a_controller_locked_out_by_a_sequence_takes_a_new_epoch", || {
        command(|command| command.sequence += 900_000)
    });
}

#[test]
fn a_command_that_claims_to_be_valid_for_49_days_does_not_keep_the_array() {
    measure("a_command_that_claims_to_be_valid_for_49_days_does_not_keep_the_array", || {
        let mut room = Setup::new(Array::Simulated).start();
        let attacker = room.attacker();
        room.undergo(|room| {
            room.controller.signal("STOP");
            wait_s(0.1);
            let last = room.witness.command();
            let (sequence, time_ns) = (last.sequence + 1, utc_ns());
            let forged = MirrorCommand { sequence, time_ns, validity_ms: u32::MAX, ..last };
            attacker.publish(&attacker.room().command(), &forged);
            wait_s(3.0);
            room.controller.signal("CONT");
        })
    });
}

#[test]
fn forged_capabilities_do_not_end_the_controller() {
    measure("forged_capabilities_do_not_end_the_controller", || {
        let (mut room, effect) = attack(|room, attacker| {
            for sequence in 1..=3 {
                let stamp = Attacker::stamp(sequence);
                let forged = Capabilities { stamp, rows: 1, columns: 1, ..room.witness.capabilities() };
                attacker.publish(&attacker.room().capabilities(), &forged);
            }
        });
        assert!(room.controller.is_running(), "{}", room.controller.errors());
        effect
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
        assert!(room.witness.counter(NodeKind::Controller, "policies_refused") > 0, "{effect:?}");
        effect
    });
}
