//! `heliostat-lab bench oracle`: solution time of the oracle, beside the model-based policies on the same states.
//!
//! A solution leads from a scene to the angles of the mirrors. The three methods alternate state by
//! state, so that a drift of the machine cancels in the ratio.

use std::hint::black_box;
use std::time::{Duration, Instant};

use anyhow::Result;
use heliostat_channel::solver::QOS_PENALTY;
use heliostat_channel::solver::{Method, MinimumRates, Solver};
use heliostat_channel::{MirrorAngles, Scene};
use heliostat_room::World;
use heliostat_scenario::Scenario;
use heliostat_service::duration;
use serde::Serialize;

use heliostat_service::outln;

/// Measure the solution time of the oracle, without and with minimum rates, beside fixed-point and
/// greedy.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Time spent on each row, in s
    #[arg(long, value_name = "S", default_value = "1", value_parser = duration::seconds, allow_negative_numbers = true)]
    seconds: Duration,
}

/// Number of rooms of a row.
const STATES: u64 = 200;

/// Times of one solution in us.
#[derive(Clone, Copy, Debug, Serialize)]
struct Time {
    p50_us: f64,
    p99_us: f64,
}

#[derive(Debug, Serialize)]
struct Row {
    mode: String,
    users: usize,
    mirrors: usize,
    /// Whether rates below the minimum are penalised.
    qos: bool,
    oracle: Time,
    fixed_point: Time,
    greedy: Time,
    /// Ratio of the medians, oracle to greedy.
    oracle_over_greedy: f64,
}

/// Runs the benchmark.
pub fn run(args: &Args) -> Result<()> {
    if !args.json {
        outln!(
            "{:<10}{:>6}{:>9}{:>7}{:>12}{:>12}{:>14}{:>14}{:>14}{:>14}{:>8}",
            "time in us",
            "users",
            "mirrors",
            "QoS",
            "oracle p50",
            "oracle p99",
            "fixed pt p50",
            "fixed pt p99",
            "greedy(3) p50",
            "greedy(3) p99",
            "ratio"
        )?;
    }
    let mut rows = Vec::new();
    for mode in ["specular", "paper"] {
        for (users, side) in [(5, 7), (5, 10), (10, 10), (5, 32)] {
            for qos in [false, true] {
                let row = measure(mode, (users, side), qos, args.seconds)?;
                if !args.json {
                    print(&row)?;
                }
                rows.push(row);
            }
        }
    }
    if args.json {
        outln!("{}", serde_json::json!({ "rows": rows }))?;
    }
    Ok(())
}

fn print(row: &Row) -> std::io::Result<()> {
    let qos = if row.qos { "yes" } else { "no" };
    let [oracle, fixed_point, greedy] = [row.oracle, row.fixed_point, row.greedy];
    outln!(
        "{:<10}{:>6}{:>9}{qos:>7}{:>12.0}{:>12.0}{:>14.0}{:>14.0}{:>14.0}{:>14.0}{:>8.1}",
        row.mode,
        row.users,
        row.mirrors,
        oracle.p50_us,
        oracle.p99_us,
        fixed_point.p50_us,
        fixed_point.p99_us,
        greedy.p50_us,
        greedy.p99_us,
        row.oracle_over_greedy
    )
}

fn measure(mode: &str, (users, side): (usize, usize), qos: bool, time: Duration) -> Result<Row> {
    let scenario = Scenario::builtin(mode)?.with_overrides(&super::room::overrides(users, side))?;
    let model = scenario.channel_model()?;
    let scenes = (0..STATES)
        .map(|seed| Ok(World::new(&scenario, scenario.read_trace()?.as_deref(), seed)?.scene().clone()))
        .collect::<Result<Vec<_>>>()?;
    let min_rate_bps = scenario.min_rate_bps();
    let minimum_rates = MinimumRates { min_rate_bps: &min_rate_bps, qos_penalty: if qos { QOS_PENALTY } else { 0.0 } };
    let mut solver = Solver::new(users, model.mirrors.len());
    let mut angles = MirrorAngles::flat(model.mirrors.len());
    let methods = [Method::Oracle, Method::FixedPoint, Method::Greedy { passes: 3 }];
    let mut times: [Vec<f64>; 3] = Default::default();
    let mut solve = |scene: &Scene, method: Method| {
        let start = Instant::now();
        black_box(solver.solve(&model, scene, &minimum_rates, method, &mut angles));
        start.elapsed().as_secs_f64() * 1e6
    };
    // One unmeasured solution each warms memory and caches.
    methods.iter().for_each(|method| _ = solve(&scenes[0], *method));
    let start = Instant::now();
    for scene in scenes.iter().cycle() {
        for (times, method) in times.iter_mut().zip(methods) {
            times.push(solve(scene, method));
        }
        if start.elapsed() >= time {
            break;
        }
    }
    let [oracle, fixed_point, greedy] = times.map(quantiles);
    let oracle_over_greedy = oracle.p50_us / greedy.p50_us;
    Ok(Row {
        mode: mode.into(),
        users,
        mirrors: model.mirrors.len(),
        qos,
        oracle,
        fixed_point,
        greedy,
        oracle_over_greedy,
    })
}

fn quantiles(mut times: Vec<f64>) -> Time {
    times.sort_by(f64::total_cmp);
    let at = |share: f64| times[((times.len() - 1) as f64 * share).round() as usize];
    Time { p50_us: at(0.5), p99_us: at(0.99) }
}
