//! `heliostat-lab calibrate`: how well `heliostat calibrate` measures rooms, and what that is worth.

use anyhow::{Result, ensure};
use heliostat_core::policy::PolicyKind;
use heliostat_learn::calibrate::{Row, Settings, Study, study};
use heliostat_learn::evaluation::Estimate;
use heliostat_scenario::ScenarioArgs;
use heliostat_service::counted::counted;
use heliostat_service::exit::UnusableInput;
use heliostat_service::outln;

/// Rates of reports that the receivers and trackers of a room may have, per second.
const REPORTS_HZ: std::ops::RangeInclusive<f64> = 1.0..=1000.0;

/// Errors of a spot in m; with larger ones the receiver is never where the session waits for it.
const SPOT_ERROR_M: std::ops::RangeInclusive<f64> = 0.0..=0.5;

/// Measure how well `heliostat calibrate` calibrates simulated rooms, and what it is worth.
///
/// Each episode is a room of its own, whose mirrors, LEDs, floor and tracker differ from the scenario as
/// mismatch.level says. The procedure of `heliostat calibrate` runs in it in virtual time: one user
/// carries one receiver to three spots and a place for the verification. The truth of the room judges
/// the result. Then the policy serves the room as assumed, with the corrections of the mirrors, and with
/// the measured room too; the ratios are those of the sum rate to the oracle in the true room. A spot
/// is searched where few mirrors light it, and rejected where most contradict it. Losses and latency of
/// reports, and the drives, come from the scenario.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Index of the array, from 0; the room has no other one meanwhile
    #[arg(long, value_name = "N", default_value_t = 0)]
    array: usize,
    /// Number of seeds, counted up from the scenario's
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    seeds: u32,
    /// Episodes of each seed, each a room of its own
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    episodes: u32,
    /// Policy that serves the rooms
    #[arg(long, value_enum, default_value = "greedy")]
    policy: PolicyKind,
    /// Position and channel reports a second during a calibration
    #[arg(long, value_name = "HZ", default_value_t = 20.0)]
    reports_hz: f64,
    /// A second user crosses the light of the mirrors at each place during a calibration
    #[arg(long)]
    passer_by: bool,
    /// How far from its true place the tracker reports the receiver at the second spot, in m, from 0 to 0.5
    #[arg(long, value_name = "M", default_value_t = 0.0)]
    spot_error_m: f64,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// An invalid scenario or flag, or a calibration without end.
pub fn run(args: Args) -> Result<()> {
    for (flag, value, range) in
        [("--reports-hz", args.reports_hz, REPORTS_HZ), ("--spot-error-m", args.spot_error_m, SPOT_ERROR_M)]
    {
        let expected = || UnusableInput::new(format!("{flag} {value}: expected {} to {}", range.start(), range.end()));
        ensure!(range.contains(&value), expected());
    }
    let study = study(&Settings {
        scenario: args.scenario.load_arrays()?,
        array: args.array,
        seeds: args.seeds as usize,
        episodes: args.episodes as usize,
        policy: args.policy,
        reports_hz: args.reports_hz,
        has_passer_by: args.passer_by,
        spot_error_m: args.spot_error_m,
    })?;
    if args.json {
        outln!("{}", serde_json::to_string(&study)?)?;
        return Ok(());
    }
    print(&study)
}

fn print(study: &Study) -> Result<()> {
    let Study { scenario, policy, seed, seeds, reports_hz, rows: [row], rooms, .. } = study;
    outln!(
        "{scenario}, {policy}, {reports_hz} reports/s: {} ({} from {seed}); {}",
        counted(rooms.len(), "room"),
        counted(*seeds, "seed"),
        match rooms.len() {
            1 => "one room gives no confidence interval: use --seeds 2 or more",
            _ => "± is the 95 % confidence interval of the mean",
        }
    )?;
    if study.is_as_described {
        outln!("  mismatch.level is none: the rooms are as described; --set mismatch.level=rough draws others")?;
    }
    let Row { readings, seconds, roll_deg, yaw_deg, led_cm, frame_cm, uncorrected, .. } = row;
    let lines = [
        ("readings", plus_minus(readings, 0)),
        ("time at the places, s", plus_minus(seconds, 0)),
        ("error of roll of corrected mirrors at held-out places, degrees", plus_minus(roll_deg, 3)),
        ("error of yaw of corrected mirrors at held-out places, degrees", plus_minus(yaw_deg, 3)),
        ("error of the LEDs' coordinates, cm", plus_minus(led_cm, 2)),
        ("error of the frame's height, cm", plus_minus(frame_cm, 2)),
        ("95 % intervals that hold the truth", format!("{:.3}", row.coverage)),
        ("mirrors without correction", plus_minus(uncorrected, 1)),
        ("rooms with a searched spot", format!("{} of {}", row.searched, rooms.len())),
        ("rooms with a rejected spot", format!("{} of {}", row.rejected, rooms.len())),
        ("calibrations written", format!("{} of {}", row.written, rooms.len())),
        ("ratio to the oracle, as assumed", plus_minus(&row.assumed_ratio, 3)),
        ("ratio with corrected mirrors", plus_minus(&row.mirrors_ratio, 3)),
        ("ratio with corrected mirrors and measured room", plus_minus(&row.calibrated_ratio, 3)),
        ("difference, room by room", plus_minus(&row.difference_ratio, 3)),
        ("rooms that became worse", format!("{} of {}", row.worse, rooms.len())),
    ];
    for (name, value) in lines {
        outln!("  {name:<62} {value}")?;
    }
    Ok(())
}

fn plus_minus(estimate: &Estimate, digits: usize) -> String {
    if estimate.ci95.is_nan() {
        return format!("{:.digits$}", estimate.mean);
    }
    format!("{:.digits$} ±{:.digits$}", estimate.mean, estimate.ci95)
}
