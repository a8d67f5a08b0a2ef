//! The command line of the driver, on its own or as a command of `heliostat`.

use std::path::PathBuf;

use anyhow::{Context, Result, bail, ensure};
use clap::Subcommand;
use heliostat_array::Kit;
use heliostat_bus::{AccessRole, BusArgs};
use heliostat_proto::{Room, Stamp};
use heliostat_service::counted::counted;
use heliostat_service::{EndArgs, LogArgs, MetricsArgs, output};

use crate::config::Config;
use crate::stop_record::StopRecordSettings;
use crate::{calibration_store, check, run};

/// Flags of the driver.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Clone, Debug, Subcommand)]
enum Command {
    /// Control the mirrors of the hardware that a file describes
    Run(RunArgs),
    /// Send valid and invalid messages to a driver and report which rules of the contract it keeps
    ///
    /// The mirrors move. No controller may run in the room during the check. The exit status is 1
    /// if a rule is broken.
    ///
    /// An array that starts stopped because its last state is unknown is re-armed first. A stop of
    /// an operator stays in force: the check then ends with an error.
    Check(CheckArgs),
}

#[derive(Clone, Debug, clap::Args)]
struct RunArgs {
    /// TOML file of the boards and their mirrors
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Correct the mirrors' mounting with this file of `heliostat calibrate`
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Keep the emergency stop over a restart, in one file per room in this folder [default:
    /// $STATE_DIRECTORY, else $XDG_STATE_HOME/heliostat or ~/.local/state/heliostat]
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
    /// Start parked if there is no file of the room, instead of stopped: declares the first start
    /// safe. A recorded stop stays in force
    #[arg(long)]
    start_armed: bool,
    #[command(flatten)]
    bus: BusArgs,
    #[command(flatten)]
    metrics: MetricsArgs,
    #[command(flatten)]
    log: LogArgs,
    #[command(flatten)]
    end: EndArgs,
    /// Print the summary as one JSON object on the last line
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Debug, clap::Args)]
struct CheckArgs {
    /// The driver's command topic, heliostat/v1/ROOM/mirrors/command, in place of --room
    #[arg(value_name = "KEY")]
    key: Option<String>,
    #[command(flatten)]
    bus: BusArgs,
    /// Print the findings as one JSON object
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// A file that describes no array, a transport that fails, or a room with another driver. For the
/// check: a driver that is absent or breaks a rule.
pub fn run(args: Args) -> Result<()> {
    match args.command {
        Command::Run(args) => drive(&args),
        Command::Check(args) => check_driver(&args),
    }
}

fn drive(args: &RunArgs) -> Result<()> {
    let wall = Config::load(&args.config)?.wall().with_context(|| format!("in {}", args.config.display()))?;
    let mut kit = Kit::new(wall);
    if let Some(file) = &args.calibration {
        let corrections = calibration_store::load(file)?.message(Stamp { sequence: 1, ..Stamp::default() });
        kit.set_calibration(&corrections).with_context(|| format!("in {}", file.display()))?;
    }
    let bus = args.bus.config_or_connect(&[AccessRole::Driver])?;
    let stop = args.end.stop()?;
    args.log.start();
    tracing::info!(room = %bus.room, config = %args.config.display(), "driver starts");
    let record = StopRecordSettings::of_driver(args.state.clone(), args.start_armed, |name| std::env::var(name).ok());
    let settings =
        run::Settings { run_for: args.end.seconds, metrics: args.metrics, record, ..run::Settings::new(bus) };
    let summary = run::run(kit, &settings, &stop)?;
    if args.json {
        output::line(serde_json::to_string(&summary)?)?
    } else {
        output::text(summary)?
    }
    Ok(())
}

fn check_driver(args: &CheckArgs) -> Result<()> {
    let mut flags = args.bus.clone();
    if let Some(key) = &args.key {
        flags.room = Some(room_of(key)?.to_string());
    }
    let report = check::run(&flags.config_or_connect(&[AccessRole::Checker])?)?;
    if args.json {
        output::line(serde_json::to_string_pretty(&report)?)?
    } else {
        output::text(&report)?
    }
    let broken = report.broken().count();
    ensure!(broken == 0, "the driver of room \"{}\" breaks {} of the contract", report.room, counted(broken, "rule"));
    Ok(())
}

/// The room of a command topic.
fn room_of(key: &str) -> Result<Room> {
    let name = key.strip_prefix("heliostat/v1/").and_then(|rest| rest.strip_suffix("/mirrors/command"));
    match name.map(Room::new) {
        Some(Ok(room)) => Ok(room),
        _ => bail!("invalid command topic \"{key}\": expected heliostat/v1/ROOM/mirrors/command, or use --room ROOM"),
    }
}
