//! The calibration of simulated rooms in virtual time, judged by the truth.

mod live;

use heliostat_calibrate::Verdict;
use live::{Faults, SPOTS, VERIFY, judge, run, scenario, walk};

fn places() -> Vec<[f64; 2]> {
    SPOTS.into_iter().chain([VERIFY]).collect()
}

#[test]
fn a_rough_room_is_calibrated() {
    let seeds: u64 = std::env::var("ROOMS").ok().and_then(|text| text.parse().ok()).unwrap_or(2);
    let first: u64 = std::env::var("FIRST").ok().and_then(|text| text.parse().ok()).unwrap_or(1);
    for seed in first..first + seeds {
        let found = run(&scenario(&[]), &walk(&places(), ""), seed, &Faults::default());
        let errors = judge(&found);
        println!(
            "{:?} rejected {:?} verdicts {:?}",
            found.outcome.verification,
            found.outcome.rejected_places,
            [Verdict::Calibrated, Verdict::NeedsSpot, Verdict::NotFound, Verdict::Inconsistent].map(|verdict| found.outcome.mirrors_with(verdict)).map(|list| if list.len() > 30 { vec![list.len()] } else { list }),
        );
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
