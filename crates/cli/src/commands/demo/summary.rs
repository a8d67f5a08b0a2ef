//! The summary of a demo, from the summaries of its two processes.

use std::collections::BTreeMap;
use std::io;

use anyhow::{Context, Result};
use heliostat_controller::report::summary::PolicySummary;
use heliostat_core::{policy::Tally, safety::Clipped};
use heliostat_proto::Quantiles;
use heliostat_service::printable::printable;
use heliostat_sim_node::SumRatesMbps;
use heliostat_ui::NetworkFile;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use heliostat_service::outln;

/// The rate of the credited policy, then those that it is compared with. It is not compared with itself.
fn rows<'a>(rates: &SumRatesMbps, credited: &'a str) -> impl Iterator<Item = (&'a str, f64)> {
    let compared = [("no IRS", rates.no_irs), ("flat", rates.flat), ("oracle", rates.oracle)];
    let others = compared.into_iter().filter(move |(name, _)| *name != credited);
    std::iter::once((credited, rates.policy)).chain(others)
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
    waiting_ticks: u64,
    late_ticks: u64,
    commands: u64,
    loop_us: Quantiles,
    sum_rate_mbps: Option<SumRatesMbps>,
    ratio_to_oracle: Option<f64>,
    qos_met: Option<f64>,
    qos_met_oracle: Option<f64>,
    blocked_users_mean: f64,
    skipped_instants: u64,
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
    /// The policy in charge at the end.
    policy: String,
    /// The hash of its network, if it is learned.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    actor: Option<String>,
    policies: BTreeMap<String, PolicySummary>,
    clipped: Clipped,
    decisions: u64,
    over_budget: u64,
    over_budget_by: BTreeMap<String, u64>,
    decision_us: Quantiles,
    stages_us: BTreeMap<String, Quantiles>,
    age_us: Quantiles,
    fallbacks: BTreeMap<String, u64>,
    withheld: BTreeMap<String, u64>,
    #[serde(rename(serialize = "users_limited"))]
    users: BTreeMap<String, u64>,
    #[serde(rename(serialize = "refused_by_controller"))]
    refused: BTreeMap<String, u64>,
    #[serde(rename(serialize = "controller_problem"))]
    last_problem: String,
}

impl RoomPart {
    /// The ticks by what became of them; late ones are among the others. Each line fits a terminal of 80 columns.
    fn ticks_in_words(&self) -> String {
        let Self { ticks, commands, lost_ticks, unattended_ticks, waiting_ticks, late_ticks, .. } = self;
        format!(
            "ticks {ticks}: commands {commands}, lost {lost_ticks}, unattended {unattended_ticks}, waiting at the end \
             {waiting_ticks}; late {late_ticks}\n(lost: also after a controller ended; unattended: before the first \
             answer,\nor during a stop; waiting: the answer was on its way)"
        )
    }

    /// Prints the mean rates; those of the mirrors are credited to a policy.
    fn print_rates(&self, credited: &str) -> io::Result<()> {
        let share = |value: Option<f64>| value.map_or("-".to_string(), |value| format!("{value:.3}"));
        outln!()?;
        outln!("{:<26}{:>9}{:>14}", "sum rate", "Mbit/s", "of the oracle")?;
        if self.sum_rate_mbps.is_none() {
            outln!("{credited:<26}{:>9}", "unknown")?;
        }
        if let Some(rates) = &self.sum_rate_mbps {
            for (name, rate) in rows(rates, credited) {
                outln!("{name:<26}{rate:>9.2}{:>14}", share((rates.oracle > 0.0).then(|| rate / rates.oracle)))?;
            }
        }
        outln!(
            "share of users with their minimum rate: {} (oracle {})",
            share(self.qos_met),
            share(self.qos_met_oracle)
        )?;
        match self.sum_rate_mbps {
            // No instant was computed.
            None => outln!("blocked users: -"),
            Some(_) => outln!("blocked users: {:.2} on average", self.blocked_users_mean),
        }
    }
}

/// Least share of the commands of a policy that shares the credit for the rates. A stalled machine
/// causes single fallbacks, which do not change a mean.
const CREDITED_MIN: f64 = 0.02;

impl ControllerPart {
    /// The policies, and the fallback, that gave at least [`CREDITED_MIN`] of the commands.
    fn credited(&self) -> Vec<String> {
        let sum = |count: fn(&Tally) -> u64| self.policies.values().map(|figures| count(&figures.tally)).sum::<u64>();
        let fallbacks = sum(|tally| tally.fallbacks);
        let all = sum(|tally| tally.commands) + fallbacks;
        let is_credited = |count: u64| count > 0 && count as f64 >= CREDITED_MIN * all as f64;
        let own = self.policies.iter().filter(|(_, figures)| is_credited(figures.tally.commands));
        let mut names: Vec<String> = own.map(|(name, _)| name.clone()).collect();
        if is_credited(fallbacks) {
            names.push("fallback".into());
        }
        if names.is_empty() { vec![self.policy.clone()] } else { names }
    }

    /// Prints a line for each policy, where the figures of all are not those of one.
    fn print_policies(&self) -> io::Result<()> {
        if self.policies.len() < 2 && self.policies.values().all(|figures| figures.tally.fallbacks == 0) {
            return Ok(());
        }
        outln!(
            "{:<26}{:>10}{:>10}{:>10}{:>10}{:>10}",
            "policy",
            "decisions",
            "commands",
            "fallbacks",
            "p50 (us)",
            "p99 (us)"
        )?;
        for (name, PolicySummary { tally, decision_us: times }) in &self.policies {
            let Tally { decisions, commands, fallbacks, .. } = tally;
            let Quantiles { count, p50, p99, .. } = times;
            let times = if *count == 0 { format!("{0:>10}{0:>10}", "-") } else { format!("{p50:>10.0}{p99:>10.0}") };
            outln!("{name:<26}{decisions:>10}{commands:>10}{fallbacks:>10}{times}")?;
        }
        Ok(())
    }
}

/// Both, as one object.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// `None` if its process ended early.
    #[serde(flatten)]
    room: Option<RoomPart>,
    /// Of the last controller; `None` if it was killed by order, or ended early.
    #[serde(flatten)]
    controller: Option<ControllerPart>,
    /// Controllers that were started: the figures of the room cover all of them.
    controllers_started: u64,
}

impl Summary {
    /// Joins the summaries of the two processes; one of them may have ended without its summary.
    pub fn new(room: Option<&Value>, controller: Option<&Value>, controllers_started: u64) -> Result<Self> {
        let room = room.map(RoomPart::deserialize).transpose().context("the summary of sim-node is incomplete")?;
        let controller = controller.map(ControllerPart::deserialize).transpose();
        let controller = controller.context("the summary of the controller is incomplete")?;
        Ok(Self { room, controller, controllers_started })
    }

    /// Which figures belong to which controller, if there were several.
    fn several_controllers(&self) -> Option<String> {
        let count = self.controllers_started;
        let of_room = self.room.as_ref().map_or("", |_| "ticks, commands, loop and sum rate cover all;\n");
        (count > 1).then(|| {
            format!(
                "{count} controllers were started: {of_room}decisions, age, fallbacks and refusals are those of the last one"
            )
        })
    }

    /// The file of the network of the last policy, if the user gave it.
    fn network<'a>(&self, given: Option<&'a NetworkFile>) -> Option<&'a str> {
        let used = self.controller.as_ref()?.actor.as_ref()?;
        given.filter(|file| file.hash == *used).map(|file| file.name.as_str())
    }

    /// The rows of times that a process has reported.
    fn times(&self) -> Vec<(&'static str, &Quantiles)> {
        let (room, controller) = (self.room.as_ref(), self.controller.as_ref());
        let times = [
            ("decision", controller.map(|controller| &controller.decision_us)),
            ("loop: report to mirrors", room.map(|room| &room.loop_us)),
            ("age of the positions", controller.map(|controller| &controller.age_us)),
        ];
        times.into_iter().filter_map(|(name, time)| Some((name, time?))).collect()
    }

    /// Prints a table. The user gave the file of a network, if any.
    pub fn print(&self, network: Option<&NetworkFile>) -> io::Result<()> {
        let (room, controller) = (self.room.as_ref(), self.controller.as_ref());
        let credited = controller.map(ControllerPart::credited);
        let policies =
            credited.as_ref().map_or("unknown (no summary of the controller)".into(), |names| names.join(", "));
        match room {
            Some(room) => {
                outln!("{} (seed {}), policy {policies}", room.scenario, room.seed)?;
                outln!("{}", room.ticks_in_words())?;
            }
            None => outln!("policy {policies}; ticks, loop and rates are unknown: sim-node ended without its summary")?,
        }
        if let Some(file) = self.network(network) {
            outln!("network of the policy: {file}")?;
        }
        if let Some(note) = self.several_controllers() {
            outln!("{note}")?;
        }
        let times = self.times();
        if !times.is_empty() {
            outln!()?;
            outln!("{:<26}{:>9}{:>9}{:>9}{:>9}{:>9}", "time in us", "p50", "p90", "p99", "p99.9", "max")?;
        }
        for (name, time) in times {
            let Quantiles { count, p50, p90, p99, p999, max, .. } = time;
            if *count == 0 {
                outln!("{name:<26}{:>9}{:>9}{:>9}{:>9}{:>9}", "-", "-", "-", "-", "-")?;
                continue;
            }
            outln!("{name:<26}{p50:>9.0}{p90:>9.0}{p99:>9.0}{p999:>9.0}{max:>9.0}")?;
        }
        if let Some(controller) = controller {
            outln!(
                "decisions over 0.5 ms: {} of {}{}",
                controller.over_budget,
                controller.decisions,
                longest_stages(&controller.over_budget_by)
            )?;
            controller.print_policies()?;
            let Clipped { range, slew } = controller.clipped;
            outln!("angles limited: {range} by range, {slew} by slew")?;
        }
        // One mean covers the complete run, so it is credited to one policy only if no other acted.
        let credited = match credited.as_deref() {
            _ if self.controllers_started > 1 => "policies of all controllers",
            Some([policy]) => policy.as_str(),
            Some(_) => "all of these policies",
            None => "policy",
        };
        room.map_or(Ok(()), |room| room.print_rates(credited))?;
        for (what, counts) in [
            ("users", room.map(|room| &room.turnover)),
            ("users limited, summed over decisions", controller.map(|controller| &controller.users)),
            ("fallbacks", controller.map(|controller| &controller.fallbacks)),
            (
                "commands not sent (standby: not leading; withheld: a stop)",
                controller.map(|controller| &controller.withheld),
            ),
            ("refused by the controller", controller.map(|controller| &controller.refused)),
            ("refused by the room", room.map(|room| &room.refused)),
        ] {
            if let Some(counts) = counts.filter(|counts| !counts.is_empty()) {
                outln!("{what}:{}", list(counts))?;
            }
        }
        if let Some(skipped) = room.map(|room| room.skipped_instants).filter(|skipped| *skipped > 0) {
            outln!("not published: {skipped} states for viewers, because the processors were busy")?;
        }
        let problems = [
            ("controller", controller.map(|controller| &controller.last_problem)),
            ("sim-node", room.map(|room| &room.last_problem)),
        ];
        for (node, problem) in problems {
            if let Some(problem) = problem.filter(|problem| !problem.is_empty()) {
                outln!("last problem of {node}: {}", printable(problem))?;
            }
        }
        Ok(())
    }
}

/// The late decisions by their longest stage; nothing without one.
fn longest_stages(counts: &BTreeMap<String, u64>) -> String {
    if counts.is_empty() { String::new() } else { format!("; longest stage:{}", list(counts)) }
}

fn list(counts: &BTreeMap<String, u64>) -> String {
    let counts: Vec<String> = counts.iter().map(|(name, count)| format!(" {name} {count}")).collect();
    counts.join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_stage_of_no_late_decision_is_left_out() {
        assert_eq!(longest_stages(&BTreeMap::new()), "");
        assert_eq!(longest_stages(&BTreeMap::from([("infer".to_owned(), 2)])), "; longest stage: infer 2");
        let two = BTreeMap::from([("infer".to_owned(), 2), ("publish".to_owned(), 1)]);
        assert_eq!(longest_stages(&two), "; longest stage: infer 2, publish 1");
    }

    #[test]
    fn the_first_run_explains_each_figure_that_every_summary_has() {
        let guide = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/tutorials/first-run.md");
        let guide = std::fs::read_to_string(guide).expect("the guide");
        let room = serde_json::to_value(heliostat_sim_node::Summary::default()).expect("a summary has a JSON form");
        let mut summary = Summary::new(Some(&room), None, 1).expect("a complete summary");
        summary.controller = Some(controller(&serde_json::json!({})));
        let rates = SumRatesMbps { policy: 1.0, no_irs: 1.0, flat: 1.0, oracle: 1.0 };
        let names = summary.times().into_iter().map(|(name, _)| name);
        // The first row has the name of the policy.
        let names = names.chain(rows(&rates, "greedy").skip(1).map(|(name, _)| name));
        let ticks = ["ticks", "commands", "lost", "unattended", "waiting at the end", "late"];
        let others =
            ["decisions over 0.5 ms", "angles limited", "share of users with their minimum rate", "blocked users"];
        let explained: String = guide.lines().filter(|line| line.starts_with("| `")).collect();
        for name in names.chain(ticks).chain(others) {
            assert!(explained.contains(&format!("`{name}`")), "{name}");
        }
        let words = RoomPart::deserialize(&room).expect("complete").ticks_in_words();
        for line in words.lines().skip(1) {
            assert!(guide.lines().any(|shown| shown == line), "{line}");
        }
    }

    #[test]
    fn a_process_that_ended_early_has_no_rows_of_times() {
        let names = |summary: &Summary| summary.times().into_iter().map(|(name, _)| name).collect::<Vec<_>>();
        let none = Summary { room: None, controller: None, controllers_started: 1 };
        assert_eq!(names(&none), [""; 0], "and no header");
        let one = Summary { controller: Some(controller(&serde_json::json!({}))), ..none };
        assert_eq!(names(&one), ["decision", "age of the positions"]);
    }

    #[test]
    fn the_summary_tells_the_figures_of_the_last_controller_from_those_of_all() {
        let room = serde_json::to_value(heliostat_sim_node::Summary::default()).expect("a summary has a JSON form");
        let of = |controllers| Summary::new(Some(&room), None, controllers).expect("a complete summary");
        assert_eq!(of(1).several_controllers(), None);
        let note = of(2).several_controllers().expect("a note");
        assert!(note.starts_with("2 controllers were started: ticks, commands"), "{note}");
        let json = serde_json::to_value(of(2)).expect("a summary has a JSON form");
        assert_eq!((json["controllers_started"].as_u64(), json["sum_rate_mbps"].is_null()), (Some(2), true));
    }

    #[test]
    fn the_ticks_of_each_class_are_those_of_the_room_together() {
        let room = heliostat_sim_node::Summary {
            ticks: 356,
            commands: 354,
            unattended_ticks: 1,
            waiting_ticks: 1,
            ..heliostat_sim_node::Summary::default()
        };
        let room = RoomPart::deserialize(serde_json::to_value(room).expect("a JSON form")).expect("complete");
        let expected = "ticks 356: commands 354, lost 0, unattended 1, waiting at the end 1; late 0\n(lost: also \
                        after a controller ended; unattended: before the first answer,\nor during a stop; waiting: \
                        the answer was on its way)";
        assert_eq!(room.ticks_in_words(), expected);
        assert!(room.ticks_in_words().lines().all(|line| line.len() <= 80), "a line wraps in a terminal");
    }

    #[test]
    fn the_policy_of_flat_mirrors_is_not_compared_with_itself() {
        let rates = SumRatesMbps { policy: 5.0, no_irs: 4.0, flat: 5.0, oracle: 9.0 };
        let names = |credited| rows(&rates, credited).map(|(name, _)| name).collect::<Vec<_>>();
        assert_eq!(names("flat"), ["flat", "no IRS", "oracle"]);
        assert_eq!(names("nearest"), ["nearest", "no IRS", "flat", "oracle"]);
    }

    fn controller(policies: &Value) -> ControllerPart {
        let none = BTreeMap::<String, u64>::new();
        let part = serde_json::json!({
            "policy": "nearest", "policies": policies, "clipped": Clipped::default(), "decisions": 9,
            "over_budget": 0, "over_budget_by": none, "decision_us": Quantiles::default(), "stages_us": {},
            "age_us": Quantiles::default(), "fallbacks": none, "withheld": none, "refused": none, "last_problem": "",
            "users": none,
        });
        ControllerPart::deserialize(&part).expect("complete")
    }

    #[test]
    fn the_network_of_the_policy_has_the_name_of_its_file() {
        let given = NetworkFile { hash: "1a2b".into(), name: "own.onnx".into() };
        let of = |actor: Option<&str>| {
            let part = ControllerPart { actor: actor.map(String::from), ..controller(&serde_json::json!({})) };
            Summary { room: None, controller: Some(part), controllers_started: 1 }
        };
        assert_eq!(of(Some("1a2b")).network(Some(&given)), Some("own.onnx"));
        assert_eq!(of(Some("3c4d")).network(Some(&given)), None, "a built-in one");
        assert_eq!(of(None).network(Some(&given)), None, "a policy that is not learned");
        assert_eq!(of(Some("1a2b")).network(None), None);
    }

    fn policy(commands: u64, fallbacks: u64) -> Value {
        let tally = Tally { commands, fallbacks, ..Tally::default() };
        serde_json::json!(PolicySummary { tally, ..PolicySummary::default() })
    }

    #[test]
    fn the_rates_are_credited_to_a_policy_only_if_no_other_gave_angles() {
        let alone = controller(&serde_json::json!({ "nearest": policy(9, 0) }));
        assert_eq!(alone.credited(), ["nearest"]);
        let stalled = controller(&serde_json::json!({ "nearest": policy(400, 3) }));
        assert_eq!(stalled.credited(), ["nearest"]);
        let changed = controller(&serde_json::json!({ "ddpg": policy(4, 0), "nearest": policy(5, 0) }));
        assert_eq!(changed.credited(), ["ddpg", "nearest"]);
        let failed = controller(&serde_json::json!({ "ddpg": policy(0, 4), "nearest": policy(5, 0) }));
        assert_eq!(failed.credited(), ["nearest", "fallback"]);
    }
}
