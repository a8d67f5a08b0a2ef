//! `heliostat-lab bench belief`: what a channel report, a position report and an observation cost, by room.
//!
//! Each room is simulated once in closed loop with the policy `greedy`, and its messages are kept.
//! Fresh controllers then handle the same messages without pauses, so that the caches are warm. The
//! controller is deterministic, so its commands are those of the simulation. The reference is one
//! evaluation of the channel model after each channel report: the gains of all reported users
//! without blockers, over the angles of the last command.

use std::{
    hint::black_box,
    time::{Duration, Instant},
};

use anyhow::Result;
use heliostat_channel::{Scene, Vec3};
use heliostat_core::{
    core::{Controller, Due, Stage, Timing},
    policy::PolicyKind,
};
use heliostat_environment::closed_loop::message;
use heliostat_models::{ActorSource, build};
use heliostat_proto::{Nanos, UserReport};
use heliostat_room::episode::{Episode, Event};
use heliostat_room::reports::Report;
use heliostat_scenario::Scenario;
use heliostat_service::duration;
use serde::Serialize;

use heliostat::commands::bench::rows::{Distribution, Times};
use heliostat_service::outln;

/// Measure the time that the belief takes for each report, and the observation for each decision.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Time spent on each row, in s
    #[arg(long, value_name = "S", default_value = "2", value_parser = duration::seconds, allow_negative_numbers = true)]
    seconds: Duration,
}

/// A room: its name in the output, its built-in scenario, and what is overridden.
type Room = (&'static str, &'static str, &'static [&'static str]);

const TWO_LEDS: &str = "led.positions_m=[[-1.25,0,3],[1.25,0,3]]";
const FOUR_LEDS: &str = "led.positions_m=[[-1.25,-1.25,3],[1.25,-1.25,3],[-1.25,1.25,3],[1.25,1.25,3]]";

/// The rooms.
const ROOMS: [Room; 9] = [
    ("hall", "hall", &[]),
    ("hall, 10 users", "hall", &["users.count=10"]),
    ("hall, seated and tilted", "hall", &["users.mobility=seated", "users.orientation.model=measured"]),
    ("hall, 2 LEDs", "hall", &[TWO_LEDS]),
    ("hall, 4 LEDs", "hall", &[FOUR_LEDS]),
    ("seated, tilted, 2 LEDs", "hall", &[TWO_LEDS, "users.mobility=seated", "users.orientation.model=measured"]),
    ("seated, tilted, 4 LEDs", "hall", &[FOUR_LEDS, "users.mobility=seated", "users.orientation.model=measured"]),
    ("office", "office", &[]),
    ("atrium", "atrium", &[]),
];

/// Users have walked for this time when the controller starts.
const START_NS: Nanos = 5_000_000_000;

/// Messages are kept for this time.
const KEPT_NS: Nanos = 30_000_000_000;

#[derive(Debug, Serialize)]
struct Row {
    room: &'static str,
    /// Mean number of users in a report.
    users: f64,
    mirrors: usize,
    /// A channel report, from its acceptance to the end of its effect on the belief.
    channel_us: Distribution,
    /// A position report.
    positions_us: Distribution,
    /// The observation of a decision.
    observation_us: Distribution,
    /// A position report and the observation of its decision.
    decision_us: Distribution,
    reference_us: Distribution,
    /// Ratios of the medians to that of the reference.
    channel_ratio: f64,
    decision_ratio: f64,
}

/// Runs the benchmark.
pub fn run(args: &Args) -> Result<()> {
    if !args.json {
        outln!("belief, hot; reference: one evaluation of the channel model; times in us")?;
        outln!(
            "{:<24}{:>6}{:>9}{:>13}{:>13}{:>15}{:>15}{:>15}{:>15}{:>11}{:>11}",
            "room",
            "users",
            "mirrors",
            "channel p50",
            "channel p99",
            "positions p50",
            "observe p50",
            "both p50",
            "reference p50",
            "x channel",
            "x both"
        )?;
    }
    let mut rows = Vec::new();
    for room in ROOMS {
        let row = measure(room, args.seconds)?;
        if !args.json {
            outln!(
                "{:<24}{:>6.1}{:>9}{:>13.1}{:>13.1}{:>15.1}{:>15.1}{:>15.1}{:>15.1}{:>11.1}{:>11.1}",
                row.room,
                row.users,
                row.mirrors,
                row.channel_us.p50,
                row.channel_us.p99,
                row.positions_us.p50,
                row.observation_us.p50,
                row.decision_us.p50,
                row.reference_us.p50,
                row.channel_ratio,
                row.decision_ratio
            )?;
        }
        rows.push(row);
    }
    if args.json {
        outln!("{}", serde_json::json!({ "rows": rows }))?;
    }
    Ok(())
}

fn measure((room, builtin, overrides): Room, time: Duration) -> Result<Row> {
    let scenario = Scenario::builtin(builtin)?.with_overrides(overrides)?;
    let kept = simulate(&scenario)?;
    let mut measured = Measured::new(&scenario)?;
    let start = Instant::now();
    while measured.channel.count() == 0 || start.elapsed() < time {
        measured.replay(controller(&scenario, &kept.episode)?, &kept.events);
    }
    let [channel, positions, observation, decision, reference] =
        [measured.channel, measured.positions, measured.observation, measured.decision, measured.reference]
            .map(|times| times.distribution());
    let reports: Vec<usize> =
        kept.events.iter().filter_map(|(_, event)| users(event)).map(|one| one.users.len()).collect();
    Ok(Row {
        room,
        users: reports.iter().sum::<usize>() as f64 / reports.len() as f64,
        mirrors: scenario.mirror_count(),
        channel_us: channel,
        positions_us: positions,
        observation_us: observation,
        decision_us: decision,
        reference_us: reference,
        channel_ratio: channel.p50 / reference.p50,
        decision_ratio: decision.p50 / reference.p50,
    })
}

/// The messages of a room with their times, and the room as it then is.
struct Kept {
    events: Vec<(Nanos, Event)>,
    episode: Episode,
}

/// A controller that knows the arrays of a room.
fn controller(scenario: &Scenario, episode: &Episode) -> Result<Controller> {
    let policy = build(PolicyKind::Greedy, scenario, &ActorSource::Shipped)?;
    let mut controller = Controller::new(scenario, scenario.channel_model()?, policy, 1);
    controller.warm_up(0..2);
    for (array, capabilities) in episode.capabilities().enumerate() {
        controller.handle_capabilities(array, &capabilities, Ok(()));
    }
    Ok(controller)
}

/// Runs a room in closed loop.
fn simulate(scenario: &Scenario) -> Result<Kept> {
    let mut episode = Episode::new(scenario, scenario.read_trace()?.as_deref(), scenario.seed, START_NS)?;
    let mut controller = controller(scenario, &episode)?;
    let mut events = Vec::new();
    while let Some((now, mut event)) = episode.poll_event(START_NS + KEPT_NS) {
        events.push((now.room_ns, event.clone()));
        let Some(message) = message(&mut event, true) else { continue };
        let Some(decision) = controller.handle_and_poll(now.room_ns, message, &mut |_| {}) else { continue };
        for (array, command) in decision.commands() {
            episode.handle_command(array, now, command)?;
        }
    }
    Ok(Kept { events, episode })
}

/// The times, and the scene of the reference.
struct Measured {
    channel: Times,
    positions: Times,
    observation: Times,
    decision: Times,
    reference: Times,
    model: heliostat_channel::ChannelModel,
    scene: Scene,
    places: Vec<Vec3>,
    gains: Vec<f64>,
}

impl Measured {
    fn new(scenario: &Scenario) -> Result<Self> {
        let model = scenario.channel_model()?;
        let scene = Scene::new(&model, scenario.users.count);
        let [channel, positions, observation, decision, reference] = std::array::from_fn(|_| Times::new());
        let (places, gains) = (Vec::new(), Vec::new());
        Ok(Self { channel, positions, observation, decision, reference, model, scene, places, gains })
    }

    /// Gives the messages of a room to a controller.
    fn replay(&mut self, mut controller: Controller, events: &[(Nanos, Event)]) {
        for (now, event) in events {
            let mut event = event.clone();
            if let Some(report) = users(&event) {
                self.places.clear();
                self.places.extend(report.users.iter().map(|user| Vec3::from_iterator(user.position_m.map(f64::from))));
            }
            let is_channel = matches!(event, Event::Report(Report::Channel(_)));
            let Some(message) = message(&mut event, true) else { continue };
            let started = Instant::now();
            let due = controller.handle_message(*now, message);
            let handled = started.elapsed();
            if is_channel {
                self.channel.record(handled);
                self.evaluate(&controller);
            }
            if due == Due::Command {
                let started = Instant::now();
                let mut observed = Duration::ZERO;
                let mut mark = |stage: Stage| {
                    if stage == Stage::Observed {
                        observed = started.elapsed();
                    }
                };
                controller.poll_command(*now, Timing::InTime, &mut mark);
                self.positions.record(handled);
                self.observation.record(observed);
                self.decision.record(handled + observed);
            }
        }
    }

    /// Evaluates the channel model once.
    fn evaluate(&mut self, controller: &Controller) {
        let users = self.places.len();
        let forced = vec![false; users];
        self.scene.resize(users);
        self.gains.resize(users, 0.0);
        let started = Instant::now();
        self.scene.update(&self.model, &self.places, &[], &forced);
        self.scene.irs_gain(&self.model, &controller.observation().angles, &mut self.gains);
        black_box(&self.gains);
        self.reference.record(started.elapsed());
    }
}

fn users(event: &Event) -> Option<&UserReport> {
    match event {
        Event::Report(Report::Users(report)) => Some(report),
        _ => None,
    }
}
