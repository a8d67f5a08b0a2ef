//! `heliostat demo`: a simulated room and a controller as two processes, watched from a third.

pub mod child;
mod summary;
mod viewer;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use heliostat_bus::{Bus, BusConfig, free_loopback_endpoint};
use heliostat_controller::policy::{self, ActorSource, PolicyKind};
use heliostat_proto::Room;
use heliostat_scenario::{Scenario, ScenarioArgs};

use child::Part;
use viewer::Viewer;

use crate::output::outln;

/// How long both processes may take to meet.
const START_PATIENCE: Duration = Duration::from_secs(30);
/// How long a process may take to end once it was asked to.
const END_PATIENCE: Duration = Duration::from_secs(10);
/// Between two looks at the processes.
const WATCH_EVERY: Duration = Duration::from_millis(50);

/// Run a simulated room and a controller as two processes and watch them.
///
/// The processes meet over Zenoh on a free loopback port. Ctrl-C, or --seconds, ends both and prints a summary. The live
/// view goes to standard error, the summary to standard output.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    pub(super) scenario: ScenarioArgs,
    /// Which policy turns the mirrors
    #[arg(long, value_enum, default_value_t = PolicyKind::Ddpg)]
    pub(super) policy: PolicyKind,
    /// ONNX file of a learned policy, in place of the built-in one
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// End after this long, counted from the first answered report
    #[arg(long, value_name = "N")]
    seconds: Option<f64>,
    /// Name of the room in the key expressions
    #[arg(long, default_value = "demo")]
    pub(super) room: String,
    /// Print the summary as one JSON object on the last line
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: Args) -> Result<()> {
    if let Some(seconds) = args.seconds.filter(|seconds| !(0.1..=1e6).contains(seconds)) {
        bail!("--seconds {seconds}: wanted 0.1 to 1000000");
    }
    let room = Room::new(&args.room)?;
    let scenario = args.scenario.load()?;
    args.check_policy(&scenario)?;
    let stop = Arc::new(AtomicBool::new(false));
    let on_signal = Arc::clone(&stop);
    ctrlc::set_handler(move || on_signal.store(true, Ordering::Relaxed)).context("cannot listen for Ctrl-C")?;

    let (room_endpoint, controller_endpoint) = (free_loopback_endpoint()?, free_loopback_endpoint()?);
    let mut parts = Parts {
        room: Part::start("sim-node", &args.part("sim-node", &[("--listen", &room_endpoint)]))?,
        controller: Part::start("controller", &args.controller_arguments(&room_endpoint, &controller_endpoint)?)?,
    };
    eprintln!(
        "scenario {}: {} users, {} x {} mirrors; sim-node is process {}, controller is process {}; Ctrl-C ends both",
        scenario.name,
        scenario.users.count,
        scenario.mirrors.rows,
        scenario.mirrors.columns,
        parts.room.id(),
        parts.controller.id()
    );
    let bus = Bus::open(&BusConfig::new(room.clone()).connect_to(&room_endpoint).connect_to(&controller_endpoint))?;
    let mut viewer = Viewer::open(&bus, &room)?;
    watch(&args, &stop, &mut parts, &mut viewer)?;

    // The room first: a tick that nobody answers because the controller has already gone is no lost tick.
    let room_summary = parts.room.finish(END_PATIENCE)?;
    let controller_summary = parts.controller.finish(END_PATIENCE)?;
    let summary = summary::Summary::new(&room_summary, &controller_summary)?;
    if args.json {
        outln!("{}", serde_json::to_string(&summary)?)?;
    } else {
        summary.print()?;
    }
    Ok(())
}

/// The two processes.
struct Parts {
    room: Part,
    controller: Part,
}

/// Draws until the time is over, a signal comes, or a process ends.
fn watch(args: &Args, stop: &AtomicBool, parts: &mut Parts, viewer: &mut Viewer) -> Result<()> {
    let opened = Instant::now();
    let mut started: Option<Instant> = None;
    let (mut drawn, redraw) = (Instant::now(), Duration::from_millis(if args.json { 1000 } else { 250 }));
    while !stop.load(Ordering::Relaxed) {
        std::thread::sleep(WATCH_EVERY);
        parts.room.check_alive()?;
        parts.controller.check_alive()?;
        match started {
            None if viewer.is_complete() => started = Some(Instant::now()),
            None if opened.elapsed() > START_PATIENCE => {
                bail!("the two processes run but did not meet within {} s", START_PATIENCE.as_secs())
            }
            None => {}
            Some(since) => {
                if args.seconds.is_some_and(|seconds| since.elapsed().as_secs_f64() >= seconds) {
                    break;
                }
                if drawn.elapsed() >= redraw {
                    drawn = Instant::now();
                    viewer.draw()?;
                }
            }
        }
    }
    Ok(())
}

impl Args {
    /// Builds the policy once here, so that an actor that does not fit is told before anything starts.
    fn check_policy(&self, scenario: &Scenario) -> Result<()> {
        let source = self.model.clone().map_or(ActorSource::Shipped, ActorSource::Path);
        policy::build(self.policy, scenario, &source)
            .context("nothing was started: the controller would have no policy")?;
        Ok(())
    }

    /// The arguments that both processes share, after their own.
    fn part(&self, command: &str, endpoints: &[(&str, &str)]) -> Vec<String> {
        let mut arguments = vec![command.to_string()];
        arguments.extend(["--scenario".into(), self.scenario.scenario.clone(), "--room".into(), self.room.clone()]);
        for text in &self.scenario.overrides {
            arguments.extend(["--set".into(), text.clone()]);
        }
        if let Some(seed) = self.scenario.seed {
            arguments.extend(["--seed".into(), seed.to_string()]);
        }
        for (flag, endpoint) in endpoints {
            arguments.extend([flag.to_string(), endpoint.to_string()]);
        }
        arguments
    }

    fn controller_arguments(&self, room: &str, controller: &str) -> Result<Vec<String>> {
        let mut arguments = self.part("controller", &[("--connect", room), ("--listen", controller)]);
        arguments.extend(["--policy".into(), self.policy.name()]);
        if let Some(model) = &self.model {
            arguments.extend(["--model".into(), model.display().to_string()]);
        }
        Ok(arguments)
    }
}
