//! `heliostat eval`: any set of policies on the same states, beside the oracle.

use std::io;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use heliostat_controller::policy::ActorSource;
use heliostat_models::comparison::{Entrant, Loop, Report, Row, Settings, Spread, compare};
use heliostat_scenario::ScenarioArgs;

use crate::output::outln;

/// The policies that are compared when none are named, the first only where an actor is built in for the room.
const DEFAULT_POLICIES: [&str; 7] = ["ddpg", "greedy", "fixed-point", "nearest", "random", "flat", "no-irs"];

/// Compare policies on the same states, each beside the oracle with minimum rates.
///
/// Without --closed-loop each policy sees held-out states as they are and its mirrors turn at once. With it, reports are as rare, late and
/// noisy as the scenario says, and mirrors take their time; the oracle still knows the true state and turns its mirrors at once.
/// The decision time is the policy's alone.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Policies by name, or paths of ONNX actors (FILE.onnx), with commas between them [default: ddpg where an actor fits, greedy,
    /// fixed-point, nearest, random, flat, no-irs]
    #[arg(long, value_name = "A,B,C", value_delimiter = ',')]
    policies: Vec<String>,
    /// ONNX file of the policy ddpg (actor), in place of the built-in one
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// States of each seed
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    states: u32,
    /// How many seeds, counted up from the scenario's
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    seeds: u32,
    /// Users whose direct path is off: short for --set blockage.forced_users=B
    #[arg(long, value_name = "B")]
    blocked: Option<usize>,
    /// Reports, delay, noise and mirrors in simulated time, in place of held-out states
    #[arg(long)]
    closed_loop: bool,
    /// Show each policy that looks at users a second time, with constant-velocity prediction of the users
    #[arg(long, requires = "closed_loop")]
    predicted: bool,
    /// Write the figures to a CSV file too, one line a policy
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

impl Args {
    fn settings(&self) -> Result<Settings> {
        let mut scenario = self.scenario.clone();
        scenario.overrides.extend(self.blocked.map(|blocked| format!("blockage.forced_users={blocked}")));
        let scenario = scenario.load()?;
        let actor = self.model.clone().map_or(ActorSource::Shipped, ActorSource::Path);
        let mut entrants = Vec::new();
        for (index, name) in self.policies.iter().enumerate() {
            ensure!(!self.policies[..index].contains(name), "--policies names {name} twice");
            entrants.push(Entrant::parse(name, &actor)?);
        }
        if self.policies.is_empty() {
            entrants =
                DEFAULT_POLICIES.map(|name| Entrant::parse(name, &actor)).into_iter().collect::<Result<_, _>>()?;
            entrants.retain(|entrant| self.model.is_some() || entrant.fits(&scenario));
        }
        let entrants = entrants.into_iter().flat_map(|entrant| {
            let predicted = if self.predicted { entrant.predicted() } else { None };
            [Some(entrant), predicted].into_iter().flatten()
        });
        Ok(Settings {
            scenario,
            entrants: entrants.collect(),
            states: self.states as usize,
            seeds: self.seeds as usize,
            mode: if self.closed_loop { Loop::ClosedLoop } else { Loop::Static },
        })
    }
}

/// Runs the command.
pub fn run(args: Args) -> Result<()> {
    let report = compare(&args.settings()?)?;
    if let Some(file) = &args.csv {
        write_csv(file, &report).with_context(|| format!("cannot write {}", file.display()))?;
    }
    if args.json {
        outln!("{}", serde_json::to_string(&report)?)?;
    } else {
        print_table(&report)?;
    }
    Ok(())
}

/// The oracle's row, then those of the policies.
fn rows(report: &Report) -> impl Iterator<Item = (&str, &Row)> {
    let policies = report.policies.iter().map(|(name, row)| (name.as_str(), row));
    std::iter::once(("(oracle)", &report.oracle)).chain(policies)
}

fn print_table(report: &Report) -> io::Result<()> {
    let loop_name = if report.mode == Loop::ClosedLoop { "closed loop" } else { "static" };
    outln!(
        "{}, {loop_name}: {} users, {} with the direct path off; {} states of each of {} seeds from {}",
        report.scenario,
        report.users,
        report.blocked,
        report.states,
        report.seeds,
        report.seed
    )?;
    outln!(
        "{:<22} {:>15} {:>15} {:>7} {:>7} {:>7} {:>9} {:>9} {:>9} {:>9}",
        "",
        "Mb/s",
        "ratio",
        "p5",
        "QoS met",
        "Jain",
        "blocked",
        "BER",
        "p50 (us)",
        "p99 (us)"
    )?;
    for (name, row) in rows(report) {
        let (rate, ratio) = (row.sum_rate_mbps, row.ratio_to_oracle);
        let time = |time: Option<f64>| time.map_or("-".into(), |time| format!("{time:.0}"));
        outln!(
            "{name:<22} {:>15} {:>15} {:>7} {:>7} {:>7} {:>9} {:>9.2e} {:>9} {:>9}",
            interval(rate, 1),
            interval(ratio, 3),
            number(ratio.p5, 3),
            number(row.qos_met.mean, 3),
            number(row.jain.mean, 3),
            number(row.blocked_rate_mbps.mean, 2),
            row.ber.mean,
            time(row.decision_us.map(|times| times.p50)),
            time(row.decision_us.map(|times| times.p99)),
        )?;
    }
    outln!("ratio: to the sum rate of the oracle with minimum rates, with its 95 % interval and 5th percentile")?;
    outln!("blocked: mean rate of a user without a direct path, in Mb/s")?;
    if report.mode == Loop::ClosedLoop {
        outln!("outage, the share of the users' time below their minimum rate, is one minus QoS met")?;
    }
    Ok(())
}

fn interval(spread: Spread, digits: usize) -> String {
    if spread.ci95.is_nan() {
        return number(spread.mean, digits);
    }
    format!("{:.digits$} ±{:.digits$}", spread.mean, spread.ci95)
}

/// A number, or a dash where there is none.
fn number(value: f64, digits: usize) -> String {
    if value.is_nan() { "-".into() } else { format!("{value:.digits$}") }
}

fn write_csv(file: &Path, report: &Report) -> Result<()> {
    let mut writer = csv::Writer::from_path(file)?;
    let mut header = vec!["policy".to_owned()];
    for (name, _) in spreads(&report.oracle) {
        header.extend(["mean", "ci95", "p5"].map(|part| format!("{name}_{part}")));
    }
    header.extend(["decision_us_p50".into(), "decision_us_p99".into()]);
    writer.write_record(&header)?;
    for (name, row) in rows(report) {
        let figures = spreads(row).into_iter().flat_map(|(_, spread)| [spread.mean, spread.ci95, spread.p5]);
        let times = row.decision_us.map_or([f64::NAN; 2], |times| [times.p50, times.p99]);
        let cells = figures.chain(times).map(|value| if value.is_nan() { String::new() } else { value.to_string() });
        writer.write_record(std::iter::once(name.to_owned()).chain(cells))?;
    }
    Ok(writer.flush()?)
}

/// The figures of a row by name.
fn spreads(row: &Row) -> Vec<(&'static str, Spread)> {
    let mut spreads = vec![
        ("sum_rate_mbps", row.sum_rate_mbps),
        ("ratio_to_oracle", row.ratio_to_oracle),
        ("qos_met", row.qos_met),
        ("jain", row.jain),
        ("blocked_rate_mbps", row.blocked_rate_mbps),
        ("ber", row.ber),
    ];
    spreads.extend(row.outage_time.map(|outage| ("outage_time", outage)));
    spreads
}
