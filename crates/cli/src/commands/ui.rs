//! `heliostat ui`: the page and the terminal view of a running room.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use anyhow::Result;
use clap::ValueEnum;
use heliostat_bus::{AccessRole, Bus, BusArgs, Identity};
use heliostat_core::policy::PolicyKind;
use heliostat_models::ActorSource;
use heliostat_scenario::{Scenario, ViewerScenarioArgs};
use heliostat_service::{
    LogArgs, LogFormat, MetricsArgs, Page as MetricsPage, Stop, duration, locks::lock, output, signals,
};
use heliostat_ui::{Display, Operator, Page, PageArgs, PoliciesOf, PolicyChoice, Rights, View};

use super::ending::{Ending, WATCH_EVERY};

/// Display a running room, simulated or real, in a browser and on the terminal.
///
/// Connect to the room's process and to the controller, since peers do not forward messages, or to
/// the router of both. Room and controller announce the geometry that is drawn; --scenario is for a
/// room in which neither does. The page has the buttons of `heliostat demo`, except those that kill
/// or restart the controller.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scenario: ViewerScenarioArgs,
    #[command(flatten)]
    bus: BusArgs,
    #[command(flatten)]
    page: PageArgs,
    /// Print lines instead of the full-screen view
    #[arg(long)]
    plain: bool,
    /// Log what begins or ends only, without figures: for a service
    #[arg(long)]
    quiet: bool,
    #[command(flatten)]
    metrics: MetricsArgs,
    #[command(flatten)]
    log: LogArgs,
    /// End after this many seconds; without it, run until stopped
    #[arg(long, value_name = "N", value_parser = duration::seconds, allow_negative_numbers = true)]
    seconds: Option<Duration>,
}

impl Args {
    /// Whether the lines go to the log: those of a service, and JSON in place of the full-screen view.
    fn is_log(&self) -> bool {
        self.quiet || self.log.log_format == LogFormat::Json
    }

    fn note(&self, text: impl std::fmt::Display) {
        if self.is_log() {
            tracing::info!("{text}");
        } else {
            output::note(text);
        }
    }
}

/// Runs the command.
pub fn run(args: Args) -> Result<()> {
    let scenario = args.scenario.load()?;
    let config = args.bus.config_or_connect(&[AccessRole::Operator, AccessRole::Viewer])?;
    let stop = signals::stop_on_signals()?;

    let _log = args.is_log().then(|| args.log.start());
    let rights = Rights::of(config.identity.as_ref().map(Identity::role), &config.room);
    if let Some(limit) = rights.limit() {
        args.note(limit);
    }
    let exporter = args.metrics.open(config.certificate_ends())?;
    let bus = Bus::open(&config)?;
    let view = Arc::new(View::open(&bus, scenario.as_ref())?);
    let room = config.room.name().to_owned();
    let server = args.page.serve(config.is_authenticated(), || {
        let operator = Operator::new(&bus, &view, None)?.with_rights(rights);
        let (view, room) = (Arc::clone(&view), room.clone());
        Ok(Page { view, operator, room, policies: fitting_policies(), network: None })
    })?;
    if let Some(server) = &server {
        args.note(server);
    }
    let title = server.as_ref().map_or(format!("room {room}"), |server| {
        // Without the token, which would stay on the screen.
        format!("room {room}, page at {}", server.url_without_token())
    });
    let export = || exporter.iter().for_each(|exporter| exporter.publish(metrics(&room)));
    let ending = watch(&args, &title, &view, &stop, &export);
    if let Some(server) = server {
        server.end(&last_sentence(ending.as_ref().ok()));
    }
    ending.map(drop)
}

/// The metrics of a page.
fn metrics(room: &str) -> MetricsPage {
    let mut page = MetricsPage::new(&[("room", room)]);
    page.build_info("page", env!("CARGO_PKG_VERSION"));
    page
}

/// Displays the room until it shall end, and calls `export` at each update. The terminal is as before then, since the end
/// of the page takes time.
fn watch(args: &Args, title: &str, view: &View, stop: &Stop, export: &dyn Fn()) -> Result<Ending> {
    let mut display = if args.is_log() { Display::log(args.quiet) } else { Display::open(args.plain, title)? };
    let (opened, mut drawn) = (Instant::now(), Instant::now());
    export();
    loop {
        if stop.is_requested() {
            return Ok(Ending::Signal);
        }
        if display.quit_requested()? {
            return Ok(Ending::Key);
        }
        if let Some(seconds) = args.seconds.filter(|seconds| opened.elapsed() >= *seconds) {
            return Ok(Ending::Time(seconds));
        }
        std::thread::sleep(WATCH_EVERY);
        if drawn.elapsed() >= display.interval() {
            drawn = Instant::now();
            display.draw(view)?;
            export();
        }
    }
}

/// What an open page says of a server that has ended.
fn last_sentence(ending: Option<&Ending>) -> String {
    format!("The server of this page has ended {}. The room goes on without it.", Ending::reason(ending))
}

/// The policies that a controller of the shown room accepts, with their help texts, for the page. Each
/// scenario is tried once.
pub fn fitting_policies() -> PoliciesOf {
    let tried: Mutex<Option<(Scenario, Vec<PolicyChoice>)>> = Mutex::default();
    Box::new(move |scenario| {
        // A list is replaced as a unit.
        let mut tried = lock(&tried);
        if let Some((_, policies)) = tried.as_ref().filter(|(known, _)| known == scenario) {
            return policies.clone();
        }
        let fits = |kind: &&PolicyKind| heliostat_models::build(**kind, scenario, &ActorSource::Shipped).is_ok();
        let choice = |kind: &PolicyKind| {
            let value = kind.to_possible_value()?;
            let description = value.get_help().map(ToString::to_string).unwrap_or_default();
            Some(PolicyChoice { name: value.get_name().to_owned(), description })
        };
        let policies: Vec<PolicyChoice> = PolicyKind::value_variants().iter().filter(fits).filter_map(choice).collect();
        *tried = Some((scenario.clone(), policies.clone()));
        policies
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_sentence_of_the_page_says_why_its_server_has_ended() {
        for (ending, why) in [(Some(&Ending::Key), "by a key"), (None, "by an error, which its terminal names.")] {
            let sentence = last_sentence(ending);
            assert!(sentence.starts_with(&format!("The server of this page has ended {why}")), "{sentence}");
        }
    }
}
