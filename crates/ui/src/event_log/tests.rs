//! Which changes are events.

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

#[test]
fn what_is_unknown_at_the_start_is_not_bad() {
    let (mut log, no_stop) = (EventLog::default(), StopFigures::default());
    let array = ArrayFigures { state: NO_REPORT.into(), ..ArrayFigures::default() };
    log.note_at(1, &Figures { array, ..Figures::default() }, &[], &no_stop);
    let unknown = ["room: no report", "mirrors: no report", "controller: no report"];
    assert_eq!(texts(&log), unknown.map(|text| (1, text, false)));
    log.note_at(2, &figures("parked", ""), &[], &no_stop);
    let parked = (2, "mirrors: no report \u{2192} parked", true);
    assert!(texts(&log).contains(&parked), "{:?}", texts(&log));
    assert!(texts(&log).contains(&(2, "controller: no report \u{2192} alive", false)), "{:?}", texts(&log));
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
    let expected = [(3, "problem of controller: a new one", true), (4, "problem of controller: of the start", true)];
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
fn a_silent_room_and_a_silent_array_have_one_word() {
    let (mut log, no_stop) = (EventLog::default(), StopFigures::default());
    log.note_at(1, &figures("following", ""), &[], &no_stop);
    let first = texts(&log).len();
    log.note_at(2, &Figures { origin: Origin::NoData, ..figures(NO_REPORT, "") }, &[], &no_stop);
    let expected =
        [(2, "room: simulated \u{2192} no report", true), (2, "mirrors: following \u{2192} no report", true)];
    assert_eq!(texts(&log)[first..], expected);
}

#[test]
fn a_problem_is_not_over_because_its_process_has_left() {
    let (mut log, no_stop) = (EventLog::default(), StopFigures::default());
    let mut now = figures("following", "two sources");
    now.array.faults = vec!["link"];
    now.notes = vec![format!("{FAULTS}: link")];
    log.note_at(1, &now, &[], &no_stop);
    assert_eq!(texts(&log).iter().filter(|(_, text, _)| text.contains("link")).count(), 1, "{:?}", texts(&log));
    now.notes.clear();
    now.array = ArrayFigures { state: "no report".into(), silent: vec!["mirrors".into()], ..Default::default() };
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
fn a_process_that_invents_problems_does_not_fill_the_log() {
    let (mut log, no_stop) = (EventLog::default(), StopFigures::default());
    log.note_at(1, &figures("following", ""), &[], &no_stop);
    let first = texts(&log).len();
    for time in 0..100 {
        let problem = if time % 2 == 0 { "x".repeat(time + 1) } else { String::new() };
        log.note_at(100 * time as u64, &figures("following", &problem), &[], &no_stop);
    }
    assert_eq!(texts(&log)[first..].len(), 2 * PROBLEMS_MAX, "each with its end");
    log.note_at(100_000, &figures("following", "another"), &[], &no_stop);
    assert_eq!(texts(&log).last().copied(), Some((100_000, "problem of controller: another", true)));
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
    let order = |id, answer| [OrderFigures::new(id, "stop".into(), answer)];
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

#[test]
fn many_stops_and_new_reasons_of_one_do_not_fill_the_log() {
    let mut log = EventLog::default();
    let held = |stops: Vec<(String, String)>| StopFigures {
        phase: StopPhase::Confirmed,
        stops: stops
            .into_iter()
            .map(|(operator, reason)| StopFigure { operator, reason, ..StopFigure::default() })
            .collect(),
        ..StopFigures::default()
    };
    log.note_at(1, &figures("stopped", ""), &[], &held(Vec::new()));
    let first = texts(&log).len();
    for stops in 1..=64 {
        let many = (0..stops).map(|stop| (stop.to_string(), "r".repeat(1000))).collect();
        log.note_at(2, &figures("stopped", ""), &[], &held(many));
    }
    let shown = texts(&log)[first..].iter().map(|(_, text, _)| text.len()).collect::<Vec<_>>();
    assert!(shown.len() == 4 && shown.iter().all(|length| *length < 500), "{shown:?}");
    for reason in 0..100 {
        let one = vec![("ann".to_owned(), reason.to_string())];
        log.note_at(2000, &figures("stopped", ""), &[], &held(one));
    }
    assert_eq!(texts(&log)[first..].len(), PROBLEMS_MAX - 1, "with the text of no stop");
    let released = StopFigures { phase: StopPhase::Released, ..StopFigures::default() };
    log.note_at(3000, &figures("stopped", ""), &[], &released);
    assert_eq!(texts(&log).last().copied(), Some((3000, "stop: released", false)));
}
