//! The flags of `heliostat record` and `heliostat replay`.

use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use heliostat_bus::{BusArgs, BusConfig};
use heliostat_controller::node::{Stop, stop_channel, stop_with_parent};
use heliostat_controller::policy::PolicyKind;
use heliostat_proto::Room;
use heliostat_scenario::ScenarioArgs;
use serde::Serialize;

use crate::{play, recorder, replay};

/// Record everything that a room says into an MCAP file.
///
/// The file opens in Foxglove, and `heliostat replay` plays it back. Two peers hear each other only over a direct link: connect to the room's
/// process and to the controller, or let the controller connect here (--listen). Gaps are counted by sequence number and told at the end.
#[derive(Clone, Debug, clap::Args)]
pub struct RecordArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    #[command(flatten)]
    bus: BusArgs,
    /// The file to make; nothing is overwritten
    #[arg(long, value_name = "FILE.mcap")]
    out: PathBuf,
    /// End after this long
    #[arg(long, value_name = "N", value_parser = seconds)]
    seconds: Option<Duration>,
    /// End when everybody who came into the room has left it
    #[arg(long)]
    until_empty: bool,
    /// End when standard input closes
    #[arg(long)]
    exit_with_parent: bool,
    /// Print the account as one JSON object on the last line
    #[arg(long)]
    json: bool,
}

/// Play a recording into a controller, and see whether it decides as it did.
///
/// Without an endpoint the controller is one inside this process, and every command is compared with the recorded one; --verify makes the exit
/// status say whether all were the same. With --listen or --connect the recording takes the room's place for a controller that runs by itself.
#[derive(Clone, Debug, clap::Args)]
pub struct ReplayArgs {
    /// The recording
    file: PathBuf,
    /// Fail unless every command that can be judged comes out bit for bit as recorded
    #[arg(long, conflicts_with_all = ["listen", "connect"])]
    verify: bool,
    /// The policy, in place of the recorded one
    #[arg(long, value_enum)]
    policy: Option<PolicyKind>,
    /// ONNX file of a learned policy, in place of the built-in one
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Decisions of each epoch that are not judged: by default none of a lockstep run that is recorded from its beginning, else 200
    #[arg(long, value_name = "N")]
    settle: Option<u64>,
    /// Endpoint at which to listen for a controller (repeatable)
    #[arg(long, value_name = "ENDPOINT")]
    listen: Vec<String>,
    /// Endpoint of a controller or of a router (repeatable)
    #[arg(long, value_name = "ENDPOINT")]
    connect: Vec<String>,
    /// Name of the room to play in, in place of the recorded one
    #[arg(long, value_name = "NAME")]
    room: Option<String>,
    /// Print the verdict as one JSON object on the last line
    #[arg(long)]
    json: bool,
}

/// Records until Ctrl-C, the end of its time or of the room, and prints the account.
///
/// # Errors
/// Whatever keeps it from starting; a file that cannot be written to its end, after the account was printed.
pub fn record(args: RecordArgs) -> Result<()> {
    let (stop, stopped) = stop_channel();
    stop_on_signal(stop.clone())?;
    if args.exit_with_parent {
        stop_with_parent(stop);
    }
    let settings = recorder::Settings {
        scenario: args.scenario.load()?,
        bus: args.bus.config_or_connect()?,
        out: args.out,
        run_for: args.seconds,
        until_empty: args.until_empty,
    };
    let outcome = recorder::run(&settings, &stopped)?;
    print(args.json, &outcome, &outcome.account)?;
    if !outcome.complete {
        bail!("{}", outcome.problems.last().map_or("the recording is not complete", String::as_str));
    }
    if outcome.account.missing() > 0 {
        eprintln!("record: {} messages are missing, see the account", outcome.account.missing());
    }
    Ok(())
}

/// Replays, and prints the verdict.
///
/// # Errors
/// A recording that cannot be read or replayed; with `--verify`, one that came out otherwise.
pub fn replay(args: ReplayArgs) -> Result<()> {
    if !args.listen.is_empty() || !args.connect.is_empty() {
        let (stop, stopped) = stop_channel();
        stop_on_signal(stop)?;
        let room = match &args.room {
            Some(room) => Room::new(room)?,
            None => Room::new(&replay::open(&args.file)?.header().room)?,
        };
        let listening = args.listen.iter().fold(BusConfig::new(room), |config, endpoint| config.listen_at(endpoint));
        let bus = args.connect.iter().fold(listening, |config, endpoint| config.connect_to(endpoint));
        let playback = play::run(&args.file, &bus, &stopped)?;
        return print(args.json, &playback, &playback);
    }
    let settings = replay::Settings { file: args.file, policy: args.policy, model: args.model, settle: args.settle };
    let verdict = replay::run(&settings)?;
    print(args.json, &verdict, &verdict)?;
    if args.verify && !verdict.is_good() {
        bail!(
            "{} does not replay as recorded: {}",
            settings.file.display(),
            verdict.first_difference.as_deref().unwrap_or("nothing in it could be judged")
        );
    }
    Ok(())
}

fn print(json: bool, value: &impl Serialize, text: &impl std::fmt::Display) -> Result<()> {
    // Not println!, which panics when the reader is gone.
    let mut out = std::io::stdout();
    if json {
        writeln!(out, "{}", serde_json::to_string(value)?)?;
    } else {
        writeln!(out, "{text}")?;
    }
    Ok(())
}

fn seconds(text: &str) -> Result<Duration, String> {
    let value = text.parse().ok().filter(|value| (0.1..=1e7).contains(value));
    value.map(Duration::from_secs_f64).ok_or_else(|| "wanted 0.1 to 10000000".into())
}

fn stop_on_signal(stop: Stop) -> Result<()> {
    ctrlc::set_handler(move || {
        // The command may have ended already.
        let _ = stop.send(());
    })
    .context("cannot listen for Ctrl-C")
}
