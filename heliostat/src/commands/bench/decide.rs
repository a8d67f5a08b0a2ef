//! `heliostat bench decide | policies | mirrors | users`: the decision without transport, from the payload of a position report to the
//! payload of the command, in one process.
//!
//! Between decisions the thread sleeps, as a controller does between reports, so that caches go cold as they do there. A decision counts from the
//! moment the thread is awake, or from when it was due where the one before was still going on.

use std::io::Write;
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use clap::ValueEnum;
use heliostat_controller::report::stage_times::{StageStamps, StageTimes};
use heliostat_decide::core::{Controller, Decision, Stage};
use heliostat_decide::inbox::Message;
use heliostat_decide::policy::{Actor, PolicyKind};
use heliostat_engine::{ActorSource, build, load_actor};
use heliostat_proto::{UserReport, decode_into, encode};
use heliostat_scenario::{Scenario, ScenarioArgs};

use super::pace::{Block, PaceArgs, Plan, Turn};
use super::people::People;
use super::rows::{Row, Table, Times, Varied};

/// Decisions before the first that counts.
const WARM_UP: usize = 200;

/// Flags that the benchmarks of the decision share.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scenario: ScenarioArgs,
    #[command(flatten)]
    pace: PaceArgs,
    /// Which policy decides; where none is named, the benchmark's own choice
    #[arg(long, value_enum)]
    policy: Option<PolicyKind>,
    /// Warm up the caches this often between decisions, in us; 0 never
    #[arg(long, value_name = "US", default_value_t = 0)]
    keep_warm: u64,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// `decide`: one policy at several paces, beside the inference engine alone.
pub fn decide(args: &Args) -> Result<()> {
    let scenario = args.scenario.load()?;
    let kind = args.policy.unwrap_or(PolicyKind::Ddpg);
    let mut table =
        Table::new(args.json, "decision without transport, beside the inference engine alone at the same pace")?;
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
        Table::new(args.json, "decision without transport, beside the inference engine alone at the same pace")?;
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

/// `mirrors`: the same wall divided into more and more mirrors, beside 49 of them, in the light of a point LED.
pub fn mirrors(args: &Args) -> Result<()> {
    let sized = |side: usize| {
        let set = [
            format!("mirrors.rows={side}"),
            format!("mirrors.columns={side}"),
            format!("mirrors.width_m={}", 2.5 / side as f64),
            format!("mirrors.height_m={}", 1.0 / side as f64),
            format!("mirrors.gap_m={}", 0.2 / side as f64),
            // A panel of 25 points costs many times as much, and its image does not fit the smallest mirrors.
            "led.side_m=0".into(),
        ];
        Ok(args.scenario.load()?.with_overrides(&set)?)
    };
    args.growth("mirrors, beside 49 of them", &[7, 10, 16, 32, 64], &sized)
}

/// `users`: more and more people, beside one.
pub fn users(args: &Args) -> Result<()> {
    let sized = |users: usize| Ok(args.scenario.load()?.with_overrides(&[format!("users.count={users}")])?);
    args.growth("users, beside one", &[1, 2, 5, 10, 20, 50], &sized)
}

impl Args {
    /// Rooms of growing size, each beside the first.
    fn growth(&self, of: &str, sizes: &[usize], sized: &dyn Fn(usize) -> Result<Scenario>) -> Result<()> {
        let kind = self.policy.unwrap_or(PolicyKind::FixedPoint);
        let mut table = Table::new(self.json, &format!("decision without transport with more and more {of}"))?;
        for plan in self.pace.plans(&[100.0])? {
            for size in sizes {
                let mut smallest = Decider::new(&sized(sizes[0])?, kind, 0)?;
                table.add(self.measure(&plan, (&sized(*size)?, kind), &mut smallest)?)?;
            }
        }
        Ok(table.finish()?)
    }

    fn measure(&self, plan: &Plan, of: (&Scenario, PolicyKind), reference: &mut dyn Party) -> Result<Row> {
        ensure!(self.keep_warm <= 1_000_000, "--keep-warm {}: wanted 0 to 1000000", self.keep_warm);
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
        let blamed = Stage::ALL.map(|stage| (stage.name().to_string(), times.over_budget_by(stage)));
        let row = Row::new(varied, (decision.into(), times.over_budget(), decision.count), &compared);
        let stages = Stage::ALL.map(|stage| (stage.name().to_string(), times.stage_us(stage)));
        Ok(row.by_stage(blamed.into_iter().filter(|(_, count)| *count > 0).collect(), &stages.into()))
    }
}

/// One of the two that take turns.
trait Party {
    /// Gets ready for the next report, before the pause.
    fn prepare(&mut self) -> Result<()>;
    /// Passes the time until shortly before the report is due.
    fn pass(&mut self, due: Instant) {
        sleep_until(due);
    }
    /// Answers a report that counts from `started`.
    fn act(&mut self, started: Instant) -> Result<()>;
}

fn sleep_until(due: Instant) {
    std::thread::sleep(due.saturating_duration_since(Instant::now()));
}

/// Lets a party answer the reports of a block; gives how many.
fn go_through(party: &mut dyn Party, block: Block, record: &mut dyn FnMut(Duration)) -> Result<u64> {
    let start = Instant::now();
    for report in 0..block.reports {
        party.prepare()?;
        let started = match block.interval {
            None => Instant::now(),
            Some(interval) => {
                let due = start + interval.mul_f64(report as f64 + 1.0);
                if Instant::now() > due {
                    due
                } else {
                    party.pass(due);
                    Instant::now()
                }
            }
        };
        party.act(started)?;
        record(started.elapsed());
        if block.interval.is_none() && Instant::now() > block.until {
            return Ok(report + 1);
        }
    }
    Ok(block.reports)
}

/// The controller's core with its codec on both sides.
struct Decider {
    controller: Controller,
    people: People,
    users: usize,
    tick: u64,
    keep_warm: Option<Duration>,
    payload: Vec<u8>,
    report: UserReport,
    command: Vec<u8>,
    times: StageTimes,
}

impl Decider {
    fn new(scenario: &Scenario, kind: PolicyKind, keep_warm_us: u64) -> Result<Self> {
        let policy = build(kind, scenario, &ActorSource::Shipped)?;
        let mut controller = Controller::new(scenario, scenario.channel_model()?, policy, 1);
        controller.warm_up(0..WARM_UP);
        let mut decider = Self {
            controller,
            people: People::default(),
            users: scenario.users.count,
            tick: 0,
            keep_warm: (keep_warm_us > 0).then(|| Duration::from_micros(keep_warm_us)),
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

impl Party for Decider {
    fn prepare(&mut self) -> Result<()> {
        self.tick += 1;
        // Ten simulated milliseconds from report to report, whatever the pace.
        let now = self.tick * 10_000_000;
        self.people.walk(1, self.tick, now, self.users);
        if self.tick % 100 == 1 {
            self.controller.handle_and_poll(now, Message::Obstacles(&mut self.people.obstacles), &mut |_| {});
        }
        self.controller.handle_and_poll(now, Message::Channel(&mut self.people.channel), &mut |_| {});
        Ok(encode(&self.people.users, &mut self.payload)?)
    }

    fn pass(&mut self, due: Instant) {
        while let Some(interval) = self.keep_warm.filter(|interval| Instant::now() + *interval < due) {
            std::thread::sleep(interval);
            self.controller.warm_cache();
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

/// The inference engine alone, on the actor that fits the room; on that of the default room where none does.
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

impl Party for Engine {
    fn prepare(&mut self) -> Result<()> {
        Ok(())
    }

    fn act(&mut self, _: Instant) -> Result<()> {
        Ok(self.actor.run_engine_alone()?)
    }
}
