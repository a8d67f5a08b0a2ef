//! What a controller has to say at the end, as one JSON object or as a table.

use std::{collections::BTreeMap, fmt};

use heliostat_proto::Quantiles;
use serde::{Deserialize, Serialize};

use crate::{ledger::Ledger, post::Post};
use heliostat_decide::core::{Controller, Departure, Stage};

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
    /// What the array said last about itself; absent before it spoke.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub array: Option<ArraySummary>,
    /// How many sources owned the room, one after the other.
    pub sources: u64,
    /// Commands that the transport did not take.
    pub unsent: u64,
    /// Reports that were shed because a newer one was there, or too many waited.
    pub shed: u64,
    /// Looks at which the policy had not answered for 0.1 s.
    pub unanswered: u64,
    /// Rehearsals between sparse reports.
    pub rehearsals: u64,
    /// What the operating system granted of what was asked for, and what not.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub machine: Vec<String>,
    /// Room by room, where there are several; the rest is then their sum.
    #[serde(skip_serializing_if = "BTreeMap::is_empty", default)]
    pub rooms: BTreeMap<String, Summary>,
    /// The last thing that went wrong; empty while nothing did.
    pub last_problem: String,
}

/// What an array says about itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ArraySummary {
    /// Bits of [`heliostat_proto::messages::fault`].
    pub faults: u32,
    /// Mirrors known not to follow.
    pub unusable: u64,
    /// Commands that it refused since it started.
    pub refused: u64,
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
            array: controller.inbox().telemetry().map(|telemetry| ArraySummary {
                faults: telemetry.faults,
                unusable: telemetry.unusable.len() as u64,
                refused: telemetry.counters.refused(),
            }),
            sources: controller.inbox().sources(),
            ..Self::default()
        }
    }

    /// The account of all rooms.
    pub(crate) fn of_posts(posts: &[Post]) -> Self {
        if let [post] = posts {
            return post.summary().clone();
        }
        let (mut all, mut times) = (Self::default(), Ledger::new());
        for post in posts {
            all.add(post.summary());
            times.absorb(&mut post.times().clone());
            all.rooms.insert(post.room().to_string(), post.summary().clone());
        }
        all.add_times(&times);
        all
    }

    /// Adds another room's counts.
    fn add(&mut self, other: &Self) {
        self.policy.clone_from(&other.policy);
        self.epoch = self.epoch.max(other.epoch);
        for (here, there) in [
            (&mut self.decisions, other.decisions),
            (&mut self.commands, other.commands),
            (&mut self.unsent, other.unsent),
            (&mut self.shed, other.shed),
            (&mut self.unanswered, other.unanswered),
            (&mut self.rehearsals, other.rehearsals),
            (&mut self.sources, other.sources),
            (&mut self.clipped.range, other.clipped.range),
            (&mut self.clipped.slew, other.clipped.slew),
        ] {
            *here += there;
        }
        for (here, there) in [(&mut self.fallbacks, &other.fallbacks), (&mut self.refused, &other.refused)] {
            there.iter().for_each(|(name, count)| *here.entry(name.clone()).or_default() += count);
        }
        if !other.last_problem.is_empty() {
            self.last_problem.clone_from(&other.last_problem);
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
        writeln!(
            formatter,
            "decisions {}, commands {}, unsent {}, shed {}, rehearsals {}",
            self.decisions, self.commands, self.unsent, self.shed, self.rehearsals
        )?;
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
        for granted in &self.machine {
            write!(formatter, "\n{granted}")?;
        }
        for (room, summary) in &self.rooms {
            let Quantiles { p50, p99, .. } = summary.decision_us;
            write!(formatter, "\nroom {room}: decisions {}, p50 {p50:.1} us, p99 {p99:.1} us", summary.decisions)?;
        }
        if self.unanswered > 0 {
            write!(formatter, "\nthe policy had not answered for 0.1 s at {} looks", self.unanswered)?;
        }
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
