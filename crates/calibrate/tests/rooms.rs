//! The calibration of simulated rooms in virtual time, judged by the truth.

mod live;

use live::{Faults, SPOTS, VERIFY, judge, run, scenario, walk};

fn places() -> Vec<[f64; 2]> {
    SPOTS.into_iter().chain([VERIFY]).collect()
}

#[test]
fn a_rough_room_is_calibrated() {
    let seeds: u64 = std::env::var("ROOMS").ok().and_then(|text| text.parse().ok()).unwrap_or(2);
    for seed in 1..=seeds {
        let found = run(&scenario(&[]), &walk(&places(), ""), seed, &Faults::default());
        let errors = judge(&found);
        println!(
            "seed {seed}: {} readings, {} unused, {:.1} s; {:?}; ratio {:?}; {:?}",
            found.outcome.readings,
            found.unused,
            found.busy_s,
            errors,
            found.outcome.verification.ratio(),
            found.outcome.leds_m,
        );
    }
}
