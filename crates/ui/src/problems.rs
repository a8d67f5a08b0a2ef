//! The problems that processes report, for as long as their cause lasts.
//!
//! A status repeats the last problem of its process for ever. It counts as current while its cause
//! is counted again and again, and some seconds after that. In the first status of a process it is
//! current only if it lasts, or if the process has just started: it may have ended long ago.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use heliostat_proto::{NodeKind, NodeStatus, make_place};

/// A problem is current this long after its last occurrence.
const CURRENT: Duration = Duration::from_secs(5);
/// Beginnings of the names of counters that rise with problems.
const COUNTED: [&str; 6] = ["refused:", "fallback:", "missed:", "policies_refused", "unsent", "unanswered"];
/// Counters that are above 0 as long as a problem lasts.
const LASTING: [&str; 6] = [
    NodeStatus::ARRAY_UNFIT,
    NodeStatus::STANDBY,
    NodeStatus::DRIVER_ABSENT,
    "device_absent",
    NodeStatus::STOP_UNRECORDED,
    NodeStatus::OTHER_PROCESSES,
];

/// How long a process had run when it sent its status.
pub(crate) fn running_for(status: &NodeStatus) -> Duration {
    Duration::from_nanos(status.stamp.time_ns.saturating_sub(status.started_ns))
}

/// The counters of commands of a former leader and to a stopped array: problems only where they rise in two statuses in
/// succession. A leader commands until it receives the stop, or its successor is obeyed.
const EXPECTED: [&str; 2] = ["refused:command:lower-epoch", "refused:command:stopped"];

/// The last problem of each process, by its name in [`Received::statuses`](crate::view::Received) and its
/// source.
#[derive(Debug, Default)]
pub(crate) struct Problems {
    last: BTreeMap<String, BTreeMap<u64, Occurrence>>,
}

#[derive(Debug)]
struct Occurrence {
    text: String,
    /// The counters of problems in the last status.
    counts: BTreeMap<String, u64>,
    /// The counters that rose when the text appeared.
    causes: BTreeSet<String>,
    /// The counters that rose in the last status.
    rose: BTreeSet<String>,
    /// The last occurrence; unknown for the text of a first status.
    at: Option<Instant>,
    /// Arrival of the last status.
    reported: Instant,
}

impl Problems {
    /// Notes the problem of a status that arrived now. It occurs again when a counter rises that rose
    /// when it appeared: another counter has another cause. Of very many processes of one name, those that are in the
    /// room have a place.
    pub fn take(&mut self, name: &str, status: &NodeStatus, is_present: impl Fn(u64) -> bool) {
        let now = Instant::now();
        let of_name = self.last.entry(name.to_owned()).or_default();
        of_name.retain(|_, last| last.reported.elapsed() < CURRENT);
        if !make_place(of_name, status.stamp.source, is_present) {
            return;
        }
        let counts: BTreeMap<String, u64> = causes(status).cloned().collect();
        let lasts =
            |name: &String| LASTING.contains(&name.as_str()) && counts.get(name).is_some_and(|count| *count > 0);
        let is_expected = |name: &String| EXPECTED.contains(&name.as_str());
        let last = of_name.get_mut(&status.stamp.source);
        let before = last.as_ref().map(|last| &last.counts);
        let has_risen =
            |name: &str, count: u64| before.and_then(|before| before.get(name)).is_none_or(|before| *before < count);
        let rose: BTreeSet<String> = counts
            .iter()
            .filter(|(name, count)| **count > 0 && has_risen(name, **count))
            .map(|(name, _)| name.clone())
            .collect();
        match last {
            Some(last) if last.text == status.last_problem => {
                // A cause is counted at times only after its text; what is counted long after it has another text.
                if last.causes.is_empty() && last.at.is_none_or(|at| at.elapsed() < CURRENT) {
                    last.causes.clone_from(&rose);
                }
                let has_recurred =
                    |name: &String| rose.contains(name) && (!is_expected(name) || last.rose.contains(name));
                if last.causes.iter().any(|name| lasts(name) || has_recurred(name)) {
                    last.at = Some(now);
                }
                last.counts = counts;
                last.rose = rose;
                last.reported = now;
            }
            _ => {
                let age = running_for(status);
                let are_expected = !rose.is_empty() && rose.iter().all(is_expected);
                let is_current = !are_expected && (last.is_some() || rose.iter().any(lasts) || age < CURRENT);
                let at = is_current.then_some(now);
                let text = status.last_problem.clone();
                let occurrence = Occurrence { text, counts, causes: rose.clone(), rose, at, reported: now };
                of_name.insert(status.stamp.source, occurrence);
            }
        }
    }

    /// The problem of a process, if it is current; else empty.
    pub fn current(&self, node: &str, source: u64) -> &str {
        let last = self.last.get(node).and_then(|of_name| of_name.get(&source));
        last.filter(|last| last.at.is_some_and(|at| at.elapsed() < CURRENT)).map_or("", |last| &last.text)
    }
}

/// The counters of a status that can count the cause of its problem. The text of a refusal begins with the kind of
/// message: then the refusals of this kind alone. The texts of a device and of a
/// record have lasting counters alone.
fn causes(status: &NodeStatus) -> impl Iterator<Item = &(String, u64)> {
    let is_named = move |counter: &str| {
        let about = counter.strip_prefix("refused:").and_then(|name| name.split(':').next());
        let rest = about.and_then(|about| status.last_problem.strip_prefix(about));
        rest.is_some_and(|rest| rest.starts_with(": "))
    };
    let is_refusal = status.counters.iter().any(|(name, _)| is_named(name));
    let is_refusal_or_device = is_refusal || status.node == NodeKind::Driver;
    status.counters.iter().filter(move |(name, _)| {
        let is_counted = COUNTED.iter().any(|start| name.starts_with(start));
        LASTING.contains(&name.as_str()) || (is_counted && (!is_refusal_or_device || is_named(name)))
    })
}

#[cfg(test)]
mod tests {
    use heliostat_proto::{SOURCES_MAX, Stamp};

    use super::*;

    fn status(problem: &str, counters: &[(&str, u64)]) -> NodeStatus {
        let counters = counters.iter().map(|(name, count)| ((*name).to_owned(), *count)).collect();
        // A minute after the start of the process.
        let stamp = Stamp { source: 7, time_ns: 60_000_000_000, ..Stamp::default() };
        NodeStatus { stamp, last_problem: problem.into(), counters, ..NodeStatus::default() }
    }

    /// Notes the status of a process that is in the room.
    fn take(problems: &mut Problems, name: &str, status: &NodeStatus) {
        problems.take(name, status, |_| true);
    }

    fn age(problems: &mut Problems, by: Duration) {
        let occurrences = problems.last.values_mut().flat_map(BTreeMap::values_mut);
        occurrences.filter_map(|last| last.at.as_mut()).for_each(|at| *at -= by);
    }

    #[test]
    fn the_text_of_a_first_status_is_no_problem_until_its_cause_is_counted() {
        let (mut problems, node) = (Problems::default(), NodeStatus::default().node.name());
        let expired = |count| status("the command has expired", &[("refused:command:expired", count)]);
        take(&mut problems, node, &expired(1));
        assert_eq!(problems.current(node, 7), "", "it may have ended long ago");
        take(&mut problems, node, &expired(1));
        assert_eq!(problems.current(node, 7), "");
        take(&mut problems, node, &expired(2));
        assert_eq!(problems.current(node, 7), "the command has expired");
        // Another process of this name.
        let other = |started_ns| {
            let text = expired(3);
            NodeStatus { stamp: Stamp { source: 8, ..text.stamp }, started_ns, ..text }
        };
        take(&mut problems, node, &other(0));
        assert_eq!(problems.current(node, 8), "");
        problems.last.clear();
        take(&mut problems, node, &other(59_000_000_000));
        assert_eq!(problems.current(node, 8), "the command has expired", "it has just started");
    }

    #[test]
    fn a_problem_ends_some_seconds_after_its_cause() {
        let (mut problems, node) = (Problems::default(), NodeStatus::default().node.name());
        let expired = |count| status("the command has expired", &[("refused:command:expired", count)]);
        take(&mut problems, node, &status("", &[]));
        take(&mut problems, node, &expired(1));
        assert_eq!(problems.current(node, 7), "the command has expired");
        age(&mut problems, CURRENT);
        assert_eq!(problems.current(node, 7), "");
        // The cause is counted again.
        take(&mut problems, node, &expired(2));
        assert_eq!(problems.current(node, 7), "the command has expired");
        age(&mut problems, CURRENT);
        take(&mut problems, node, &expired(2));
        assert_eq!(problems.current(node, 7), "", "the text alone is no new problem");
    }

    #[test]
    fn a_command_of_a_former_leader_or_to_a_stopped_array_is_a_problem_only_if_more_follow_at_once() {
        for expected in EXPECTED {
            let (mut problems, node) = (Problems::default(), NodeKind::Driver.name());
            let mut shown = |text: &str, refused, malformed| {
                let counters = [(expected, refused), ("refused:command:not-finite", malformed)];
                take(&mut problems, node, &NodeStatus { node: NodeKind::Driver, ..status(text, &counters) });
                problems.current(node, 7).to_owned()
            };
            let text = "command: a command of epoch 1: expected at least 2";
            assert_eq!([shown("", 0, 0), shown(text, 1, 0), shown(text, 1, 0)], [""; 3]);
            // The next stop, or the next takeover, with the same text.
            assert_eq!([shown(text, 2, 0), shown(text, 2, 0)], [""; 2]);
            assert_eq!([shown(text, 3, 0), shown(text, 4, 0)], ["", text]);
            assert_eq!(shown("command: not finite", 5, 1), "command: not finite");
        }
    }

    #[test]
    fn an_old_problem_does_not_return_with_another_cause() {
        let (mut problems, node) = (Problems::default(), NodeStatus::default().node.name());
        take(&mut problems, node, &status("", &[("policies_refused", 0), ("fallback:withheld", 0)]));
        let refusal =
            |withheld| status("there is no such policy", &[("policies_refused", 1), ("fallback:withheld", withheld)]);
        take(&mut problems, node, &refusal(0));
        assert_eq!(problems.current(node, 7), "there is no such policy");
        age(&mut problems, CURRENT);
        // A stop withholds commands; the status still has the last text.
        take(&mut problems, node, &refusal(5));
        assert_eq!(problems.current(node, 7), "");
    }

    #[test]
    fn an_old_problem_without_a_counted_cause_does_not_return_with_a_later_count() {
        let (mut problems, node) = (Problems::default(), NodeKind::Controller.name());
        let left = |missed| status("controller 7 has left", &[("missed:late", missed)]);
        take(&mut problems, node, &status("", &[("missed:late", 0)]));
        take(&mut problems, node, &left(0));
        assert_eq!(problems.current(node, 7), "controller 7 has left");
        age(&mut problems, CURRENT);
        for missed in 1..3 {
            take(&mut problems, node, &left(missed));
            assert_eq!(problems.current(node, 7), "", "{missed}");
        }
    }

    #[test]
    fn the_old_text_of_a_device_is_no_problem_while_a_driver_counts_refusals() {
        let (mut problems, node) = (Problems::default(), NodeKind::Driver.name());
        let of_driver = |problem: &str, absent, expired| {
            let counters = [("device_absent", absent), ("refused:command:expired", expired)];
            NodeStatus { node: NodeKind::Driver, ..status(problem, &counters) }
        };
        let mut shown = |problem: &str, absent, expired| {
            take(&mut problems, node, &of_driver(problem, absent, expired));
            let shown = problems.current(node, 7).to_owned();
            age(&mut problems, CURRENT);
            shown
        };
        let device = "port: no answer";
        assert_eq!([shown(device, 0, 3), shown(device, 0, 4), shown(device, 0, 5)], [""; 3], "the device has returned");
        assert_eq!([shown(device, 1, 6), shown(device, 1, 7)], [device; 2], "it is absent again");
        assert_eq!(shown("command: the command has expired", 0, 8), "command: the command has expired");
        assert_eq!(shown("command: the command has expired", 0, 9), "command: the command has expired");
    }

    #[test]
    fn an_old_refusal_is_no_problem_while_messages_of_another_kind_are_refused() {
        let (mut problems, node) = (Problems::default(), NodeKind::SimNode.name());
        let mut shown = |control, command| {
            let counters = [("refused:control:too-many", control), ("refused:command:expired", command)];
            let status = NodeStatus { node: NodeKind::SimNode, ..status("control: 64 users: too many", &counters) };
            take(&mut problems, node, &status);
            problems.current(node, 7).to_owned()
        };
        assert_eq!([shown(1, 3), shown(1, 4), shown(1, 5)], [""; 3]);
        assert_eq!(shown(2, 5), "control: 64 users: too many");
    }

    #[test]
    fn a_lasting_state_keeps_no_text_of_another_cause() {
        let (mut problems, node) = (Problems::default(), NodeKind::Controller.name());
        let refusal = |count| status("users: outside-room", &[("standby", 1), ("refused:users:outside-room", count)]);
        take(&mut problems, node, &status("", &[("standby", 1), ("refused:users:outside-room", 0)]));
        take(&mut problems, node, &refusal(1));
        assert_eq!(problems.current(node, 7), "users: outside-room");
        age(&mut problems, CURRENT);
        take(&mut problems, node, &refusal(1));
        assert_eq!(problems.current(node, 7), "", "it stands by, and refuses nothing");
    }

    #[test]
    fn a_lasting_problem_is_current_without_new_counts() {
        let (mut problems, node) = (Problems::default(), NodeStatus::default().node.name());
        let unfit = status("the array receives no commands", &[(NodeStatus::ARRAY_UNFIT, 1)]);
        take(&mut problems, node, &unfit);
        age(&mut problems, CURRENT);
        take(&mut problems, node, &unfit);
        assert_eq!(problems.current(node, 7), "the array receives no commands");
    }

    #[test]
    fn another_process_with_mirrors_is_a_problem_as_long_as_it_is_in_the_room() {
        let (mut problems, node) = (Problems::default(), NodeKind::SimNode.name());
        let mut shown = |others| {
            let counters = [(NodeStatus::OTHER_PROCESSES, others), ("refused:another-process", 1)];
            let status = status("another simulator has joined the room", &counters);
            take(&mut problems, node, &NodeStatus { node: NodeKind::SimNode, ..status });
            let shown = problems.current(node, 7).to_owned();
            age(&mut problems, CURRENT);
            shown
        };
        let text = "another simulator has joined the room";
        assert_eq!([shown(1), shown(1), shown(0), shown(0)], [text, text, "", ""]);
    }

    #[test]
    fn a_stop_that_is_not_recorded_is_a_problem_in_the_first_status_that_a_viewer_sees() {
        for node in [NodeKind::SimNode, NodeKind::Driver] {
            let mut problems = Problems::default();
            let text = "cannot record the emergency stop in lab.stop.toml: Permission denied";
            let unrecorded = status(text, &[(NodeStatus::STOP_UNRECORDED, 1), ("refused:command:stopped", 9)]);
            take(&mut problems, node.name(), &NodeStatus { node, ..unrecorded });
            assert_eq!(problems.current(node.name(), 7), text);
        }
    }

    #[test]
    fn the_problems_of_very_many_processes_do_not_keep_out_that_of_one_in_the_room() {
        let (mut problems, node) = (Problems::default(), NodeKind::Viewer.name());
        let started_ns = 59_000_000_000;
        for source in 1..=500 {
            let stamp = Stamp { source, ..status("", &[]).stamp };
            let status = NodeStatus { stamp, started_ns, ..status("it has just started", &[]) };
            problems.take(node, &status, |source| source == 500);
        }
        assert_eq!(problems.last[node].len(), SOURCES_MAX);
        assert_eq!([problems.current(node, 500), problems.current(node, 499)], ["it has just started", ""]);
    }
}
