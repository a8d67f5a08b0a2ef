//! How long a decision takes without transport, policy by policy: from the payload of a position report to the payload of the
//! command, in a hot loop and with a pause of 10 ms before each report, as at 100 reports a second.
//!
//! `cargo run --release --example decision_times -- [--scenario FILE] [--set table.key=value] [--model FILE]`

use std::{
    path::PathBuf,
    time::{Duration, Instant},
};

use anyhow::Result;
use clap::{Parser, ValueEnum};
use heliostat_controller::{
    core::{Controller, Decision, Stage},
    inbox::Message,
    ledger::{Laps, Ledger},
    policy::{ActorSource, PolicyKind, build},
};
use heliostat_proto::{
    ChannelReport, Nanos, Obstacle, ObstacleReport, Quantiles, Stamp, UserChannel, UserReport, UserState, decode_into,
    encode,
};
use heliostat_scenario::{Scenario, ScenarioArgs};

#[derive(Parser)]
struct Args {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// ONNX file of the actor, in place of the built-in one
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Decisions a policy in the hot loop
    #[arg(long, default_value_t = 5000)]
    decisions: u64,
    /// Decisions a policy with pauses
    #[arg(long, default_value_t = 300)]
    paced: u64,
}

/// Report interval of the invented room.
const INTERVAL: Duration = Duration::from_millis(10);

fn main() -> Result<()> {
    let args = Args::parse();
    let scenario = args.scenario.load()?;
    let actor = args.model.map_or(ActorSource::Shipped, ActorSource::Path);
    println!("{} users, {} mirrors; times in us", scenario.users.count, scenario.mirror_count());
    println!(
        "{:<12} {:>6} {:>9} {:>9} {:>9} | {:>8} {:>8} {:>8}",
        "policy", "pace", "p50", "p99", "max", "observe", "infer", "safe"
    );
    for kind in PolicyKind::value_variants() {
        for (pace, pause, decisions) in [("hot", Duration::ZERO, args.decisions), ("10 ms", INTERVAL, args.paced)] {
            let policy = match build(*kind, &scenario, &actor) {
                Ok(policy) => policy,
                Err(error) => {
                    println!("{error}");
                    break;
                }
            };
            let mut controller = Controller::new(&scenario, scenario.channel_model()?, policy, 1);
            controller.warm_up(200);
            let ledger = measure(&scenario, &mut controller, decisions, pause)?;
            let Quantiles { p50, p99, max, .. } = ledger.decision_us();
            let stage = |stage| ledger.stage_us(stage).p50;
            println!(
                "{:<12} {pace:>6} {p50:>9.1} {p99:>9.1} {max:>9.1} | {:>8.1} {:>8.1} {:>8.1}",
                controller.policy_name(),
                stage(Stage::Observed),
                stage(Stage::Inferred),
                stage(Stage::MadeSafe)
            );
        }
    }
    Ok(())
}

/// Decides for people who walk in circles among two pillars; half of them have no direct path.
fn measure(scenario: &Scenario, controller: &mut Controller, decisions: u64, pause: Duration) -> Result<Ledger> {
    let mut ledger = Ledger::new();
    let (mut reports, mut payload) = (Reports::default(), Vec::new());
    let (mut users, mut command_payload) = (UserReport::default(), Vec::new());
    for tick in 1..=decisions {
        let now = tick * 10_000_000;
        reports.at(tick, now, scenario.users.count);
        if tick == 1 {
            controller.receive(now, Message::Obstacles(&mut reports.obstacles), &mut |_| {});
        }
        controller.receive(now, Message::Channel(&mut reports.channel), &mut |_| {});
        encode(&reports.users, &mut payload)?;
        std::thread::sleep(pause);

        let mut laps = Laps::start(Instant::now());
        decode_into(&mut users, &payload)?;
        laps.mark(Stage::Decoded);
        let decision = controller.receive(now, Message::Users(&mut users), &mut |stage| laps.mark(stage));
        if let Some(Decision::Move { command, age_ns }) = decision {
            encode(command, &mut command_payload)?;
            laps.mark(Stage::Published);
            ledger.record(&laps, age_ns);
        }
    }
    Ok(ledger)
}

#[derive(Default)]
struct Reports {
    users: UserReport,
    channel: ChannelReport,
    obstacles: ObstacleReport,
}

impl Reports {
    fn at(&mut self, tick: u64, now: Nanos, users: usize) {
        let stamp = Stamp { source: 1, sequence: tick, time_ns: now };
        let pillar = |x_m: f32, y_m: f32| Obstacle { x_m, y_m, radius_m: 0.25, height_m: 1.75 };
        self.obstacles = ObstacleReport { stamp, obstacles: vec![pillar(1.2, 0.8), pillar(-1.0, -0.6)] };
        self.users = UserReport { stamp, tick, users: (0..users).map(|user| walker(user, users, tick)).collect() };
        let gain = |user: usize| if user.is_multiple_of(2) { 0.0 } else { 8e-7 };
        let measured = |user: usize| UserChannel { user: user as u32, los_gain: gain(user), irs_gain: 0.0, sinr: 0.0 };
        self.channel = ChannelReport { stamp, tick, users: (0..users).map(measured).collect() };
    }
}

fn walker(user: usize, users: usize, tick: u64) -> UserState {
    let turn = std::f64::consts::TAU * user as f64 / users as f64 + 0.01 * tick as f64;
    let (sin, cos) = turn.sin_cos();
    UserState {
        user: user as u32,
        position_m: [(1.8 * cos) as f32, (1.4 * sin) as f32, 0.85],
        velocity_m_s: [(-1.8 * sin) as f32, (1.4 * cos) as f32],
        min_rate_bps: 1e6,
    }
}
