//! The summary of a demo, from the summaries of its two processes.

use std::collections::BTreeMap;
use std::io;

use anyhow::{Context, Result};
use heliostat_proto::Quantiles;
use heliostat_service::printable::printable;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::output::outln;

/// Mean sum rates in Mbit/s over the same instants.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct SumRates {
    policy: f64,
    no_irs: f64,
    flat: f64,
    oracle: f64,
}

/// The summary of the room.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct RoomPart {
    scenario: String,
    scenario_hash: String,
    seed: u64,
    ticks: u64,
    unattended_ticks: u64,
    lost_ticks: u64,
    late_ticks: u64,
    commands: u64,
    loop_us: Quantiles,
    sum_rate_mbps: SumRates,
    ratio_to_oracle: Option<f64>,
    qos_met: Option<f64>,
    qos_met_oracle: Option<f64>,
    blocked_users_mean: f64,
    /// Users who entered and left; empty where they stay.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    turnover: BTreeMap<String, u64>,
    #[serde(rename(serialize = "refused_by_room"))]
    refused: BTreeMap<String, u64>,
    #[serde(rename(serialize = "room_problem"))]
    last_problem: String,
}

/// The summary of the controller.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct ControllerPart {
    policy: String,
    decisions: u64,
    over_budget: u64,
    over_budget_by: BTreeMap<String, u64>,
    decision_us: Quantiles,
    stages_us: BTreeMap<String, Quantiles>,
    age_us: Quantiles,
    fallbacks: BTreeMap<String, u64>,
    #[serde(rename(serialize = "users_limited"))]
    users: BTreeMap<String, u64>,
    #[serde(rename(serialize = "refused_by_controller"))]
    refused: BTreeMap<String, u64>,
    #[serde(rename(serialize = "controller_problem"))]
    last_problem: String,
}

/// Both, as one object.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    #[serde(flatten)]
    room: RoomPart,
    /// `None` if it was killed by order.
    #[serde(flatten)]
    controller: Option<ControllerPart>,
}

impl Summary {
    /// Joins the summaries of the two processes.
    pub fn new(room: &Value, controller: Option<&Value>) -> Result<Self> {
        let room = RoomPart::deserialize(room).context("the summary of sim-node is incomplete")?;
        let controller = controller.map(ControllerPart::deserialize).transpose();
        let controller = controller.context("the summary of the controller is incomplete")?;
        Ok(Self { room, controller })
    }

    /// Prints a table.
    pub fn print(&self) -> io::Result<()> {
        let (room, controller) = (&self.room, self.controller.as_ref());
        let share = |value: Option<f64>| value.map_or("-".to_string(), |value| format!("{value:.3}"));
        let policy = controller.map_or("unknown (the controller was killed)", |controller| controller.policy.as_str());
        outln!("{} (seed {}), policy {policy}", room.scenario, room.seed)?;
        outln!(
            "ticks {}, commands {}, lost {}, late {}, unattended {}",
            room.ticks,
            room.commands,
            room.lost_ticks,
            room.late_ticks,
            room.unattended_ticks
        )?;
        outln!()?;
        outln!("{:<26}{:>9}{:>9}{:>9}{:>9}{:>9}", "time in us", "p50", "p90", "p99", "p99.9", "max")?;
        let times = [
            ("decision", controller.map(|controller| &controller.decision_us)),
            ("loop: report to mirrors", Some(&room.loop_us)),
            ("age of the positions", controller.map(|controller| &controller.age_us)),
        ];
        for (name, time) in times.into_iter().filter_map(|(name, time)| Some((name, time?))) {
            let Quantiles { p50, p90, p99, p999, max, .. } = time;
            outln!("{name:<26}{p50:>9.0}{p90:>9.0}{p99:>9.0}{p999:>9.0}{max:>9.0}")?;
        }
        if let Some(controller) = controller {
            outln!(
                "decisions over 0.5 ms: {} of {}; longest stage:{}",
                controller.over_budget,
                controller.decisions,
                list(&controller.over_budget_by)
            )?;
        }
        outln!()?;
        outln!("{:<26}{:>9}{:>14}", "sum rate", "Mbit/s", "of the oracle")?;
        let rates = &room.sum_rate_mbps;
        let policy = controller.map_or("policy", |controller| controller.policy.as_str());
        for (name, rate) in
            [(policy, rates.policy), ("no IRS", rates.no_irs), ("flat", rates.flat), ("oracle with QoS", rates.oracle)]
        {
            outln!("{name:<26}{rate:>9.2}{:>14}", share((rates.oracle > 0.0).then(|| rate / rates.oracle)))?;
        }
        outln!(
            "share of users with their minimum rate: {} (oracle {})",
            share(room.qos_met),
            share(room.qos_met_oracle)
        )?;
        outln!("blocked users: {:.2} on average", room.blocked_users_mean)?;
        for (what, counts) in [
            ("users", Some(&room.turnover)),
            ("users limited, summed over decisions", controller.map(|controller| &controller.users)),
            ("fallbacks", controller.map(|controller| &controller.fallbacks)),
            ("refused by the controller", controller.map(|controller| &controller.refused)),
            ("refused by the room", Some(&room.refused)),
        ] {
            if let Some(counts) = counts.filter(|counts| !counts.is_empty()) {
                outln!("{what}:{}", list(counts))?;
            }
        }
        let problem = controller.map_or("", |controller| controller.last_problem.as_str());
        for (node, problem) in [("controller", problem), ("sim-node", room.last_problem.as_str())] {
            if !problem.is_empty() {
                outln!("last problem of {node}: {}", printable(problem))?;
            }
        }
        Ok(())
    }
}

fn list(counts: &BTreeMap<String, u64>) -> String {
    counts.iter().map(|(name, count)| format!(" {name} {count}")).collect()
}
