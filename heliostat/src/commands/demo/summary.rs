//! What a demo came to, from what its two processes said last.

use std::collections::BTreeMap;
use std::io;

use anyhow::{Context, Result};
use heliostat_proto::Quantiles;
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

/// What the room said.
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
    #[serde(rename(serialize = "refused_by_room"))]
    refused: BTreeMap<String, u64>,
    #[serde(rename(serialize = "room_problem"))]
    last_problem: String,
}

/// What the controller said.
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
    #[serde(flatten)]
    controller: ControllerPart,
}

impl Summary {
    /// Joins what the two processes printed.
    pub fn new(room: &Value, controller: &Value) -> Result<Self> {
        let room = RoomPart::deserialize(room).context("the sim-node's summary lacks something")?;
        let controller = ControllerPart::deserialize(controller).context("the controller's summary lacks something")?;
        Ok(Self { room, controller })
    }

    /// Prints a table.
    pub fn print(&self) -> io::Result<()> {
        let (room, controller) = (&self.room, &self.controller);
        let share = |value: Option<f64>| value.map_or("-".to_string(), |value| format!("{value:.3}"));
        outln!("{} (seed {}), policy {}", room.scenario, room.seed, controller.policy)?;
        outln!(
            "ticks {}, commands {}, lost {}, late {}, before the first answer {}",
            room.ticks,
            room.commands,
            room.lost_ticks,
            room.late_ticks,
            room.unattended_ticks
        )?;
        outln!()?;
        outln!("{:<26}{:>9}{:>9}{:>9}{:>9}{:>9}", "time in us", "p50", "p90", "p99", "p99.9", "max")?;
        for (name, time) in [
            ("decision", &controller.decision_us),
            ("loop: report to mirrors", &room.loop_us),
            ("age of the information", &controller.age_us),
        ] {
            let Quantiles { p50, p90, p99, p999, max, .. } = time;
            outln!("{name:<26}{p50:>9.0}{p90:>9.0}{p99:>9.0}{p999:>9.0}{max:>9.0}")?;
        }
        outln!(
            "decisions over 0.5 ms: {} of {}; longest stage:{}",
            controller.over_budget,
            controller.decisions,
            list(&controller.over_budget_by)
        )?;
        outln!()?;
        outln!("{:<26}{:>9}{:>14}", "sum rate", "Mbit/s", "of the oracle")?;
        let rates = &room.sum_rate_mbps;
        for (name, rate) in [
            (controller.policy.as_str(), rates.policy),
            ("no IRS", rates.no_irs),
            ("flat", rates.flat),
            ("oracle with QoS", rates.oracle),
        ] {
            outln!("{name:<26}{rate:>9.2}{:>14}", share((rates.oracle > 0.0).then(|| rate / rates.oracle)))?;
        }
        outln!("users whose need is met: {} (oracle {})", share(room.qos_met), share(room.qos_met_oracle))?;
        outln!("users in shadow: {:.2} on average", room.blocked_users_mean)?;
        for (what, counts) in [
            ("fallbacks", &controller.fallbacks),
            ("refused by the controller", &controller.refused),
            ("refused by the room", &room.refused),
        ] {
            if !counts.is_empty() {
                outln!("{what}:{}", list(counts))?;
            }
        }
        for (who, problem) in [("controller", &controller.last_problem), ("sim-node", &room.last_problem)] {
            if !problem.is_empty() {
                outln!("last problem of the {who}: {problem}")?;
            }
        }
        Ok(())
    }
}

fn list(counts: &BTreeMap<String, u64>) -> String {
    counts.iter().map(|(name, count)| format!(" {name} {count}")).collect()
}
