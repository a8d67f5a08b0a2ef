//! The command line of the simulator, on its own or as a command of `heliostat`.

use std::path::PathBuf;

use anyhow::Result;
use heliostat_bus::{AccessRole, BusArgs};
use heliostat_driver::calibration_store;
use heliostat_driver::stop_record::StopRecordSettings;
use heliostat_scenario::ScenarioArgs;
use heliostat_service::{EndArgs, LogArgs, MetricsArgs, exit, output};

use crate::error::NodeError;
use crate::run;
use crate::settings::{Pace, Settings};

/// Help of --listen: of the two endpoints, the simulator has this one by default.
const LISTEN: &str = "Endpoint at which to listen (repeatable) [default without --connect: tcp/127.0.0.1:7447, or \
                      tls/127.0.0.1:7447 with --tls]";

/// Flags of the simulator.
#[derive(Clone, Debug, clap::Args)]
#[command(
    mut_arg("listen", |flag| flag.help(LISTEN)),
    mut_arg("connect", |flag| flag.help("Endpoint of another process or of a router (repeatable)"))
)]
pub struct Args {
    #[command(flatten)]
    scenario: ScenarioArgs,
    #[command(flatten)]
    bus: BusArgs,
    #[command(flatten)]
    metrics: MetricsArgs,
    #[command(flatten)]
    log: LogArgs,
    #[command(flatten)]
    end: EndArgs,
    /// Run so many ticks in simulated time, where each tick waits for its answer: the same seed
    /// gives the same run, bit for bit
    #[arg(long, value_name = "TICKS", conflicts_with = "seconds", value_parser = clap::value_parser!(u64).range(1..))]
    lockstep: Option<u64>,
    /// Correct the mirrors' mounting with this file of `heliostat calibrate`
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Keep the emergency stop over a restart, in one file per room in this folder; without it the
    /// array starts parked
    #[arg(long, value_name = "DIR", conflicts_with = "lockstep")]
    state: Option<PathBuf>,
    /// With --state: start parked if there is no file of the room, instead of stopped; a recorded
    /// stop stays in force
    #[arg(long, requires = "state")]
    start_armed: bool,
    /// Print the summary as one JSON object on the last line
    #[arg(long)]
    json: bool,
}

impl Args {
    /// The settings that the flags describe.
    ///
    /// # Errors
    /// An invalid flag, scenario or calibration file.
    pub fn settings(&self) -> Result<Settings> {
        let pace = match self.lockstep {
            Some(ticks) => Pace::Lockstep { ticks },
            None => Pace::Live { duration: self.end.seconds },
        };
        Ok(Settings {
            scenario: self.scenario.load_arrays()?,
            bus: self.bus.config_or_listen(&[AccessRole::Simulator])?,
            pace,
            metrics: self.metrics,
            calibration: self
                .calibration
                .as_deref()
                .map(calibration_store::load)
                .transpose()
                .map_err(exit::unusable)?,
            record: self
                .state
                .clone()
                .map(|directory| StopRecordSettings { directory: Some(directory), start_armed: self.start_armed }),
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
    let stop = args.end.stop()?;
    let _log = args.log.start();
    let summary = run::run(&settings, &stop).map_err(|error| match error {
        NodeError::World(_)
        | NodeError::Trace(_)
        | NodeError::Calibration(_)
        | NodeError::CalibrationOfSeveral { .. } => exit::unusable(error),
        error => error.into(),
    })?;
    if args.json {
        output::line(serde_json::to_string(&summary)?)?
    } else {
        output::text(summary)?
    }
    Ok(())
}
