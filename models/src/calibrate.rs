//! `heliostat calibrate`: the mounting of each mirror, estimated from commanded angles and measured gains.
//!
//! Detectors stand at five known spots of an empty room. One mirror at a time is aimed at each spot, all others at the ceiling:
//!
//! 1. **Find** the light: about the aim of the law of reflection, nearest places first, until the spot is lit.
//! 2. **Centre** it: lines along yaw and roll, upwards and downwards, whose centroids are the angles at which the light is centred. The same lines, gone
//!    through in the model of an exact mirror, give the true angles; so what is asymmetric in the lit region cancels.
//! 3. **Fit** drive = gain * true + offset for each axis over the spots, which is the contract's calibration.
//!
//! A mirror whose light is found at no spot keeps gain 1 and offset 0. Corrections are held to what the drives can do beyond the range that
//! they announce. The simulator plays the room ([`mod@bench`]); nothing here looks at the mounting that it drew, but [`Study`] compares with it.

pub mod bench;
pub mod locate;
pub mod worth;

use anyhow::{Context, ensure};
use heliostat_array::calibration_file::{AxisCorrections, CalibrationFile};
use heliostat_proto::AxisLimits;
use heliostat_scenario::{ChannelMode, Scenario};
use indicatif::ProgressBar;
use serde::Serialize;

use crate::comparison::{Entrant, progress_bar};
use crate::evaluate::Estimate;
use bench::Bench;
use locate::{centre, find, fit};
use worth::Exam;

/// Standard deviation of the true angles of a mirror's spots below which only an offset is estimated, in rad.
const SPREAD_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;

/// How a measurement is made.
#[derive(Clone, Copy, Debug)]
pub struct Method {
    /// How long the light is averaged for a reading, in s.
    pub dwell_s: f64,
    /// How far off the light is looked for on either axis, in rad.
    pub search_rad: f64,
}

/// What came out for one array.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The corrections.
    pub file: CalibrationFile,
    /// Readings of the detectors.
    pub readings: u64,
    /// How long it took in s, as it would in a real room.
    pub seconds: f64,
    /// Mirrors whose light was found at no spot, ascending.
    pub unfound: Vec<usize>,
    /// Mirrors whose correction was cut to what the drives can do, ascending.
    pub limited: Vec<usize>,
}

/// Calibrates the array that a scenario and a seed make.
///
/// # Errors
/// A scenario that makes no room or gives angles that mean nothing to a real mirror, drives that do not answer.
pub fn calibrate(scenario: &Scenario, seed: u64, method: &Method, bar: &ProgressBar) -> anyhow::Result<Outcome> {
    ensure!(
        scenario.channel.mode == ChannelMode::Specular,
        "channel.mode = \"{}\" knows no spot of light to look for: use \"specular\"",
        scenario.channel.mode.name()
    );
    let mut bench = Bench::new(scenario, seed, method.dwell_s)?;
    let mirrors = scenario.mirror_count();
    let mut axes = [AxisCorrections::none(mirrors), AxisCorrections::none(mirrors)];
    let (mut unfound, mut limited) = (Vec::new(), Vec::new());
    for mirror in 0..mirrors {
        let places = measure(&mut bench, mirror, method.search_rad);
        if places.is_empty() {
            unfound.push(mirror);
        }
        let ranges = [bench.capabilities().roll, bench.capabilities().yaw];
        for (axis, corrections) in axes.iter_mut().enumerate().filter(|_| !places.is_empty()) {
            let of = |which: fn(&Place) -> [f64; 2]| places.iter().map(|place| which(place)[axis]).collect::<Vec<_>>();
            let (gain, offset) = fit(&of(|place| place.truth), &of(|place| place.drive), SPREAD_RAD);
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
    let file = CalibrationFile { rows: scenario.mirrors.rows, columns: scenario.mirrors.columns, roll, yaw };
    Ok(Outcome { file, readings: bench.readings(), seconds: bench.seconds(), unfound, limited })
}

/// Angles at which a mirror's light is centred on a spot: roll and yaw in rad.
struct Place {
    /// Of an exact mirror.
    truth: [f64; 2],
    /// As the drive has to be told.
    drive: [f64; 2],
}

/// Finds the light of a mirror at each spot; what is off at one spot is where the next is looked for.
fn measure(bench: &mut Bench, mirror: usize, search_rad: f64) -> Vec<Place> {
    let mut places: Vec<Place> = Vec::new();
    for pair in bench.pairs(mirror) {
        let off = |axis: usize| {
            let sum: f64 = places.iter().map(|place| place.drive[axis] - place.truth[axis]).sum();
            sum / places.len().max(1) as f64
        };
        let start = [pair.aim[0] + off(0), pair.aim[1] + off(1)];
        let Some(lit) = find(bench, &pair, start, search_rad) else { continue };
        let drive = centre(bench, &pair, lit);
        let truth = centre(&mut bench.expected(), &pair, pair.aim);
        places.push(Place { truth, drive });
    }
    places
}

/// To five decimals, far finer than any drive.
fn rounded(value: f64) -> f64 {
    (value * 1e5).round() / 1e5
}

/// The correction with its offset cut to what the drives can do at either end of the announced range.
fn within((gain, offset): (f64, f64), range: &AxisLimits, [least, most]: [f64; 2]) -> (f64, f64) {
    let (low, high) = (least - gain * f64::from(range.min_rad), most - gain * f64::from(range.max_rad));
    if low <= high { (gain, offset.clamp(low, high)) } else { within((1.0, offset), range, [least, most]) }
}

/// What to study: arrays of several mounting errors, and what is lost and won back.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The room; its seed is the first one.
    pub scenario: Scenario,
    /// Standard deviations of each axis' mounting in degrees.
    pub mounting_deg: Vec<f64>,
    /// Consecutive seeds; each is an array of its own.
    pub seeds: usize,
    /// States of each seed.
    pub states: usize,
    /// Who decides.
    pub entrant: Entrant,
    /// How it is measured.
    pub method: Method,
}

/// What came out.
#[derive(Clone, Debug, Serialize)]
pub struct Study {
    /// Name of the scenario.
    pub scenario: String,
    /// Hash of the effective scenario.
    pub configuration: String,
    /// Who decides.
    pub policy: String,
    /// The first seed.
    pub seed: u64,
    /// How many seeds, each an array of its own.
    pub seeds: usize,
    /// States of each seed.
    pub states: usize,
    /// One for each mounting error.
    pub rows: Vec<Row>,
}

/// One mounting error: means over arrays with 95 % intervals.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Standard deviation of each axis' mounting in degrees.
    pub mounting_deg: f64,
    /// Sum rate in Mbit/s without mounting error.
    pub exact_mbps: Estimate,
    /// As mounted.
    pub uncalibrated_mbps: Estimate,
    /// Calibrated.
    pub calibrated_mbps: Estimate,
    /// As mounted, over without error, array by array.
    pub uncalibrated_ratio: Estimate,
    /// Calibrated, over without error, array by array.
    pub calibrated_ratio: Estimate,
    /// Readings for an array.
    pub readings: f64,
    /// Seconds for an array, as they would pass in a real room.
    pub seconds: f64,
    /// Mirrors of an array whose light was found nowhere.
    pub unfound: f64,
    /// Mirrors of an array whose correction was cut to what the drives can do.
    pub limited: f64,
}

/// One array: its sum rates exact, as mounted and calibrated, and its calibration.
type OneArray = ([f64; 3], Outcome);

/// Studies; gives the calibration of the first array too. A progress bar on standard error shows how far it is.
///
/// # Errors
/// As [`calibrate`], and a policy that cannot be had for the room.
pub fn study(settings: &Settings) -> anyhow::Result<(Study, CalibrationFile)> {
    ensure!(settings.seeds > 0 && settings.states > 0, "a study needs a seed and a state at least");
    let scenario = &settings.scenario;
    let bar = progress_bar()?;
    bar.set_length((settings.mounting_deg.len() * settings.seeds * scenario.mirror_count()) as u64);
    let mut rows = Vec::new();
    let mut first = None;
    for mounting_deg in &settings.mounting_deg {
        bar.set_message(format!("mirrors, mounted to {mounting_deg} degrees"));
        let mounted = mounted(scenario, *mounting_deg, scenario.actuator.scale_error_relative)?;
        let arrays = (0..settings.seeds as u64).map(|set| one(settings, &mounted, set, &bar));
        let arrays: Vec<OneArray> = arrays.collect::<anyhow::Result<_>>()?;
        first = first.or_else(|| arrays.first().map(|(_, outcome)| outcome.file.clone()));
        rows.push(Row::of(*mounting_deg, &arrays));
    }
    bar.finish_and_clear();
    let study = Study {
        scenario: scenario.name.clone(),
        configuration: scenario.hash(),
        policy: settings.entrant.name().to_owned(),
        seed: scenario.seed,
        seeds: settings.seeds,
        states: settings.states,
        rows,
    };
    Ok((study, first.context("no mounting error to study")?))
}

fn mounted(scenario: &Scenario, offset_deg: f64, scale_error: Option<f64>) -> anyhow::Result<Scenario> {
    let scale_error = scale_error.unwrap_or(0.0);
    let keys = [("offset_deg", offset_deg), ("scale_error_relative", scale_error)];
    Ok(scenario.with_overrides(&keys.map(|(key, value)| format!("actuator.{key}={value:?}")))?)
}

fn one(settings: &Settings, mounted_so: &Scenario, set: u64, bar: &ProgressBar) -> anyhow::Result<OneArray> {
    let seed = settings.scenario.seed.wrapping_add(set);
    let exact = mounted(&settings.scenario, 0.0, None)?;
    let mut exam = Exam::new(&exact, &settings.entrant, seed, settings.states)?;
    let outcome = calibrate(mounted_so, seed, &settings.method, bar)?;
    let rates = [
        exam.sum_rate_mbps(&exact, seed, None)?,
        exam.sum_rate_mbps(mounted_so, seed, None)?,
        exam.sum_rate_mbps(mounted_so, seed, Some(&outcome.file))?,
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
