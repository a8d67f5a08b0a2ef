//! Counts of refusals by name, and the text of the last problem.

use std::collections::BTreeMap;
use std::fmt::Display;

/// Name of the count of other processes with the same mirrors that have joined the room.
pub const ANOTHER_PROCESS: &str = "another-process";

/// Name of the count of messages that were dropped before they were handled.
pub const DROPPED: &str = "dropped";

/// A count in words, as a line of a summary.
pub fn line(name: &str, count: u64) -> String {
    let (heading, words) = match (name, name.split_once(':')) {
        (ANOTHER_PROCESS, _) => ("other process", "joined the room with the same mirrors".to_owned()),
        (DROPPED, _) => ("dropped", "messages, because the queue of received messages was full".to_owned()),
        (_, Some((kind, reason))) => ("refused", format!("of kind {kind}: {}", reason.replace('-', " "))),
        (_, None) => ("refused", name.replace('-', " ")),
    };
    format!("{heading:<16}{count} {words}")
}

/// Counts of refusals by name, which is the kind of message, a colon and the reason.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RefusalCounts {
    counts: BTreeMap<String, u64>,
    last_problem: String,
    problems: u64,
}

impl RefusalCounts {
    /// Counts one refusal of a message of kind `about`.
    pub fn note(&mut self, about: &str, why: &str, problem: &dyn Display) {
        self.count(&format!("{about}:{why}"), format!("{about}: {problem}"));
    }

    /// Counts one occurrence of another problem under a name.
    pub fn count(&mut self, name: &str, problem: String) {
        self.count_without_problem(name);
        self.last_problem = problem;
        self.problems += 1;
    }

    /// Counts one refusal under a name that is no problem.
    pub fn count_without_problem(&mut self, name: &str) {
        *self.counts.entry(name.to_owned()).or_default() += 1;
    }

    /// Sets a count that is kept elsewhere; a count of 0 has no entry.
    pub fn set(&mut self, name: &str, count: u64) {
        if count > 0 {
            self.counts.insert(name.to_owned(), count);
        }
    }

    /// The counts by name.
    pub fn counts(&self) -> &BTreeMap<String, u64> {
        &self.counts
    }

    /// Number of problems so far.
    pub fn problems(&self) -> u64 {
        self.problems
    }

    /// The text of the last problem; empty before the first.
    pub fn last_problem(&self) -> &str {
        &self.last_problem
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusals_are_counted_by_name_and_the_last_problem_is_kept() {
        let mut refused = RefusalCounts::default();
        refused.note("command", "wrong-version", &"version 9");
        refused.note("command", "wrong-version", &"version 8");
        refused.note("stop", "truncated", &"too short");
        assert_eq!(
            refused.counts(),
            &BTreeMap::from([("command:wrong-version".into(), 2), ("stop:truncated".into(), 1)])
        );
        assert_eq!(refused.last_problem(), "stop: too short");
    }

    #[test]
    fn a_summary_has_each_count_in_words() {
        for (name, expected) in [
            ("command:wrong-version", "refused         2 of kind command: wrong version"),
            (DROPPED, "dropped         2 messages, because the queue of received messages was full"),
            (ANOTHER_PROCESS, "other process   2 joined the room with the same mirrors"),
        ] {
            assert_eq!(line(name, 2), expected);
        }
    }
}
