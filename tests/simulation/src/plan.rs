//! What a run consists of, drawn from its seed: the hosts of the room, and the faults with their times.

mod draw;
mod stories;

use std::fmt;

use rand::RngExt;

use crate::clock::MS;
use crate::random::{Purpose, stream};

pub use draw::draw;

/// What a host does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Role {
    /// Publishes the positions of the users.
    Tracker,
    /// Drives the mirrors of an array.
    Array(usize),
    /// Decides; several stand by for one another.
    Controller(usize),
    /// Stops and re-arms.
    Operator,
    /// Publishes payloads that no honest process publishes.
    Attacker,
    /// Takes the lead from the controllers while it calibrates an array; only in plans with a calibration.
    Calibration,
}

/// The policy of the controllers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PolicyChoice {
    /// Each mirror serves the user with its largest gain.
    Nearest,
    /// All mirrors are flat.
    Flat,
    /// The fixed point of the model-based iteration.
    FixedPoint,
}

/// Reports that a room may have beside positions and gains.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OptionalReports {
    /// A tracker sees the obstacles.
    pub obstacles: bool,
    /// Users report how they hold their receivers.
    pub orientation: bool,
    /// Receivers identify LEDs.
    pub leds: bool,
}

impl OptionalReports {
    fn draw(seed: u64) -> Self {
        let mut rng = stream(seed, Purpose::Reports);
        let [obstacles, orientation, leds] = [0; 3].map(|_| rng.random_bool(0.25));
        Self { obstacles, orientation, leds }
    }
}

/// Telemetry messages of a driver per second.
pub(crate) const TELEMETRY_HZ: u64 = 20;

/// The room of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Setup {
    /// The seed of all random numbers.
    pub seed: u64,
    /// Number of arrays.
    pub arrays: usize,
    /// Number of controllers.
    pub controllers: usize,
    /// Whether receivers report their gains.
    pub has_channel: bool,
    /// What else is reported.
    pub reports: OptionalReports,
    /// Whether all controllers but the first begin in standby, as by `--standby`.
    pub is_reserve: bool,
    /// Whether the operator gave each standby its rank.
    pub has_ranks: bool,
    /// Position reports per second.
    pub rate_hz: u64,
    /// Whether the arrays count the validity of a command from its arrival.
    pub counts_from_arrival: bool,
    /// Whether the belief of the controllers is the filter.
    pub has_filter: bool,
    /// Whether the controllers repeat the last command while no reports come.
    pub repeats_in_silence: bool,
    /// The policy.
    pub policy: PolicyChoice,
    /// Whether the operator releases every stop after the last fault.
    pub rearms_at_end: bool,
    /// Telemetry messages of each array per second.
    pub telemetry_hz: u64,
    /// Whether processes pause as on a machine with few cores.
    pub is_busy: bool,
}

impl Setup {
    /// The room of a seed.
    pub fn draw(seed: u64) -> Self {
        let mut rng = stream(seed, Purpose::Setup);
        Self {
            seed,
            arrays: if rng.random_bool(0.7) { 1 } else { 2 },
            controllers: [1, 1, 2, 2, 2, 2, 3, 3][rng.random_range(0..8)],
            has_channel: rng.random_bool(0.5),
            reports: OptionalReports::draw(seed),
            is_reserve: rng.random_bool(0.4),
            has_ranks: rng.random_bool(0.3),
            rate_hz: [20, 50, 50, 100][rng.random_range(0..4)],
            counts_from_arrival: rng.random_bool(0.2),
            has_filter: rng.random_bool(0.15),
            repeats_in_silence: false,
            policy: [PolicyChoice::Nearest, PolicyChoice::Flat, PolicyChoice::FixedPoint][rng.random_range(0..3)],
            rearms_at_end: rng.random_bool(0.8),
            telemetry_hz: TELEMETRY_HZ,
            is_busy: false,
        }
    }

    /// The hosts, in the order of their numbers.
    pub fn roles(&self) -> Vec<Role> {
        let arrays = (0..self.arrays).map(Role::Array);
        let controllers = (0..self.controllers).map(Role::Controller);
        let others = [Role::Operator, Role::Attacker];
        std::iter::once(Role::Tracker).chain(arrays).chain(controllers).chain(others).collect()
    }
}

/// What becomes of the record of a stop when its array crashes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DiskAfterCrash {
    /// It stays.
    Kept,
    /// It is gone.
    Lost,
    /// It is cut off.
    Torn,
}

/// How a device fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceFault {
    /// Every call fails; the mirrors keep their angles.
    Fails,
    /// Calls return at once, and the hardware executes them when the fault ends.
    Blocks,
    /// The hardware refuses angles.
    RefusesAngles,
    /// The hardware refuses to stop.
    RefusesStops,
    /// It answers no question.
    Silent,
}

/// How a policy fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PolicyFault {
    /// It gives no angles.
    Fails,
    /// An angle is not a number.
    NotFinite,
}

/// How a re-arm names what it releases.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RearmBy {
    /// Kind 13, with the name of each stop.
    Name,
    /// Kind 9, by its time.
    Time,
}

/// What an attacker publishes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Attack {
    /// Payloads that are cut off.
    Truncated,
    /// Payloads of another kind or version.
    WrongKind,
    /// Payloads that were just published, again.
    Replayed,
    /// Payloads that are one second old or older, again.
    Stale,
    /// A command with the last epoch.
    LastEpoch,
    /// A command whose epoch is 30 s ahead.
    HigherEpoch,
    /// A command with an epoch below that of the leader.
    LowerEpoch,
    /// A command whose sequence is far ahead.
    FarSequence,
    /// A command with an angle that is not a number.
    NotANumber,
    /// A command with angles far outside the range.
    WildAngles,
    /// A command that claims the longest validity.
    LongValidity,
    /// A command for another number of mirrors.
    WrongCount,
    /// Telemetry of a foreign source with the last epoch.
    ForgedTelemetry,
    /// Position reports of the owner with users outside the room.
    OutsideUsers,
    /// Position reports of a foreign source.
    ForeignUsers,
    /// A stop of a source of its own.
    ForeignStop,
    /// Telemetry of the present source with the last epoch.
    OwnTelemetry,
    /// Telemetry of the present source in state stopped.
    OwnTelemetryStopped,
    /// Position reports of the owner whose sequence is far ahead.
    FarUsers,
    /// Capabilities of a foreign source and of another size.
    ForgedCapabilities,
    /// Safety reports of a foreign source with the last epoch.
    ForgedSafety,
    /// A command with the last sequence.
    LastSequence,
    /// Position reports of the owner with the last sequence.
    LastUsers,
}

impl Attack {
    pub(crate) const ALL: [Self; 23] = [
        Self::Truncated,
        Self::WrongKind,
        Self::Replayed,
        Self::Stale,
        Self::LastEpoch,
        Self::HigherEpoch,
        Self::LowerEpoch,
        Self::FarSequence,
        Self::NotANumber,
        Self::WildAngles,
        Self::LongValidity,
        Self::WrongCount,
        Self::ForgedTelemetry,
        Self::OutsideUsers,
        Self::ForeignUsers,
        Self::ForeignStop,
        Self::OwnTelemetry,
        Self::OwnTelemetryStopped,
        Self::FarUsers,
        Self::ForgedCapabilities,
        Self::ForgedSafety,
        Self::LastSequence,
        Self::LastUsers,
    ];
}

/// A fault or an order; it begins at a time and lasts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Messages of a link are lost.
    Loss {
        /// The sender.
        from: Role,
        /// The receiver.
        to: Role,
        /// How many of 1000.
        per_mille: u32,
    },
    /// Messages of a link are late.
    Delay {
        /// The sender.
        from: Role,
        /// The receiver.
        to: Role,
        /// By how much, in ms.
        ms: u64,
    },
    /// Messages of a link arrive twice.
    Duplicate {
        /// The sender.
        from: Role,
        /// The receiver.
        to: Role,
        /// How many of 1000.
        per_mille: u32,
    },
    /// Messages of a link arrive in another order.
    Reorder {
        /// The sender.
        from: Role,
        /// The receiver.
        to: Role,
        /// By how much at most, in ms.
        ms: u64,
    },
    /// Pairs of hosts do not reach each other.
    Partition {
        /// The pairs, in both directions.
        pairs: Vec<(Role, Role)>,
        /// Whether the messages arrive when the link is up again.
        holds: bool,
    },
    /// A process ends at once, and starts again at the end of the fault.
    Crash {
        /// The process.
        host: Role,
        /// What becomes of the record of a stop.
        disk: DiskAfterCrash,
    },
    /// A controller is asked to end, and starts again at the end of the fault.
    End {
        /// The controller.
        controller: usize,
    },
    /// A host does not run, and goes on at the end of the fault.
    Freeze {
        /// The host.
        host: Role,
    },
    /// The UTC of a host is wrong.
    ClockStep {
        /// The host.
        host: Role,
        /// By how much, in ms.
        ms: i64,
    },
    /// The clock of a host is too fast or too slow.
    ClockRate {
        /// The host.
        host: Role,
        /// By how much, in parts per million.
        ppm: i64,
    },
    /// No stop can be recorded.
    DiskFull {
        /// The array.
        array: usize,
    },
    /// A device fails.
    Device {
        /// The array.
        array: usize,
        /// In which way.
        how: DeviceFault,
    },
    /// Decisions take long.
    SlowPolicy {
        /// The controller.
        controller: usize,
        /// How long, in ms.
        ms: u64,
    },
    /// The receivers report no gains.
    ReceiversSilent,
    /// The policy of a controller fails.
    Policy {
        /// The controller.
        controller: usize,
        /// In which way.
        how: PolicyFault,
    },
    /// The operator stops the room.
    Stop,
    /// The operator releases stops that are known.
    Rearm(RearmBy),
    /// The attacker publishes.
    Attack(Attack),
    /// An array is calibrated; at the end the calibration is asked to end.
    Calibrate {
        /// The array.
        array: usize,
    },
}

/// A fault with its time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Timed {
    /// When it begins, in ms since the start of the run.
    pub at_ms: u64,
    /// How long it lasts, in ms.
    pub for_ms: u64,
    /// What happens.
    pub fault: Fault,
}

impl Timed {
    /// When it ends, in ms.
    pub fn end_ms(&self) -> u64 {
        self.at_ms + self.for_ms
    }
}

impl fmt::Display for Timed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { at_ms, for_ms, fault } = self;
        write!(f, "Timed {{ at_ms: {at_ms}, for_ms: {for_ms}, fault: Fault::{fault:?} }}")
    }
}

/// The first fault begins at this time at the earliest: the room works by then.
const FIRST_MS: u64 = 1500;

/// When the last fault ends, in ns.
pub(crate) fn last_end_ns(faults: &[Timed]) -> u64 {
    faults.iter().map(Timed::end_ms).max().unwrap_or(FIRST_MS) * MS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_gives_one_plan_and_most_seeds_differ() {
        let of = |seed| draw(&Setup::draw(seed));
        assert_eq!(of(7), of(7));
        let distinct = (0..50).filter(|seed| of(*seed) != of(seed + 1)).count();
        assert!(distinct > 45, "{distinct}");
    }
}
