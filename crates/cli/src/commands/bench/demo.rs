//! `heliostat bench demo`: decisions over 0.5 ms of the demo, on a quiet and on a busy machine.
//!
//! Each run is `heliostat demo` as it stands, one policy after the other, each in processes of its own.
//! Busy processes are `heliostat bench env`, which keeps one processor busy. The reference is the policy
//! `hold`, which publishes the last angles again: its share is what the machine itself causes.

use std::collections::BTreeMap;
use std::process::{Child, Stdio};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use heliostat_core::policy::PolicyKind;
use heliostat_proto::Quantiles;
use heliostat_service::duration;
use serde::{Deserialize, Serialize};

use crate::commands::own_program;
use crate::output::outln;

/// A busy process measures each of more than thirty rows for this much longer than a demo takes, so
/// that it outlasts all of them.
const BUSY_MARGIN: Duration = Duration::from_secs(20);

/// Count the decisions over 0.5 ms of a demo with each policy, beside those of the policy hold, on the
/// machine as it is and beside busy processes.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Policies (comma-separated); hold always runs, as the reference
    #[arg(long, value_enum, value_name = "A,B,C", value_delimiter = ',', default_values_t = [PolicyKind::FixedPoint, PolicyKind::Greedy])]
    policies: Vec<PolicyKind>,
    /// Numbers of busy processes beside the demo (comma-separated) [default: 0 and the number of
    /// processors]
    #[arg(long, value_name = "N", value_delimiter = ',', value_parser = clap::value_parser!(u16).range(0..=1024))]
    busy: Vec<u16>,
    /// Time for each policy, in s
    #[arg(long, value_name = "S", default_value = "25", value_parser = duration::seconds, allow_negative_numbers = true)]
    seconds: Duration,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// The figures of a demo.
#[derive(Debug, Deserialize)]
struct Demo {
    scenario: String,
    decisions: u64,
    over_budget: u64,
    over_budget_by: BTreeMap<String, u64>,
    decision_us: Quantiles,
}

#[derive(Debug, Serialize)]
struct Row {
    scenario: String,
    policy: String,
    /// Busy processes beside the demo.
    busy: u16,
    /// The times in us.
    measured_us: Quantiles,
    /// Number of decisions.
    count: u64,
    /// Decisions of more than 0.5 ms.
    over_budget: u64,
    /// The same, by their longest stage.
    over_budget_by: BTreeMap<String, u64>,
    /// Their share of all decisions.
    share: f64,
    /// The share less that of `hold` with as many busy processes.
    above_hold: f64,
}

impl Row {
    /// The figures of a policy; `hold` is its share, `None` for the policy itself.
    fn new((policy, busy): (PolicyKind, u16), demo: Demo, hold: Option<f64>) -> Result<Self> {
        ensure!(demo.decisions > 0, "the demo with {} made no decision", policy.name());
        let share = demo.over_budget as f64 / demo.decisions as f64;
        Ok(Self {
            scenario: demo.scenario,
            policy: policy.name(),
            busy,
            measured_us: demo.decision_us,
            count: demo.decisions,
            over_budget: demo.over_budget,
            over_budget_by: demo.over_budget_by,
            share,
            above_hold: share - hold.unwrap_or(share),
        })
    }

    fn print(&self) -> std::io::Result<()> {
        let by_stage: String = self.over_budget_by.iter().map(|(stage, count)| format!(" {stage} {count}")).collect();
        let Quantiles { p50, p99, .. } = self.measured_us;
        outln!(
            "{:>5}  {:<15}{p50:>9.1}{p99:>9.1}{:>8}{:>8}{:>9.4}{:>12.4} {by_stage}",
            self.busy,
            self.policy,
            self.count,
            self.over_budget,
            self.share,
            self.above_hold
        )
    }
}

/// Runs the benchmark.
pub fn run(args: &Args) -> Result<()> {
    let processors = std::thread::available_parallelism().map_or(1, std::num::NonZero::get) as u16;
    let busy = if args.busy.is_empty() { &[0, processors][..] } else { &args.busy };
    if !args.json {
        outln!("demo, a policy after the other; reference: the policy hold; times in us")?;
        outln!(
            "{:>5}  {:<15}{:>9}{:>9}{:>8}{:>8}{:>9}{:>12}",
            "busy",
            "policy",
            "p50",
            "p99",
            "count",
            ">500us",
            "share",
            "above hold"
        )?;
    }
    let mut rows = Vec::new();
    for busy in busy {
        let mut load = Load::start(*busy, args.seconds)?;
        let mut hold = None;
        let others = args.policies.iter().filter(|policy| **policy != PolicyKind::Hold);
        for policy in [PolicyKind::Hold].iter().chain(others) {
            let row = Row::new((*policy, *busy), demo(*policy, args.seconds)?, hold)?;
            load.check_alive()?;
            hold = hold.or(Some(row.share));
            if !args.json {
                row.print()?;
            }
            rows.push(row);
        }
    }
    if args.json {
        outln!("{}", serde_json::json!({ "rows": rows }))?;
    }
    Ok(())
}

/// Runs the demo.
fn demo(policy: PolicyKind, time: Duration) -> Result<Demo> {
    let (policy, seconds) = (policy.name(), time.as_secs_f64().to_string());
    let words = ["demo", "--policy", &policy, "--seconds", &seconds, "--plain", "--no-ui", "--json"];
    let summary = own_program::json(&words.map(String::from), Stdio::piped());
    let summary = summary.with_context(|| format!("the demo with {policy} failed"))?;
    serde_json::from_value(summary).context("the summary of the demo is incomplete")
}

/// Busy processes, which end with this value.
struct Load(Vec<Child>);

impl Load {
    fn start(count: u16, time: Duration) -> Result<Self> {
        let seconds = (time + BUSY_MARGIN).as_secs_f64().to_string();
        let mut load = Self(Vec::new());
        for _ in 0..count {
            let mut process = own_program::process(&["bench", "env", "--seconds", &seconds].map(String::from))?;
            process.stdout(Stdio::null()).stderr(Stdio::null());
            load.0.push(process.spawn().context("cannot start a busy process")?);
        }
        Ok(load)
    }

    fn check_alive(&mut self) -> Result<()> {
        for process in &mut self.0 {
            let ended = process.try_wait().context("cannot watch a busy process")?;
            ensure!(ended.is_none(), "a busy process ended before the demo");
        }
        Ok(())
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        for process in &mut self.0 {
            process.kill().ok();
            process.wait().ok();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figures(decisions: u64, over_budget: u64) -> Demo {
        let (over_budget_by, decision_us) = (BTreeMap::new(), Quantiles::default());
        Demo { scenario: "hall".into(), decisions, over_budget, over_budget_by, decision_us }
    }

    #[test]
    fn a_share_is_compared_with_that_of_hold() {
        let hold = Row::new((PolicyKind::Hold, 2), figures(200, 4), None).unwrap();
        assert_eq!((hold.share, hold.above_hold), (0.02, 0.0));
        let greedy = Row::new((PolicyKind::Greedy, 2), figures(200, 10), Some(hold.share)).unwrap();
        assert!((greedy.share - 0.05).abs() < 1e-12 && (greedy.above_hold - 0.03).abs() < 1e-12, "{greedy:?}");
        assert!(Row::new((PolicyKind::Greedy, 2), figures(0, 0), Some(0.02)).is_err());
    }
}
