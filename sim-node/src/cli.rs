//! The command line of the simulator, on its own or as a command of `heliostat`.

use std::io::{Read, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, Result};
use heliostat_bus::BusArgs;
use heliostat_driver::calibration_store;
use heliostat_metrics::{LogArgs, MetricsArgs};
use heliostat_scenario::ScenarioArgs;

use crate::run;
use crate::settings::{Pace, Settings};

/// What is logged unless RUST_LOG says otherwise; Zenoh warns about the discovery that we switched
/// off.
const DEFAULT_LOG: &str = "warn,zenoh=error,heliostat_sim_node=info,heliostat_metrics=info";

/// Flags of the simulator.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scenario: ScenarioArgs,
    #[command(flatten)]
    bus: BusArgs,
    #[command(flatten)]
    metrics: MetricsArgs,
    #[command(flatten)]
    log: LogArgs,
    /// End after this many seconds; without it, run until stopped
    #[arg(long, value_name = "N", value_parser = seconds)]
    seconds: Option<Duration>,
    /// Run so many ticks in simulated time, where each tick waits for its answer: the same seed
    /// gives the same run, bit for bit
    #[arg(long, value_name = "TICKS", conflicts_with = "seconds", value_parser = clap::value_parser!(u64).range(1..))]
    lockstep: Option<u64>,
    /// Correct the mirrors' mounting with this file of `heliostat calibrate`
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Print the summary as one JSON object on the last line
    #[arg(long)]
    json: bool,
    /// End when the standard input is closed, as it is when the starting process ends
    #[arg(long)]
    exit_with_parent: bool,
}

impl Args {
    /// The settings that the flags describe.
    ///
    /// # Errors
    /// An invalid flag, scenario or calibration file.
    pub fn settings(&self) -> Result<Settings> {
        let pace = match self.lockstep {
            Some(ticks) => Pace::Lockstep { ticks },
            None => Pace::Live { duration: self.seconds },
        };
        Ok(Settings {
            scenario: self.scenario.load()?,
            bus: self.bus.config_or_listen()?,
            pace,
            metrics: self.metrics,
            calibration: self.calibration.as_deref().map(calibration_store::load).transpose()?,
        })
    }
}

/// Runs the simulator until its end, Ctrl-C or SIGTERM, and prints its summary.
///
/// # Errors
/// A scenario that cannot be read, a room that cannot be created, a transport that fails, another
/// driver or simulator in the room, a tick of a lockstep run without an answer.
pub fn run(args: Args) -> Result<()> {
    let settings = args.settings()?;
    let stop = Arc::new(AtomicBool::new(false));
    stop_on_signals(&stop)?;
    if args.exit_with_parent {
        stop_with_parent(&stop);
    }
    args.log.begin(DEFAULT_LOG);
    let summary = run::run(&settings, &stop)?;
    // Not println!, which panics when the reader is gone.
    let mut out = std::io::stdout();
    if args.json {
        writeln!(out, "{}", serde_json::to_string(&summary)?)?;
    } else {
        write!(out, "{summary}")?;
    }
    Ok(())
}

fn seconds(text: &str) -> Result<Duration, String> {
    let value: f64 = text.parse().map_err(|_| format!("`{text}` is no number of seconds"))?;
    Duration::try_from_secs_f64(value).map_err(|_| format!("`{text}` is no length of time"))
}

/// The first signal ends the run in good order; a second ends the process.
fn stop_on_signals(stop: &Arc<AtomicBool>) -> Result<()> {
    let stop = Arc::clone(stop);
    let handler = move || {
        if stop.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
    };
    ctrlc::set_handler(handler).context("cannot watch for Ctrl-C")
}

fn stop_with_parent(stop: &Arc<AtomicBool>) {
    let stop = Arc::clone(stop);
    std::thread::spawn(move || {
        let mut buffer = [0; 256];
        // A read error also means that the parent process has ended.
        while std::io::stdin().read(&mut buffer).is_ok_and(|count| count > 0) {}
        stop.store(true, Ordering::Relaxed);
    });
}
