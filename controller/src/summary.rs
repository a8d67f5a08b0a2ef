//! What a controller has to say at the end, as one JSON object or as a table.

use std::{collections::BTreeMap, fmt};

use heliostat_proto::Quantiles;
use serde::{Deserialize, Serialize};

use crate::{
    core::{Controller, Departure, Stage},
    ledger::Ledger,
};

/// The account of one run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// The policy.
    pub policy: String,
    /// The epoch of the commands.
    pub epoch: u64,
    /// Position reports that got an answer, be it to hold.
    pub decisions: u64,
    /// Commands among the answers.
    pub commands: u64,
    /// Decisions of more than 0.5 ms.
    pub over_budget: u64,
    /// The same, by the stage that took longest.
    pub over_budget_by: BTreeMap<String, u64>,
    /// From the entry of the callback to the return of the put.
    pub decision_us: Quantiles,
    /// The same, stage by stage.
    pub stages_us: BTreeMap<String, Quantiles>,
    /// From the sampling of the positions to the decision.
    pub age_us: Quantiles,
    /// Ticks that left the plain way, by how.
    pub fallbacks: BTreeMap<String, u64>,
    /// What was received and not used, by stream and reason.
    pub refused: BTreeMap<String, u64>,
    /// Axis values that the limits changed.
    pub clipped: ClippedSummary,
    /// How many sources owned the room, one after the other.
    pub sources: u64,
    /// Commands that the transport did not take.
    pub unsent: u64,
    /// The last thing that went wrong; empty while nothing did.
    pub last_problem: String,
}

/// Axis values that the limits changed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClippedSummary {
    /// Values outside the range.
    pub range: u64,
    /// Values out of reach within the tick.
    pub slew: u64,
}

impl Summary {
    /// The controller's part of the account; the ledger's follows by [`Summary::add_times`].
    pub fn of(controller: &Controller) -> Self {
        let counters = controller.counters();
        let departures = Departure::ALL.map(|departure| (departure.name().to_string(), counters.departures(departure)));
        Self {
            policy: controller.policy_name().into(),
            epoch: controller.epoch(),
            decisions: counters.decisions,
            commands: counters.commands,
            fallbacks: departures.into_iter().filter(|(_, count)| *count > 0).collect(),
            refused: controller.inbox().refused().named().collect(),
            clipped: ClippedSummary { range: counters.clipped.range, slew: counters.clipped.slew },
            sources: controller.inbox().sources(),
            ..Self::default()
        }
    }

    /// Adds the times.
    pub fn add_times(&mut self, ledger: &Ledger) {
        let blamed = Stage::ALL.map(|stage| (stage.name().to_string(), ledger.over_budget_by(stage)));
        self.over_budget = ledger.over_budget();
        self.over_budget_by = blamed.into_iter().filter(|(_, count)| *count > 0).collect();
        self.decision_us = ledger.decision_us();
        self.stages_us = Stage::ALL.map(|stage| (stage.name().to_string(), ledger.stage_us(stage))).into();
        self.age_us = ledger.age_us();
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(formatter, "policy {}, epoch {}", self.policy, self.epoch)?;
        writeln!(formatter, "decisions {}, commands {}, unsent {}", self.decisions, self.commands, self.unsent)?;
        writeln!(formatter, "over 0.5 ms: {}, by longest stage:{}", self.over_budget, list(&self.over_budget_by))?;
        writeln!(formatter, "{:<12}{:>10}{:>10}{:>10}{:>10}{:>10}", "time in us", "p50", "p90", "p99", "p99.9", "max")?;
        let stages = Stage::ALL.iter().filter_map(|stage| Some((stage.name(), self.stages_us.get(stage.name())?)));
        let rows = [("decision", &self.decision_us)].into_iter().chain(stages).chain([("age", &self.age_us)]);
        for (name, times) in rows {
            let Quantiles { p50, p90, p99, p999, max, .. } = times;
            writeln!(formatter, "{name:<12}{p50:>10.1}{p90:>10.1}{p99:>10.1}{p999:>10.1}{max:>10.1}")?;
        }
        writeln!(formatter, "fallbacks:{}", list(&self.fallbacks))?;
        writeln!(formatter, "refused:{}", list(&self.refused))?;
        write!(formatter, "angles limited: {} by range, {} by slew", self.clipped.range, self.clipped.slew)?;
        if !self.last_problem.is_empty() {
            write!(formatter, "\nlast problem: {}", self.last_problem)?;
        }
        Ok(())
    }
}

fn list(counts: &BTreeMap<String, u64>) -> String {
    if counts.is_empty() {
        return " none".into();
    }
    counts.iter().map(|(name, count)| format!(" {name} {count}")).collect()
}
