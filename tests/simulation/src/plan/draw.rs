//! Draws the faults of a seed.

use rand::RngExt;

use super::{Attack, DeviceFault, DiskAfterCrash, FIRST_MS, Fault, PolicyFault, RearmBy, Role, Setup, Timed, stories};
use crate::random::{Purpose, Rng, stream};

/// Share of the seeds in which an array is calibrated, and share of these in which nothing else happens.
const CALIBRATED: (f64, f64) = (0.15, 0.4);

/// The faults of a seed.
pub fn draw(setup: &Setup) -> Vec<Timed> {
    let mut faults = draw_faults(setup);
    let mut rng = stream(setup.seed, Purpose::Calibrations);
    if !rng.random_bool(CALIBRATED.0) {
        return faults;
    }
    if rng.random_bool(CALIBRATED.1) {
        faults.clear();
    }
    let at_ms = rng.random_range(2000..4000);
    let for_ms = if rng.random_bool(0.5) { rng.random_range(300..1500) } else { rng.random_range(1500..5000) };
    let fault = Fault::Calibrate { array: rng.random_range(0..setup.arrays) };
    faults.push(Timed { at_ms, for_ms, fault });
    let (after_ms, host) = (rng.random_range(0..for_ms), Role::Calibration);
    match rng.random_range(0..8) {
        0 => {
            let fault = Fault::Crash { host, disk: DiskAfterCrash::Kept };
            faults.push(Timed { at_ms: at_ms + after_ms, for_ms, fault });
        }
        1 => {
            let for_ms = rng.random_range(100..2500);
            faults.push(Timed { at_ms: at_ms + after_ms, for_ms, fault: Fault::Freeze { host } });
        }
        _ => {}
    }
    faults.sort_by_key(|timed| timed.at_ms);
    faults
}

fn draw_faults(setup: &Setup) -> Vec<Timed> {
    let mut rng = stream(setup.seed, Purpose::Plan);
    if setup.controllers > 1 && rng.random_bool(0.15) {
        // The loss of the leader alone.
        let host = Role::Controller(0);
        let fault = match rng.random_range(0..4) {
            0 => Fault::Crash { host, disk: DiskAfterCrash::Kept },
            1 => Fault::End { controller: 0 },
            2 => {
                let pairs = (0..setup.arrays).map(|array| (host, Role::Array(array))).collect();
                Fault::Partition { pairs, holds: rng.random_bool(0.5) }
            }
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
    match rng.random_range(0..28) {
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
        23 => Fault::ReceiversSilent,
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
