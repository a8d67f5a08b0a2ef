//! The command line of the driver, on its own or as a command of `heliostat`.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::Subcommand;
use heliostat_array::Kit;
use heliostat_bus::{AccessRole, BusArgs, BusConfig};
use heliostat_proto::{MAX_ARRAYS, Room, Stamp};
use heliostat_service::exit::UnusableInput;
use heliostat_service::signals::stop_on_signals;
use heliostat_service::{EndArgs, LogArgs, MetricsArgs, duration, output};

use crate::config::Config;
use crate::devices::wall::Wall;
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
    /// The mirrors move. No controller may run in the room during the check: one that is there is
    /// named, and the check ends before it sends anything. The exit status is 1 if a rule is broken,
    /// if the device does not answer, or if an array that was stopped does not stop again.
    ///
    /// An array that starts stopped because its last state is unknown is re-armed first, and stopped
    /// again at the end, also after Ctrl-C, which ends the check after the present rule. A stop of an
    /// operator stays in force, also one during the check or at another array of the room: the check
    /// then ends with an error.
    Check(CheckArgs),
}

#[derive(Clone, Copy, Debug, clap::Args)]
struct ArrayArgs {
    /// Index of the array in a room with several ([[mirrors]] in the scenario), from 0
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = array_index)]
    array: usize,
}

// No doc comment: clap would show it in place of that of the command.
#[derive(Clone, Debug, clap::Args)]
#[allow(missing_docs)]
pub struct DrivenArgs {
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
    array: ArrayArgs,
}

impl DrivenArgs {
    /// The array of a configuration file, with its calibration. No device is opened yet.
    ///
    /// # Errors
    /// [`UnusableInput`]: a file that describes no array, or a calibration that does not fit it.
    pub fn kit(&self, config: &Path) -> Result<Kit<Wall>> {
        self.read(config).context(UnusableInput::new("the driver cannot start with this configuration"))
    }

    fn read(&self, config: &Path) -> Result<Kit<Wall>> {
        let wall = Config::load(config)?.wall().with_context(|| format!("in {}", config.display()))?;
        let mut kit = Kit::new(wall);
        if let Some(file) = &self.calibration {
            let corrections = calibration_store::load(file)?.message(Stamp { sequence: 1, ..Stamp::default() });
            kit.set_calibration(&corrections).with_context(|| format!("in {}", file.display()))?;
        }
        Ok(kit)
    }

    /// The settings of its driver in a room.
    pub fn settings(&self, bus: BusConfig) -> run::Settings {
        let variable = |name: &str| std::env::var(name).ok();
        let record = StopRecordSettings::of_driver(self.state.clone(), self.start_armed, variable);
        run::Settings { record, array: self.array.array, ..run::Settings::new(bus) }
    }
}

#[derive(Clone, Debug, clap::Args)]
struct RunArgs {
    /// TOML file of the boards and their mirrors
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    #[command(flatten)]
    driven: DrivenArgs,
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
    /// The driver's command topic, heliostat/v1/ROOM/mirrors/command, in place of --room and --array
    #[arg(value_name = "KEY")]
    key: Option<String>,
    #[command(flatten)]
    array: ArrayArgs,
    #[command(flatten)]
    bus: BusArgs,
    /// Seconds for which the check waits at most for the start of the driver
    #[arg(long, value_name = "N", default_value = "30", value_parser = duration::seconds, allow_negative_numbers = true)]
    wait: Duration,
    /// Print the findings as one JSON object
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// [`UnusableInput`] for a file that describes no array; a transport that fails, or a room with another driver. For the
/// check: a driver that is absent or breaks a rule.
pub fn run(args: Args) -> Result<()> {
    match args.command {
        Command::Run(args) => drive(&args),
        Command::Check(args) => check_driver(&args),
    }
}

fn drive(args: &RunArgs) -> Result<()> {
    let kit = args.driven.kit(&args.config)?;
    let bus = args.bus.config_or_connect(&[AccessRole::Driver])?;
    let stop = args.end.stop()?;
    let _log = args.log.start();
    tracing::info!(room = %bus.room, config = %args.config.display(), "driver starts");
    let settings = run::Settings { run_for: args.end.seconds, metrics: args.metrics, ..args.driven.settings(bus) };
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
    let mut array = args.array.array;
    if let Some(key) = &args.key {
        let (room, named) = array_of(key)?;
        (flags.room, array) = (Some(room.to_string()), named);
    }
    let config = flags.config_or_connect(&[AccessRole::Checker])?;
    let end = stop_on_signals()?;
    let requested = end.clone();
    std::thread::spawn(move || {
        requested.wait();
        output::note(
            "the check ends: a rule that has begun is judged first, and an array that it re-armed is stopped again",
        );
    });
    let report = check::run(&config, array, args.wait, &end, &output::note)?;
    if args.json {
        output::line(serde_json::to_string_pretty(&report)?)?
    } else {
        output::text(&report)?
    }
    match report.failure() {
        None => Ok(()),
        Some(reason) => bail!(reason),
    }
}

/// The room and the array of a command topic.
///
/// # Errors
/// [`UnusableInput`]: another text.
fn array_of(key: &str) -> Result<(Room, usize)> {
    let name = key.strip_prefix("heliostat/v1/").and_then(|rest| rest.split('/').next());
    if let Some(Ok(room)) = name.map(Room::new)
        && let Some(array) = room.array_of(key, &room.command())
    {
        return Ok((room, array));
    }
    let advice = if key.ends_with(".toml") {
        "; `heliostat driver run --config FILE` reads the file of an array, and this check tests the running driver"
    } else {
        ""
    };
    Err(UnusableInput::new(format!(
        "invalid command topic \"{key}\": expected heliostat/v1/ROOM/mirrors/command, or mirrors-N in place of mirrors \
         for array N from 1, or use --room ROOM and --array N{advice}"
    ))
    .into())
}

/// The index of an array, as a flag has it.
///
/// # Errors
/// What was expected of a text that is no index of an array of a room.
pub fn array_index(text: &str) -> Result<usize, String> {
    let index = text.parse().ok().filter(|index| (0..MAX_ARRAYS).contains(index));
    index.ok_or_else(|| format!("expected an integer from 0 to {}", MAX_ARRAYS - 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_in_place_of_a_command_topic_is_an_unusable_input_with_the_command_that_reads_it() {
        let (room, array) = array_of("heliostat/v1/studio/mirrors-2/command").expect("a command topic");
        assert_eq!((room.to_string(), array), ("studio".to_owned(), 2));
        for (key, names_file) in [("array.toml", true), ("studio", false)] {
            let error = array_of(key).expect_err("no command topic");
            assert!(error.is::<UnusableInput>(), "{error}");
            assert_eq!(error.to_string().contains("heliostat driver run --config FILE"), names_file, "{error}");
        }
    }
}
