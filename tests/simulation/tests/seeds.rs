//! Random plans: no invariant fails for any seed.

use std::collections::BTreeSet;
use std::hash::{BuildHasher, RandomState};
use std::time::{Duration, Instant};

use heliostat_core::core::DegradedMode;
use heliostat_core::tenure::TenureEvent;
use heliostat_simulation::{report, run_seed};

/// Seeds of each run without settings.
const SEEDS: u64 = 2000;

/// The seed that alone is run.
fn only_seed() -> Option<u64> {
    std::env::var("HELIOSTAT_SIM_SEED").ok().map(|seed| seed.parse().expect("HELIOSTAT_SIM_SEED is a number"))
}

/// For how long fresh seeds are run.
fn duration() -> Option<Duration> {
    let seconds = std::env::var("HELIOSTAT_SIM_SECONDS").ok()?;
    Some(Duration::from_secs(seconds.parse().expect("HELIOSTAT_SIM_SECONDS is a number of seconds")))
}

/// What occurred in a run without a violation.
fn check(seed: u64) -> BTreeSet<String> {
    let outcome = run_seed(seed, None);
    if outcome.violation.is_some() {
        panic!("{}", report(seed, None).unwrap_or_else(|| format!("seed {seed} fails only sometimes")));
    }
    outcome.occurred
}

/// Refusals that the fixed seeds have to reach.
const REFUSALS: [&str; 25] = [
    "command:epoch-bound",
    "command:expired",
    "command:from-future",
    "command:lower-epoch",
    "command:not-finite",
    "command:old-sequence",
    "command:sequence-bound",
    "command:stopped",
    "command:truncated",
    "command:validity-bound",
    "command:wrong-mirror-count",
    "rearm:not-stopped",
    "rearm:other-stop",
    "rearm:too-early",
    "stop:truncated",
    "telemetry:foreign-source",
    "telemetry:source-gone",
    "telemetry:stale",
    "users:foreign-source",
    "users:from-future",
    "users:out-of-order",
    "users:outside-room",
    "users:repeated",
    "users:sequence-jump",
    "users:stale",
];

/// What calibrations have to reach in the fixed seeds.
const CALIBRATIONS: [&str; 2] = ["calibration:led", "calibration:probed"];

#[test]
fn no_invariant_fails_for_any_seed() {
    let begun = Instant::now();
    let seeds = match (only_seed(), duration()) {
        (Some(seed), _) => {
            check(seed);
            1
        }
        (None, Some(duration)) => check_fresh(duration),
        (None, None) => {
            let occurred: BTreeSet<String> = (0..SEEDS).flat_map(check).collect();
            check_reach(&occurred);
            SEEDS
        }
    };
    println!("{seeds} seeds, {:.1} a second", seeds as f64 / begun.elapsed().as_secs_f64());
}

/// Seeds between two lines about the progress.
const PROGRESS_EVERY: u64 = 10_000;

/// Runs seeds from a random one on; how many.
fn check_fresh(duration: Duration) -> u64 {
    let (begun, mut seeds) = (Instant::now(), 0);
    // Runs that start together have other seeds each.
    let first = RandomState::new().hash_one(0) >> 8;
    println!("fresh seeds from {first}");
    while begun.elapsed() < duration {
        check(first + seeds);
        seeds += 1;
        if seeds.is_multiple_of(PROGRESS_EVERY) {
            println!("{seeds} seeds after {:.0} s", begun.elapsed().as_secs_f64());
        }
    }
    seeds
}

/// Seeds that never reach a rule would not find its violation.
fn check_reach(occurred: &BTreeSet<String>) {
    let events = TenureEvent::ALL.iter().map(|event| event.name());
    let modes = DegradedMode::ALL.iter().map(|mode| mode.name());
    let missing: Vec<_> =
        events.chain(modes).chain(REFUSALS).chain(CALIBRATIONS).filter(|name| !occurred.contains(*name)).collect();
    assert!(missing.is_empty(), "no seed reaches {missing:?}");
}

#[test]
fn one_seed_is_one_run() {
    for seed in 0..10 {
        let [first, second] = [seed, seed].map(|seed| run_seed(seed, None));
        assert_eq!(first.hash, second.hash, "seed {seed}");
        assert!(first.accepted.iter().any(|times| !times.is_empty()), "seed {seed}");
    }
}
