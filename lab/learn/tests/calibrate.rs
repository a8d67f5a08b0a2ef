//! Calibration from measured gains: the loss by mounting errors, and the gain by calibration.

use heliostat_learn::calibrate::{Method, Settings, calibrate, study};
use heliostat_learn::comparison::EvaluatedPolicy;
use heliostat_models::ActorSource;
use heliostat_room::mirrors::actuator::Actuator;
use heliostat_room::random::{Purpose, stream};
use heliostat_scenario::Scenario;
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

/// Root mean square error of an array's angles over axes and commanded angles, in degrees.
fn residual_deg(scenario: &Scenario, (index, seed): (usize, u64), corrected: bool) -> f64 {
    let file = calibrate(scenario, (index, seed), &METHOD, &ProgressBar::hidden()).unwrap().file;
    let mut parameters = scenario.actuator.parameters();
    parameters.jitter_rad = 0.0;
    let mirrors = scenario.mirror_count();
    let mut squares = Vec::new();
    for commanded_deg in [-8.0, 0.0, 8.0] {
        let drive = |axis: &heliostat_array::calibration_file::AxisCorrections| {
            let correct = |mirror: usize| axis.gain[mirror] * commanded_deg + axis.offset_deg[mirror];
            (0..mirrors).map(|mirror| if corrected { correct(mirror) } else { commanded_deg }.to_radians()).collect()
        };
        let mut array = Actuator::new(&parameters, mirrors, stream(seed, Purpose::Actuator, index as u32));
        array.command(&heliostat_channel::MirrorAngles { roll: drive(&file.roll), yaw: drive(&file.yaw) });
        array.step(1.0);
        let angles = array.angles().roll.iter().chain(&array.angles().yaw);
        squares.extend(angles.map(|angle| (angle.to_degrees() - commanded_deg).powi(2)));
    }
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

#[test]
fn a_calibration_removes_most_of_a_mounting_error() {
    let plain = room(&[]);
    let (before, after) = (residual_deg(&plain, (0, 3), false), residual_deg(&plain, (0, 3), true));
    assert!(before > 0.7 && after < 0.15, "from {before} to {after} degrees");
    let scaled = room(&["actuator.scale_error_relative=0.03", "streams.channel.noise_relative=0.05"]);
    let after = residual_deg(&scaled, (0, 3), true);
    assert!(after < 0.25, "scale errors and noisy gains: {after} degrees");
}

#[test]
fn a_calibration_restores_the_sum_rate_lost_by_one_degree_of_mounting_error() {
    let settings = Settings {
        scenario: room(&["actuator.offset_deg=0"]),
        array: 0,
        mounting_deg: vec![1.0],
        seeds: 3,
        states: 30,
        policy: EvaluatedPolicy::parse("fixed-point", &ActorSource::Shipped).unwrap(),
        method: METHOD,
    };
    let (study, file) = study(&settings).unwrap();
    let row = &study.rows[0];
    assert!(row.uncalibrated_ratio.mean < 0.93, "without calibration there is a loss: {row:?}");
    assert!(row.calibrated_ratio.mean > 0.95, "{row:?}");
    assert_eq!((row.unfound, row.limited, file.roll.gain.len()), (0.0, 0.0, 16));
    assert!(row.readings > 100.0 && row.seconds > 1.0, "{row:?}");
    let again = calibrate(&room(&[]), (0, settings.scenario.seed), &METHOD, &ProgressBar::hidden()).unwrap();
    assert_eq!(again.file, file, "the seed determines the calibration");
}

#[test]
fn a_later_array_is_calibrated_alone_and_with_its_own_mounting() {
    let text = "[actuator]\nprofile = \"mems\"\noffset_deg = 1.0\n[[mirrors]]\nrows = 2\ncolumns = 2\n\
                [[mirrors]]\nrows = 2\ncolumns = 3\nwall = \"-x\"\n";
    let two = Scenario::from_toml(text).unwrap();
    let second = two.with_array_alone(1).unwrap();
    assert_eq!(second.mirrors.arrays(), &two.mirrors.arrays()[1..]);
    let (before, after) = (residual_deg(&second, (1, 3), false), residual_deg(&second, (1, 3), true));
    assert!(before > 0.7 && after < 0.15, "from {before} to {after} degrees");
    let settings = Settings {
        scenario: two,
        array: 1,
        mounting_deg: vec![1.0],
        seeds: 1,
        states: 2,
        policy: EvaluatedPolicy::parse("fixed-point", &ActorSource::Shipped).unwrap(),
        method: METHOD,
    };
    let (found, file) = study(&settings).unwrap();
    assert_eq!((found.array, file.rows, file.columns), (1, 2, 3));
    let [first, own] = [0, 1].map(|index| {
        calibrate(&second, (index, settings.scenario.seed), &METHOD, &ProgressBar::hidden()).unwrap().file
    });
    assert!(file == own && file != first, "the mounting is that of the array's index");
    let absent = study(&Settings { array: 2, ..settings }).unwrap_err().to_string();
    assert!(absent.contains("there is no mirror array 2: expected an index from 0 to 1"), "{absent}");
}

#[test]
fn arrays_that_cannot_be_calibrated_are_reported() {
    let paper = Scenario::builtin("paper").unwrap();
    let refusal = calibrate(&paper, (0, 1), &METHOD, &ProgressBar::hidden()).unwrap_err().to_string();
    assert!(refusal.contains("channel.mode = \"paper\"") && refusal.contains("specular"), "{refusal}");
    // The light of a stuck mirror is found at no detector, and its correction stays neutral.
    let stuck = calibrate(&room(&["actuator.stuck_share=1"]), (0, 1), &METHOD, &ProgressBar::hidden()).unwrap();
    assert!(stuck.unfound.len() > 12, "{:?}", stuck.unfound);
    let far = room(&["actuator.offset_deg=4"]);
    let outcome = calibrate(&far, (0, 2), &METHOD, &ProgressBar::hidden()).unwrap();
    assert!(!outcome.limited.is_empty(), "a correction beyond the travel of the drives is limited");
}
