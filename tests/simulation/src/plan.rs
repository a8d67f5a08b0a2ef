//! What a run consists of, drawn from its seed: the hosts of the room, and the faults with their times.

mod stories;

use std::fmt;

use rand::RngExt;

use crate::clock::MS;
use crate::random::{Purpose, Rng, stream};

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
    /// The policy.
    pub policy: PolicyChoice,
    /// Whether the operator releases every stop after the last fault.
    pub rearms_at_end: bool,
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
            is_reserve: rng.random_bool(0.4),
            has_ranks: rng.random_bool(0.3),
            rate_hz: [20, 50, 50, 100][rng.random_range(0..4)],
            counts_from_arrival: rng.random_bool(0.2),
            has_filter: rng.random_bool(0.15),
            policy: [PolicyChoice::Nearest, PolicyChoice::Flat, PolicyChoice::FixedPoint][rng.random_range(0..3)],
            rearms_at_end: rng.random_bool(0.8),
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
    const ALL: [Self; 23] = [
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

/// The faults of a seed.
pub fn draw(setup: &Setup) -> Vec<Timed> {
    let mut rng = stream(setup.seed, Purpose::Plan);
    if setup.controllers > 1 && rng.random_bool(0.15) {
        // The loss of the leader alone.
        let host = Role::Controller(0);
        let fault = match rng.random_range(0..3) {
            0 => Fault::Crash { host, disk: DiskAfterCrash::Kept },
            1 => Fault::End { controller: 0 },
            _ => Fault::Freeze { host },
        };
        return vec![Timed { at_ms: rng.random_range(3000..4000), for_ms: 2000, fault }];
    }
    let count = [1, 1, 2, 2, 3, 3, 4, 6, 10, 20][rng.random_range(0..10)];
    let mut faults: Vec<Timed> = (0..count).map(|_| draw_timed(setup, &mut rng)).collect();
    if rng.random_bool(0.3) {
        faults.extend(stories::draw(setup, &mut rng));
    }
    // A stop is often followed by a re-arm, so that both are tested together with other faults.
    for index in 0..faults.len() {
        if faults[index].fault == Fault::Stop && rng.random_bool(0.6) {
            let at_ms = faults[index].at_ms + rng.random_range(5..2500);
            let by = if rng.random_bool(0.75) { RearmBy::Name } else { RearmBy::Time };
            faults.push(Timed { at_ms, for_ms: 0, fault: Fault::Rearm(by) });
        }
    }
    faults.sort_by_key(|timed| timed.at_ms);
    faults
}

fn draw_timed(setup: &Setup, rng: &mut Rng) -> Timed {
    let fault = draw_fault(setup, rng);
    let for_ms = match (&fault, rng.random_range(0..10)) {
        (Fault::Stop | Fault::Rearm(_), _) => 0,
        (_, 0..3) => rng.random_range(5..100),
        (_, 3..7) => rng.random_range(100..1000),
        (_, 7..9) => rng.random_range(1000..3500),
        _ => rng.random_range(5200..6500),
    };
    Timed { at_ms: rng.random_range(FIRST_MS..6000), for_ms, fault }
}

fn draw_fault(setup: &Setup, rng: &mut Rng) -> Fault {
    let (from, to) = draw_link(setup, rng);
    let host = draw_host(setup, rng);
    let array = rng.random_range(0..setup.arrays);
    let controller = rng.random_range(0..setup.controllers);
    match rng.random_range(0..27) {
        0 => Fault::Loss { from, to, per_mille: [50, 300, 700, 1000][rng.random_range(0..4)] },
        1 => Fault::Delay { from, to, ms: [3, 20, 60, 190, 600][rng.random_range(0..5)] },
        2 => Fault::Duplicate { from, to, per_mille: [100, 500, 1000][rng.random_range(0..3)] },
        3 => Fault::Reorder { from, to, ms: [2, 30, 120][rng.random_range(0..3)] },
        4 | 5 => Fault::Partition { pairs: draw_pairs(setup, rng), holds: rng.random_bool(0.5) },
        6 => Fault::Crash { host: Role::Controller(controller), disk: DiskAfterCrash::Kept },
        7 => Fault::Crash { host, disk: DiskAfterCrash::Kept },
        8 | 9 => {
            let disk = [DiskAfterCrash::Kept, DiskAfterCrash::Kept, DiskAfterCrash::Lost, DiskAfterCrash::Torn];
            Fault::Crash { host: Role::Array(array), disk: disk[rng.random_range(0..4)] }
        }
        10 | 11 => Fault::Freeze { host },
        12 => Fault::ClockStep { host, ms: [-3_600_000, -300, -40, 40, 300, 3_600_000][rng.random_range(0..6)] },
        13 => Fault::ClockRate { host, ppm: [-20_000, -500, 500, 20_000][rng.random_range(0..4)] },
        14 => Fault::DiskFull { array },
        15 | 16 => {
            let how = [
                DeviceFault::Fails,
                DeviceFault::Blocks,
                DeviceFault::RefusesAngles,
                DeviceFault::RefusesStops,
                DeviceFault::Silent,
            ];
            Fault::Device { array, how: how[rng.random_range(0..5)] }
        }
        17 => Fault::SlowPolicy { controller, ms: [5, 30, 150, 700][rng.random_range(0..4)] },
        18..=20 => Fault::Stop,
        21 => Fault::End { controller },
        22 => Fault::Policy { controller, how: [PolicyFault::Fails, PolicyFault::NotFinite][rng.random_range(0..2)] },
        _ => Fault::Attack(Attack::ALL[rng.random_range(0..Attack::ALL.len())]),
    }
}

fn draw_host(setup: &Setup, rng: &mut Rng) -> Role {
    let roles = setup.roles();
    roles[rng.random_range(0..roles.len() - 1)]
}

/// A link that carries messages.
fn draw_link(setup: &Setup, rng: &mut Rng) -> (Role, Role) {
    let array = Role::Array(rng.random_range(0..setup.arrays));
    let controller = Role::Controller(rng.random_range(0..setup.controllers));
    let links = [
        (Role::Tracker, controller),
        (controller, array),
        (array, controller),
        (Role::Operator, array),
        (array, Role::Operator),
        (Role::Operator, controller),
    ];
    links[rng.random_range(0..links.len())]
}

fn draw_pairs(setup: &Setup, rng: &mut Rng) -> Vec<(Role, Role)> {
    let array = Role::Array(rng.random_range(0..setup.arrays));
    let controller = rng.random_range(0..setup.controllers);
    let of_controller = Role::Controller(controller);
    let all = setup.roles();
    let cut_off = |one: Role| all.iter().filter(|other| **other != one).map(|other| (one, *other)).collect();
    match rng.random_range(0..6) {
        0 => vec![draw_link(setup, rng)],
        1 if setup.controllers > 1 => {
            let others = (0..setup.controllers).filter(|other| *other != controller);
            others.map(|other| (of_controller, Role::Controller(other))).collect()
        }
        2 => (0..setup.arrays).map(|array| (of_controller, Role::Array(array))).collect(),
        3 => vec![(array, Role::Operator)],
        4 => cut_off(of_controller),
        _ => cut_off(array),
    }
}

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
