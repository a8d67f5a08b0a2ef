//! What was refused, counted by name, and the last thing that went wrong, in words.

use std::collections::BTreeMap;
use std::fmt::Display;

/// Counts of refusals by name: what it was about, a colon, why.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Refused {
    counts: BTreeMap<String, u64>,
    last_problem: String,
}

impl Refused {
    /// One refusal.
    pub fn note(&mut self, about: &str, why: &str, problem: &dyn Display) {
        self.count(&format!("{about}:{why}"), format!("{about}: {problem}"));
    }

    /// One occurrence of anything else, under a name.
    pub fn count(&mut self, name: &str, problem: String) {
        *self.counts.entry(name.to_owned()).or_default() += 1;
        self.last_problem = problem;
    }

    /// Sets a count that is kept elsewhere; none of it is no entry.
    pub fn set(&mut self, name: &str, count: u64) {
        if count > 0 {
            self.counts.insert(name.to_owned(), count);
        }
    }

    /// The counts by name.
    pub fn counts(&self) -> &BTreeMap<String, u64> {
        &self.counts
    }

    /// The last problem; empty while there was none.
    pub fn last_problem(&self) -> &str {
        &self.last_problem
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_by_name_and_keeps_the_last_words() {
        let mut refused = Refused::default();
        refused.note("command", "wrong-version", &"version 9");
        refused.note("command", "wrong-version", &"version 8");
        refused.note("stop", "truncated", &"too short");
        assert_eq!(
            refused.counts(),
            &BTreeMap::from([("command:wrong-version".into(), 2), ("stop:truncated".into(), 1)])
        );
        assert_eq!(refused.last_problem(), "stop: too short");
    }
}
