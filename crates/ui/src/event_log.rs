//! What happened in the room, with times: changes of states, orders and their answers, stops, faults and
//! problems. The server keeps it, so that a page that opens later shows it too.

use std::collections::{BTreeMap, VecDeque};

use heliostat_proto::takeover_reason;
use heliostat_service::clock::utc_ns;
use serde::Serialize;

use crate::causes::{follows_from_stop, not_in, over, without_figures};
use crate::controllers::{ControllerFigures, Role};
use crate::expiry::EXPIRY;
use crate::figures::{Figures, GONE, Origin};
use crate::order_log::OrderFigures;
use crate::stop_state::{StopFigure, StopFigures, StopPhase};

/// Events that are kept.
const EVENTS_MAX: usize = 100;
/// A problem that is an event is no other one within this time: two that take turns would fill the log.
const REPEATED_MS: u64 = 60_000;

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
    /// The notes about the room at the last call.
    notes: Vec<String>,
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
            Origin::Measured => "measured",
            Origin::NoData => "no data",
        };
        self.change(at_ms, "room", origin, figures.origin == Origin::NoData);
        let is_moving = ["following", "holding"].iter().any(|state| figures.array.state.starts_with(state));
        self.change(at_ms, "mirrors", &figures.array.state, !is_moving);
        // Neither a fault nor a problem is over because its process is silent.
        if figures.array.silent.is_empty() {
            self.change(at_ms, "faults", &figures.array.faults.join(", "), !figures.array.faults.is_empty());
        }
        let controller = controller_state(figures);
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
        // A stop of a start has no operator, and one of the button no reason.
        let known = |stop: &StopFigure| {
            [&stop.operator, &stop.reason].into_iter().filter(|text| !text.is_empty()).cloned().collect()
        };
        let by = stop.stops.iter().map(known).filter(|known: &Vec<String>| !known.is_empty());
        let by: String = by.map(|known| format!(" ({})", known.join(": "))).collect();
        self.change(at_ms, "stop", &format!("{phase}{by}"), !matches!(stop.phase, StopPhase::Released));
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
            let key = format!("{subject}: {words}");
            if !self.problems.contains_key(&key) {
                self.change(at_ms, &subject, &node.problem, true);
                if !words.is_empty() {
                    self.problems.insert(key, at_ms);
                }
            }
        }
        self.controllers.clone_from(&figures.controllers);
        let notes = std::mem::replace(&mut self.notes, figures.notes.clone());
        for note in not_in(&figures.notes, &notes) {
            self.push(at_ms, note.clone(), true);
        }
        for note in not_in(&notes, &figures.notes) {
            self.push(at_ms, over(note), false);
        }
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

    /// Notes the state of a subject if it has changed; an empty one is noted as the end of the last.
    fn change(&mut self, at_ms: u64, subject: &str, state: &str, is_bad: bool) {
        let before = self.states.insert(subject.to_owned(), state.to_owned()).unwrap_or_default();
        if before == state {
            return;
        }
        let (text, is_bad) = match (before.as_str(), state) {
            // The release was the end of the stop.
            (RELEASED, "") if subject == "stop" => return,
            (_, "") => (format!("{subject}: over"), false),
            ("", state) => (format!("{subject}: {state}"), is_bad),
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

/// The state of the controller. One that hangs is silent before its token ends.
fn controller_state(figures: &Figures) -> &'static str {
    let is_old = figures.ages_s.present_controller.is_some_and(|age_s| age_s >= EXPIRY.as_secs_f64());
    // A standby reports, although the status of the leader is still the last one.
    let is_silent = is_old && figures.controllers.iter().all(|one| one.role == Role::Silent);
    match (figures.controller_alive, figures.controller_unseen) {
        (true, _) if is_silent => "silent",
        (true, _) => ALIVE,
        (false, true) => "not seen",
        (false, false) => "gone",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figures::{Ages, ArrayFigures, NodeFigures};
    use crate::order_answer::Answer;

    fn figures(state: &str, problem: &str) -> Figures {
        Figures {
            origin: Origin::Simulated,
            policy: "greedy".into(),
            controller_alive: true,
            array: ArrayFigures { state: state.into(), ..ArrayFigures::default() },
            nodes: vec![NodeFigures { node: "controller".into(), problem: problem.into(), ..NodeFigures::default() }],
            ..Figures::default()
        }
    }

    fn texts(log: &EventLog) -> Vec<(u64, &str, bool)> {
        log.events.iter().map(|event| (event.at_ms, event.text.as_str(), event.is_bad)).collect()
    }

    #[test]
    fn only_changes_are_events() {
        let (mut log, no_stop) = (EventLog::default(), StopFigures::default());
        assert!(log.note_at(1, &figures("following", ""), &[], &no_stop));
        assert!(!log.note_at(2, &figures("following", ""), &[], &no_stop));
        let first = texts(&log).len();
        assert!(log.note_at(3, &figures("parked", "reports refused"), &[], &no_stop));
        assert!(log.note_at(4, &figures("following", ""), &[], &no_stop));
        assert_eq!(
            texts(&log)[first..],
            [
                (3, "mirrors: following \u{2192} parked", true),
                (3, "problem of controller: reports refused", true),
                (4, "mirrors: parked \u{2192} following", false),
                (4, "problem of controller: over", false),
            ]
        );
    }

    fn controller(name: &str, role: Role, takeovers: u64, false_takeovers: u64) -> ControllerFigures {
        ControllerFigures { name: name.into(), role, takeovers, false_takeovers, ..ControllerFigures::default() }
    }

    #[test]
    fn an_old_problem_of_a_controller_that_is_displayed_in_place_of_another_is_no_event() {
        let (mut log, no_stop) = (EventLog::default(), StopFigures::default());
        let shown = |source: &str, problem: &str, present: &[&str]| {
            let mut now = figures("following", problem);
            now.nodes[0].source = source.into();
            now.controllers = present.iter().map(|name| controller(name, Role::Leads, 0, 0)).collect();
            now
        };
        log.note_at(1, &shown("a", "", &["a", "b"]), &[], &no_stop);
        let first = texts(&log).len();
        log.note_at(2, &shown("b", "an old one", &["b"]), &[], &no_stop);
        log.note_at(3, &shown("b", "a new one", &["b"]), &[], &no_stop);
        // A controller that has just started has no old problem.
        log.note_at(4, &shown("c", "of the start", &["c"]), &[], &no_stop);
        let expected =
            [(3, "problem of controller: a new one", true), (4, "problem of controller: of the start", true)];
        assert_eq!(texts(&log)[first..], expected);
    }

    #[test]
    fn each_takeover_is_an_event_with_both_controllers_and_the_reason() {
        let (mut log, no_stop) = (EventLog::default(), StopFigures::default());
        let (leads, stands_by) = (Role::Leads, Role::StandsBy);
        let rounds = [
            vec![controller("a", leads, 0, 0), controller("b", stands_by, 0, 0)],
            vec![controller("b", leads, 1, 0), controller("a", stands_by, 0, 0)],
            vec![controller("a", leads, 1, 1), controller("b", stands_by, 1, 0)],
            vec![controller("b", stands_by, 1, 0)],
            vec![controller("b", leads, 2, 0), controller("c", stands_by, 0, 0)],
            vec![controller("c", leads, 1, 1)],
        ];
        let mut first = 0;
        for (time, controllers) in (1..).zip(rounds) {
            log.note_at(time, &Figures { controllers, ..figures("following", "") }, &[], &no_stop);
            first = if time == 1 { texts(&log).len() } else { first };
        }
        let expected = [
            (2, format!("controller b leads, took over from a: {}", takeover_reason(false, false)), true),
            (3, format!("controller a leads, took over from b: {}", takeover_reason(false, true)), true),
            (5, format!("controller b leads, took over from a: {}", takeover_reason(true, false)), false),
            (6, format!("controller c leads, took over from b: {}", takeover_reason(true, true)), true),
        ];
        let noted = log.events.iter().skip(first).map(|event| (event.at_ms, event.text.clone(), event.is_bad));
        assert_eq!(noted.collect::<Vec<_>>(), expected);
    }

    #[test]
    fn a_calibration_is_one_event_at_its_begin_and_one_at_its_end() {
        let (mut log, no_stop) = (EventLog::default(), StopFigures::default());
        log.note_at(1, &figures("following", ""), &[], &no_stop);
        let first = texts(&log).len();
        for (time, progress) in [(2, Some("spot 1 of 3")), (3, Some("spot 2 of 3")), (4, None), (5, None)] {
            let calibration = progress.map(str::to_owned);
            log.note_at(time, &Figures { calibration, ..figures("following", "") }, &[], &no_stop);
        }
        let expected = [(2, "calibration: commands the mirrors", false), (4, "calibration: over", false)];
        assert_eq!(texts(&log)[first..], expected);
    }

    #[test]
    fn a_controller_that_is_not_seen_is_not_gone() {
        let (mut log, no_stop) = (EventLog::default(), StopFigures::default());
        log.note_at(1, &figures("following", ""), &[], &no_stop);
        let first = texts(&log).len();
        for (time, controller_unseen) in [(2, true), (3, false)] {
            let now = Figures { controller_alive: false, controller_unseen, ..figures("following", "") };
            log.note_at(time, &now, &[], &no_stop);
        }
        let shown: Vec<_> = texts(&log)[first..].iter().map(|(_, text, _)| *text).collect();
        assert_eq!(shown, ["controller: alive \u{2192} not seen", "controller: not seen \u{2192} gone"]);
    }

    #[test]
    fn a_controller_that_hangs_is_silent_before_it_is_gone() {
        let (mut log, no_stop) = (EventLog::default(), StopFigures::default());
        log.note_at(1, &figures("following", ""), &[], &no_stop);
        let first = texts(&log).len();
        let hung = |age_s, controllers| Figures {
            ages_s: Ages { present_controller: Some(age_s), ..Ages::default() },
            controllers,
            ..figures("following", "")
        };
        log.note_at(2, &hung(2.5, vec![controller("a", Role::Leads, 0, 0)]), &[], &no_stop);
        let (silent, standby) = (controller("a", Role::Silent, 0, 0), controller("b", Role::StandsBy, 0, 0));
        log.note_at(3, &hung(3.1, vec![standby, silent.clone()]), &[], &no_stop);
        log.note_at(4, &hung(3.2, vec![silent]), &[], &no_stop);
        let gone = Figures { controller_alive: false, ..figures("following", "") };
        log.note_at(5, &gone, &[], &no_stop);
        let expected = [(4, "controller: alive \u{2192} silent", true), (5, "controller: silent \u{2192} gone", true)];
        assert_eq!(texts(&log)[first..], expected);
    }

    #[test]
    fn a_stop_is_an_event_with_what_is_known_of_its_sender() {
        let mut log = EventLog::default();
        let stop = |operator: &str, reason: &str| StopFigures {
            phase: StopPhase::Confirmed,
            stops: vec![StopFigure { operator: operator.into(), reason: reason.into(), ..StopFigure::default() }],
            ..StopFigures::default()
        };
        log.note_at(1, &figures("stopped", ""), &[], &StopFigures::default());
        let first = texts(&log).len();
        for (time, operator, reason) in [(2, "ann", "ladder"), (3, "ann", ""), (4, "", "no record"), (5, "", "")] {
            log.note_at(time, &figures("stopped", ""), &[], &stop(operator, reason));
        }
        let by = [
            "stop: confirmed by every array (ann: ladder)",
            "stop: confirmed by every array (ann)",
            "stop: confirmed by every array (no record)",
            "stop: confirmed by every array",
        ];
        assert_eq!(texts(&log)[first..].iter().map(|(_, text, _)| *text).collect::<Vec<_>>(), by);
    }

    #[test]
    fn a_stop_ends_with_its_release_and_its_confirmation_can_be_lost() {
        let mut log = EventLog::default();
        let stop = |phase| StopFigures { phase, ..StopFigures::default() };
        log.note_at(1, &figures("stopped", ""), &[], &stop(StopPhase::None));
        let first = texts(&log).len();
        let phases = [
            StopPhase::Requested,
            StopPhase::Confirmed,
            StopPhase::Unconfirmed,
            StopPhase::Unconfirmed,
            StopPhase::Confirmed,
            StopPhase::Released,
            StopPhase::None,
        ];
        for (time, phase) in (2..).zip(phases) {
            log.note_at(time, &figures("stopped", ""), &[], &stop(phase));
        }
        let expected = [
            "stop: requested",
            "stop: confirmed by every array",
            "stop: no longer confirmed",
            "stop: confirmed by every array",
            "stop: released",
        ];
        assert_eq!(texts(&log)[first..].iter().map(|(_, text, _)| *text).collect::<Vec<_>>(), expected);
    }

    #[test]
    fn a_problem_is_not_over_because_its_process_has_left() {
        let (mut log, no_stop) = (EventLog::default(), StopFigures::default());
        let mut now = figures("following", "two sources");
        now.array.faults = vec!["link"];
        log.note_at(1, &now, &[], &no_stop);
        now.array = ArrayFigures { state: "no telemetry".into(), silent: vec!["mirrors".into()], ..Default::default() };
        now.nodes[0] = NodeFigures { state: GONE.into(), problem: String::new(), ..now.nodes[0].clone() };
        log.note_at(2, &now, &[], &no_stop);
        assert!(!texts(&log).iter().any(|(_, text, _)| text.ends_with(": over")), "{:?}", texts(&log));
        log.note_at(3, &figures("following", ""), &[], &no_stop);
        let over: Vec<_> = texts(&log).into_iter().filter(|(_, text, _)| text.ends_with(": over")).collect();
        assert_eq!(over, [(3, "faults: over", false), (3, "problem of controller: over", false)]);
    }

    #[test]
    fn problems_that_take_turns_do_not_fill_the_log() {
        let (mut log, no_stop) = (EventLog::default(), StopFigures::default());
        log.note_at(1, &figures("following", ""), &[], &no_stop);
        let first = texts(&log).len();
        for time in 0..50 {
            let problem = if time % 2 == 0 { format!("a report is {time}.5 s old") } else { "two sources".to_owned() };
            log.note_at(1000 * time, &figures("following", &problem), &[], &no_stop);
        }
        log.note_at(50_000, &figures("following", ""), &[], &no_stop);
        log.note_at(51_000, &figures("following", "two sources"), &[], &no_stop);
        log.note_at(200_000, &figures("following", "two sources"), &[], &no_stop);
        let expected = [
            (0, "problem of controller: a report is 0.5 s old", true),
            (1000, "problem of controller: two sources", true),
            (50_000, "problem of controller: over", false),
            (200_000, "problem of controller: two sources", true),
        ];
        assert_eq!(texts(&log)[first..], expected);
    }

    #[test]
    fn a_problem_that_begins_again_and_lasts_is_an_event_within_a_minute() {
        let (mut log, no_stop) = (EventLog::default(), StopFigures::default());
        log.note_at(1, &figures("following", ""), &[], &no_stop);
        let first = texts(&log).len();
        for second in 0..300 {
            // It ends for one second.
            let problem = if second == 30 { String::new() } else { format!("a report is {second}.5 s old") };
            log.note_at(1000 * second, &figures("following", &problem), &[], &no_stop);
        }
        let expected = [
            (0, "problem of controller: a report is 0.5 s old", true),
            (30_000, "problem of controller: over", false),
            (60_000, "problem of controller: a report is 60.5 s old", true),
        ];
        assert_eq!(texts(&log)[first..], expected);
    }

    #[test]
    fn what_a_controller_withheld_because_of_a_stop_is_no_event_after_the_release() {
        let (mut log, problem) = (EventLog::default(), "withheld by the stop of ann");
        let stop = |phase| StopFigures { phase, ..StopFigures::default() };
        log.note_at(1, &figures("following", ""), &[], &stop(StopPhase::Confirmed));
        let first = texts(&log).len();
        log.note_at(2, &figures("following", problem), &[], &stop(StopPhase::Released));
        assert_eq!(texts(&log)[first..], [(2, "stop: released", false)]);
    }

    #[test]
    fn problems_of_two_parts_are_two_events() {
        let (mut log, no_stop) = (EventLog::default(), StopFigures::default());
        log.note_at(1, &figures("following", ""), &[], &no_stop);
        let first = texts(&log).len();
        let problems = ["no driver of mirrors-1", "no driver of mirrors-2", "LED 0 brings 0.61", "LED 10 brings 0.60"];
        for (second, problem) in (0..).zip(problems) {
            log.note_at(1000 * second, &figures("following", problem), &[], &no_stop);
        }
        let shown: Vec<_> =
            texts(&log)[first..].iter().map(|(_, text, _)| text.replace("problem of controller: ", "")).collect();
        assert_eq!(shown, problems);
    }

    #[test]
    fn a_note_is_an_event_when_it_begins_and_when_it_ends_each_time() {
        let (mut log, no_stop) = (EventLog::default(), StopFigures::default());
        let note = "no driver receives the commands";
        let with = |notes: &[&str]| Figures {
            notes: notes.iter().map(|note| (*note).to_owned()).collect(),
            ..figures("following", "")
        };
        log.note_at(1, &with(&[]), &[], &no_stop);
        let first = texts(&log).len();
        for (time, notes) in [(2, &[note][..]), (3, &[note]), (4, &[]), (5, &[note])] {
            log.note_at(time, &with(notes), &[], &no_stop);
        }
        let before = texts(&log).len();
        log.note_at(6, &with(&[note, "LED 0 brings 0.61"]), &[], &no_stop);
        assert!(!log.note_at(7, &with(&[note, "LED 0 brings 0.59"]), &[], &no_stop), "only a figure has changed");
        assert_eq!(texts(&log)[before..], [(6, "LED 0 brings 0.61", true)]);
        log.events.truncate(before);
        let over = format!("over: {note}");
        assert_eq!(texts(&log)[first..], [(2, note, true), (4, over.as_str(), false), (5, note, true)]);
    }

    #[test]
    fn an_order_is_an_event_when_it_is_answered_and_the_log_is_bounded() {
        let (mut log, no_stop) = (EventLog::default(), StopFigures::default());
        let order = |id, answer| [OrderFigures { id, what: "stop".into(), answer }];
        log.note_at(1, &figures("following", ""), &order(1, Answer::Sent), &no_stop);
        let first = texts(&log).len();
        log.note_at(2, &figures("following", ""), &order(1, Answer::Done), &no_stop);
        log.note_at(3, &figures("following", ""), &order(1, Answer::Done), &no_stop);
        assert_eq!(texts(&log)[first..], [(2, "order: stop: done", false)]);
        for time in 0..300 {
            let state = if time % 2 == 0 { "parked" } else { "following" };
            assert!(log.note_at(time, &figures(state, ""), &[], &no_stop), "a full log changes too");
        }
        assert_eq!(log.events.len(), EVENTS_MAX);
    }
}
