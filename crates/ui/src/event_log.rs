//! What happened in the room, with times: changes of states, orders and their answers, stops, faults and
//! problems. The server keeps it, so that a page that opens later shows it too.

use std::collections::{BTreeMap, VecDeque};

use heliostat_proto::takeover_reason;
use heliostat_service::clock::utc_ns;
use serde::Serialize;

use crate::causes::{FAULTS, NO_REPORT, NoteLines, follows_from_stop, without_figures};
use crate::controllers::{ControllerFigures, Role};
use crate::expiry::EXPIRY;
use crate::figures::{Figures, GONE, Origin};
use crate::order_log::OrderFigures;
use crate::stop_state::{StopFigure, StopFigures, StopPhase};

/// Events that are kept.
const EVENTS_MAX: usize = 100;
/// A problem that is an event is no other one within this time: two that take turns would fill the log.
const REPEATED_MS: u64 = 60_000;
/// Most problems of one process, and most texts about one phase of a stop, that are events within this time: a sender
/// can invent any number.
const PROBLEMS_MAX: usize = 10;
/// Most stops that an event names, and most characters of each operator and of each reason.
const STOPS_NAMED: usize = 3;
const STOP_TEXT_MAX: usize = 100;

/// State of a controller that is in the room and reports.
const ALIVE: &str = "alive";

/// States of a stop.
const CONFIRMED: &str = "confirmed by every array";
const LOST: &str = "no longer confirmed";
const RELEASED: &str = "released";

/// One event.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Event {
    /// Time in ms since 1970 UTC.
    at_ms: u64,
    text: String,
    /// Whether it is a problem.
    is_bad: bool,
}

/// The last events, and the states that the next ones are compared with.
#[derive(Debug, Default)]
pub(crate) struct EventLog {
    events: VecDeque<Event>,
    /// The state of each subject, in words.
    states: BTreeMap<String, String>,
    /// The problems of each process without their figures, and the times of their last events.
    problems: BTreeMap<String, u64>,
    /// The notes about the room.
    notes: NoteLines,
    /// The source of each process at the last call.
    sources: BTreeMap<String, String>,
    /// The controllers of the room at the last call.
    controllers: Vec<ControllerFigures>,
    /// The name of the last leader.
    leader: String,
}

impl EventLog {
    /// Notes what has changed since the last call; returns whether anything has.
    pub fn note(&mut self, figures: &Figures, orders: &[OrderFigures], stop: &StopFigures) -> bool {
        self.note_at(utc_ns() / 1_000_000, figures, orders, stop)
    }

    fn note_at(&mut self, at_ms: u64, figures: &Figures, orders: &[OrderFigures], stop: &StopFigures) -> bool {
        self.problems.retain(|_, last| at_ms.saturating_sub(*last) < REPEATED_MS);
        let kept = self.events.len().min(EVENTS_MAX);
        let last = self.events.back().cloned();
        let origin = match figures.origin {
            Origin::Simulated => "simulated",
            Origin::Real => "real",
            Origin::NoData => NO_REPORT,
        };
        self.change(at_ms, "room", origin, figures.origin == Origin::NoData);
        let is_moving = ["following", "holding"].iter().any(|state| figures.array.state.starts_with(state));
        self.change(at_ms, "mirrors", &figures.array.state, !is_moving);
        // Neither a fault nor a problem is over because its process is silent.
        if figures.array.silent.is_empty() {
            self.change(at_ms, "faults", &figures.array.faults.join(", "), !figures.array.faults.is_empty());
        }
        let before = self.states.get("controller").map_or(NO_REPORT, String::as_str);
        let controller = match controller_state(figures) {
            // None has been in the room yet, as far as this viewer knows.
            GONE if before == NO_REPORT => NO_REPORT,
            state => state,
        };
        self.change(at_ms, "controller", controller, controller != ALIVE);
        // Its progress is no event.
        let calibration = if figures.calibration.is_some() { "commands the mirrors" } else { "" };
        self.change(at_ms, "calibration", calibration, false);
        self.note_takeovers(at_ms, &figures.controllers);
        if !figures.policy.is_empty() {
            self.change(at_ms, "policy", &figures.policy, false);
        }
        let before = self.states.get("stop").map_or("", String::as_str);
        let was_confirmed = [CONFIRMED, LOST].iter().any(|state| before.starts_with(state));
        let phase = match stop.phase {
            StopPhase::None => "",
            StopPhase::Requested => "requested",
            StopPhase::Unconfirmed if was_confirmed => LOST,
            StopPhase::Unconfirmed => "not confirmed",
            StopPhase::Confirmed => CONFIRMED,
            StopPhase::Released => RELEASED,
        };
        let is_same_phase = before == phase || before.strip_prefix(phase).is_some_and(|by| by.starts_with(" ("));
        let text = format!("{phase}{}", in_words(&stop.stops));
        let (is_new, key) = (before != text, format!("stop: {text}"));
        if is_new && !(is_same_phase && (self.problems.contains_key(&key) || self.is_full("stop: "))) {
            self.change(at_ms, "stop", &text, !matches!(stop.phase, StopPhase::Released));
            self.problems.insert(key, at_ms);
        }
        for node in figures.nodes.iter().filter(|node| node.state != GONE) {
            // The last status before a release still has the stop as its problem.
            if stop.phase != StopPhase::None && follows_from_stop(&node.problem) {
                continue;
            }
            let subject = format!("problem of {}", node.node);
            let words = without_figures(&node.problem);
            let source_before = self.sources.insert(node.node.clone(), node.source.clone());
            let is_replaced = source_before.is_some_and(|before| before != node.source);
            // A controller that was in the room already has had this problem before it is displayed.
            if is_replaced && self.controllers.iter().any(|one| one.name == node.source) {
                self.states.insert(subject, node.problem.clone());
                continue;
            }
            if self.states.get(&subject).is_some_and(|state| without_figures(state) == words) {
                continue;
            }
            let of_subject = format!("{subject}: ");
            let key = format!("{of_subject}{words}");
            if !self.problems.contains_key(&key) && (words.is_empty() || !self.is_full(&of_subject)) {
                self.change(at_ms, &subject, &node.problem, true);
                if !words.is_empty() {
                    self.problems.insert(key, at_ms);
                }
            }
        }
        self.controllers.clone_from(&figures.controllers);
        // The faults have the line of their change, which the silence of an array does not end.
        let notes: Vec<String> = figures.notes.iter().filter(|note| !note.starts_with(FAULTS)).cloned().collect();
        let (begun, ended) = self.notes.next(at_ms, &notes);
        begun.into_iter().for_each(|note| self.push(at_ms, note, true));
        ended.into_iter().for_each(|line| self.push(at_ms, line, false));
        // Oldest first.
        for order in orders.iter().rev() {
            let Some((answer, is_bad)) = order.answer.in_log() else { continue };
            let key = format!("order {}", order.id);
            if self.states.get(&key) != Some(&answer) {
                self.push(at_ms, format!("order: {}: {answer}", order.what), is_bad);
                self.states.insert(key, answer);
            }
        }
        self.states.retain(|key, _| {
            key.strip_prefix("order ").is_none_or(|id| orders.iter().any(|order| order.id.to_string() == id))
        });
        self.events.len() != kept || self.events.back() != last.as_ref()
    }

    /// The events as JSON, oldest first.
    pub fn json(&self) -> String {
        // Serialization of these types cannot fail: they hold only numbers, texts and lists.
        serde_json::to_string(&self.events).unwrap_or_default()
    }

    /// Whether a subject has had so many problems lately that a further one is no event.
    fn is_full(&self, of_subject: &str) -> bool {
        self.problems.keys().filter(|noted| noted.starts_with(of_subject)).count() >= PROBLEMS_MAX
    }

    /// Notes each takeover since the last call, with its reason as far as this viewer sees the former leader.
    fn note_takeovers(&mut self, at_ms: u64, controllers: &[ControllerFigures]) {
        for one in controllers {
            let Some(before) = self.controllers.iter().find(|before| before.name == one.name) else { continue };
            let (is_contested, name) = (one.false_takeovers > before.false_takeovers, &one.name);
            if one.takeovers <= before.takeovers {
                continue;
            }
            let is_former = !self.leader.is_empty() && self.leader != *name;
            let former = if is_former { self.leader.as_str() } else { "another controller" };
            let has_ended = is_former && !controllers.iter().any(|other| other.name == self.leader);
            let reason = takeover_reason(has_ended, is_contested);
            let text = format!("controller {name} leads, took over from {former}: {reason}");
            self.push(at_ms, text, is_contested || !has_ended);
        }
        if let Some(leader) = controllers.iter().find(|one| one.role == Role::Leads) {
            self.leader.clone_from(&leader.name);
        }
    }

    /// Notes the state of a subject if it has changed; an empty one is noted as the end of the last. That nothing is known at
    /// the start is not bad.
    fn change(&mut self, at_ms: u64, subject: &str, state: &str, is_bad: bool) {
        let before = self.states.insert(subject.to_owned(), state.to_owned()).unwrap_or_default();
        if before == state {
            return;
        }
        let (text, is_bad) = match (before.as_str(), state) {
            // The release was the end of the stop.
            (RELEASED, "") if subject == "stop" => return,
            (_, "") => (format!("{subject}: over"), false),
            ("", state) => (format!("{subject}: {state}"), is_bad && state != NO_REPORT),
            (_, state) if subject.starts_with("problem") || subject == "stop" => {
                (format!("{subject}: {state}"), is_bad)
            }
            (before, state) => (format!("{subject}: {before} \u{2192} {state}"), is_bad),
        };
        self.push(at_ms, text, is_bad);
    }

    fn push(&mut self, at_ms: u64, text: String, is_bad: bool) {
        if self.events.len() >= EVENTS_MAX {
            self.events.pop_front();
        }
        self.events.push_back(Event { at_ms, text, is_bad });
    }
}

/// The operators and the reasons of the first stops. A stop of a start has no operator, and one of the button no reason.
fn in_words(stops: &[StopFigure]) -> String {
    let known = |stop: &StopFigure| -> Vec<String> {
        let texts = [&stop.operator, &stop.reason].into_iter().filter(|text| !text.is_empty());
        texts.map(|text| text.chars().take(STOP_TEXT_MAX).collect::<String>()).collect()
    };
    let mut all = stops.iter().map(known).filter(|known| !known.is_empty());
    let named: String = all.by_ref().take(STOPS_NAMED).map(|known| format!(" ({})", known.join(": "))).collect();
    if all.next().is_some() { format!("{named} and more") } else { named }
}

/// The state of the controller. One that hangs is silent before its token ends.
fn controller_state(figures: &Figures) -> &'static str {
    let is_old = figures.ages_s.present_controller.is_some_and(|age_s| age_s >= EXPIRY.as_secs_f64());
    // A standby reports, although the status of the leader is still the last one.
    let is_silent = is_old && figures.controllers.iter().all(|one| one.role == Role::Silent);
    match (figures.controller_alive, figures.controller_unseen) {
        (true, _) if is_silent => "silent",
        (true, _) => ALIVE,
        (false, true) => "not seen",
        (false, false) => GONE,
    }
}

#[cfg(test)]
mod tests;
