//! The flags of `heliostat record` and `heliostat replay`.

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Result, bail};
use heliostat_bus::BusArgs;
use heliostat_controller::policy::PolicyKind;
use heliostat_proto::Room;
use heliostat_scenario::ScenarioArgs;
use heliostat_service::{EndArgs, signals};
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
    #[command(flatten)]
    end: EndArgs,
    /// End when everybody who came into the room has left it
    #[arg(long)]
    until_empty: bool,
    /// Print the account as one JSON object on the last line
    #[arg(long)]
    json: bool,
}

/// Play a recording into a controller, and see whether it decides as it did.
///
/// By itself it takes the room's place for a controller that runs elsewhere: it listens where that controller connects, and plays at the recorded
/// pace. With --verify, --policy or --model it decides anew inside this process and compares every command with the recorded one. The exit status is 1
/// where --verify finds a difference, 2 where the file cannot be replayed.
#[derive(Clone, Debug, clap::Args)]
#[command(group = clap::ArgGroup::new("anew").multiple(true))]
pub struct ReplayArgs {
    /// The recording
    file: PathBuf,
    /// Decide anew, and fail unless every command that can be judged comes out bit for bit as recorded
    #[arg(long, group = "anew")]
    verify: bool,
    /// Decide anew by this policy in place of the recorded one
    #[arg(long, value_enum, group = "anew")]
    policy: Option<PolicyKind>,
    /// Decide anew by this ONNX file of a learned policy in place of the built-in one
    #[arg(long, visible_alias = "actor", value_name = "FILE", group = "anew")]
    model: Option<PathBuf>,
    /// Decisions of each epoch that are not judged: by default none of a lockstep run that is recorded from its beginning, else 200
    #[arg(long, value_name = "N", requires = "anew")]
    settle: Option<u64>,
    /// Endpoint at which to listen for a controller (repeatable); without any endpoint tcp/127.0.0.1:7447
    #[arg(long, value_name = "ENDPOINT", conflicts_with = "anew")]
    listen: Vec<String>,
    /// Endpoint of a controller or of a router (repeatable)
    #[arg(long, value_name = "ENDPOINT", conflicts_with = "anew")]
    connect: Vec<String>,
    /// Talk through a Zenoh router only, the one given by --connect
    #[arg(long, conflicts_with = "anew")]
    client: bool,
    /// Name of the room to play in, in place of the recorded one
    #[arg(long, value_name = "NAME", conflicts_with = "anew")]
    room: Option<Room>,
    /// Play at so many times the recorded pace, 0.01 to 100
    #[arg(long, value_name = "N", default_value_t = 1.0, value_parser = rate, conflicts_with = "anew")]
    rate: f64,
    /// Print what came out as one JSON object on the last line
    #[arg(long)]
    json: bool,
}

/// Records until Ctrl-C, the end of its time or of the room, and prints the account.
///
/// # Errors
/// Whatever keeps it from starting; a file that cannot be written to its end, after the account was printed.
pub fn record(args: RecordArgs) -> Result<()> {
    let stop = args.end.stop()?;
    let settings = recorder::Settings {
        scenario: args.scenario.load()?,
        bus: args.bus.config_or_connect()?,
        out: args.out,
        run_for: args.end.seconds,
        until_empty: args.until_empty,
    };
    let outcome = recorder::run(&settings, &stop)?;
    print(args.json, &outcome, &outcome.account)?;
    if let Some(failure) = &outcome.failure {
        bail!("{}: {failure}", outcome.file.display());
    }
    if outcome.account.missing() > 0 {
        drop(writeln!(
            std::io::stderr(),
            "record: {} messages are missing, see the account",
            outcome.account.missing()
        ));
    }
    Ok(())
}

/// Replays, and prints what came out.
///
/// # Errors
/// [`UnusableInput`](heliostat_service::exit::UnusableInput) where the recording cannot be replayed; with `--verify`, one that came out otherwise.
pub fn replay(args: ReplayArgs) -> Result<()> {
    if !args.verify && args.policy.is_none() && args.model.is_none() {
        return play(args);
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

fn play(args: ReplayArgs) -> Result<()> {
    let stop = signals::stop_on_signals()?;
    let bus = BusArgs { listen: args.listen, connect: args.connect, client: args.client, ..BusArgs::default() };
    let settings = play::Settings { file: args.file, room: args.room, bus, rate: args.rate };
    let playback = play::run(&settings, &stop)?;
    print(args.json, &playback, &playback)
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

fn rate(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|rate| (0.01..=100.0).contains(rate)).ok_or_else(|| "wanted 0.01 to 100".into())
}
