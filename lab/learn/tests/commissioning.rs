//! What a calibration of a live room is worth in closed loop: the same episodes with nominal aims, and
//! with the corrections and the measured room of `heliostat-calibrate`.
//!
//! `EPISODES=20 cargo test --release --workspace --test commissioning -- --nocapture` prints the ratios
//! to the oracle in more rooms; each episode is a room of its own.

#[path = "../../../crates/calibrate/tests/live/mod.rs"]
mod live;

use clap::ValueEnum;
use heliostat_array::calibration_file::CalibrationFile;
use heliostat_core::core::Controller;
use heliostat_core::policy::PolicyKind;
use heliostat_environment::closed_loop::ClosedLoop;
use heliostat_environment::episodes::{HeldOutEpisode, WARM, held_out_episodes, start_ns};
use heliostat_environment::sampling::Sampled;
use heliostat_models::ActorSource;
use heliostat_proto::Stamp;
use heliostat_room::SimulatedRoom;
use heliostat_room::episode::Episode;
use heliostat_scenario::Scenario;
use live::{Faults, SPOTS, VERIFY, run, walk};

/// Mean sum rate of an episode whose controller assumes a room, with corrections of the array.
fn sum_rate_mbps(
    scenario: &Scenario,
    episode: &HeldOutEpisode,
    (assumed, calibration): (&Scenario, Option<&CalibrationFile>),
) -> f64 {
    let mut room = SimulatedRoom::new(scenario, None, episode.seed).unwrap();
    if let Some(file) = calibration {
        room.set_calibration(0, &file.message(Stamp { source: 1, sequence: 1, time_ns: 0 })).unwrap();
    }
    let inner = Episode::of_room(room, scenario, episode.seed, start_ns());
    let policy = heliostat_models::build(PolicyKind::from_str("greedy", true).unwrap(), assumed, &ActorSource::Shipped);
    let controller = Controller::new(assumed, assumed.channel_model().unwrap(), policy.unwrap(), 1);
    let mut closed = ClosedLoop::new(inner, controller);
    let mut sum = 0.0;
    for instant in &episode.instants_ns {
        while let Some((now, event)) = closed.poll_event(*instant) {
            closed.deliver(now, event, &mut |_| {}).unwrap();
        }
        closed.advance(*instant);
        sum += Sampled::of(closed.room().world(), closed.room().angles()).sum_rate_mbps;
    }
    sum / episode.instants_ns.len() as f64
}

fn oracle_mbps(scenario: &Scenario, episode: &HeldOutEpisode) -> f64 {
    let mut sum = 0.0;
    episode.solve(scenario, None, |world, angles| sum += Sampled::of(world, angles).sum_rate_mbps).unwrap();
    sum / episode.instants_ns.len() as f64
}

#[test]
fn a_calibrated_room_has_a_higher_sum_rate_in_closed_loop() {
    let level = std::env::var("LEVEL").unwrap_or_else(|_| "rough".into());
    let count: usize = std::env::var("EPISODES").ok().and_then(|text| text.parse().ok()).unwrap_or(2);
    let mismatch = format!("mismatch.level={level}");
    let hall = Scenario::builtin("hall").unwrap().with_overrides(std::slice::from_ref(&mismatch)).unwrap();
    let places: Vec<[f64; 2]> = SPOTS.into_iter().chain([VERIFY]).collect();
    let mut sums = [0.0; 4];
    for episode in held_out_episodes(&hall, None, (20 * count, 1), WARM).unwrap() {
        // The same seed is the same equipment.
        let measured = run(&live::scenario(&[&mismatch]), &walk(&places, ""), episode.seed, &Faults::default());
        let room = measured.outcome.measured_room(&hall, 0);
        let calibration = measured.outcome.calibration();
        let mirrors_only = sum_rate_mbps(&hall, &episode, (&hall, Some(&calibration)));
        let rates = [
            oracle_mbps(&hall, &episode),
            sum_rate_mbps(&hall, &episode, (&hall, None)),
            mirrors_only,
            sum_rate_mbps(&hall, &episode, (&room, Some(&calibration))),
        ];
        sums = [0, 1, 2, 3].map(|index| sums[index] + rates[index]);
        let live::Run { unused, busy_s, scenario, seed, .. } = &measured;
        println!(
            "{}, seed {seed}: ratios {:?}; {} readings, {unused} reports without use, {busy_s:.0} s",
            scenario.name,
            rates.map(|rate| (rate / rates[0] * 1e4).round() / 1e4),
            measured.outcome.readings
        );
    }
    let [before, mirrors, after] = [1, 2, 3].map(|index| sums[index] / sums[0]);
    println!("{level}, {count} episodes: nominal {before:.4}, mirrors {mirrors:.4}, mirrors and room {after:.4}");
    assert!(after > before, "{after} and {before}");
}
