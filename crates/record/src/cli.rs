//! The flags of `heliostat record` and `heliostat replay`.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Result, bail, ensure};
use heliostat_bus::{AccessRole, BusArgs, TlsArgs};
use heliostat_core::policy::PolicyKind;
use heliostat_files::shell_word;
use heliostat_proto::Room;
use heliostat_scenario::{BUILTIN_NAMES, ScenarioArgs};
use heliostat_service::exit::UnusableInput;
use heliostat_service::printable::printable;
use heliostat_service::{EndArgs, LogArgs, MetricsArgs, duration, output, signals};
use serde::Serialize;

use crate::ring::Bounds;
use crate::{play, recorder, replay};

/// Record all messages of a room into an MCAP file.
///
/// The file opens in Foxglove, and `heliostat replay` plays it back. Peers exchange messages over
/// direct links only: connect to the processes of the room that listen (--connect), and let tracker, driver
/// and controller connect to this process (--listen). A stream that a replay needs and that is missing is reported
/// after some seconds and at the end. Missing messages are counted by sequence number and reported at the end.
#[derive(Clone, Debug, clap::Args)]
pub struct RecordArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    #[command(flatten)]
    bus: BusArgs,
    /// The file to create; an existing file is not overwritten
    #[arg(long, value_name = "FILE.mcap")]
    out: PathBuf,
    /// Keep a ring of files FILE-0001.mcap, FILE-0002.mcap ... of at most this many MB together, 8 or
    /// more: the oldest are deleted. Files around a fault or a stop are named FILE-0007-fault.mcap and stay,
    /// as many MB at most. A later run with the same FILE continues the ring
    #[arg(long, value_name = "MB", value_parser = clap::value_parser!(u32).range(8..))]
    ring_mb: Option<u32>,
    /// Seconds before and after a fault or a stop whose files stay
    #[arg(long, value_name = "N", default_value = "30", value_parser = duration::seconds, requires = "ring_mb")]
    around_fault: Duration,
    #[command(flatten)]
    metrics: MetricsArgs,
    #[command(flatten)]
    log: LogArgs,
    #[command(flatten)]
    end: EndArgs,
    /// End when every process that was seen in the room has left it
    #[arg(long)]
    until_empty: bool,
    /// Print the message counts as one JSON object on the last line
    #[arg(long)]
    json: bool,
}

/// Play a recording into a controller, or verify its commands.
///
/// Without --verify, --policy and --model this process replaces the room: it publishes the recorded
/// reports for a controller that runs elsewhere, at the recorded speed. With one of them a
/// controller inside this process decides again, and every command is compared with the recorded
/// one. The exit status is 1 if --verify finds a difference, and 2 if the file cannot be replayed or no
/// command counts.
#[derive(Clone, Debug, clap::Args)]
#[command(group = clap::ArgGroup::new("decide_again").multiple(true))]
pub struct ReplayArgs {
    /// The recording (MCAP)
    file: PathBuf,
    /// Decide again, and fail unless every compared command equals the recorded one bit for bit
    #[arg(long, group = "decide_again")]
    verify: bool,
    /// Decide again with this policy instead of the recorded one
    #[arg(long, value_enum, group = "decide_again")]
    policy: Option<PolicyKind>,
    /// Decide again with this ONNX file of a learned policy instead of the built-in one
    #[arg(long, visible_alias = "actor", value_name = "FILE", group = "decide_again")]
    model: Option<PathBuf>,
    /// Decisions at the start of each epoch that do not count [default: 0 for a lockstep run recorded
    /// from its start, and where the recording has states of the controller; else 200]
    #[arg(long, value_name = "N", requires = "decide_again")]
    settle: Option<u64>,
    /// Endpoint at which to listen for a controller (repeatable); without any endpoint
    /// tcp/127.0.0.1:7447
    #[arg(long, value_name = "ENDPOINT", conflicts_with = "decide_again")]
    listen: Vec<String>,
    /// Endpoint of a controller or of a router (repeatable)
    #[arg(long, value_name = "ENDPOINT", conflicts_with = "decide_again")]
    connect: Vec<String>,
    /// Communicate through the Zenoh router given by --connect only
    #[arg(long, conflicts_with = "decide_again")]
    client: bool,
    #[command(flatten)]
    tls: TlsArgs,
    /// Name of the room to publish in, instead of the recorded one
    #[arg(long, value_name = "NAME", conflicts_with = "decide_again")]
    room: Option<Room>,
    /// Playback speed relative to the recorded one, 0.01 to 100
    #[arg(long, value_name = "N", default_value_t = 1.0, value_parser = rate, conflicts_with = "decide_again")]
    rate: f64,
    /// Print the result as one JSON object on the last line
    #[arg(long)]
    json: bool,
}

/// Records until Ctrl-C, the end of its time or of the room, and prints the message counts.
///
/// # Errors
/// Any error that prevents the start; a file that could not be written completely, after the counts
/// were printed.
pub fn record(args: RecordArgs) -> Result<()> {
    // The session says there that its connection is lost.
    let _log = args.log.start();
    let stop = args.end.stop()?;
    let settings = recorder::Settings {
        scenario: args.scenario.load_arrays()?,
        bus: args.bus.config_or_connect(&[AccessRole::Viewer, AccessRole::Operator])?,
        out: args.out,
        run_for: args.end.seconds,
        until_empty: args.until_empty,
        metrics: args.metrics,
        ring: args.ring_mb.map(|mb| Bounds { bytes: u64::from(mb) * 1_000_000, around_fault: args.around_fault }),
    };
    let outcome = recorder::run(&settings, &stop)?;
    print(args.json, &outcome, &outcome)?;
    if let Some(failure) = &outcome.failure {
        bail!("{}: {failure}", outcome.file.display());
    }
    if outcome.account.missing() > 0 {
        tracing::warn!("missing messages: {}, see the table", outcome.account.missing());
    }
    Ok(())
}

/// Replays, and prints the result.
///
/// # Errors
/// [`UnusableInput`] if the recording cannot be replayed, or if no command of it can be compared; with
/// `--verify`, a difference.
pub fn replay(args: ReplayArgs) -> Result<()> {
    if !args.verify && args.policy.is_none() && args.model.is_none() {
        return play(args);
    }
    let settings = replay::Settings { file: args.file, policy: args.policy, model: args.model, settle: args.settle };
    let verdict = replay::run(&settings)?;
    print(args.json, &verdict, &verdict)?;
    if verdict.is_empty() {
        let (file, reason) = (settings.file.display(), why_empty(&verdict, settings.settle));
        return Err(UnusableInput::new(format!("{file} has no command that a replay can compare: {reason}")).into());
    }
    if !args.verify {
        let (file, scenario) = (shell_word(&settings.file.to_string_lossy()), scenario_argument(&verdict.scenario));
        output::note(format_args!(
            "replay: commands are compared, not rates: the recorded gains are those of the recorded commands. For rates over the recorded walk: \
             heliostat-lab trace export {file} --out walk.csv; then heliostat-lab eval --closed-loop --scenario {scenario}, \
             with the --set that trace export prints, and --policies RECORDED,OTHER"
        ));
    }
    if args.verify && !verdict.is_good() {
        bail!(
            "{} does not replay as recorded: {}{}",
            settings.file.display(),
            verdict.first_difference.as_deref().unwrap_or("a report has no command in the replay"),
            verdict.cause().map_or(String::new(), |cause| format!("; {cause}"))
        );
    }
    Ok(())
}

/// What a command takes as --scenario for the scenario of a recording: its name if it is built in, else its file.
fn scenario_argument(name: &str) -> String {
    if BUILTIN_NAMES.contains(&name) {
        return name.to_owned();
    }
    format!("FILE (the file of the scenario \"{}\")", printable(name))
}

/// Why no command counts, and what to do.
fn why_empty(verdict: &replay::Verdict, settle: Option<u64>) -> String {
    match (verdict.settle, settle) {
        (first @ 1.., None) if verdict.not_counted > 0 => format!(
            "it has no state of the controller, so the first {first} decisions do not count; --settle 0 compares them from the first on"
        ),
        (first @ 1.., Some(_)) if verdict.not_counted > 0 => {
            format!("by --settle {first} its first decisions do not count; --settle 0 compares them from the first on")
        }
        _ => "it is too short, cut off, or holds no state of the controller before its commands".into(),
    }
}

fn play(args: ReplayArgs) -> Result<()> {
    let stop = signals::stop_on_signals()?;
    let bus = BusArgs { listen: args.listen, connect: args.connect, client: args.client, tls: args.tls, room: None };
    let settings = play::Settings { file: args.file, room: args.room, bus, rate: args.rate };
    let playback = play::run(&settings, &stop)?;
    print(args.json, &playback, &playback)?;
    ensure!(
        playback.reports == 0 || playback.answered > 0 || stop.is_requested(),
        "no controller answered a played report: each controller's log says why, such as another room's mirrors, a stop, \
         or a process that reports users already"
    );
    Ok(())
}

fn print(json: bool, value: &impl Serialize, text: &impl std::fmt::Display) -> Result<()> {
    if json {
        output::line(serde_json::to_string(value)?)?
    } else {
        output::line(text)?
    }
    Ok(())
}

fn rate(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|rate| (0.01..=100.0).contains(rate)).ok_or_else(|| "expected 0.01 to 100".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scenario_that_is_not_built_in_is_named_by_its_file() {
        assert_eq!(scenario_argument(BUILTIN_NAMES[0]), BUILTIN_NAMES[0]);
        assert_eq!(scenario_argument("studio"), "FILE (the file of the scenario \"studio\")");
    }
}
