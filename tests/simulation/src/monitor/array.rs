//! What an array does, compared with the rules of CONTRACT.md, section 4.

use std::collections::BTreeSet;

use heliostat_array::arrivals::Arrival;
use heliostat_array::content::Content;
use heliostat_array::moment::Moment;
use heliostat_proto::EPOCH_SLOTS;
use heliostat_proto::{ArrayState, CLOCK_LEAD_MAX_NS, MAX_STOPS, MirrorCommand, Nanos, StopName};

use super::stops::StopModel;
use crate::clock::{MS, TrueNs};
use crate::hosts::array::SimStation;
use crate::hosts::device::{Hardware, MIRRORS, PARK_AFTER_MS};
use crate::violation::Invariant;

/// Bounds of every array of this project.
const VALIDITY_MAX_MS: u32 = 10_000;
const EPOCH_LEAD_MAX: u64 = 60_000;
const EPOCH_MAX_WITHOUT_UTC: u64 = 1 << 42;
const SEQUENCE_STEP_MAX: u64 = 1 << 32;

/// A running array acts within this time: it publishes telemetry twenty times a second.
const STEP_MAX_NS: u64 = 55 * MS;

/// A device that answers again is connected, and so stopped, within this time.
const STOPPED_WITHIN_NS: u64 = 1000 * MS;

/// Time from the end of validity to parking.
const PARK_AFTER_NS: u64 = PARK_AFTER_MS as u64 * MS;

type Check = Result<(), (Invariant, String)>;

/// What was before a message.
pub(crate) struct Before {
    accepted: u64,
    sets: u64,
    /// The command that has to be followed, or the rule that excludes it; absent for other messages.
    command: Option<Result<Valid, (Invariant, String)>>,
}

/// A command that has to be followed, with local times.
struct Valid {
    number: (u64, u64),
    holds_at_ns: u64,
}

/// The models of one array.
#[derive(Debug, Default)]
pub(crate) struct ArrayMonitor {
    /// Whether validity is counted from the arrival of a command.
    counts_from_arrival: bool,
    stops: StopModel,
    /// Epoch and sequence of the command that the process followed last.
    followed: Option<(u64, u64)>,
    /// End of its validity in local time.
    holds_at_ns: Option<u64>,
    /// True times of the commands that were followed.
    pub accepted_at: Vec<TrueNs>,
    /// The stops that the device has executed.
    executed: BTreeSet<StopName>,
    /// The remainder of the epochs of a calibration that leads undisturbed.
    pub guest: Option<u64>,
    /// When the hardware last had a fault, or the array was not stopped.
    unsound: TrueNs,
}

impl ArrayMonitor {
    pub fn new(counts_from_arrival: bool) -> Self {
        Self { counts_from_arrival, ..Self::default() }
    }

    /// A process of the array starts.
    pub fn start(&mut self, room_ns: Nanos, is_unknown: bool) {
        self.stops.start(room_ns, is_unknown);
        (self.followed, self.holds_at_ns) = (None, None);
    }

    /// The epoch that is followed.
    pub fn epoch(&self) -> Option<u64> {
        self.followed.map(|(epoch, _)| epoch)
    }

    pub fn is_stopped(&self) -> bool {
        self.stops.is_stopped()
    }

    pub fn has_executed(&self, name: StopName) -> bool {
        self.executed.contains(&name)
    }

    pub(super) fn before_message(&mut self, arrival: &Arrival, station: &SimStation, hardware: &Hardware) -> Before {
        let was_stopped = self.stops.is_stopped();
        self.stops.handle(arrival);
        if was_stopped && !self.stops.is_stopped() {
            // After the last release the state is parked.
            self.holds_at_ns = None;
        }
        let command = match &arrival.content {
            Content::Command(Ok(command)) => Some(self.judge(arrival.at, command)),
            Content::Command(Err(error)) => Some(Err((Invariant::Payload, error.to_string()))),
            _ => None,
        };
        let accepted = station.kit().array().counters().accepted;
        Before { accepted, sets: hardware.sets, command }
    }

    pub(super) fn after_message(
        &mut self,
        now: TrueNs,
        before: Before,
        station: &SimStation,
        hardware: &Hardware,
    ) -> Check {
        let accepted = station.kit().array().counters().accepted - before.accepted;
        match (before.command, accepted) {
            (None, 0) | (Some(Err(_)), 0) => {}
            (Some(Ok(Valid { number, holds_at_ns })), 1) => {
                (self.followed, self.holds_at_ns) = (Some(number), Some(holds_at_ns));
                self.accepted_at.push(now);
                if self.guest.is_some_and(|slot| number.0 % EPOCH_SLOTS != slot) {
                    return Err((Invariant::Guest, format!("{number:?} was followed while a calibration leads")));
                }
            }
            (Some(Ok(Valid { number, .. })), 0) => {
                return Err((Invariant::Recovery, format!("the valid command {number:?} was refused")));
            }
            (Some(Err((invariant, why))), _) => {
                return Err((invariant, format!("a command was followed although {why}")));
            }
            (_, count) => {
                return Err((Invariant::Numbering, format!("{count} commands were followed for one message")));
            }
        }
        if self.stops.is_stopped() && hardware.sets > before.sets {
            return Err((Invariant::StoppedArray, "the device was set after a stop".into()));
        }
        let followed = station.kit().array().followed().map(|followed| (followed.epoch, followed.sequence));
        if followed != self.followed {
            return Err((Invariant::Numbering, format!("{followed:?} is followed, expected {:?}", self.followed)));
        }
        self.check_stop(now, station, hardware)
    }

    pub(super) fn after_advance(
        &mut self,
        now: TrueNs,
        at: Moment,
        station: &SimStation,
        hardware: &Hardware,
    ) -> Check {
        self.check_stop(now, station, hardware)?;
        let state = station.kit().array().state();
        let expected = self.expected_state(at.local_ns);
        if state != expected {
            return Err((Invariant::Validity, format!("the state is {state:?}, expected {expected:?}")));
        }
        if !station.kit().device_stopped() && now - self.unsound > STOPPED_WITHIN_NS {
            return Err((Invariant::StoppedArray, "the device has not executed the stop".into()));
        }
        Ok(())
    }

    /// Checks that no change of the state is overdue.
    pub(super) fn audit(&self, at: Moment, station: &SimStation) -> Check {
        let Some(holds_at_ns) = self.holds_at_ns else { return Ok(()) };
        let state = station.kit().array().state();
        let due_ns = match state {
            ArrayState::Following => holds_at_ns,
            ArrayState::Holding => holds_at_ns + PARK_AFTER_NS,
            _ => return Ok(()),
        };
        if at.local_ns < due_ns + STEP_MAX_NS {
            return Ok(());
        }
        Err((Invariant::Validity, format!("the state is still {state:?}")))
    }

    /// What holds after each step: the stops in force, and what the device does about them.
    pub(super) fn check_stop(&mut self, now: TrueNs, station: &SimStation, hardware: &Hardware) -> Check {
        let (kit, fault) = (station.kit(), |text: String| Err((Invariant::StoppedArray, text)));
        let latched: BTreeSet<StopName> = kit.array().latch().stops().iter().map(|stop| stop.name()).collect();
        let expected: BTreeSet<StopName> = self.stops.names().collect();
        if latched != expected {
            return fault(format!("the stops {latched:?} are latched, expected {expected:?}"));
        }
        if kit.array().latch().stops().len() > MAX_STOPS {
            return Err((Invariant::Payload, "more stops are latched than a report can list".into()));
        }
        if let Some(angle) = hardware.bad_angle {
            return Err((Invariant::Payload, format!("the device was set to {angle} rad")));
        }
        if !hardware.is_sound() || expected.is_empty() {
            self.unsound = now;
        }
        if kit.device_stopped() {
            if !hardware.is_halted {
                return fault("the device counts as stopped, and has not executed the stop".into());
            }
            self.executed.extend(expected);
        }
        Ok(())
    }

    fn expected_state(&self, local_ns: u64) -> ArrayState {
        match self.holds_at_ns {
            _ if self.stops.is_stopped() => ArrayState::Stopped,
            Some(holds_at_ns) if local_ns < holds_at_ns => ArrayState::Following,
            Some(holds_at_ns) if local_ns < holds_at_ns + PARK_AFTER_NS => ArrayState::Holding,
            _ => ArrayState::Parked,
        }
    }

    /// The rules for a command in the order of the contract.
    fn judge(&self, at: Moment, command: &MirrorCommand) -> Result<Valid, (Invariant, String)> {
        let MirrorCommand { epoch, sequence, validity_ms, time_ns, .. } = *command;
        let refuse = |invariant, why: String| Err((invariant, why));
        if [command.roll.len(), command.yaw.len()] != [MIRRORS; 2] {
            return refuse(Invariant::Payload, "it is for another number of mirrors".into());
        }
        if self.stops.is_stopped() {
            return refuse(Invariant::StoppedArray, "a stop is in force".into());
        }
        let number = (epoch, sequence);
        if let Some(followed) = self.followed.filter(|followed| number <= *followed) {
            return refuse(Invariant::Numbering, format!("{number:?} came after {followed:?}"));
        }
        let validity_ns = u64::from(validity_ms) * MS;
        let has_clock = !self.counts_from_arrival;
        if has_clock && time_ns > at.room_ns + CLOCK_LEAD_MAX_NS {
            return refuse(Invariant::Validity, "its time is in the future".into());
        }
        let age_ns = if has_clock { at.room_ns.saturating_sub(time_ns) } else { 0 };
        if has_clock && age_ns >= validity_ns {
            return refuse(Invariant::Validity, format!("it had expired: {age_ns} ns old"));
        }
        let (highest, last) = self.followed.unwrap_or_default();
        let first = if highest == epoch { last } else { 0 };
        let highest_epoch = match has_clock {
            true => highest.max(at.room_ns / MS) + EPOCH_LEAD_MAX,
            false => EPOCH_MAX_WITHOUT_UTC.max(highest + EPOCH_LEAD_MAX),
        };
        let is_within = epoch <= highest_epoch
            && sequence <= first.saturating_add(SEQUENCE_STEP_MAX)
            && validity_ms <= VALIDITY_MAX_MS;
        if !is_within {
            return refuse(Invariant::Numbering, format!("{number:?} or its validity is beyond its bound"));
        }
        Ok(Valid { number, holds_at_ns: at.local_ns + validity_ns - age_ns })
    }
}
