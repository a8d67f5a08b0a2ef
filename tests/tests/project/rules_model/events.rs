//! What can happen in the modelled room, and how often.

use heliostat_core::tenure::Evidence;
use heliostat_proto::{EmergencyStop, MirrorCommand};

/// How often each event may occur.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Budgets {
    pub rounds: u32,
    /// Messages of a round that are lost.
    pub lost: u8,
    /// Messages that arrive after later ones.
    pub held: u8,
    /// Held messages that arrive twice.
    pub repeated: u8,
    pub starts: u8,
    pub crashes: u8,
    pub array_crashes: u8,
    pub stops: u8,
    pub rearms: u8,
    pub attacks: u8,
}

/// A message on its way.
#[derive(Clone, Debug, PartialEq)]
pub enum Packet {
    /// A command, and the controller that sent it; 0 for an attacker.
    Command(u64, MirrorCommand),
    /// Telemetry for the controller at a place.
    Telemetry(usize, Evidence),
    Stop(EmergencyStop),
}

/// What happens to one message of a round; all others arrive at once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fate {
    AllArrive,
    Lost(usize),
    Held(usize),
}

/// What an attacker sends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Attack {
    /// A command of the highest epoch that there is.
    LastEpoch,
    /// A command of the highest epoch within the bound, with the highest sequence within the bound.
    LeadingEpoch,
    /// A command of the followed epoch with the highest sequence that there is.
    LastSequence,
    /// The same with the highest sequence within the bound.
    LeadingSequence,
    /// A command of the next epoch that is valid for 49 days.
    LongValidity,
    /// Telemetry of the highest epoch.
    TelemetryOfLastEpoch,
    /// Telemetry that shows the highest sequence in each controller's own epoch.
    TelemetryOfLastSequence,
    /// Telemetry of an array that is stopped.
    TelemetryOfStop,
    /// A stop of the highest time that there is.
    FutureStop,
}

/// All of them.
pub const ATTACKS: [Attack; 9] = [
    Attack::LastEpoch,
    Attack::LeadingEpoch,
    Attack::LastSequence,
    Attack::LeadingSequence,
    Attack::LongValidity,
    Attack::TelemetryOfLastEpoch,
    Attack::TelemetryOfLastSequence,
    Attack::TelemetryOfStop,
    Attack::FutureStop,
];

#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// Every controller answers a report, and the array reports.
    Round(Fate),
    /// The held message arrives; a copy may remain.
    Arrive {
        remains: bool,
    },
    /// A controller starts at a place, with a right clock or one a day ahead.
    Start {
        place: usize,
        is_ahead: bool,
    },
    Crash {
        place: usize,
    },
    CrashArray,
    StartArray,
    /// An operator stops; the clock of one is an hour ahead. The order may be held.
    Stop {
        is_ahead: bool,
        is_held: bool,
    },
    /// An operator releases the stop by its name, or by a later time.
    Rearm {
        by_name: bool,
        is_ahead: bool,
    },
    Attack(Attack),
}
