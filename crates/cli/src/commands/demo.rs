//! `heliostat demo`: a simulated room and a controller as two processes, displayed by this one.

pub mod child;
mod processes;
mod summary;

use std::sync::Arc;
use std::sync::mpsc::{self, Receiver};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use heliostat_bus::{Bus, BusArgs, BusConfig, BusError, free_loopback_endpoint};
use heliostat_core::policy::PolicyKind;
use heliostat_files::shell_word;
use heliostat_models::{PolicyArgs, build, library};
use heliostat_proto::Room;
use heliostat_room::World;
use heliostat_scenario::{Scenario, ScenarioArgs};
use heliostat_service::counted::counted;
use heliostat_service::exit::UnusableInput;
use heliostat_service::printable::printable;
use heliostat_service::{Stop, duration, output, signals};
use heliostat_ui::{Display, NetworkFile, Operator, Page, PageArgs, ProcessOrder, View};

use processes::{Processes, ROOM};

use super::ending::{Ending, WATCH_EVERY};
use super::ui::fitting_policies;
use heliostat_service::outln;

/// Time limit for the two processes to connect.
const START_LIMIT: Duration = Duration::from_secs(60);

/// Run a simulated room and a controller as two processes, and display them.
///
/// The processes connect over Zenoh on free loopback ports. A web page on loopback shows the room,
/// and its buttons act on it; the address is printed. The terminal shows the same figures in
/// full-screen mode (q quits), or as lines if output is not a terminal. Ctrl-C or --seconds ends
/// the demo with a summary. Where a process ends early, the demo goes on, and the terminal has the
/// command that starts it again; with --seconds or --json the demo ends. The summary covers the other
/// process, and the exit status is 1. Figures go to standard error, the summary to standard output.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    pub(super) scenario: ScenarioArgs,
    #[command(flatten)]
    pub(super) policy: PolicyArgs,
    /// End after this many seconds, counted from the first answered report
    #[arg(long, value_name = "N", value_parser = duration::seconds, allow_negative_numbers = true)]
    seconds: Option<Duration>,
    /// Name of the room
    #[arg(long, default_value = "demo")]
    pub(super) room: String,
    #[command(flatten)]
    page: PageArgs,
    /// Print lines instead of the full-screen view
    #[arg(long)]
    plain: bool,
    /// Print the summary as one JSON object on the last line
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: Args) -> Result<()> {
    let opened = Instant::now();
    let room = Room::new(&args.room).map_err(BusError::from)?;
    let scenario = args.scenario.load_arrays()?;
    args.check_room(&scenario)?;
    let network = args.network(&scenario)?;
    let stop = signals::stop_on_signals()?;

    let (room_endpoint, controller_endpoint) = (free_loopback_endpoint()?, free_loopback_endpoint()?);
    let endpoints = (room_endpoint.as_str(), controller_endpoint.as_str());
    let mut processes = Processes::start(
        &args.room_arguments(endpoints.0),
        &args.controller_arguments(endpoints, args.policy.kind())?,
    )?;
    let (room_id, controller_id) = processes.ids();
    output::note(format_args!(
        "scenario {}: {}, {} mirrors; sim-node is process {room_id} at {}, controller is process {} at {}; Ctrl-C ends both",
        scenario.name,
        counted(scenario.users.count, "user"),
        scenario.mirrors,
        endpoints.0,
        controller_id.unwrap_or_default(),
        endpoints.1
    ));
    let bus = Bus::open(&BusConfig::new(room.clone()).connect_to(endpoints.0).connect_to(endpoints.1))?;
    let view = Arc::new(View::open(&bus, Some(&scenario))?);
    let (process_orders, received_orders) = mpsc::channel();
    let server = args.page.serve(false, || {
        let operator = Operator::new(&bus, &view, Some(process_orders))?;
        let (view, room, network) = (Arc::clone(&view), args.room.clone(), network.clone());
        Ok(Page { view, operator, room, policies: fitting_policies(), network })
    })?;
    if let Some(server) = &server {
        output::note(server);
    }
    let title = server.as_ref().map_or(format!("room {room}"), |server| format!("room {room}, {server}"));
    let title = format!("{title}\n{}", status_command(&args.room, endpoints.0));
    let watched = Watched { opened, stop: &stop, view: &view, process_orders: received_orders, endpoints, title };
    let outcome = watch(&args, &watched, &mut processes);
    if let Some(server) = server {
        server.end(&last_sentence(outcome.as_ref().ok()));
    }

    let controllers = processes.controllers();
    let (room_summary, controller_summary) = processes.finish();
    // Without any command there is nothing to sum up.
    let printed = if outcome.is_ok() || view.is_complete() {
        let of_controller = controller_summary.as_ref().and_then(|summary| summary.as_ref().ok());
        summary::Summary::new(room_summary.as_ref().ok(), of_controller, controllers)
            .and_then(|summary| args.print_summary(&summary, network.as_ref()))
    } else {
        Ok(())
    };
    // The first error says which process ended; a summary that lacks something is its consequence.
    let ended = room_summary.map(drop).and(controller_summary.map_or(Ok(()), |summary| summary.map(drop)));
    outcome.map(drop).and(ended).and(printed)
}

/// The command that shows the state of the demo from another terminal. The room outlives a restart of the controller.
fn status_command(room: &str, endpoint: &str) -> String {
    let flags = BusArgs { room: Some(room.to_owned()), connect: vec![endpoint.to_owned()], ..BusArgs::default() };
    flags.command("heliostat status", "").trim_end().to_owned()
}

/// What an open page says of a demo that has ended, without a reason by an error.
fn last_sentence(ending: Option<&Ending>) -> String {
    format!("The demo has ended {}. Start it again to go on.", Ending::reason(ending))
}

/// The inputs of the display loop.
struct Watched<'a> {
    /// When the command began.
    opened: Instant,
    stop: &'a Stop,
    view: &'a View,
    /// Orders of the page about the processes.
    process_orders: Receiver<ProcessOrder>,
    /// Endpoints of the room and of the controller.
    endpoints: (&'a str, &'a str),
    title: String,
}

/// Draws until the time is over, or a signal or a key arrives. A process that ends is an error in a script, and before the
/// first answered report.
fn watch(args: &Args, watched: &Watched, processes: &mut Processes) -> Result<Ending> {
    let mut started: Option<Instant> = None;
    let mut display = Display::open(args.plain || args.json, &watched.title)?;
    let mut drawn = Instant::now();
    loop {
        if watched.stop.is_requested() {
            return Ok(Ending::Signal);
        }
        if display.quit_requested()? {
            return Ok(Ending::Key);
        }
        std::thread::sleep(WATCH_EVERY);
        let controller_arguments = || {
            let policy = watched.view.policy().and_then(|name| PolicyKind::from_str(&name, true).ok());
            args.controller_arguments(watched.endpoints, policy.unwrap_or_else(|| args.policy.kind()))
        };
        if let Some((command, error)) = processes.next_ended() {
            // A script waits for the end, and a demo that never worked shows nothing.
            if started.is_none() || args.seconds.is_some() || args.json {
                return Err(error);
            }
            let arguments =
                if command == ROOM { args.room_arguments(watched.endpoints.0) } else { controller_arguments()? };
            let words: Vec<String> = arguments.iter().map(|word| shell_word(word)).collect();
            display.advise(
                &format!("the {command} process has ended; the demo goes on until Ctrl-C. To start it again"),
                &format!("heliostat {}", words.join(" ")),
            );
        }
        for order in watched.process_orders.try_iter() {
            processes.apply(order, controller_arguments)?;
        }
        match started {
            None if watched.view.is_complete() => {
                started = Some(Instant::now());
                // The full-screen view occupies the terminal.
                if matches!(display, Display::Lines(_)) {
                    output::note(format_args!(
                        "the mirrors answer reports, {:.2} s after the start",
                        watched.opened.elapsed().as_secs_f64()
                    ));
                }
            }
            None if watched.opened.elapsed() > START_LIMIT => {
                bail!("the two processes run but did not connect within {} s", START_LIMIT.as_secs())
            }
            None => {}
            Some(since) => {
                if let Some(seconds) = args.seconds.filter(|seconds| since.elapsed() >= *seconds) {
                    return Ok(Ending::Time(seconds));
                }
                if drawn.elapsed() >= display.interval() {
                    drawn = Instant::now();
                    display.draw(watched.view)?;
                }
            }
        }
    }
}

impl Args {
    fn print_summary(&self, summary: &summary::Summary, network: Option<&NetworkFile>) -> Result<()> {
        if self.json {
            outln!("{}", serde_json::to_string(summary)?)?
        } else {
            summary.print(network)?
        }
        Ok(())
    }

    /// Builds room and policy once here, so that an unsuitable walk or actor is refused before any
    /// process starts.
    fn check_room(&self, scenario: &Scenario) -> Result<()> {
        let nothing = |why: &str| UnusableInput::new(format!("nothing was started{why}"));
        let trace = scenario.read_trace().with_context(|| nothing(""))?;
        World::new(scenario, trace.as_deref(), scenario.seed).with_context(|| nothing(": there would be no room"))?;
        build(self.policy.kind(), scenario, &self.policy.actor())
            .with_context(|| nothing(": the controller would have no policy"))?;
        Ok(())
    }

    /// The file of the network that the flags give.
    fn network(&self, scenario: &Scenario) -> Result<Option<NetworkFile>> {
        let Some(path) = &self.policy.model else { return Ok(None) };
        let file = self.policy.actor().fetch(self.policy.kind(), scenario)?;
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy();
        Ok(Some(NetworkFile { hash: file.hash(), name: printable(&name).into_owned() }))
    }

    /// The arguments of a process: its command, the shared flags, and its endpoints.
    fn process_arguments(&self, command: &str, endpoints: &[(&str, &str)]) -> Vec<String> {
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

    fn room_arguments(&self, endpoint: &str) -> Vec<String> {
        self.process_arguments(ROOM, &[("--listen", endpoint)])
    }

    fn controller_arguments(&self, (room, controller): (&str, &str), kind: PolicyKind) -> Result<Vec<String>> {
        let mut arguments = self.process_arguments("controller", &[("--connect", room), ("--listen", controller)]);
        arguments.extend(["--policy".into(), kind.name()]);
        if let Some(library) = library::chosen() {
            arguments.extend(["--onnxruntime".into(), library.display().to_string()]);
        }
        if let Some(model) = self.policy.model.as_ref().filter(|_| kind == self.policy.kind()) {
            arguments.extend(["--model".into(), model.display().to_string()]);
        }
        Ok(arguments)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_header_of_a_demo_has_the_command_that_connects_to_its_room() {
        let command = status_command("studio", "tcp/127.0.0.1:17447");
        assert_eq!(command, "heliostat status --room studio --connect tcp/127.0.0.1:17447");
    }

    #[test]
    fn the_last_sentence_of_the_page_says_why_the_demo_has_ended() {
        let ended = last_sentence(Some(&Ending::Time(Duration::from_secs(20))));
        assert_eq!(ended, "The demo has ended after its 20 s. Start it again to go on.");
        assert!(last_sentence(None).starts_with("The demo has ended by an error, which its terminal names."));
    }
}
