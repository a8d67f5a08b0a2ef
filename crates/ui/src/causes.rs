//! Which problems follow from which: one cause is one line.

use heliostat_proto::gauges::ServedLight;
use heliostat_proto::{ArrayState, NodeStatus};
use heliostat_scenario::ROOM_DIFFERS;

use crate::expiry::EXPIRY;

/// The note about one controller that sees no other process of its room.
pub(crate) const OTHERS_MISSING: &str = "a controller is alone, without array, tracker and other controller: check the link to their host or router, and start them again if they have ended or hang";
/// The note about a room whose controller has seen another one, and sees none.
pub(crate) const STANDBY_MISSING: &str = "the standby has gone: the end of the one controller parks the mirrors; start the standby again, or restart the controller where one is enough";
/// Beginning of the note about commands that reach no driver.
pub(crate) const NO_DRIVER: &str = NodeStatus::NO_DRIVER;
/// Beginning of the note about absent position reports, of a viewer that stays open.
pub(crate) const NO_POSITIONS: &str = "no process reports the positions of users";
/// Beginning of the same note about a simulated room, whose positions and array are of one process.
pub(crate) const NO_SIMULATED_POSITIONS: &str = "the simulator reports no positions of users";
/// Beginning of the same problem, of a viewer that counts the reports.
pub(crate) const NO_REPORTS: &str = "no position reports";
/// Beginning of the problem of an array that does not follow; its state comes behind a colon.
pub(crate) const NOT_FOLLOWING: &str = "the array does not follow";
/// Beginning of the problem of an array that reports faults; their names come behind a colon.
pub(crate) const FAULTS: &str = "faults of the array";
/// The problem of a room whose controllers all stand by.
pub(crate) const ALL_STAND_BY: &str = "no controller leads: each stands by";
/// The problem of a room in which no telemetry shows the leader.
pub(crate) const UNKNOWN_LEADER: &str = "no controller leads: no telemetry shows which one the array follows";
/// Beginning of the problem of a room without a controller.
pub(crate) const NO_CONTROLLER_SEEN: &str = "no controller: start one";

/// Between a cause and what follows from it.
const CONSEQUENCES: &str = "; it causes: ";
/// State of a part of the room that does not report. Of arrays the names follow, where others report.
pub(crate) const NO_REPORT: &str = "no report";
/// Between the names of arrays.
pub(crate) const AND: &str = " and ";
/// States of an array that receives no commands.
const UNCOMMANDED: [&str; 2] = ["parked", "holding"];

/// Whether the second text follows from the first one.
fn causes(cause: &str, text: &str) -> bool {
    let state = text.strip_prefix(NOT_FOLLOWING).and_then(|rest| rest.strip_prefix(": "));
    let silent = state.and_then(silent_arrays);
    let begins_with = |starts: &[&str]| starts.iter().any(|start| text.starts_with(start));
    if cause.starts_with(OTHERS_MISSING) {
        return silent.is_some()
            || begins_with(&[NO_DRIVER, NO_POSITIONS, NO_SIMULATED_POSITIONS, NO_REPORTS])
            || [STANDBY_MISSING, ALL_STAND_BY, UNKNOWN_LEADER].contains(&text);
    }
    if let Some(which) = cause.strip_prefix(NO_DRIVER) {
        let absent = which.strip_prefix(" to ").and_then(|which| which.split_once(": ")).map(|(names, _)| names);
        let Some(absent) = absent else {
            return silent.is_some() || text == UNKNOWN_LEADER || begins_with(&[NO_SIMULATED_POSITIONS]);
        };
        // Another array that is silent has a cause of its own.
        let is_absent = |name: &str| absent.split(AND).any(|absent| absent == name);
        return text == UNKNOWN_LEADER || silent.is_some_and(|names| names.split(AND).all(is_absent));
    }
    // One process: where it drives no array, another one is silent too.
    if cause.starts_with(NO_SIMULATED_POSITIONS) {
        return silent == Some("") || text == UNKNOWN_LEADER || begins_with(&[NO_REPORTS]);
    }
    if cause.starts_with(FAULTS) {
        return state == Some(ArrayState::Fault.name());
    }
    let is_uncommanding = [NO_REPORTS, NO_CONTROLLER_SEEN, ALL_STAND_BY].iter().any(|start| cause.starts_with(start));
    is_uncommanding && state.is_some_and(|state| UNCOMMANDED.contains(&state))
}

/// The names of the arrays that do not report, of which a state has nothing else to say; empty for all arrays.
fn silent_arrays(state: &str) -> Option<&str> {
    let rest = state.strip_prefix(ArrayState::Following.name()).map_or(state, |rest| rest.trim_start_matches(", "));
    match rest.strip_prefix(NO_REPORT)? {
        "" => Some(""),
        of => of.strip_prefix(" of "),
    }
}

/// These problems with each one that follows from another in the line of its cause, without its advice. The line has
/// the place of the first of them.
pub(crate) fn folded(mut problems: Vec<String>) -> Vec<String> {
    let mut lines = Vec::new();
    while !problems.is_empty() {
        let first = &problems[0];
        let of_first = problems.iter().position(|other| causes(other, first)).unwrap_or(0);
        let cause = problems.remove(of_first);
        let (following, others): (Vec<String>, Vec<String>) =
            problems.into_iter().partition(|problem| causes(&cause, problem));
        lines.push(with_consequences(cause, &following));
        problems = others;
    }
    lines
}

/// A line of a cause and these problems; the line may have others already.
fn with_consequences(mut cause: String, following: &[String]) -> String {
    for problem in following {
        cause += if cause.contains(CONSEQUENCES) { ", " } else { CONSEQUENCES };
        cause += problem.split(": ").next().unwrap_or_default();
    }
    cause
}

/// The beginning of the note about two drivers, and beginning and part of what a controller reports because
/// of them. A second source of users is another fault.
pub(crate) const TWO_DRIVERS: &str = "two drivers serve one array";
const OF_TWO_DRIVERS: [(&str, &str); 2] =
    [("a second source ", " reports telemetry of "), (NodeStatus::FOREIGN_ARRAY, "")];

/// Whether a controller reports this problem because of what a note states: in a room of another geometry it expects
/// another light.
pub(crate) fn follows_from(notes: &[String], problem: &str) -> bool {
    let is_noted = |start: &str| notes.iter().any(|note| note.starts_with(start));
    let is_of = |(start, part): &(&str, &str)| problem.starts_with(start) && problem.contains(part);
    (is_noted(TWO_DRIVERS) && OF_TWO_DRIVERS.iter().any(is_of))
        || (is_noted(ROOM_DIFFERS) && problem.contains(ServedLight::IN_WORDS))
}

/// The notes of a room and of its geometry, a difference of geometries before its consequences, and without those
/// that follow from it.
pub(crate) fn causes_first(of_room: Vec<String>, of_geometry: Vec<String>) -> Vec<String> {
    let (mut notes, others) = causes_and_others(of_geometry);
    let of_room: Vec<String> = of_room.into_iter().filter(|note| !follows_from(&notes, note)).collect();
    notes.extend(of_room.into_iter().chain(others));
    notes
}

/// The notes from which other problems follow, about geometries that differ and about a cut link, and the others.
pub(crate) fn causes_and_others(notes: impl IntoIterator<Item = String>) -> (Vec<String>, Vec<String>) {
    notes.into_iter().partition(|note| note.starts_with(ROOM_DIFFERS) || note.starts_with(OTHERS_MISSING))
}

/// Whether a controller reports this problem because of an emergency stop in force.
pub(crate) fn follows_from_stop(problem: &str) -> bool {
    problem.starts_with(NodeStatus::WITHHELD_BY)
}

/// What a driver reports of a command that it refuses because it is stopped, with advice for the sender.
const LATCHED: &str = "command: an emergency stop is latched";

/// This problem in words for an operator, where commands of another process to a stopped array cause it; empty where no
/// stop is shown: it is over with the release.
pub(crate) fn of_stopped(problem: &str, is_stopped: bool) -> Option<&'static str> {
    let still =
        "commands still arrive at the stopped array, which refuses them: find the process that sends them, and end it";
    problem.starts_with(LATCHED).then_some(if is_stopped { still } else { "" })
}

/// A text without its figures, which differ at each occurrence of one fault. The digit of a name stays, as in
/// `LED 0` and `mirrors-1`.
pub(crate) fn without_figures(text: &str) -> String {
    let mut kept = String::with_capacity(text.len());
    for symbol in text.chars() {
        // A digit stays only in a name, so one before another is of the same name.
        let is_in_name = kept.ends_with("LED ")
            || kept.ends_with(|last: char| last.is_ascii_digit())
            || kept.strip_suffix('-').is_some_and(|word| word.ends_with(char::is_alphabetic));
        if !symbol.is_ascii_digit() || is_in_name {
            kept.push(symbol);
        }
    }
    kept
}

/// Whether a line of a cause has this problem as a consequence.
fn has_consequence(line: &str, problem: &str) -> bool {
    let fault = problem.split(": ").next().unwrap_or_default();
    line.split_once(CONSEQUENCES).is_some_and(|(_, all)| all.split(", ").any(|one| one == fault))
}

/// A note without its consequences.
fn alone(note: &str) -> &str {
    note.split(CONSEQUENCES).next().unwrap_or_default()
}

/// Whether two texts are one note: figures and consequences may differ.
fn is_same(one: &str, other: &str) -> bool {
    without_figures(alone(one)) == without_figures(alone(other))
}

/// The notes that are neither among the others nor consequences of one of them.
fn not_in<'a>(notes: &'a [String], others: &[String]) -> Vec<&'a String> {
    let is_other = |note: &str| others.iter().any(|other| is_same(other, note) || has_consequence(other, note));
    notes.iter().filter(|note| !is_other(note)).collect()
}

/// Which notes of a log begin and which are over: a note has one line at its begin and one at its end. A consequence
/// has the lines of its cause. Where it outlives its cause, it has its own lines after [`OUTLIVES_MS`].
#[derive(Debug, Default)]
pub(crate) struct NoteLines {
    /// The notes at the last call.
    notes: Vec<String>,
    /// The notes that have outlived their causes, and the times of their lines in ms.
    outliving: Vec<(String, u64)>,
}

/// The processes that a cause has kept away return one after another.
const OUTLIVES_MS: u64 = EXPIRY.as_millis() as u64;

impl NoteLines {
    /// The notes of the last call that begin so.
    pub fn beginning(&self, start: &str) -> Vec<String> {
        self.notes.iter().filter(|note| note.starts_with(start)).cloned().collect()
    }

    /// The notes that begin at this time in ms, and the lines of those that are over. Faults that change are not over.
    pub fn next(&mut self, at_ms: u64, notes: &[String]) -> (Vec<String>, Vec<String>) {
        let before = std::mem::replace(&mut self.notes, notes.to_vec());
        let is_in = |notes: &[String], note: &str| notes.iter().any(|other| is_same(other, note));
        let has_no_line = |note: &str| self.outliving.iter().any(|(outliving, _)| is_same(outliving, note));
        let are_faults = |note: &str| note.starts_with(FAULTS);
        let goes_on = |note: &str| are_faults(note) && notes.iter().any(|other| are_faults(other));
        let ended = not_in(&before, notes).into_iter().filter(|note| !has_no_line(note) && !goes_on(note));
        let ended = ended.map(|note| over(note)).collect();
        let mut begun: Vec<String> = not_in(notes, &before).into_iter().cloned().collect();
        let has_outlived =
            |note: &&String| !is_in(&before, note) && before.iter().any(|cause| has_consequence(cause, note));
        self.outliving.extend(notes.iter().filter(has_outlived).map(|note| (note.clone(), at_ms + OUTLIVES_MS)));
        self.outliving.retain(|(note, due_ms)| {
            let is_due = at_ms >= *due_ms;
            begun.extend(notes.iter().find(|current| is_due && is_same(current, note)).cloned());
            !is_due && is_in(notes, note)
        });
        (begun, ended)
    }
}

/// The line about a note that has ended: its fault without advice and consequences, which end with it or have notes of
/// their own.
pub(crate) fn over(note: &str) -> String {
    let note = alone(note);
    let mut depth = 0_i32;
    let end = note.char_indices().find(|(at, symbol)| {
        match symbol {
            '(' => depth += 1,
            ')' => depth -= 1,
            _ => {}
        }
        // One word before a colon is the endpoint of the fault.
        depth == 0 && note[*at..].starts_with(": ") && note[..*at].contains(' ')
    });
    format!("over: {}", end.map_or(note, |(at, _)| &note[..at]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_ended_is_named_without_its_advice_and_its_consequences() {
        let line = format!("{OTHERS_MISSING}{CONSEQUENCES}{NO_DRIVER}");
        assert_eq!(over(&line), "over: a controller is alone, without array, tracker and other controller");
        let refused = "controller c1 refuses the reports (users: stale): it could not take over";
        assert_eq!(over(refused), "over: controller c1 refuses the reports (users: stale)");
        let endpoint = "tls/lab:7448: the certificate of lab has expired: renew it";
        assert_eq!(over(endpoint), "over: tls/lab:7448: the certificate of lab has expired");
        assert_eq!(over("another note"), "over: another note");
        assert_eq!(over(&format!("another note{CONSEQUENCES}{NO_DRIVER}")), "over: another note");
    }

    #[test]
    fn a_lost_simulator_is_one_line_with_what_follows_from_it() {
        let silent = format!("{NOT_FOLLOWING}: {NO_REPORT}");
        let reports = format!("{NO_REPORTS}: start the tracker");
        let driver = format!("{NO_DRIVER}: start a driver");
        let problems = |cause: &str| [reports.as_str(), cause, &silent, "another", &driver].map(str::to_owned).to_vec();
        let line = format!("{OTHERS_MISSING}; it causes: {NO_REPORTS}, {NOT_FOLLOWING}, {NO_DRIVER}");
        assert_eq!(folded(problems(OTHERS_MISSING)), [line.clone(), "another".to_owned()]);
        // The notes of a viewer are folded before its other problems come to them.
        let of_viewer = format!("{OTHERS_MISSING}; it causes: {NO_DRIVER}");
        assert_eq!(folded(vec![reports, of_viewer.clone()]), [format!("{of_viewer}, {NO_REPORTS}")]);
        assert_eq!(not_in(std::slice::from_ref(&line), &[of_viewer]), [""; 0], "the same note");
        assert_eq!(not_in(&[driver, "another".to_owned()], &[line]), ["another"], "it is not over");
    }

    #[test]
    fn on_the_cut_off_side_the_missing_standby_and_leader_follow_from_the_cut_link() {
        for leader in [ALL_STAND_BY, UNKNOWN_LEADER] {
            let problems = [STANDBY_MISSING, leader, OTHERS_MISSING].map(str::to_owned).to_vec();
            let line = format!("{OTHERS_MISSING}; it causes: the standby has gone, no controller leads");
            assert_eq!(folded(problems), [line]);
        }
    }

    #[test]
    fn a_consequence_has_the_lines_of_its_cause_and_its_own_where_it_lasts() {
        let mut lines = NoteLines::default();
        let driver = format!("{NO_DRIVER}: start a driver");
        let line = format!("{OTHERS_MISSING}{CONSEQUENCES}{NO_DRIVER}");
        let [over_cause, over_driver] = [over(&line), over(&driver)];
        let mut next = |at_ms, notes: &[&String]| {
            let (begun, ended) = lines.next(at_ms, &notes.iter().map(|note| (*note).clone()).collect::<Vec<_>>());
            [begun, ended].concat()
        };
        assert_eq!(next(0, &[&line]), [line.as_str()]);
        assert_eq!(next(100, &[&driver]), [over_cause.as_str()]);
        assert_eq!(next(200, &[]), [""; 0], "it had no line of its own");
        assert_eq!(next(300, &[&line]), [line.as_str()]);
        assert_eq!(next(400, &[&driver]), [over_cause.as_str()]);
        assert_eq!(next(400 + OUTLIVES_MS, &[&driver]), [driver.as_str()], "it lasts");
        assert_eq!(next(500 + OUTLIVES_MS, &[&driver]), [""; 0]);
        assert_eq!(next(600 + OUTLIVES_MS, &[]), [over_driver.as_str()]);
        // A note that becomes a consequence has the line of its cause at the end.
        assert_eq!(next(9000, &[&driver]), [driver.as_str()]);
        assert_eq!(next(9100, &[&line]), [line.as_str()]);
        assert_eq!(next(9200, &[]), [over_cause.as_str()]);
    }

    #[test]
    fn an_array_without_a_driver_and_one_without_commands_are_one_line_with_their_cause() {
        let state = |state: &str| format!("{NOT_FOLLOWING}: {state}");
        let absent = format!("{NO_DRIVER} to mirrors-1: start its driver");
        let expected = format!("{absent}; it causes: {NOT_FOLLOWING}, no controller leads");
        let silent = state("following, no report of mirrors-1");
        assert_eq!(folded(vec![silent.clone(), UNKNOWN_LEADER.to_owned(), absent]), [expected]);
        for other in ["following, no report of mirrors-1 and mirrors-2", "fault, no report of mirrors-1"].map(state) {
            let absent = format!("{NO_DRIVER} to mirrors-1: start its driver");
            assert_eq!(folded(vec![absent.clone(), other.clone()]), [absent, other], "a part has another cause");
        }
        let simulator = format!("{NO_SIMULATED_POSITIONS}: start it");
        let reports = format!("{NO_REPORTS}: start the tracker");
        let expected = format!("{simulator}; it causes: {NO_REPORTS}, {NOT_FOLLOWING}");
        assert_eq!(folded(vec![reports, state(NO_REPORT), simulator.clone()]), [expected]);
        let lines = |driver: &str| folded(vec![driver.to_owned(), simulator.clone()]);
        let all = format!("{NO_DRIVER}: start a driver or a simulator");
        assert_eq!(lines(&all), [format!("{all}; it causes: {NO_SIMULATED_POSITIONS}")]);
        let one = format!("{NO_DRIVER} to mirrors-1: start its driver");
        assert_eq!(lines(&one), [one.as_str(), &simulator], "the simulator has another array");
        for cause in [NO_REPORTS, NO_CONTROLLER_SEEN, ALL_STAND_BY] {
            let lines = |state: &str| folded(vec![cause.to_owned(), state.to_owned()]);
            for uncommanded in UNCOMMANDED {
                assert_eq!(lines(&state(uncommanded)), [format!("{cause}; it causes: {NOT_FOLLOWING}")]);
            }
            for other in [state("fault"), silent.clone()] {
                assert_eq!(lines(&other), [cause, &other], "it has a cause of its own");
            }
        }
    }

    #[test]
    fn a_difference_of_geometries_comes_first_and_the_light_that_follows_from_it_is_left_out() {
        let [differ, light, missing, other] = [
            format!("{ROOM_DIFFERS}: room.height_m is 2.8 in the room and 4.0 in the controller c1; start both"),
            "LED 0 brings 1.31 of the expected light: look for receivers".to_owned(),
            NO_DRIVER.to_owned(),
            "the picture shows another room".to_owned(),
        ];
        let of_room = || vec![light.clone(), missing.clone()];
        let expected = [differ.clone(), missing.clone(), other.clone()];
        assert_eq!(causes_first(of_room(), vec![other.clone(), differ.clone()]), expected);
        assert_eq!(causes_first(of_room(), vec![other.clone()]), [light.clone(), missing, other]);
        assert!(follows_from(&[differ], &light), "the status of the controller has it too");
    }
}
