//! The cases, in the order of the page, and which of them real processes undergo too.

use super::Case;
use crate::plan::{Attack, DeviceFault, DiskAfterCrash, Fault, PolicyFault, RearmBy, Role, TELEMETRY_HZ};

const CONTROLLER: Role = Role::Controller(0);
const STANDBY: Role = Role::Controller(1);
const ARRAY: Role = Role::Array(0);

/// Why the measurements of two hosts can be outside.
const TWO_HOSTS: &str = "the test runs two rooms, two routers and TLS on 2 cores, and each message passes one or two \
                         routers; the simulation has neither their delays nor their load";

/// Telemetry messages per second of the simulator in the tests of real processes.
const SIMULATOR_HZ: u64 = 100;

/// A killed process is started again after this time in ms: it has ended, and the next one is launched.
const RELAUNCH_MS: u64 = 5;

fn one(action: &'static str, for_ms: u64, fault: Fault) -> Case {
    several(action, vec![(0, for_ms, fault)])
}

fn several(action: &'static str, parts: Vec<(u64, u64, Fault)>) -> Case {
    Case { action, controllers: 1, parts, telemetry_hz: TELEMETRY_HZ, tests: &[], differs: None }
}

/// Simulator and array of a test are one process.
fn both(action: &'static str, for_ms: u64, fault: fn(Role) -> Fault) -> Case {
    several(action, vec![(0, for_ms, fault(Role::Tracker)), (0, for_ms, fault(ARRAY))])
}

fn beside_standby(action: &'static str, for_ms: u64, fault: Fault) -> Case {
    one(action, for_ms, fault).beside_standby()
}

fn crash(host: Role) -> Fault {
    Fault::Crash { host, disk: DiskAfterCrash::Kept }
}

/// A host that reaches no other one of a room with so many controllers.
fn cut_off(host: Role, controllers: usize) -> Fault {
    let others = [Role::Tracker, ARRAY, Role::Operator].into_iter().chain((0..controllers).map(Role::Controller));
    cut(&others.filter(|other| *other != host).map(|other| (host, other)).collect::<Vec<_>>())
}

fn freeze(host: Role) -> Fault {
    Fault::Freeze { host }
}

impl Case {
    /// The tests in which a controller of a real simulator undergoes the same.
    fn like(self, tests: &'static [&'static str]) -> Self {
        Self { telemetry_hz: SIMULATOR_HZ, ..self.like_with_driver(tests) }
    }

    /// The tests of real processes that cause the same fault, with a driver.
    fn like_with_driver(self, tests: &'static [&'static str]) -> Self {
        Self { tests, ..self }
    }

    fn beside_standby(self) -> Self {
        Self { controllers: 2, ..self }
    }

    /// Why the measurement can be outside.
    fn but(self, differs: &'static str) -> Self {
        Self { differs: Some(differs), ..self }
    }
}

fn cut(pairs: &[(Role, Role)]) -> Fault {
    Fault::Partition { pairs: pairs.to_vec(), holds: false }
}

/// All cases, in the order of the page.
pub fn cases() -> Vec<Case> {
    let hour_ms = 3_600_000;
    let step = |host, ms| Fault::ClockStep { host, ms };
    let device = |how| Fault::Device { array: 0, how };
    let mut cases = vec![
        one("the controller is frozen for 3 s", 3000, freeze(CONTROLLER))
            .like(&["the_array_parks_while_the_controller_is_frozen"]),
        one("the controller is killed and started again", RELAUNCH_MS, crash(CONTROLLER))
            .like(&["a_killed_controller_is_replaced_by_the_next", "silent_connections_do_not_delay_a_new_controller"]),
        one("the controller ends and is started again", RELAUNCH_MS, Fault::End { controller: 0 })
            .like(&["a_controller_ended_by_sigterm_is_replaced_by_the_next"]),
        both("tracker and array are killed and started again", RELAUNCH_MS, crash)
            .like(&["a_killed_simulator_is_served_again_after_its_restart"]),
        one("the tracker is killed and another one reports after 3 s", 3000, crash(Role::Tracker)),
        one("the driver is frozen for 3 s", 3000, freeze(ARRAY)),
        one("the driver is killed and started again", RELAUNCH_MS, crash(ARRAY))
            .like_with_driver(&["a_killed_driver_follows_again_after_its_restart"]),
        one("controller and array are partitioned for 1 s", 1000, cut(&[(CONTROLLER, ARRAY)])),
        one("controller and array are partitioned for 3 s", 3000, cut(&[(CONTROLLER, ARRAY)])),
        one("controller and array are partitioned for 6 s, beyond the lease", 6000, cut(&[(CONTROLLER, ARRAY)])),
        one("the controller is cut off for 3 s", 3000, cut_off(CONTROLLER, 1))
            .like(&["a_link_between_two_hosts_that_was_down_for_3_s_is_used_again"]),
        one("the controller is cut off for 30 s, beyond the lease", 30_000, cut_off(CONTROLLER, 1))
            .like(&["the_array_parks_during_a_partition_of_30_s"]),
        one(
            "no command arrives at the array for 3 s",
            3000,
            Fault::Loss { from: CONTROLLER, to: ARRAY, per_mille: 1000 },
        ),
        one("half of the commands are lost for 3 s", 3000, Fault::Loss { from: CONTROLLER, to: ARRAY, per_mille: 500 }),
        one("commands are 190 ms late for 3 s", 3000, Fault::Delay { from: CONTROLLER, to: ARRAY, ms: 190 }),
        one("the clock of the controller is 1 h ahead for 3 s", 3000, step(CONTROLLER, hour_ms))
            .like(&["the_array_parks_while_the_clock_of_the_controller_is_1_h_ahead"]),
        one("the clock of the controller is 1 h behind for 3 s", 3000, step(CONTROLLER, -hour_ms)),
        one("the clock of the driver is 1 h ahead for 3 s", 3000, step(ARRAY, hour_ms)),
        one("the clock of the driver is 1 h behind for 3 s", 3000, step(ARRAY, -hour_ms)),
        one("the clock of the tracker is 1 h ahead for 3 s", 3000, step(Role::Tracker, hour_ms)),
        one("the clock of the tracker is 1 h behind for 3 s", 3000, step(Role::Tracker, -hour_ms)),
        one("the device fails for 2 s", 2000, device(DeviceFault::Fails)),
        one("the device blocks for 2 s", 2000, device(DeviceFault::Blocks)),
        one("the device refuses angles for 2 s", 2000, device(DeviceFault::RefusesAngles)),
        one("the device is silent for 2 s", 2000, device(DeviceFault::Silent))
            .like(&["the_array_follows_again_after_it_was_offline"]),
        one("the policy takes 30 ms for 3 s", 3000, Fault::SlowPolicy { controller: 0, ms: 30 }),
        one("the policy fails for 3 s", 3000, Fault::Policy { controller: 0, how: PolicyFault::Fails }),
        one(
            "the policy gives an angle that is no number for 3 s",
            3000,
            Fault::Policy { controller: 0, how: PolicyFault::NotFinite },
        ),
        one("the receivers report no gains for 3 s", 3000, Fault::ReceiversSilent),
        several(
            "the array is stopped, and re-armed by name after 1 s",
            vec![(0, 0, Fault::Stop), (1000, 0, Fault::Rearm(RearmBy::Name))],
        )
        .like(&["a_stop_of_any_sender_is_obeyed_until_its_re_arm"])
        .but(
            "the test re-arms by a command of its own process, which starts after 1 s and ends after the array \
             follows; the simulated operator runs already",
        ),
        several(
            "the array is stopped, the driver killed and started again, then the array re-armed",
            vec![(0, 0, Fault::Stop), (500, 300, crash(ARRAY)), (3000, 0, Fault::Rearm(RearmBy::Name))],
        ),
        several(
            "the disk of the stop record is full, the array is stopped, the driver killed and started again, then the array re-armed",
            vec![
                (0, 2000, Fault::DiskFull { array: 0 }),
                (200, 0, Fault::Stop),
                (700, 300, crash(ARRAY)),
                (3000, 0, Fault::Rearm(RearmBy::Name)),
            ],
        ),
        several(
            "an array is calibrated for 3 s, and the lead given back",
            vec![(0, 3000, Fault::Calibrate { array: 0 })],
        ),
        several(
            "an array is calibrated for 3 s beside a standby, and the lead given back",
            vec![(0, 3000, Fault::Calibrate { array: 0 })],
        )
        .beside_standby(),
        beside_standby("the leader is killed beside a standby", 2000, crash(CONTROLLER))
            .like(&[
                "the_standby_of_the_other_host_replaces_a_killed_controller",
                "a_local_standby_takes_over_when_the_host_of_the_leader_is_lost",
            ])
            .but(TWO_HOSTS),
        beside_standby("the leader ends beside a standby", 2000, Fault::End { controller: 0 }),
        beside_standby("the leader is frozen for 3 s beside a standby", 3000, freeze(CONTROLLER))
            .like(&["the_standby_of_the_other_host_replaces_a_frozen_controller"])
            .but(TWO_HOSTS),
        beside_standby("the leader is cut off for 3 s beside a standby", 3000, cut_off(CONTROLLER, 2))
            .like(&["a_local_standby_takes_over_when_the_link_to_the_host_of_the_leader_is_cut"]),
        beside_standby("leader and array are partitioned for 2 s beside a standby", 2000, cut(&[(CONTROLLER, ARRAY)])),
        beside_standby("leader and standby are partitioned for 2 s", 2000, cut(&[(CONTROLLER, STANDBY)])),
        beside_standby("the standby is killed", 2000, crash(STANDBY))
            .like(&["a_killed_standby_does_not_disturb_the_room"])
            .but(TWO_HOSTS),
        beside_standby("the standby is frozen for 3 s", 3000, freeze(STANDBY))
            .like(&["a_frozen_standby_does_not_disturb_the_room"])
            .but(TWO_HOSTS),
        beside_standby("the standby is cut off for 3 s", 3000, cut_off(STANDBY, 2))
            .like(&["a_cut_link_between_the_hosts_does_not_disturb_a_room_whose_leader_is_local"]),
        beside_standby("the standby is cut off for 12 s, beyond the lease", 12_000, cut_off(STANDBY, 2))
            .like(&["a_link_cut_beyond_the_lease_does_not_disturb_a_room_whose_leader_is_local"])
            .but(TWO_HOSTS),
        both("tracker and array are killed and started again after 1 s beside a standby", 1000, crash)
            .beside_standby()
            .like(&["a_killed_array_is_served_again_through_its_router"])
            .but(TWO_HOSTS),
        both("tracker and array are frozen for 3 s beside a standby", 3000, freeze)
            .beside_standby()
            .like(&["a_frozen_array_is_served_again_through_its_router"])
            .but(TWO_HOSTS),
    ];
    let attack = |attack: &Attack| one(attacked(*attack), 1000, Fault::Attack(*attack)).like(as_real(*attack));
    cases.extend(Attack::ALL.iter().map(attack));
    cases
}

/// The tests in which a real process publishes the same.
fn as_real(attack: Attack) -> &'static [&'static str] {
    match attack {
        Attack::Truncated => &["truncated_payloads_on_every_key_are_refused"],
        Attack::WrongKind => &["wrong_versions_on_every_key_are_refused"],
        _ => &[],
    }
}

/// What an attacker does for 1 s.
fn attacked(attack: Attack) -> &'static str {
    match attack {
        Attack::Truncated => "payloads that are cut off arrive for 1 s",
        Attack::WrongKind => "payloads of another kind or version arrive for 1 s",
        Attack::Replayed => "payloads that were just published arrive again for 1 s",
        Attack::Stale => "payloads that are 1 s old arrive again for 1 s",
        Attack::LastEpoch => "commands with the last epoch arrive for 1 s",
        Attack::HigherEpoch => "commands with an epoch 30 s ahead arrive for 1 s",
        Attack::LowerEpoch => "commands with a lower epoch arrive for 1 s",
        Attack::FarSequence => "commands with a sequence far ahead arrive for 1 s",
        Attack::NotANumber => "commands with an angle that is no number arrive for 1 s",
        Attack::WildAngles => "commands with angles far outside the range arrive for 1 s",
        Attack::LongValidity => "commands with the longest validity arrive for 1 s",
        Attack::WrongCount => "commands for another number of mirrors arrive for 1 s",
        Attack::ForgedTelemetry => "telemetry of a foreign source with the last epoch arrives for 1 s",
        Attack::OutsideUsers => "reports of the present source with users outside the room arrive for 1 s",
        Attack::ForeignUsers => "position reports of a foreign source arrive for 1 s",
        Attack::ForeignStop => "a foreign process stops the array for 1 s, and an operator re-arms it",
        Attack::OwnTelemetry => "telemetry of the present source with the last epoch arrives for 1 s",
        Attack::OwnTelemetryStopped => "telemetry of the present source in state stopped arrives for 1 s",
        Attack::FarUsers => "position reports of the present source with a sequence far ahead arrive for 1 s",
        Attack::ForgedCapabilities => "capabilities of a foreign source and another size arrive for 1 s",
        Attack::ForgedSafety => "safety reports of a foreign source with the last epoch arrive for 1 s",
        Attack::LastSequence => "commands with the last sequence arrive for 1 s",
        Attack::LastUsers => "position reports of the present source with the last sequence arrive for 1 s",
    }
}
