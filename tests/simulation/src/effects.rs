//! The effect of one fault, over many seeds: what docs/results/simulated-faults.md shows.
//!
//! Each case is one fault, or one short sequence, in a room with one array and 100 reports a second.
//! The seed draws the moment of the fault, the delays of the links, the clocks, the positions and the
//! policy. The invariants hold in each run; the effect is what they leave open.

use rand::RngExt;

use crate::clock::{MS, TrueNs};
use crate::plan::{
    Attack, DeviceFault, DiskAfterCrash, Fault, OptionalReports, PolicyFault, RearmBy, Role, Setup, Timed, last_end_ns,
};
use crate::random::{Purpose, stream};
use crate::violation::Violation;
use crate::world;

/// Position reports per second.
const RATE_HZ: u64 = 100;

const CONTROLLER: Role = Role::Controller(0);
const ARRAY: Role = Role::Array(0);

/// A fault with its name on the page.
pub struct Case {
    /// What is done.
    pub action: &'static str,
    /// Number of controllers; all but the first stand by.
    pub controllers: usize,
    /// Each part with its begin after the first, and its duration, in ms.
    parts: Vec<(u64, u64, Fault)>,
}

/// What a fault does to the commands that an array follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effect {
    /// Longest time between two followed commands, in ms.
    pub gap_ms: f64,
    /// Commands that would have been followed at the rate of the reports, less those that were.
    pub lost: u64,
    /// From the end of the fault to the next followed command, in ms.
    pub recovery_ms: f64,
}

impl Case {
    /// The effect in the run of a seed.
    ///
    /// # Errors
    /// The violation of an invariant.
    pub fn run(&self, seed: u64) -> Result<Effect, Violation> {
        let setup = Setup {
            arrays: 1,
            controllers: self.controllers,
            is_reserve: true,
            has_ranks: false,
            rate_hz: RATE_HZ,
            counts_from_arrival: false,
            reports: OptionalReports::default(),
            rearms_at_end: true,
            ..Setup::draw(seed)
        };
        let at_ms = stream(seed, Purpose::Plan).random_range(3000..4000);
        let timed = |(after_ms, for_ms, fault): &(u64, u64, Fault)| Timed {
            at_ms: at_ms + after_ms,
            for_ms: *for_ms,
            fault: fault.clone(),
        };
        let faults: Vec<Timed> = self.parts.iter().map(timed).collect();
        let outcome = world::run(&setup, &faults, None, false);
        match outcome.violation {
            Some(violation) => Err(violation),
            None => Ok(effect(&outcome.accepted[0], at_ms * MS, last_end_ns(&faults))),
        }
    }
}

/// The effect on the commands that were followed at these times.
fn effect(accepted: &[TrueNs], begin: TrueNs, end: TrueNs) -> Effect {
    let interval = 1_000_000_000 / RATE_HZ;
    let before = accepted.partition_point(|at| *at < begin).saturating_sub(1);
    let window = &accepted[before..];
    let gap = window.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap_or_default();
    let first = window.first().copied().unwrap_or(begin);
    let last = window.last().copied().unwrap_or(begin);
    let due = (last - first + interval / 2) / interval;
    let next = accepted.iter().find(|at| **at >= end);
    Effect {
        gap_ms: gap as f64 / MS as f64,
        lost: due.saturating_sub(window.len() as u64 - 1),
        recovery_ms: next.map_or(f64::INFINITY, |at| (at - end) as f64 / MS as f64),
    }
}

fn one(action: &'static str, for_ms: u64, fault: Fault) -> Case {
    Case { action, controllers: 1, parts: vec![(0, for_ms, fault)] }
}

fn beside_standby(action: &'static str, for_ms: u64, fault: Fault) -> Case {
    Case { controllers: 2, ..one(action, for_ms, fault) }
}

fn crash(host: Role) -> Fault {
    Fault::Crash { host, disk: DiskAfterCrash::Kept }
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
        one("the controller is frozen for 3 s", 3000, Fault::Freeze { host: CONTROLLER }),
        one("the controller is killed and started again after 300 ms", 300, crash(CONTROLLER)),
        one("the controller ends and is started again after 300 ms", 300, Fault::End { controller: 0 }),
        one("the tracker is killed and another one reports after 3 s", 3000, crash(Role::Tracker)),
        one("the driver is frozen for 3 s", 3000, Fault::Freeze { host: ARRAY }),
        one("the driver is killed and started again after 300 ms", 300, crash(ARRAY)),
        one("controller and array are partitioned for 1 s", 1000, cut(&[(CONTROLLER, ARRAY)])),
        one("controller and array are partitioned for 3 s", 3000, cut(&[(CONTROLLER, ARRAY)])),
        one("controller and array are partitioned for 6 s, beyond the lease", 6000, cut(&[(CONTROLLER, ARRAY)])),
        one(
            "no command arrives at the array for 3 s",
            3000,
            Fault::Loss { from: CONTROLLER, to: ARRAY, per_mille: 1000 },
        ),
        one("half of the commands are lost for 3 s", 3000, Fault::Loss { from: CONTROLLER, to: ARRAY, per_mille: 500 }),
        one("commands are 190 ms late for 3 s", 3000, Fault::Delay { from: CONTROLLER, to: ARRAY, ms: 190 }),
        one("the clock of the controller is 1 h ahead for 3 s", 3000, step(CONTROLLER, hour_ms)),
        one("the clock of the controller is 1 h behind for 3 s", 3000, step(CONTROLLER, -hour_ms)),
        one("the clock of the driver is 1 h ahead for 3 s", 3000, step(ARRAY, hour_ms)),
        one("the clock of the driver is 1 h behind for 3 s", 3000, step(ARRAY, -hour_ms)),
        one("the clock of the tracker is 1 h ahead for 3 s", 3000, step(Role::Tracker, hour_ms)),
        one("the clock of the tracker is 1 h behind for 3 s", 3000, step(Role::Tracker, -hour_ms)),
        one("the device fails for 2 s", 2000, device(DeviceFault::Fails)),
        one("the device blocks for 2 s", 2000, device(DeviceFault::Blocks)),
        one("the device refuses angles for 2 s", 2000, device(DeviceFault::RefusesAngles)),
        one("the device is silent for 2 s", 2000, device(DeviceFault::Silent)),
        one("the policy takes 30 ms for 3 s", 3000, Fault::SlowPolicy { controller: 0, ms: 30 }),
        one("the policy fails for 3 s", 3000, Fault::Policy { controller: 0, how: PolicyFault::Fails }),
        one(
            "the policy gives an angle that is no number for 3 s",
            3000,
            Fault::Policy { controller: 0, how: PolicyFault::NotFinite },
        ),
        one("the receivers report no gains for 3 s", 3000, Fault::ReceiversSilent),
        Case {
            action: "the array is stopped, and re-armed by name after 1 s",
            controllers: 1,
            parts: vec![(0, 0, Fault::Stop), (1000, 0, Fault::Rearm(RearmBy::Name))],
        },
        Case {
            action: "the array is stopped, the driver killed and started again, then the array re-armed",
            controllers: 1,
            parts: vec![(0, 0, Fault::Stop), (500, 300, crash(ARRAY)), (3000, 0, Fault::Rearm(RearmBy::Name))],
        },
        Case {
            action: "the disk of the stop record is full, the array is stopped, the driver killed and started again, then the array re-armed",
            controllers: 1,
            parts: vec![
                (0, 2000, Fault::DiskFull { array: 0 }),
                (200, 0, Fault::Stop),
                (700, 300, crash(ARRAY)),
                (3000, 0, Fault::Rearm(RearmBy::Name)),
            ],
        },
        beside_standby("the leader is killed beside a standby", 2000, crash(CONTROLLER)),
        beside_standby("the leader ends beside a standby", 2000, Fault::End { controller: 0 }),
        beside_standby("the leader is frozen for 2 s beside a standby", 2000, Fault::Freeze { host: CONTROLLER }),
        beside_standby("leader and array are partitioned for 2 s beside a standby", 2000, cut(&[(CONTROLLER, ARRAY)])),
        beside_standby("leader and standby are partitioned for 2 s", 2000, cut(&[(CONTROLLER, Role::Controller(1))])),
        beside_standby("the standby is killed", 2000, crash(Role::Controller(1))),
    ];
    cases.extend(Attack::ALL.iter().map(|attack| one(attacked(*attack), 1000, Fault::Attack(*attack))));
    cases
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_effect_is_read_from_the_times_of_the_followed_commands() {
        let accepted: Vec<TrueNs> = [0, 10, 20, 60, 70, 80].map(|ms| ms * MS).to_vec();
        let effect = effect(&accepted, 25 * MS, 55 * MS);
        assert_eq!(effect, Effect { gap_ms: 40.0, lost: 3, recovery_ms: 5.0 });
    }
}
