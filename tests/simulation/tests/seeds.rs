//! Random plans: no invariant fails for any seed.

use std::time::{Duration, Instant, SystemTime};

use heliostat_simulation::{report, run_seed};

/// Seeds of each run without settings.
const SEEDS: u64 = 1000;

/// The seed that alone is run.
fn only_seed() -> Option<u64> {
    std::env::var("HELIOSTAT_SIM_SEED").ok().map(|seed| seed.parse().expect("HELIOSTAT_SIM_SEED is a number"))
}

/// For how long fresh seeds are run.
fn duration() -> Option<Duration> {
    let seconds = std::env::var("HELIOSTAT_SIM_SECONDS").ok()?;
    Some(Duration::from_secs(seconds.parse().expect("HELIOSTAT_SIM_SECONDS is a number of seconds")))
}

fn check(seed: u64) {
    if run_seed(seed, None).violation.is_some() {
        panic!("{}", report(seed, None).unwrap_or_else(|| format!("seed {seed} fails only sometimes")));
    }
}

#[test]
fn no_invariant_fails_for_any_seed() {
    let begun = Instant::now();
    let mut seeds = 0;
    match (only_seed(), duration()) {
        (Some(seed), _) => check(seed),
        (None, Some(duration)) => {
            let first = SystemTime::UNIX_EPOCH.elapsed().map_or(1, |now| now.as_micros() as u64);
            println!("fresh seeds from {first}");
            while begun.elapsed() < duration {
                check(first + seeds);
                seeds += 1;
            }
        }
        (None, None) => {
            (0..SEEDS).for_each(check);
            seeds = SEEDS;
        }
    }
    println!("{seeds} seeds, {:.1} a second", seeds as f64 / begun.elapsed().as_secs_f64());
}

#[test]
fn one_seed_is_one_run() {
    for seed in 0..10 {
        let [first, second] = [seed, seed].map(|seed| run_seed(seed, None));
        assert_eq!(first.hash, second.hash, "seed {seed}");
        assert!(first.followed > 0, "seed {seed}");
    }
}
