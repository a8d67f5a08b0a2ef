//! `heliostat-lab calibrate`: estimates the mounting error of each mirror from commanded angles and
//! measured gains.

use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use heliostat_learn::calibrate::{Method, Row, Settings, Study, study};
use heliostat_learn::comparison::EvaluatedPolicy;
use heliostat_learn::evaluation::Estimate;
use heliostat_models::ActorSource;
use heliostat_scenario::{STUDY_SCENARIO, ScenarioArgs};
use heliostat_service::counted::counted;

use heliostat_service::outln;

/// Estimate the mounting error of each mirror from measured gains.
///
/// The array is simulated: its axes have random mounting errors. Detectors at five known positions
/// measure one mirror after the other. The output compares the sum rate without mounting error,
/// with it, and after calibration. Settling time, slew rate, jitter, hysteresis and quantisation
/// come from the scenario's actuator; the noise comes from its receiver and from
/// streams.channel.noise_relative.
#[derive(Debug, clap::Args)]
#[command(mut_arg("scenario", |argument| argument.default_value(STUDY_SCENARIO)))]
pub struct Args {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Index of the array, from 0; the other arrays of the room are covered meanwhile
    #[arg(long, value_name = "N", default_value_t = 0)]
    array: usize,
    /// Mounting errors to simulate: standard deviation of each axis in degrees, separated by commas
    #[arg(long, value_name = "A,B", value_delimiter = ',', default_value = "1,2")]
    mounting_deg: Vec<f64>,
    /// Number of arrays for each mounting error; seeds count up from the scenario's
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    seeds: u32,
    /// States for the sum rate of each array
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    states: u32,
    /// Policy by name, or path of an ONNX actor
    #[arg(long, value_name = "POLICY", default_value = "fixed-point")]
    policy: String,
    /// Averaging time of a reading in ms
    #[arg(long, value_name = "MS", default_value_t = 1.0)]
    dwell_ms: f64,
    /// Search range on each axis in degrees
    #[arg(long, value_name = "DEG", default_value_t = 8.0)]
    search_deg: f64,
    /// Write the calibration of the first array of the first mounting error, for --calibration of
    /// sim-node and driver run
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// An invalid scenario or flag, a file that cannot be written.
pub fn run(args: Args) -> Result<()> {
    for (flag, value, most) in [("--dwell-ms", args.dwell_ms, 1e4), ("--search-deg", args.search_deg, 30.0)] {
        ensure!(value > 0.0 && value <= most, "{flag} {value}: expected more than 0 and at most {most}");
    }
    if let Some(out) = &args.out {
        ensure!(!out.exists(), "{} exists already; expected a new file", out.display());
        let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        ensure!(folder.is_dir(), "cannot write {}: there is no folder {}", out.display(), folder.display());
    }
    let settings = Settings {
        scenario: args.scenario.load_arrays()?,
        array: args.array,
        mounting_deg: args.mounting_deg,
        seeds: args.seeds as usize,
        states: args.states as usize,
        policy: EvaluatedPolicy::parse(&args.policy, &ActorSource::Shipped)?,
        method: Method { dwell_s: args.dwell_ms * 1e-3, search_rad: args.search_deg.to_radians() },
    };
    let (study, file) = study(&settings)?;
    if let Some(out) = &args.out {
        heliostat_driver::calibration_store::save(&file, out)?;
    }
    if args.json {
        outln!("{}", serde_json::to_string(&study)?)?;
    } else {
        print(&study)?;
        if let Some(out) = &args.out {
            outln!(
                "written: {}, the array of seed {} mounted to {} degrees",
                out.display(),
                study.seed,
                study.rows[0].mounting_deg
            )?;
        }
    }
    Ok(())
}

fn print(study: &Study) -> Result<()> {
    let Study { scenario, policy, seed, seeds, states, rows, .. } = study;
    outln!(
        "{scenario}, {policy}: sum rate in Mbit/s over {} (seeds from {seed}) with {} each; {}",
        counted(*seeds, "array"),
        counted(*states, "state"),
        match seeds {
            1 => "one seed gives no confidence interval: use --seeds 2 or more",
            _ => "± is the 95 % confidence interval of the mean",
        }
    )?;
    outln!(
        "{:>8} {:>14} {:>14} {:>14} {:>15} {:>15} {:>9} {:>8} {:>9} {:>8}",
        "mounting",
        "no error",
        "uncalibrated",
        "calibrated",
        "ratio uncal.",
        "ratio cal.",
        "readings",
        "seconds",
        "not found",
        "limited"
    )?;
    for row in rows {
        let Row { exact_mbps, uncalibrated_mbps, calibrated_mbps, uncalibrated_ratio, calibrated_ratio, .. } = row;
        outln!(
            "{:>6} ° {:>14} {:>14} {:>14} {:>15} {:>15} {:>9.0} {:>8.0} {:>9.1} {:>8.1}",
            row.mounting_deg,
            plus_minus(exact_mbps, 1),
            plus_minus(uncalibrated_mbps, 1),
            plus_minus(calibrated_mbps, 1),
            plus_minus(uncalibrated_ratio, 3),
            plus_minus(calibrated_ratio, 3),
            row.readings,
            row.seconds,
            row.unfound,
            row.limited,
        )?;
    }
    outln!(
        "ratio: to the sum rate of the same array without mounting error; readings and seconds: for one array in real time"
    )?;
    outln!(
        "not found: mirrors without a reading at any position; limited: mirrors whose correction exceeds the range of the drives"
    )?;
    Ok(())
}

fn plus_minus(estimate: &Estimate, digits: usize) -> String {
    if estimate.ci95.is_nan() {
        return format!("{:.digits$}", estimate.mean);
    }
    format!("{:.digits$} ±{:.digits$}", estimate.mean, estimate.ci95)
}
