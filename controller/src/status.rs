//! What a controller says about itself twice a second, for people; nothing is decided by it.

use heliostat_proto::{Nanos, NodeKind, NodeStatus, Stamp};
use heliostat_service::clock::utc_ns;

use crate::{control::ControlAccount, desk::Desk, ledger::Ledger, summary::Summary};
use heliostat_decide::{
    core::{Controller, Departure},
    refusal::Refusal,
};

/// Who reports.
#[derive(Clone, Debug)]
pub struct Identity {
    /// Random id of this instance.
    pub source: u64,
    /// When it started.
    pub started_ns: Nanos,
    /// Hash of the scenario.
    pub scenario: String,
}

/// Composes reports, and remembers what was said last.
pub struct Reporter {
    identity: Identity,
    sequence: u64,
    decisions: u64,
    refused: u64,
    failed: u64,
    unsent: u64,
    orders_refused: u64,
    last_problem: String,
}

/// What is copied from the desk while it is held.
pub struct Snapshot {
    /// Counters and names.
    pub summary: Summary,
    /// What went wrong since the last snapshot.
    pub problem: Option<String>,
    now: Nanos,
    state: String,
    control: ControlAccount,
}

impl Reporter {
    /// A reporter that has said nothing yet.
    pub fn new(identity: Identity) -> Self {
        Self {
            identity,
            sequence: 0,
            decisions: 0,
            refused: 0,
            failed: 0,
            unsent: 0,
            orders_refused: 0,
            last_problem: String::new(),
        }
    }

    /// Copies what changed; the desk is held meanwhile.
    pub fn look(&mut self, desk: &Desk) -> Snapshot {
        let controller = &desk.controller;
        let mut summary = Summary::of(controller);
        summary.unsent = desk.unsent;
        summary.shed = desk.shed;
        summary.rehearsals = desk.rehearsals;
        let problem = self.new_problem(desk);
        if let Some(problem) = &problem {
            self.last_problem.clone_from(problem);
        }
        summary.last_problem.clone_from(&self.last_problem);
        let state = self.state(controller);
        self.decisions = summary.decisions;
        Snapshot { summary, problem, now: desk.clock.now(), state, control: desk.control.clone() }
    }

    /// The report for a snapshot, with the times since the start.
    pub fn report(&mut self, snapshot: &Snapshot, times: &Ledger) -> NodeStatus {
        self.sequence += 1;
        let summary = &snapshot.summary;
        let own = [
            ("decisions", summary.decisions),
            ("commands", summary.commands),
            ("over_budget", times.over_budget()),
            ("unsent", summary.unsent),
            ("shed", summary.shed),
            ("unanswered", summary.unanswered),
            ("clipped_range", summary.clipped.range),
            ("clipped_slew", summary.clipped.slew),
            ("sources", summary.sources),
            ("epoch", summary.epoch),
            ("policies_switched", snapshot.control.switched),
            ("policies_refused", snapshot.control.refused),
        ];
        let own = own.into_iter().map(|(name, count)| (name.to_string(), count));
        let within = times.decisions_within().map(|(edge_us, count)| (format!("decision_us_le:{edge_us}"), count));
        let named = |prefix: &'static str| move |(name, count): (&String, &u64)| (format!("{prefix}{name}"), *count);
        let fallbacks = summary.fallbacks.iter().map(named("fallback:"));
        let refused = summary.refused.iter().map(named("refused:"));
        let mut timed = summary.clone();
        timed.add_times(times);
        let stages = timed.stages_us.iter().map(|(name, times)| (name.clone(), *times));
        let whole = [("decision".to_string(), timed.decision_us), ("age".to_string(), timed.age_us)];
        NodeStatus {
            stamp: Stamp { source: self.identity.source, sequence: self.sequence, time_ns: snapshot.now },
            state: snapshot.state.clone(),
            policy: summary.policy.clone(),
            counters: own.chain(within).chain(fallbacks).chain(refused).collect(),
            timings: whole.into_iter().chain(stages).collect(),
            last_problem: summary.last_problem.clone(),
            ..self.blank()
        }
    }

    /// The report while the policy gives no answer: what was known before.
    pub fn silent(&self, summary: &Summary) -> NodeStatus {
        NodeStatus {
            stamp: Stamp { source: self.identity.source, sequence: self.sequence, time_ns: utc_ns() },
            state: "no answer from the policy".into(),
            policy: summary.policy.clone(),
            counters: vec![("unanswered".into(), summary.unanswered)],
            last_problem: summary.last_problem.clone(),
            ..self.blank()
        }
    }

    fn blank(&self) -> NodeStatus {
        NodeStatus {
            node: NodeKind::Controller,
            name: format!("controller-{:08x}", self.identity.source >> 32),
            software: env!("CARGO_PKG_VERSION").into(),
            scenario: self.identity.scenario.clone(),
            started_ns: self.identity.started_ns,
            ..NodeStatus::default()
        }
    }

    fn state(&self, controller: &Controller) -> String {
        let counters = controller.counters();
        match controller.deposed_by() {
            Some(epoch) => format!("deposed by epoch {epoch}"),
            None if counters.decisions == 0 => "waiting for position reports".into(),
            None if counters.decisions == self.decisions => "position reports stopped".into(),
            None => "running".into(),
        }
    }

    /// What went wrong since the last look, the gravest first.
    fn new_problem(&mut self, desk: &Desk) -> Option<String> {
        let counters = desk.controller.counters();
        let failed = counters.departures(Departure::PolicyFailed) + counters.departures(Departure::Held);
        let refused = desk.controller.inbox().refused().total();
        let rose = |before: &mut u64, after: u64| std::mem::replace(before, after) < after;
        let (unsent_rose, failed_rose, refused_rose) =
            (rose(&mut self.unsent, desk.unsent), rose(&mut self.failed, failed), rose(&mut self.refused, refused));
        let order_refused = rose(&mut self.orders_refused, desk.control.refused);
        if failed_rose && let Some(failure) = desk.controller.last_failure() {
            return Some(format!("policy {}: {failure}", desk.controller.policy_name()));
        }
        if unsent_rose {
            return Some("a command could not be sent: the session is closed".into());
        }
        if order_refused {
            return desk.control.last_refusal.clone();
        }
        refused_rose.then(|| describe_refusal(desk)).flatten()
    }
}

fn describe_refusal(desk: &Desk) -> Option<String> {
    let inbox = desk.controller.inbox();
    let (stream, refusal) = inbox.refused().last()?;
    let name = stream.name();
    Some(match (refusal, &desk.last_malformed) {
        (Refusal::ForeignSource, _) => format!(
            "a second source {:016x} reports {name} in this room, which belongs to {:016x}; it is refused",
            inbox.refused().last_foreign_source().unwrap_or_default(),
            inbox.source().unwrap_or_default()
        ),
        (_, Some(error)) if refusal == Refusal::from(error) => format!("{name}: {error}"),
        _ => format!("{name} refused: {refusal}"),
    })
}
