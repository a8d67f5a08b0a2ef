//! `heliostat bench decide | policies | mirrors | users`: the decision without transport, from the payload of a
//! position report to the payload of the command, in one process.
//!
//! Between decisions the thread sleeps, as a controller does between reports, so the caches lose
//! their contents as they do there. A decision counts from the moment the thread is awake, or from
//! its due time if the previous decision was still running.

use std::io::Write;
use std::time::{Duration, Instant};

use anyhow::Result;
use clap::ValueEnum;
use heliostat_controller::report::stage_times::{StageStamps, StageTimes};
use heliostat_decide::core::{Controller, Decision, Stage};
use heliostat_decide::inbox::Message;
use heliostat_decide::policy::{Actor, PolicyKind};
use heliostat_engine::{ActorSource, build, load_actor};
use heliostat_proto::{UserReport, decode_into, encode};
use heliostat_scenario::{Scenario, ScenarioArgs};

use super::pace::{Block, PaceArgs, Plan, Turn};
use super::rows::{Row, Table, Times, Varied};
use super::walkers::Walkers;

/// Unmeasured decisions at the start.
const WARM_UP: usize = 200;
/// Cache warm-ups before each report, as in the controller.
const WARM_UPS: u32 = 2;
/// The cache warm-ups end this long before the report is due, as in the controller.
const WARM_UP_MARGIN: Duration = Duration::from_micros(50);

/// Flags that the benchmarks of the decision share.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scenario: ScenarioArgs,
    #[command(flatten)]
    pace: PaceArgs,
    /// Policy that decides [default: ddpg for decide, fixed-point for mirrors and users, all for
    /// policies]
    #[arg(long, value_enum)]
    policy: Option<PolicyKind>,
    /// Whether caches are warmed shortly before each report, as the controller does
    #[arg(long, value_enum, value_name = "WHEN", default_value_t = KeepWarm::Off)]
    keep_warm: KeepWarm,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// When caches are warmed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum KeepWarm {
    /// Never
    Off,
    /// Shortly before each report
    Expected,
}

/// `decide`: one policy at several rates, beside the inference engine alone.
pub fn decide(args: &Args) -> Result<()> {
    let scenario = args.scenario.load()?;
    let kind = args.policy.unwrap_or(PolicyKind::Ddpg);
    let mut table =
        Table::new(args.json, "decision without transport; reference: the inference engine alone at the same rate")?;
    for plan in args.pace.plans(&[10.0, 100.0, 1000.0, 0.0])? {
        let mut reference = Engine::new(&scenario)?;
        table.add(args.measure(&plan, (&scenario, kind), &mut reference)?)?;
    }
    Ok(table.finish()?)
}

/// `policies`: every policy that can decide here, beside the inference engine alone.
pub fn policies(args: &Args) -> Result<()> {
    let scenario = args.scenario.load()?;
    let mut table =
        Table::new(args.json, "decision without transport; reference: the inference engine alone at the same rate")?;
    for plan in args.pace.plans(&[100.0])? {
        for kind in PolicyKind::value_variants() {
            if let Err(error) = build(*kind, &scenario, &ActorSource::Shipped) {
                drop(writeln!(std::io::stderr(), "left out: {error}"));
                continue;
            }
            let mut reference = Engine::new(&scenario)?;
            table.add(args.measure(&plan, (&scenario, *kind), &mut reference)?)?;
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
        Ok(args.scenario.load()?.with_overrides(&set)?)
    };
    args.growth("mirrors; reference: 49 mirrors", &[7, 10, 16, 32, 64], &sized)
}

/// `users`: 1 to 50 users; reference: one user.
pub fn users(args: &Args) -> Result<()> {
    let sized = |users: usize| Ok(args.scenario.load()?.with_overrides(&[format!("users.count={users}")])?);
    args.growth("users; reference: one user", &[1, 2, 5, 10, 20, 50], &sized)
}

impl Args {
    /// Rooms of growing size; the first is the reference.
    fn growth(&self, of: &str, sizes: &[usize], sized: &dyn Fn(usize) -> Result<Scenario>) -> Result<()> {
        let kind = self.policy.unwrap_or(PolicyKind::FixedPoint);
        let mut table = Table::new(self.json, &format!("decision without transport with a growing number of {of}"))?;
        for plan in self.pace.plans(&[100.0])? {
            for size in sizes {
                let mut smallest = Decider::new(&sized(sizes[0])?, kind, KeepWarm::Off)?;
                table.add(self.measure(&plan, (&sized(*size)?, kind), &mut smallest)?)?;
            }
        }
        Ok(table.finish()?)
    }

    fn measure(&self, plan: &Plan, of: (&Scenario, PolicyKind), reference: &mut dyn Side) -> Result<Row> {
        let (scenario, kind) = of;
        let mut decider = Decider::new(scenario, kind, self.keep_warm)?;
        let mut compared = Times::new();
        plan.take_turns(|turn, block| match turn {
            Turn::Measured => go_through(&mut decider, block, &mut |_| {}),
            Turn::Reference => go_through(reference, block, &mut |time| compared.record(time)),
        })?;
        let times = &decider.times;
        let decision = times.decision_us();
        let varied = Varied {
            hz: plan.hz,
            mirrors: scenario.mirror_count(),
            users: scenario.users.count,
            rooms: 1,
            policy: decider.controller.policy_name().into(),
        };
        let by_stage = Stage::ALL.map(|stage| (stage.name().to_string(), times.over_budget_by(stage)));
        let row = Row::new(varied, (decision.into(), times.over_budget(), decision.count), &compared);
        let stages = Stage::ALL.map(|stage| (stage.name().to_string(), times.stage_us(stage)));
        Ok(row.by_stage(by_stage.into_iter().filter(|(_, count)| *count > 0).collect(), &stages.into()))
    }
}

/// One of the two sides that alternate.
trait Side {
    /// Prepares the next report, before the pause.
    fn prepare(&mut self) -> Result<()>;
    /// Waits until the report is due.
    fn wait(&mut self, due: Instant) {
        sleep_until(due);
    }
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
                    side.wait(due);
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
    users: usize,
    tick: u64,
    keep_warm: KeepWarm,
    /// How long the last cache warm-up took.
    warm_up_took: Duration,
    payload: Vec<u8>,
    report: UserReport,
    command: Vec<u8>,
    times: StageTimes,
}

impl Decider {
    fn new(scenario: &Scenario, kind: PolicyKind, keep_warm: KeepWarm) -> Result<Self> {
        let policy = build(kind, scenario, &ActorSource::Shipped)?;
        let mut controller = Controller::new(scenario, scenario.channel_model()?, policy, 1);
        controller.warm_up(0..WARM_UP);
        let mut decider = Self {
            controller,
            walkers: Walkers::default(),
            users: scenario.users.count,
            tick: 0,
            keep_warm,
            warm_up_took: Duration::ZERO,
            payload: Vec::new(),
            report: UserReport::default(),
            command: Vec::new(),
            times: StageTimes::new(),
        };
        for _ in 0..WARM_UP {
            decider.prepare()?;
            decider.act(Instant::now())?;
        }
        decider.times = StageTimes::new();
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
        self.controller.handle_and_poll(now, Message::Channel(&mut self.walkers.channel), &mut |_| {});
        Ok(encode(&self.walkers.users, &mut self.payload)?)
    }

    fn wait(&mut self, due: Instant) {
        let ahead = self.warm_up_took + WARM_UP_MARGIN;
        if self.keep_warm == KeepWarm::Expected
            && let Some(start) = due.checked_sub(ahead).filter(|start| *start > Instant::now())
        {
            sleep_until(start);
            let start = Instant::now();
            (0..WARM_UPS).for_each(|_| self.controller.warm_cache());
            self.warm_up_took = start.elapsed();
            while Instant::now() < due {
                std::hint::spin_loop();
            }
        }
        sleep_until(due);
    }

    fn act(&mut self, started: Instant) -> Result<()> {
        let mut stamps = StageStamps::start(started);
        stamps.mark(Stage::Waited);
        decode_into(&mut self.report, &self.payload)?;
        stamps.mark(Stage::Decoded);
        let now = self.tick * 10_000_000;
        let message = Message::Users(&mut self.report);
        let decision = self.controller.handle_and_poll(now, message, &mut |stage| stamps.mark(stage));
        let Some(Decision::Move { command, age_ns }) = decision else {
            anyhow::bail!("the controller gave no command for tick {}", self.tick);
        };
        command.sequence = self.tick;
        encode(command, &mut self.command)?;
        stamps.mark(Stage::Published);
        self.times.record(&stamps, age_ns);
        Ok(())
    }
}

/// The inference engine alone, on the actor for the room, or on that of the default room if there
/// is none.
struct Engine {
    actor: Actor,
}

impl Engine {
    fn new(scenario: &Scenario) -> Result<Self> {
        let fetch = |room: &Scenario| ActorSource::Shipped.fetch(PolicyKind::Ddpg, room);
        let default = Scenario::default();
        let (file, room) = match fetch(scenario) {
            Ok(file) => (file, scenario),
            Err(_) => (fetch(&default)?, &default),
        };
        let mut actor = load_actor(&file, room)?;
        for _ in 0..WARM_UP {
            actor.run_engine_alone()?;
        }
        Ok(Self { actor })
    }
}

impl Side for Engine {
    fn prepare(&mut self) -> Result<()> {
        Ok(())
    }

    fn act(&mut self, _: Instant) -> Result<()> {
        Ok(self.actor.run_engine_alone()?)
    }
}
