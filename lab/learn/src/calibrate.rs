//! `heliostat-lab calibrate`: the mounting of each mirror, estimated from commanded angles and measured
//! gains.
//!
//! Detectors stand at five known positions of an empty room. One mirror at a time is aimed at each
//! detector, and all others at the ceiling:
//!
//! 1. **Find** the light. The search starts at the aim by the law of reflection and goes outwards
//!    until the detector is lit.
//! 2. **Centre** it. Scans along yaw and roll, in both directions, have centroids at the angles at
//!    which the light is centred. The same scans in the model of an exact mirror give the true
//!    angles, so that an asymmetry of the lit region cancels.
//! 3. **Fit** drive = gain * true + offset for each axis over the detectors, which is the
//!    contract's calibration.
//!
//! A mirror whose light is found at no detector keeps gain 1 and offset 0. Corrections are limited
//! to the travel of the drives beyond the range that they announce. The simulator takes the place
//! of the room ([`mod@bench`]). The estimate does not read the mounting that the simulator drew;
//! [`Study`] compares the two.

pub mod bench;
pub mod locate;
pub mod worth;

use anyhow::{Context, ensure};
use heliostat_array::calibration::{GAIN_RANGE, OFFSET_MAX_RAD};
use heliostat_array::calibration_file::{AxisCorrections, CalibrationFile};
use heliostat_proto::AxisLimits;
use heliostat_scenario::{ChannelMode, Mirrors, Scenario};
use indicatif::ProgressBar;
use serde::Serialize;

use crate::comparison::{EvaluatedPolicy, progress_bar};
use crate::evaluation::Estimate;
use bench::Bench;
use locate::{centre, find, fit};
use worth::Evaluation;

/// Standard deviation of a mirror's true angles below which only an offset is estimated, in rad.
const SPREAD_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;

/// The method of a measurement.
#[derive(Clone, Copy, Debug)]
pub struct Method {
    /// Averaging time of a reading in s.
    pub dwell_s: f64,
    /// Half the width of the search on each axis in rad.
    pub search_rad: f64,
}

/// The calibration of one array.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The corrections.
    pub file: CalibrationFile,
    /// Number of readings.
    pub readings: u64,
    /// Time in s that the readings take in a real room.
    pub seconds: f64,
    /// Mirrors whose light was found at no detector, ascending.
    pub unfound: Vec<usize>,
    /// Mirrors whose correction was limited to the travel of the drives, ascending.
    pub limited: Vec<usize>,
}

/// Calibrates the array of a scenario with one array, as a seed mounts it.
///
/// `index` is that of the array in its room, which determines its mounting too.
///
/// # Errors
/// The scenario describes no room, its channel mode has no spot of light, or the drives do not
/// answer.
pub fn calibrate(
    scenario: &Scenario,
    (index, seed): (usize, u64),
    method: &Method,
    bar: &ProgressBar,
) -> anyhow::Result<Outcome> {
    ensure!(
        scenario.channel.mode == ChannelMode::Specular,
        "channel.mode = \"{}\" has no spot of light: expected \"specular\"",
        scenario.channel.mode.name()
    );
    let mut bench = Bench::new(scenario, (index, seed), method.dwell_s)?;
    let mirrors = scenario.mirror_count();
    let mut axes = [AxisCorrections::none(mirrors), AxisCorrections::none(mirrors)];
    let (mut unfound, mut limited) = (Vec::new(), Vec::new());
    for mirror in 0..mirrors {
        let aims = measure(&mut bench, mirror, method.search_rad);
        if aims.is_empty() {
            unfound.push(mirror);
        }
        let ranges = [bench.capabilities().roll, bench.capabilities().yaw];
        for (axis, corrections) in axes.iter_mut().enumerate().filter(|_| !aims.is_empty()) {
            let of = |which: fn(&Aim) -> [f64; 2]| aims.iter().map(|aim| which(aim)[axis]).collect::<Vec<_>>();
            let (gain, offset) = fit(&of(|aim| aim.truth), &of(|aim| aim.drive), SPREAD_RAD);
            let fitted = (rounded(gain), offset);
            let (gain, offset) = within(fitted, &ranges[axis], bench.travel_rad()[axis]);
            if (gain, offset) != fitted && limited.last() != Some(&mirror) {
                limited.push(mirror);
            }
            (corrections.gain[mirror], corrections.offset_deg[mirror]) = (gain, rounded(offset.to_degrees()));
        }
        bar.inc(1);
    }
    if let Some(failure) = bench.take_failure() {
        return Err(failure).context("the array did not answer");
    }
    let [roll, yaw] = axes;
    let Mirrors { rows, columns, .. } = *scenario.mirrors.first();
    let file = CalibrationFile { rows, columns, roll, yaw };
    Ok(Outcome { file, readings: bench.readings(), seconds: bench.seconds(), unfound, limited })
}

/// Angles at which a mirror's light is centred on a detector: roll and yaw in rad.
struct Aim {
    /// The angles of an exact mirror.
    truth: [f64; 2],
    /// The angles of the drive's command.
    drive: [f64; 2],
}

/// Finds the light of a mirror at each detector; the mean error so far is the start of the next
/// search.
fn measure(bench: &mut Bench, mirror: usize, search_rad: f64) -> Vec<Aim> {
    let mut aims: Vec<Aim> = Vec::new();
    for pair in bench.pairs(mirror) {
        let off = |axis: usize| {
            let sum: f64 = aims.iter().map(|aim| aim.drive[axis] - aim.truth[axis]).sum();
            sum / aims.len().max(1) as f64
        };
        let start = [pair.aim[0] + off(0), pair.aim[1] + off(1)];
        let Some(lit) = find(bench, &pair, start, search_rad) else { continue };
        let drive = centre(bench, &pair, lit);
        let truth = centre(&mut bench.expected(), &pair, pair.aim);
        aims.push(Aim { truth, drive });
    }
    aims
}

/// Rounds to five decimals, far finer than any drive.
fn rounded(value: f64) -> f64 {
    (value * 1e5).round() / 1e5
}

/// The correction with its offset limited to that of a calibration, and to the drives' travel at
/// both ends of the announced range.
fn within((gain, offset): (f64, f64), range: &AxisLimits, [least, most]: [f64; 2]) -> (f64, f64) {
    let low = (least - gain * f64::from(range.min_rad)).max(-OFFSET_MAX_RAD);
    let high = (most - gain * f64::from(range.max_rad)).min(OFFSET_MAX_RAD);
    if low <= high && (GAIN_RANGE[0]..=GAIN_RANGE[1]).contains(&gain) {
        (gain, offset.clamp(low, high))
    } else {
        within((1.0, offset), range, [least, most])
    }
}

/// The settings of a study: the loss by mounting errors, and the gain by calibration.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The room; its seed is the first one.
    pub scenario: Scenario,
    /// Index of the array that is calibrated; the room has no other one meanwhile.
    pub array: usize,
    /// Standard deviations of each axis' mounting error in degrees.
    pub mounting_deg: Vec<f64>,
    /// Number of consecutive seeds; each is a separate array.
    pub seeds: usize,
    /// States of each seed.
    pub states: usize,
    /// The policy.
    pub policy: EvaluatedPolicy,
    /// The method of the measurement.
    pub method: Method,
}

/// The result of a study.
#[derive(Clone, Debug, Serialize)]
pub struct Study {
    /// Name of the scenario.
    pub scenario: String,
    /// Hash of the effective scenario.
    pub configuration: String,
    /// Index of the calibrated array; the sum rates are those of this array alone.
    pub array: usize,
    /// Name of the policy.
    pub policy: String,
    /// The first seed.
    pub seed: u64,
    /// Number of seeds, each a separate array.
    pub seeds: usize,
    /// States of each seed.
    pub states: usize,
    /// One row for each mounting error.
    pub rows: Vec<Row>,
}

/// One mounting error: means over arrays with 95 % intervals.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Standard deviation of each axis' mounting error in degrees.
    pub mounting_deg: f64,
    /// Sum rate in Mbit/s without mounting error.
    pub exact_mbps: Estimate,
    /// Sum rate in Mbit/s with the mounting error.
    pub uncalibrated_mbps: Estimate,
    /// Sum rate in Mbit/s after calibration.
    pub calibrated_mbps: Estimate,
    /// Sum rate with the mounting error over that without, array by array.
    pub uncalibrated_ratio: Estimate,
    /// Sum rate after calibration over that without error, array by array.
    pub calibrated_ratio: Estimate,
    /// Readings for an array.
    pub readings: f64,
    /// Time for an array in a real room, in s.
    pub seconds: f64,
    /// Mirrors of an array whose light was found at no detector.
    pub unfound: f64,
    /// Mirrors of an array whose correction was limited to the travel of the drives.
    pub limited: f64,
}

/// One array: its sum rates without error, as mounted and after calibration, and its calibration.
type OneArray = ([f64; 3], Outcome);

/// Runs a study with a progress bar on standard error; returns the calibration of the first array
/// too.
///
/// # Errors
/// As [`calibrate`]; the policy cannot be built for the room.
pub fn study(settings: &Settings) -> anyhow::Result<(Study, CalibrationFile)> {
    ensure!(settings.seeds > 0 && settings.states > 0, "a study needs at least one seed and one state");
    let scenario = &settings.scenario.with_array_alone(settings.array)?;
    let bar = progress_bar()?;
    bar.set_length((settings.mounting_deg.len() * settings.seeds * scenario.mirror_count()) as u64);
    let mut rows = Vec::new();
    let mut first = None;
    for mounting_deg in &settings.mounting_deg {
        bar.set_message(format!("mirrors, mounted to {mounting_deg} degrees"));
        let mounted = mounted(scenario, *mounting_deg, scenario.actuator.scale_error_relative)?;
        let arrays = (0..settings.seeds as u64).map(|set| one(settings, (scenario, &mounted), set, &bar));
        let arrays: Vec<OneArray> = arrays.collect::<anyhow::Result<_>>()?;
        first = first.or_else(|| arrays.first().map(|(_, outcome)| outcome.file.clone()));
        rows.push(Row::of(*mounting_deg, &arrays));
    }
    bar.finish_and_clear();
    let study = Study {
        scenario: scenario.name.clone(),
        configuration: settings.scenario.hash(),
        array: settings.array,
        policy: settings.policy.name().to_owned(),
        seed: scenario.seed,
        seeds: settings.seeds,
        states: settings.states,
        rows,
    };
    Ok((study, first.context("a study needs at least one mounting error")?))
}

fn mounted(scenario: &Scenario, offset_deg: f64, scale_error: Option<f64>) -> anyhow::Result<Scenario> {
    let scale_error = scale_error.unwrap_or(0.0);
    let keys = [("offset_deg", offset_deg), ("scale_error_relative", scale_error)];
    Ok(scenario.with_overrides(&keys.map(|(key, value)| format!("actuator.{key}={value:?}")))?)
}

fn one(
    settings: &Settings,
    (scenario, mounted): (&Scenario, &Scenario),
    set: u64,
    bar: &ProgressBar,
) -> anyhow::Result<OneArray> {
    let seed = scenario.seed.wrapping_add(set);
    let drawn = (settings.array, seed);
    let exact = self::mounted(scenario, 0.0, None)?;
    let mut evaluation = Evaluation::new(&exact, &settings.policy, seed, settings.states)?;
    let outcome = calibrate(mounted, drawn, &settings.method, bar)?;
    let rates = [
        evaluation.sum_rate_mbps(&exact, drawn, None)?,
        evaluation.sum_rate_mbps(mounted, drawn, None)?,
        evaluation.sum_rate_mbps(mounted, drawn, Some(&outcome.file))?,
    ];
    Ok((rates, outcome))
}

impl Row {
    fn of(mounting_deg: f64, arrays: &[OneArray]) -> Self {
        let estimate = |value: fn(&[f64; 3]) -> f64| {
            Estimate::of(&arrays.iter().map(|(rates, _)| value(rates)).collect::<Vec<_>>())
        };
        let mean = |value: fn(&Outcome) -> f64| {
            arrays.iter().map(|(_, outcome)| value(outcome)).sum::<f64>() / arrays.len() as f64
        };
        Self {
            mounting_deg,
            exact_mbps: estimate(|rates| rates[0]),
            uncalibrated_mbps: estimate(|rates| rates[1]),
            calibrated_mbps: estimate(|rates| rates[2]),
            uncalibrated_ratio: estimate(|rates| rates[1] / rates[0]),
            calibrated_ratio: estimate(|rates| rates[2] / rates[0]),
            readings: mean(|outcome| outcome.readings as f64),
            seconds: mean(|outcome| outcome.seconds),
            unfound: mean(|outcome| outcome.unfound.len() as f64),
            limited: mean(|outcome| outcome.limited.len() as f64),
        }
    }
}
