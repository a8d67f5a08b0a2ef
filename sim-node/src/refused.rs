//! What was refused, counted by name, and the last thing that went wrong, in words.

use std::collections::BTreeMap;

use heliostat_proto::CodecError;

use crate::array::Refusal;
use crate::control;

/// Counts of refusals by name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Refused {
    counts: BTreeMap<String, u64>,
    last_problem: String,
}

impl Refused {
    /// A payload on the command key that is no command.
    pub fn malformed(&mut self, error: &CodecError) {
        self.note(&format!("command:{}", error.name()), 1, format!("command key: {error}"));
    }

    /// A command that the array does not follow.
    pub fn command(&mut self, refusal: &Refusal) {
        self.note(&format!("command:{}", refusal.name()), 1, format!("command: {refusal}"));
    }

    /// A part of an operator's order that the room does not follow.
    pub fn order(&mut self, refusal: &control::Refusal) {
        self.note(&format!("control:{}", refusal.name()), 1, format!("control: {refusal}"));
    }

    /// A payload on the key of orders that is none.
    pub fn malformed_order(&mut self, error: &CodecError) {
        self.note(&format!("control:{}", error.name()), 1, format!("control key: {error}"));
    }

    /// Anything else, under a name.
    pub fn note(&mut self, name: &str, times: u64, problem: String) {
        *self.counts.entry(name.to_owned()).or_default() += times;
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
        refused.malformed(&CodecError::WrongVersion { found: 9 });
        refused.malformed(&CodecError::WrongVersion { found: 8 });
        refused.command(&Refusal::OldSequence { found: 3, last: 4 });
        assert_eq!(
            refused.counts(),
            &BTreeMap::from([("command:old-sequence".into(), 1), ("command:wrong-version".into(), 2)])
        );
        assert_eq!(refused.last_problem(), "command: sequence 3 after 4 of the same epoch");
    }
}
