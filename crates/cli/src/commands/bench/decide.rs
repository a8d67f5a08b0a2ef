//! `heliostat bench decide`, and `heliostat-lab bench policies | mirrors | users`.
//!
//! They measure the decision without transport, from the payload of a position report to the payload
//! of the command, in one process.
//!
//! Between decisions the thread sleeps, as a controller does between reports, so the caches lose
//! their contents as they do there. A decision counts from the moment the thread is awake, or from
//! its due time if the previous decision was still running.

use std::io::Write;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use clap::ValueEnum;
use heliostat_channel::MirrorAngles;
use heliostat_controller::report::stage_times::{BUDGET, StageStamps, StageTimes, quantiles_us};
use heliostat_core::core::{Controller, Decision, Stage};
use heliostat_core::inbox::Message;
use heliostat_core::observation::Observation;
use heliostat_core::policy::{Actor, Policy, PolicyKind, actor_file::ActorFile};
use heliostat_models::{ActorSource, BareSession, ORT, build, load_actor, load_actor_on_onnxruntime};
use heliostat_proto::{ArrayState, MirrorTelemetry, Stamp, UserReport, decode_into, encode};
use heliostat_scenario::{STUDY_SCENARIO, Scenario, ScenarioArgs};
use heliostat_service::exit;

use super::pace::{Block, PaceArgs, Plan, Turn};
use super::rows::{Row, Table, Times, Varied};
use super::walkers::Walkers;

/// Unmeasured decisions at the start.
const WARM_UP: usize = 200;
/// Reports between two messages of telemetry.
const TELEMETRY_TICKS: u64 = 5;

/// Flags that the benchmarks of the decision share.
#[derive(Debug, clap::Args)]
#[command(mut_arg("scenario", |argument| argument.default_value(STUDY_SCENARIO)))]
pub struct Args {
    #[command(flatten)]
    scenario: ScenarioArgs,
    #[command(flatten)]
    pace: PaceArgs,
    /// Policy that decides [default: ddpg for decide, fixed-point for mirrors and users, all for
    /// policies]
    #[arg(long, value_enum)]
    policy: Option<PolicyKind>,
    /// ONNX file of a learned policy, instead of the built-in one
    #[arg(long, value_name = "FILE", requires = "policy")]
    model: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// What is measured: a policy in a room.
#[derive(Clone, Copy)]
struct Subject<'a> {
    scenario: &'a Scenario,
    kind: PolicyKind,
    source: &'a ActorSource,
    engine: Engine,
}

/// What evaluates a learned policy.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Engine {
    /// What the controller uses.
    Own,
    /// ONNX Runtime, even for a chain of dense layers.
    OnnxRuntime,
}

impl Subject<'_> {
    fn build(&self) -> Result<Box<dyn Policy>> {
        match self.engine {
            Engine::Own => build(self.kind, self.scenario, self.source).map_err(exit::unusable),
            Engine::OnnxRuntime => {
                Ok(Box::new(self.load(&self.source.fetch(self.kind, self.scenario)?)?.named(self.kind.name())))
            }
        }
    }

    /// The engines that run the actor: that of the controller, and ONNX Runtime beside it.
    fn engines(&self) -> Vec<Engine> {
        let on_ort = Subject { engine: Engine::OnnxRuntime, ..*self };
        match (self.kind.is_learned(), self.build()) {
            (true, Ok(own)) if own.engine() != Some(ORT) && on_ort.build().is_ok() => {
                vec![Engine::Own, Engine::OnnxRuntime]
            }
            // Where none does, the error follows from a build.
            _ => vec![Engine::Own],
        }
    }

    fn load(&self, file: &ActorFile) -> Result<Actor> {
        match self.engine {
            Engine::Own => Ok(load_actor(file, self.scenario)?),
            Engine::OnnxRuntime => Ok(load_actor_on_onnxruntime(file, self.scenario)?),
        }
    }
}

/// `decide`: one policy at several rates, beside the inference engine alone.
pub fn decide(args: &Args) -> Result<()> {
    let (scenario, source) = (args.scenario.load_arrays()?, args.source()?);
    let kind = args.policy.unwrap_or(PolicyKind::Ddpg);
    let subject = Subject { scenario: &scenario, kind, source: &source, engine: Engine::Own };
    let engines = subject.engines();
    let mut table =
        Table::new(args.json, "decision without transport; reference: the inference engine alone at the same rate")?;
    for plan in args.pace.plans(&[10.0, 100.0, 1000.0, 0.0])? {
        for engine in &engines {
            let subject = Subject { engine: *engine, ..subject };
            let mut reference = EngineAlone::new(&subject)?;
            table.add(args.measure(&plan, subject, &mut reference)?)?;
        }
        if engines.contains(&Engine::OnnxRuntime) {
            table.add(overhead(&plan, &Subject { engine: Engine::OnnxRuntime, ..subject })?)?;
        }
    }
    Ok(table.finish()?)
}

/// The network on ONNX Runtime beside `Session::run` alone on the same file.
fn overhead(plan: &Plan, subject: &Subject<'_>) -> Result<Row> {
    let file = subject.source.fetch(subject.kind, subject.scenario)?;
    let (scenario, mut measured, mut compared) = (subject.scenario, Times::new(), Times::new());
    let mut network = EngineAlone::new(subject)?;
    let mut bare = Bare(BareSession::new(&file.bytes, scenario.users.count).map_err(anyhow::Error::msg)?);
    (0..WARM_UP).try_for_each(|_| bare.act(Instant::now()))?;
    plan.take_turns(|turn, block| match turn {
        Turn::Measured => go_through(&mut network, block, &mut |time| measured.record(time)),
        Turn::Reference => go_through(&mut bare, block, &mut |time| compared.record(time)),
    })?;
    let varied = Varied {
        hz: plan.hz,
        mirrors: scenario.mirror_count(),
        users: scenario.users.count,
        rooms: 1,
        controllers: None,
        policy: "on Session::run".into(),
        engine: Some(ORT.into()),
    };
    let over = measured.over(BUDGET);
    Ok(Row::new(varied, (measured.distribution(), over, measured.count()), &compared))
}

/// `policies`: every policy that can decide here, beside the inference engine alone.
pub fn policies(args: &Args) -> Result<()> {
    let scenario = args.scenario.load_arrays()?;
    let refused = || exit::UnusableInput::new("--model: bench policies measures the built-in actors; use bench decide");
    anyhow::ensure!(args.model.is_none(), refused());
    let engine = Engine::Own;
    let mut table =
        Table::new(args.json, "decision without transport; reference: the inference engine alone at the same rate")?;
    for plan in args.pace.plans(&[100.0])? {
        for kind in PolicyKind::value_variants() {
            let subject = Subject { scenario: &scenario, kind: *kind, source: &ActorSource::Shipped, engine };
            if let Err(error) = subject.build() {
                drop(writeln!(std::io::stderr(), "left out: {error}"));
                continue;
            }
            let mut reference = EngineAlone::new(&subject)?;
            table.add(args.measure(&plan, subject, &mut reference)?)?;
        }
    }
    Ok(table.finish()?)
}

/// `mirrors`: the same wall divided into 49 to 4096 mirrors under a point LED; reference: 49 mirrors.
pub fn mirrors(args: &Args) -> Result<()> {
    let sized = |side: usize| {
        let set = [
            format!("mirrors.rows={side}"),
            format!("mirrors.columns={side}"),
            format!("mirrors.width_m={}", 2.5 / side as f64),
            format!("mirrors.height_m={}", 1.0 / side as f64),
            format!("mirrors.gap_m={}", 0.2 / side as f64),
            // A panel of 25 points costs many times as much, and its image does not fit the
            // smallest mirrors.
            "led.side_m=0".into(),
        ];
        let scenario = args.scenario.load().context("bench mirrors divides the wall of one array")?;
        Ok(scenario.with_overrides(&set)?)
    };
    args.growth("mirrors; reference: 49 mirrors", &[7, 10, 16, 32, 64], &sized)
}

/// `users`: 1 to 50 users; reference: one user.
pub fn users(args: &Args) -> Result<()> {
    let sized = |users: usize| Ok(args.scenario.load_arrays()?.with_overrides(&[format!("users.count={users}")])?);
    args.growth("users; reference: one user", &[1, 2, 5, 10, 20, 50], &sized)
}

impl Args {
    /// Rooms of growing size; the first is the reference.
    fn growth(&self, of: &str, sizes: &[usize], sized: &dyn Fn(usize) -> Result<Scenario>) -> Result<()> {
        let kind = self.policy.unwrap_or(PolicyKind::FixedPoint);
        let (source, engine) = (self.source()?, Engine::Own);
        let mut table = Table::new(self.json, &format!("decision without transport with a growing number of {of}"))?;
        for plan in self.pace.plans(&[100.0])? {
            for size in sizes {
                let [first, scenario] = [sized(sizes[0])?, sized(*size)?];
                let subject = Subject { scenario: &scenario, kind, source: &source, engine };
                let mut smallest = Decider::new(&Subject { scenario: &first, ..subject })?;
                table.add(self.measure(&plan, subject, &mut smallest)?)?;
            }
        }
        Ok(table.finish()?)
    }

    /// The actor of the flags.
    fn source(&self) -> Result<ActorSource> {
        let source = ActorSource::from(self.model.clone());
        let kind = self.policy.unwrap_or(PolicyKind::Ddpg);
        source.check_used_by(kind).context("--model names the file of a learned policy")?;
        Ok(source)
    }

    fn measure(&self, plan: &Plan, subject: Subject<'_>, reference: &mut dyn Side) -> Result<Row> {
        let mut decider = Decider::new(&subject)?;
        let scenario = subject.scenario;
        let mut compared = Times::new();
        plan.take_turns(|turn, block| match turn {
            Turn::Measured => go_through(&mut decider, block, &mut |_| {}),
            Turn::Reference => go_through(reference, block, &mut |time| compared.record(time)),
        })?;
        let times = &decider.times;
        let decision = quantiles_us(times.decision());
        let varied = Varied {
            hz: plan.hz,
            mirrors: scenario.mirror_count(),
            users: scenario.users.count,
            rooms: 1,
            controllers: None,
            policy: decider.controller.policy().name().into(),
            engine: decider.controller.policy().engine().map(str::to_owned),
        };
        let by_stage = Stage::ALL.map(|stage| (stage.name().to_string(), times.over_budget_by(stage)));
        let row = Row::new(varied, (decision.into(), times.over_budget(), decision.count), &compared);
        let stages = Stage::ALL.map(|stage| (stage.name().to_string(), quantiles_us(times.stage(stage))));
        Ok(row.by_stage(by_stage.into_iter().filter(|(_, count)| *count > 0).collect(), &stages.into()))
    }
}

/// Telemetry of each of several arrays; nothing for one.
fn telemetry(scenario: &Scenario) -> Vec<MirrorTelemetry> {
    let arrays = scenario.mirrors.arrays();
    let of_array = |mirrors: usize| {
        let (state, flat) = (ArrayState::Following, vec![0.0; mirrors]);
        MirrorTelemetry { state, roll_commanded: flat.clone(), yaw_commanded: flat, ..Default::default() }
    };
    arrays.iter().filter(|_| arrays.len() > 1).map(|array| of_array(array.rows * array.columns)).collect()
}

/// One of the two sides that alternate.
trait Side {
    /// Prepares the next report, before the pause.
    fn prepare(&mut self) -> Result<()>;
    /// Answers a report that counts from `started`.
    fn act(&mut self, started: Instant) -> Result<()>;
}

fn sleep_until(due: Instant) {
    std::thread::sleep(due.saturating_duration_since(Instant::now()));
}

/// Lets a side answer the reports of a block; returns their number.
fn go_through(side: &mut dyn Side, block: Block, record: &mut dyn FnMut(Duration)) -> Result<u64> {
    let start = Instant::now();
    for report in 0..block.reports {
        side.prepare()?;
        let started = match block.interval {
            None => Instant::now(),
            Some(interval) => {
                let due = start + interval.mul_f64(report as f64 + 1.0);
                if Instant::now() > due {
                    due
                } else {
                    sleep_until(due);
                    Instant::now()
                }
            }
        };
        side.act(started)?;
        record(started.elapsed());
        if block.interval.is_none() && Instant::now() > block.until {
            return Ok(report + 1);
        }
    }
    Ok(block.reports)
}

/// The decision core, with decoding before it and encoding after it.
struct Decider {
    controller: Controller,
    walkers: Walkers,
    /// Of each of several arrays, which are lost without it; empty for one array.
    telemetry: Vec<MirrorTelemetry>,
    users: usize,
    tick: u64,
    payload: Vec<u8>,
    report: UserReport,
    command: Vec<u8>,
    times: StageTimes,
}

impl Decider {
    fn new(subject: &Subject<'_>) -> Result<Self> {
        let (scenario, policy) = (subject.scenario, subject.build()?);
        let mut controller = Controller::new(scenario, scenario.channel_model()?, policy, 1);
        controller.warm_up(0..WARM_UP);
        let mut decider = Self {
            controller,
            walkers: Walkers::default(),
            telemetry: telemetry(scenario),
            users: scenario.users.count,
            tick: 0,
            payload: Vec::new(),
            report: UserReport::default(),
            command: Vec::new(),
            times: StageTimes::default(),
        };
        for _ in 0..WARM_UP {
            decider.prepare()?;
            decider.act(Instant::now())?;
        }
        decider.times = StageTimes::default();
        Ok(decider)
    }
}

impl Side for Decider {
    fn prepare(&mut self) -> Result<()> {
        self.tick += 1;
        // Ten simulated milliseconds from report to report, at every rate.
        let now = self.tick * 10_000_000;
        self.walkers.walk(1, self.tick, now, self.users);
        if self.tick % 100 == 1 {
            self.controller.handle_and_poll(now, Message::Obstacles(&mut self.walkers.obstacles), &mut |_| {});
        }
        for (array, telemetry) in self.telemetry.iter().enumerate().filter(|_| self.tick % TELEMETRY_TICKS == 1) {
            // A copy, since the controller keeps the memory of an accepted message.
            let stamp = Stamp { source: 2 + array as u64, sequence: self.tick, time_ns: now };
            let mut telemetry = MirrorTelemetry { stamp, ..telemetry.clone() };
            self.controller.handle_and_poll(now, Message::Telemetry(array, &mut telemetry), &mut |_| {});
        }
        self.controller.handle_and_poll(now, Message::Channel(&mut self.walkers.channel), &mut |_| {});
        Ok(encode(&self.walkers.users, &mut self.payload)?)
    }

    fn act(&mut self, started: Instant) -> Result<()> {
        let mut stamps = StageStamps::start(started);
        stamps.mark(Stage::Waited);
        decode_into(&mut self.report, &self.payload)?;
        stamps.mark(Stage::Decoded);
        let now = self.tick * 10_000_000;
        let message = Message::Users(&mut self.report);
        let decision = self.controller.handle_and_poll(now, message, &mut |stage| stamps.mark(stage));
        let Some(decision @ Decision::Move { age_ns, .. }) = decision else {
            anyhow::bail!("the controller gave no command for tick {}", self.tick);
        };
        for (_, command) in decision.commands() {
            encode(command, &mut self.command)?;
        }
        stamps.mark(Stage::Published);
        self.times.record(&stamps, age_ns);
        Ok(())
    }
}

/// The inference engine alone: on the file of the subject, else on the built-in actor of ddpg.
struct EngineAlone {
    actor: Actor,
}

impl EngineAlone {
    fn new(subject: &Subject<'_>) -> Result<Self> {
        let own = subject.source.fetch(subject.kind, subject.scenario).ok().filter(|_| subject.kind.is_learned());
        let file = match own {
            Some(file) => file,
            None => ActorSource::Shipped.fetch(PolicyKind::Ddpg, subject.scenario)?,
        };
        let (mut actor, model) = (subject.load(&file)?, subject.scenario.channel_model()?);
        // The network then has its input of a decision, with a row for each user where it has rows.
        let observation = Observation::new(&model, subject.scenario.users.count);
        actor.act(&model, &observation, &mut MirrorAngles::flat(observation.mirrors()))?;
        for _ in 0..WARM_UP {
            actor.run_engine_alone()?;
        }
        Ok(Self { actor })
    }
}

/// `Session::run` of ONNX Runtime alone.
struct Bare(BareSession);

impl Side for Bare {
    fn prepare(&mut self) -> Result<()> {
        Ok(())
    }

    fn act(&mut self, _: Instant) -> Result<()> {
        Ok(self.0.run()?)
    }
}

impl Side for EngineAlone {
    fn prepare(&mut self) -> Result<()> {
        Ok(())
    }

    fn act(&mut self, _: Instant) -> Result<()> {
        Ok(self.actor.run_engine_alone()?)
    }
}
