//! Calibration from measured gains: what a mounting error costs, and what is won back.

use heliostat_engine::ActorSource;
use heliostat_models::calibrate::{Method, Settings, calibrate, study};
use heliostat_models::comparison::Entrant;
use heliostat_scenario::Scenario;
use heliostat_sim::mirrors::actuator::Actuator;
use heliostat_sim::random::{Purpose, stream};
use indicatif::ProgressBar;

const METHOD: Method = Method { dwell_s: 1e-3, search_rad: 8.0 * std::f64::consts::PI / 180.0 };

fn room(changes: &[&str]) -> Scenario {
    let small = [
        "mirrors.rows=4",
        "mirrors.columns=4",
        "actuator.profile=mems",
        "actuator.offset_deg=1",
        "blockage.forced_users=5",
    ];
    let changes: Vec<String> = small.iter().chain(changes).map(|change| (*change).to_owned()).collect();
    Scenario::builtin("specular").unwrap().with_overrides(&changes).unwrap()
}

/// How far the mirrors of an array stand from where corrected commands want them, root mean square over axes and places, in degrees.
fn residual_deg(scenario: &Scenario, seed: u64, corrected: bool) -> f64 {
    let file = calibrate(scenario, seed, &METHOD, &ProgressBar::hidden()).unwrap().file;
    let mut parameters = scenario.actuator.parameters();
    parameters.jitter_rad = 0.0;
    let mirrors = scenario.mirror_count();
    let mut squares = Vec::new();
    for wanted_deg in [-8.0, 0.0, 8.0] {
        let told = |axis: &heliostat_array::calibration_file::AxisCorrections| {
            let correct = |mirror: usize| axis.gain[mirror] * wanted_deg + axis.offset_deg[mirror];
            (0..mirrors).map(|mirror| if corrected { correct(mirror) } else { wanted_deg }.to_radians()).collect()
        };
        let mut array = Actuator::new(&parameters, mirrors, stream(seed, Purpose::Actuator, 0));
        array.command(&heliostat_channel::MirrorAngles { roll: told(&file.roll), yaw: told(&file.yaw) });
        array.step(1.0);
        let angles = array.angles().roll.iter().chain(&array.angles().yaw);
        squares.extend(angles.map(|angle| (angle.to_degrees() - wanted_deg).powi(2)));
    }
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

#[test]
fn a_mounting_error_is_found_to_a_small_part_of_itself() {
    let plain = room(&[]);
    let (before, after) = (residual_deg(&plain, 3, false), residual_deg(&plain, 3, true));
    assert!(before > 0.7 && after < 0.15, "from {before} to {after} degrees");
    let scaled = room(&["actuator.scale_error_relative=0.03", "streams.channel.noise_relative=0.05"]);
    let after = residual_deg(&scaled, 3, true);
    assert!(after < 0.25, "scale errors and noisy gains: {after} degrees");
}

#[test]
fn a_calibration_wins_back_what_a_degree_of_mounting_loses() {
    let settings = Settings {
        scenario: room(&["actuator.offset_deg=0"]),
        mounting_deg: vec![1.0],
        seeds: 3,
        states: 30,
        entrant: Entrant::parse("fixed-point", &ActorSource::Shipped).unwrap(),
        method: METHOD,
    };
    let (study, file) = study(&settings).unwrap();
    let row = &study.rows[0];
    assert!(row.uncalibrated_ratio.mean < 0.93, "without calibration there is a loss: {row:?}");
    assert!(row.calibrated_ratio.mean > 0.95, "{row:?}");
    assert_eq!((row.unfound, row.limited, file.roll.gain.len()), (0.0, 0.0, 16));
    assert!(row.readings > 100.0 && row.seconds > 1.0, "{row:?}");
    let again = calibrate(&room(&[]), settings.scenario.seed, &METHOD, &ProgressBar::hidden()).unwrap();
    assert_eq!(again.file, file, "the seed decides all of it");
}

#[test]
fn what_cannot_be_calibrated_is_told() {
    let paper = Scenario::builtin("paper").unwrap();
    let refusal = calibrate(&paper, 1, &METHOD, &ProgressBar::hidden()).unwrap_err().to_string();
    assert!(refusal.contains("channel.mode = \"paper\"") && refusal.contains("specular"), "{refusal}");
    // A stuck mirror's light is nowhere to be found, and it is left as it is.
    let stuck = calibrate(&room(&["actuator.stuck_share=1"]), 1, &METHOD, &ProgressBar::hidden()).unwrap();
    assert!(stuck.unfound.len() > 12, "{:?}", stuck.unfound);
    let far = room(&["actuator.offset_deg=4"]);
    let outcome = calibrate(&far, 2, &METHOD, &ProgressBar::hidden()).unwrap();
    assert!(!outcome.limited.is_empty(), "a correction beyond the drives' reserve is cut");
}
