//! The calibration of simulated rooms in virtual time, judged by the truth.
//!
//! `ROOMS=8 cargo test --release --workspace --test rooms -- --nocapture` prints the errors in more
//! rooms.

mod live;
mod truth;

use heliostat_calibrate::session::Log;
use heliostat_calibrate::{Session, Stage, Verdict};
use heliostat_room::episode::Episode;
use live::{Faults, Run, SPOTS, VERIFY, drive, run, scenario, setup, walk};
use truth::{Errors, judge};

fn places() -> Vec<[f64; 2]> {
    SPOTS.into_iter().chain([VERIFY]).collect()
}

fn seeds(from: u64, few: u64) -> std::ops::Range<u64> {
    from..from + std::env::var("ROOMS").ok().and_then(|text| text.parse().ok()).unwrap_or(few)
}

fn shown(name: &str, found: &Run) -> Errors {
    let errors = judge(found);
    let others = [Verdict::NeedsSpot, Verdict::NotFound, Verdict::Inconsistent, Verdict::Unusable];
    println!(
        "{name}, seed {}: {} readings, {} reports without use, {:.1} s; pointing {:.3}/{:.3} degrees, failed {:.2}, \
         LED {:.4} m, frame {:.4} m, covered {:?}, gain {:.4} (nominal {:.4}), verification {:.3}, rejected {:?}, {:?}",
        found.seed,
        found.outcome.readings,
        found.unused,
        found.busy_s,
        errors.pointing_deg[0],
        errors.pointing_deg[1],
        errors.failed,
        errors.led_m,
        errors.frame_m,
        errors.covered,
        errors.gain,
        errors.nominal_gain,
        found.outcome.verification.ratio().value,
        found.outcome.rejected_places,
        others.map(|verdict| found.outcome.mirrors_with(verdict)),
    );
    errors
}

#[test]
fn a_rough_room_is_calibrated_within_the_promised_errors() {
    let mut covered = [0; 2];
    for seed in seeds(1, 2) {
        let found = run(&scenario(&[]), &walk(&places(), ""), seed, &Faults::default());
        let errors = shown("rough", &found);
        assert!(errors.pointing_deg.iter().all(|error| *error < 0.15), "seed {seed}: {errors:?}");
        assert!(errors.led_m < 0.015 && errors.frame_m < 0.01, "seed {seed}: {errors:?}");
        assert!(errors.gain > 0.99 && errors.gain > errors.nominal_gain, "seed {seed}: {errors:?}");
        assert!(found.outcome.verification.is_improvement() && found.outcome.rejected_places.is_empty());
        covered = [0, 1].map(|index| covered[index] + errors.covered[index]);
    }
    let share = covered[0] as f64 / covered[1] as f64;
    println!("95 % intervals hold the truth in {share:.3} of {} cases", covered[1]);
    assert!((0.9..=1.0).contains(&share), "{share}");
}

#[test]
fn latency_costs_no_report_at_100_reports_a_second() {
    let fast = ["streams.channel.rate_hz=100", "streams.positions.rate_hz=20", "streams.channel.latency_ms=100"];
    for seed in seeds(1, 1) {
        let found = run(&scenario(&fast), &walk(&places(), ""), seed, &Faults::default());
        let errors = shown("100 reports/s", &found);
        assert!(errors.pointing_deg.iter().all(|error| *error < 0.15), "{errors:?}");
        // The mirrors settle within two reports. With a wait for each report a reading would take ten more.
        assert!(found.unused < 2 * found.outcome.readings as u64, "{} of {}", found.unused, found.outcome.readings);
    }
}

#[test]
fn lost_reports_and_a_body_that_passes_do_not_spoil_a_calibration() {
    // A second user crosses the light at each spot.
    let mut crossing = String::new();
    for begin in [0.0, 124.0, 248.0, 372.0] {
        for (time, x) in [(0.0, 2.3), (15.0, 2.3), (21.0, -2.3), (30.0, -2.3), (36.0, 2.3)] {
            crossing += &format!("{},1,{x},1.9,0\n", begin + time);
        }
    }
    let changes = ["users.count=2", "streams.channel.loss=0.1", "streams.positions.loss=0.1"];
    for seed in seeds(1, 1) {
        let found = run(&scenario(&changes), &walk(&places(), &crossing), seed, &Faults::default());
        let errors = shown("lost reports and a body", &found);
        assert!(errors.pointing_deg.iter().all(|error| *error < 0.15), "{errors:?}");
        assert!(errors.gain > 0.985, "{errors:?}");
    }
}

#[test]
fn a_stuck_mirror_is_named_and_gets_no_correction() {
    for seed in seeds(1, 1) {
        let found = run(&scenario(&["actuator.stuck_share=0.01"]), &walk(&places(), ""), seed, &Faults::default());
        let errors = shown("one stuck mirror", &found);
        let named = found.outcome.mirrors_with(Verdict::NotFound);
        assert_eq!(named.len(), 1, "{named:?}");
        let calibration = found.outcome.calibration();
        assert_eq!((calibration.roll.offset_deg[named[0]], calibration.yaw.gain[named[0]]), (0.0, 1.0));
        assert!(errors.pointing_deg.iter().all(|error| *error < 0.15), "{errors:?}");
    }
}

#[test]
fn a_spot_that_the_tracker_reports_in_a_wrong_place_is_found_or_rejected() {
    // The tracker is 0.3 m off at the second spot.
    let faults = Faults { tracker: Some(|at| if at[0] > 0.8 && at[1] > 0.4 { [0.21, -0.21] } else { [0.0; 2] }) };
    for seed in seeds(1, 1) {
        let found = run(&scenario(&[]), &walk(&places(), ""), seed, &faults);
        let errors = shown("a wrong spot", &found);
        assert!(errors.pointing_deg.iter().all(|error| *error < 0.2), "{errors:?}");
        assert!(errors.gain > 0.98, "{errors:?}");
    }
}

#[test]
fn a_room_as_described_gets_no_calibration() {
    let exact = scenario(&["mismatch.level=none", "streams.positions.noise_m=0.01"]);
    let found = run(&exact, &walk(&places(), ""), 1, &Faults::default());
    assert!(!found.outcome.verification.is_improvement(), "{:?}", found.outcome.verification.ratio());
}

#[test]
fn a_session_continues_from_its_log() {
    let (scenario, trace) = (scenario(&[]), walk(&places(), ""));
    let mut episode = Episode::new(&scenario, Some(&trace), 1, 0).unwrap();
    let capabilities = episode.capabilities().next().unwrap();
    let mut first = Session::new(setup(&scenario, capabilities.clone())).unwrap();
    drive(&mut first, &mut episode, &Faults::default(), |session| session.stage() == Stage::Await(1));
    let log = first.log();
    assert_eq!((log.complete, log.spots.len()), (1, 1));
    let mut second = Session::new(setup(&scenario, capabilities)).unwrap();
    second.resume(log.clone()).unwrap();
    assert_eq!((second.stage(), second.readings()), (Stage::Await(1), first.readings()));
    let other = Log { mirrors: 9, ..log };
    assert!(second.resume(other).unwrap_err().to_string().contains("expected 100"));
}
