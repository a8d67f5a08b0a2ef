//! The status report of one room, twice a second, for operators. No decision depends on it.

mod describe;
mod problem;

use std::time::Duration;

use heliostat_core::{
    core::{Counters, DegradedMode, Stage},
    refusal::{Refusal, Stream},
    room_core::UndecodableCounts,
    tenure::{Standing, Tenure, TenureEvent},
};
use heliostat_proto::{Nanos, NodeKind, NodeStatus, Stamp, clock_time, gauges::ServedLight};
use heliostat_service::{clock::utc_ns, printable::printable};

use super::{decision_loop::DecisionLoop, lost_drivers::LostDrivers, peers::ReportedPeers, policy_swap::SwapCounters};
use crate::report::{
    stage_times::{StageTimes, quantiles_us},
    summary::Summary,
};
use describe::{
    describe_absence, describe_events, describe_foreign_array, describe_left_out, describe_refusal, with_pause,
};
use problem::NewestProblem;
pub use problem::{Problem, Subject};

/// What to do about commands without a receiver.
const DRIVER_ABSENT: &str = "there is no telemetry, and no liveliness token of a driver or simulator; start one, with an endpoint in common with this controller, or restart one that hangs";

/// The reporting node.
#[derive(Clone, Debug, Default)]
pub struct Identity {
    /// Random id of this instance.
    pub source: u64,
    /// The name of its machine; empty if there is none.
    pub host: String,
    /// When it started.
    pub started_ns: Nanos,
    /// Hash of the scenario.
    pub scenario: String,
}

/// Composes reports, and keeps the counters of the last one.
#[derive(Default)]
pub struct Reporter {
    identity: Identity,
    sequence: u64,
    decisions: u64,
    commands: u64,
    /// Refused reports of positions at the last snapshot.
    refused_positions: u64,
    /// Whether reports of positions were refused since the last snapshot.
    has_refused_positions: bool,
    left_out: u64,
    /// The counts of problems at the last snapshot, in the order of [`Self::new_problem`].
    problems: [u64; 6],
    undecodable: u64,
    epoch_events: [u64; TenureEvent::ALL.len()],
    unfit: Option<String>,
    /// Occurrences of the problem of the present snapshot; 0 for a change of state.
    occurrences: u64,
    conditions: Conditions,
    /// The drivers that have left the room, for operators who stop it.
    lost_drivers: LostDrivers,
    /// Of what the light is not the expected one.
    off_light: Vec<String>,
    /// Controllers that were reported as silent.
    silent_peers: ReportedPeers,
    /// The stops that withhold commands, in words; empty for none.
    stops: String,
    /// Whether the controller ends.
    is_ending: bool,
    /// The longest recent pause of this process.
    pause: Option<Duration>,
    /// Since something kept commands from the mirrors.
    newest: NewestProblem,
}

/// What is wrong in the room outside the decision loop.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Conditions {
    /// Indices of the arrays of which there is no sign of a driver, although one is expected.
    pub without_driver: Vec<usize>,
    /// Why the room's geometry is not that of this controller.
    pub geometry: Option<String>,
    /// That this process has lost its last connection: it then says nothing about the driver.
    pub connection: Option<String>,
    /// Source ids of the other controllers with a token.
    pub peers: Vec<u64>,
    /// Those of them whose statuses do not come.
    pub silent_peers: Vec<u64>,
    /// Whether no other controller reports, although there was one that did not end in order.
    pub standby_missing: bool,
}

/// A copy of the counters, taken while the decision loop is locked.
pub struct Snapshot {
    /// Counters and names.
    pub summary: Summary,
    /// What went wrong since the last snapshot.
    pub problem: Option<Problem>,
    /// How often; 0 for a change of state.
    pub occurrences: u64,
    now: Nanos,
    state: String,
    swaps: SwapCounters,
    room_source: Option<u64>,
}

impl Reporter {
    /// A reporter before its first report.
    pub fn new(identity: Identity) -> Self {
        Self { identity, ..Self::default() }
    }

    /// The reporting node.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// The controller ends: a successor is expected from now on.
    pub fn end(&mut self) {
        self.is_ending = true;
    }

    /// The longest recent pause of this process, for the next snapshot.
    pub fn note_pause(&mut self, pause: Option<Duration>) {
        self.pause = pause;
    }

    /// Copies the counters; the decision loop is locked meanwhile.
    pub fn take_snapshot(
        &mut self,
        decision_loop: &DecisionLoop,
        swaps: SwapCounters,
        conditions: Conditions,
    ) -> Snapshot {
        let controller = decision_loop.room.controller();
        let room = &decision_loop.room;
        self.lost_drivers.set(room.lost_drivers().collect());
        let mut summary = Summary::of(controller);
        summary.unsent = decision_loop.unsent();
        summary.dropped = room.superseded();
        summary.trackers = room.trackers() as u64;
        let undecodable = room.undecodable();
        summary.refused.extend(undecodable.named());
        summary.peers = summary.peers.saturating_sub(conditions.silent_peers.len() as u64);
        summary.standby_missing = conditions.standby_missing;
        // Of several arrays, the first that follows another controller.
        let mut tenures = (0..controller.arrays()).map(|array| controller.tenure(array));
        let tenure = tenures.find(|tenure| tenure.standing() == Standing::Standby).unwrap_or(controller.tenure(0));
        let stops_before = std::mem::replace(&mut self.stops, controller.describe_stops(printable));
        let problem = self
            .new_alarm(&summary, controller.counters(), tenure)
            .or_else(|| self.new_stops(&stops_before))
            .or_else(|| self.new_condition(conditions, controller.arrays()))
            .or_else(|| self.lost_drivers.news())
            .or_else(|| self.new_light(&summary.light))
            .or_else(|| self.new_problem(decision_loop, &swaps).map(warning))
            .or_else(|| self.new_undecodable(undecodable).map(warning));
        let occurrences = std::mem::take(&mut self.occurrences);
        self.keep(problem.as_ref());
        let problem = problem.map(|(_, problem)| problem);
        summary.last_problem = self.present_problem(controller.arrays());
        summary.set_without_driver(&self.conditions.without_driver);
        summary.geometry_differs = self.conditions.geometry.is_some();
        let refused = controller.inbox().refused();
        let positions = Refusal::ALL.into_iter().map(|reason| refused.get(Stream::Users, reason)).sum();
        self.has_refused_positions = std::mem::replace(&mut self.refused_positions, positions) < positions;
        let state = self.state(&summary);
        (self.decisions, self.commands) = (summary.decisions, summary.commands);
        let (now, room_source) = (decision_loop.room_time_ns(), controller.inbox().source());
        Snapshot { summary, problem, occurrences, now, state, swaps, room_source }
    }

    /// What the status names: why no commands reach the mirrors, otherwise the newest problem.
    fn present_problem(&self, arrays: usize) -> String {
        let without_driver = &self.conditions.without_driver;
        match &self.unfit {
            Some(unfit) => no_commands(unfit),
            None if !without_driver.is_empty() => self.no_driver(arrays),
            None if !self.stops.is_empty() => self.stops.clone(),
            None if self.newest.text().is_empty() => self.conditions.geometry.clone().unwrap_or_default(),
            None => self.newest.text().to_owned(),
        }
    }

    /// Keeps the newest problem until it ends. What keeps commands from the mirrors discards it, so that no old one
    /// returns afterwards.
    fn keep(&mut self, problem: Option<&(Subject, Problem)>) {
        if self.unfit.is_some() || !self.conditions.without_driver.is_empty() || !self.stops.is_empty() {
            self.newest = NewestProblem::default();
        } else {
            problem.into_iter().for_each(|problem| self.newest.handle(problem));
        }
    }

    /// The report for a snapshot, with the times since the start.
    pub fn report(&mut self, snapshot: &Snapshot, times: &StageTimes) -> NodeStatus {
        self.sequence += 1;
        let summary = &snapshot.summary;
        let own = [
            (NodeStatus::DECISIONS, summary.decisions),
            ("commands", summary.commands),
            ("over_budget", times.over_budget()),
            ("unsent", summary.unsent),
            ("dropped", summary.dropped),
            ("unanswered", summary.unanswered),
            ("modelled", summary.modelled),
            ("clipped_range", summary.clipped.range),
            ("clipped_slew", summary.clipped.slew),
            ("sources", summary.sources),
            (NodeStatus::EPOCH, summary.epoch),
            (NodeStatus::STANDBY, u64::from(summary.standby)),
            ("peers", summary.peers),
            (NodeStatus::STANDBY_MISSING, u64::from(summary.standby_missing)),
            (NodeStatus::ARRAY_UNFIT, u64::from(summary.unfit.is_some())),
            (NodeStatus::DRIVER_ABSENT, self.conditions.without_driver.len() as u64),
            ("geometry_differs", u64::from(summary.geometry_differs)),
            ("policies_switched", snapshot.swaps.replaced),
            ("policies_refused", snapshot.swaps.refused),
        ];
        let own = own.into_iter().map(|(name, count)| (name.to_string(), count));
        let within = times.decisions_within().map(|(edge_us, count)| (format!("decision_us_le:{edge_us}"), count));
        let over = Stage::ALL.map(|stage| (format!("over_budget_by:{}", stage.name()), times.over_budget_by(stage)));
        let over = over.into_iter().filter(|(_, count)| *count > 0);
        let named = |prefix: &'static str| move |(name, count): (&String, &u64)| (format!("{prefix}{name}"), *count);
        let fallbacks = summary.fallbacks.iter().chain(&summary.withheld).map(named(NodeStatus::DEGRADED));
        let refused = summary.refused.iter().map(named("refused:"));
        let epochs = summary.epoch_events.iter().map(named(NodeStatus::TENURE));
        let missed = summary.missed.iter().map(named("missed:"));
        let users = summary.users.iter().map(named("users:"));
        let absent = summary.arrays.iter().filter(|array| array.driver_absent);
        let absent = absent.map(|array| (format!("{}:{}", NodeStatus::DRIVER_ABSENT, array.name), 1));
        let unfit = summary.arrays.iter().filter(|array| array.unfit && !summary.is_entirely_unfit());
        let unfit = unfit.map(|array| (format!("{}{}", NodeStatus::ARRAY_UNFIT_OF, array.name), 1));
        let host = (!self.identity.host.is_empty()).then(|| (format!("{}{}", NodeStatus::HOST, self.identity.host), 1));
        let ending = self.is_ending.then(|| (NodeStatus::ENDING.to_owned(), 1));
        let engine = summary.engine.iter().map(|name| (format!("engine:{name}"), 1));
        let actor = summary.actor.iter().map(|hash| (format!("{}{hash}", NodeStatus::ACTOR), 1));
        let stages = Stage::ALL.map(|stage| (stage.name().to_string(), quantiles_us(times.stage(stage))));
        let noise = summary.belief.and_then(|belief| belief.noise).into_iter().flat_map(|noise| noise.gauges());
        let noise = noise.map(|(name, value)| (name.to_owned(), value));
        let totals =
            [("decision".to_string(), quantiles_us(times.decision())), ("age".to_string(), quantiles_us(times.age()))];
        NodeStatus {
            stamp: Stamp { source: self.identity.source, sequence: self.sequence, time_ns: snapshot.now },
            state: snapshot.state.clone(),
            policy: summary.policy.clone(),
            counters: own
                .chain(within)
                .chain(over)
                .chain(fallbacks)
                .chain(refused)
                .chain(epochs)
                .chain(missed)
                .chain(users)
                .chain(host)
                .chain(ending)
                .chain(snapshot.room_source.map(NodeStatus::room_source_counter))
                .chain(engine)
                .chain(actor)
                .chain(absent)
                .chain(unfit)
                .chain(self.lost_drivers.counters())
                .collect(),
            gauges: noise.chain(summary.light.iter().flat_map(ServedLight::gauges)).collect(),
            timings: totals.into_iter().chain(stages).collect(),
            last_problem: summary.last_problem.clone(),
            ..self.blank()
        }
    }

    /// The report while the policy does not return, from the last summary.
    pub fn report_stall(&self, summary: &Summary) -> NodeStatus {
        NodeStatus {
            stamp: Stamp { source: self.identity.source, sequence: self.sequence, time_ns: utc_ns() },
            state: "no answer from the policy".into(),
            policy: summary.policy.clone(),
            counters: self.lost_drivers.counters().chain([("unanswered".into(), summary.unanswered)]).collect(),
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

    fn state(&self, summary: &Summary) -> String {
        let state = match summary {
            _ if !self.stops.is_empty() => return self.stops.clone(),
            _ if summary.is_entirely_unfit() => "no commands: the array does not fit",
            _ if summary.standby => "standby",
            _ if summary.decisions == 0 && !self.has_refused_positions => "waiting for position reports",
            _ if summary.commands == self.commands && self.has_refused_positions => NodeStatus::REPORTS_REFUSED,
            _ if summary.decisions == self.decisions => "position reports stopped",
            _ if summary.driver_absent => {
                return describe_absence(&self.conditions.without_driver, summary.arrays.len().max(1));
            }
            _ => "running",
        };
        state.into()
    }

    /// A new reason for which the array receives no commands, or a sign of another controller.
    fn new_alarm(&mut self, summary: &Summary, counters: &Counters, tenure: &Tenure) -> Option<(Subject, Problem)> {
        let unfit_before = std::mem::replace(&mut self.unfit, summary.unfit.clone());
        if unfit_before != self.unfit {
            let problem = match &self.unfit {
                Some(unfit) => Problem::Alarm(no_commands(unfit)),
                None => Problem::End("the array fits the scenario: it receives commands again".into()),
            };
            return Some((Subject::Fit, problem));
        }
        let events = TenureEvent::ALL.map(|event| counters.tenure(event));
        let before = std::mem::replace(&mut self.epoch_events, events);
        let rose = TenureEvent::ALL.into_iter().filter(|event| events[*event as usize] > before[*event as usize]);
        let rose: Vec<TenureEvent> = rose.collect();
        let problem = describe_events(&rose, tenure, self.is_ending)?;
        Some((Subject::Tenure, with_pause(problem, &rose, self.pause)))
    }

    /// A stop that began or ended.
    fn new_stops(&self, before: &str) -> Option<(Subject, Problem)> {
        if before == self.stops {
            return None;
        }
        let problem = match self.stops.as_str() {
            "" => Problem::End("no stop withholds commands any longer".into()),
            stops => Problem::Warning(format!("commands are {stops}")),
        };
        Some((Subject::Stops, problem))
    }

    /// A condition that began or ended; a second one is reported at the next snapshot.
    fn new_condition(&mut self, now: Conditions, arrays: usize) -> Option<(Subject, Problem)> {
        self.conditions.connection = now.connection;
        let before = std::mem::replace(&mut self.conditions.without_driver, now.without_driver);
        if before != self.conditions.without_driver {
            let problem = if self.conditions.without_driver.is_empty() {
                Problem::End("a driver is in the room".into())
            } else {
                Problem::Warning(self.no_driver(arrays))
            };
            return Some((Subject::Driver, problem));
        }
        let before = std::mem::replace(&mut self.conditions.geometry, now.geometry);
        if before == self.conditions.geometry {
            return self.silent_peers.news(&now.silent_peers, &now.peers);
        }
        let problem = match &self.conditions.geometry {
            Some(difference) => Problem::Warning(difference.clone()),
            None => Problem::End("the room announces no other geometry than this controller".into()),
        };
        Some((Subject::Geometry, problem))
    }

    /// Why commands have no receiver, in a room with this number of arrays.
    fn no_driver(&self, arrays: usize) -> String {
        let Conditions { without_driver, connection, .. } = &self.conditions;
        let reason = connection.as_deref().unwrap_or(DRIVER_ABSENT);
        format!("{}: {reason}", describe_absence(without_driver, arrays))
    }

    /// Light that is not the expected one any longer, is again, or is not watched any more.
    fn new_light(&mut self, light: &[ServedLight]) -> Option<(Subject, Problem)> {
        let is_known = |one: &&ServedLight| self.off_light.contains(&one.of);
        let begun = light.iter().find(|one| one.off_since_s.is_some() && !is_known(one));
        if let Some(one) = begun {
            self.off_light.push(one.of.clone());
            let since = clock_time((one.off_since_s.unwrap_or_default() * 1e9) as Nanos);
            let problem = Problem::Warning(format!("{one} since {since}: {}", one.advice()));
            return Some((Subject::Light(one.of.clone()), problem));
        }
        let measured = |of: &String| light.iter().find(|one| one.of == *of);
        let is_off = |of: &String| measured(of).is_some_and(|one| one.off_since_s.is_some());
        let of = self.off_light.remove(self.off_light.iter().position(|of| !is_off(of))?);
        let end = match measured(&of) {
            Some(one) => format!("{one} again"),
            // Another source reports the users, or no array fits any more.
            None => format!("the light of {of} is not judged any longer"),
        };
        Some((Subject::Light(of), Problem::End(end)))
    }

    /// The most serious problem since the last snapshot.
    fn new_problem(&mut self, decision_loop: &DecisionLoop, swaps: &SwapCounters) -> Option<String> {
        let controller = decision_loop.room.controller();
        let (counters, refused) = (controller.counters(), controller.inbox().refused());
        let counts = [
            counters.degraded(DegradedMode::PolicyFailed) + counters.degraded(DegradedMode::Held),
            decision_loop.unsent(),
            swaps.refused,
            swaps.warnings,
            refused.total(),
            counters.foreign_arrays,
        ];
        let descriptions: [&dyn Fn() -> Option<String>; 6] = [
            &|| controller.last_failure().map(|failure| format!("policy {}: {failure}", controller.policy().name())),
            &|| Some("a command could not be sent: the session is closed".into()),
            &|| swaps.last_refusal.clone(),
            &|| swaps.last_warning.clone(),
            &|| describe_refusal(decision_loop),
            &|| {
                let (array, source) = counters.last_foreign_array?;
                Some(describe_foreign_array(array, source, controller.inbox().array_source(array)))
            },
        ];
        let before = std::mem::replace(&mut self.problems, counts);
        for ((count, before), describe) in counts.into_iter().zip(before).zip(descriptions) {
            if count > before
                && let Some(text) = describe()
            {
                self.occurrences = count - before;
                return Some(text);
            }
        }
        // The first of a series; the counter shows the others.
        let left_out_before = std::mem::replace(&mut self.left_out, refused.left_out());
        (left_out_before == 0).then(|| refused.last_left_out().map(describe_left_out)).flatten()
    }

    /// The last payload that did not decode, if there are more than at the last report of one.
    fn new_undecodable(&mut self, counts: &UndecodableCounts) -> Option<String> {
        let before = std::mem::replace(&mut self.undecodable, counts.total());
        self.occurrences = counts.total().saturating_sub(before);
        counts.last().filter(|_| before < counts.total()).map(str::to_owned)
    }
}

fn no_commands(unfit: &str) -> String {
    format!("the array receives no commands: {unfit}")
}

/// A problem of which no end is reported.
fn warning(text: String) -> (Subject, Problem) {
    (Subject::Other, Problem::Warning(text))
}

#[cfg(test)]
mod tests;
